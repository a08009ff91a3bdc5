"""One picture taken decomposition: what `learn predict` writes.

normals.exr (X, Y, Z, camera frame), light.exr (64×128, light frame), rendering.exr, each with a PNG
beside it, material.json, sheet.png
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from learn.data import devices, photographs
from learn.data.batch import ExampleBatch
from learn.data.devices import array
from learn.data.records import Records
from learn.figures.montage import rows as captioned
from learn.layer.inputs import LENGTH_TOLERANCE
from learn.networks import weights as checkpoint
from learn.training import montage as training_sheet
from learn.training import validation
from manifests import files
from manifests.errors import InputError
from manifests.materials import load_catalogue
from shaders import tone
from shaders.frames import ELEVATION

WEIGHTS = Path(__file__).parents[1] / "weights" / "joint-compact.safetensors"
NEAREST, TILE = 3, 160
# of the sheet, each a picture of its own
CELLS = ("picture", "normals", "light", "material", "rendering")
WRITTEN = (
    "material.json",
    "normals.exr",
    "light.exr",
    "rendering.exr",
    "mask.png",
    "sheet.png",
    *(f"{name}.png" for name in CELLS),
)


def of(framed, network, regions=None, count=1):
    """(ExampleBatch of one, Prediction) of a learn.data.photographs.Framed, on its device.

    regions  (size, size) 1 … S, None for one; count: S, of which a small one may have no pixel left
    at the network's size
    Raises   InputError: the network predicts what is not finite
    """
    image = torch.from_numpy(framed.radiance).movedim(-1, 0)[None].contiguous()
    mask = torch.from_numpy(framed.mask)
    segments = mask[None].long() if regions is None else torch.from_numpy(regions)[None]
    nothing = torch.zeros(1, 3, 64, 128) + 1
    label = torch.zeros(1, count, 108)
    normals = torch.zeros_like(image)
    batch = ExampleBatch(
        image,
        mask[None, None].float(),
        normals,
        segments,
        label,
        nothing,
        label,
        ("picture",),
        float(ELEVATION),
    )
    batch = batch.to(devices.of(network))
    with torch.no_grad():
        predicted = network(
            batch.image, batch.mask, batch.segments if count > 1 else None, regions=count
        )
    # 0 where numbers before their scaling overflowed
    lengths = predicted.n.movedim(1, -1)[mask[None].to(predicted.n.device)].norm(dim=-1)
    finite = all(part.isfinite().all() for part in (predicted.n, predicted.label, predicted.light))
    if not (finite and ((lengths - 1).abs() <= LENGTH_TOLERANCE).all()):
        rule = "weights that predict finite normals, light and material"
        raise InputError(
            "--weights", rule, "NaN or infinity", "train them again, or leave --weights out"
        )
    return batch, predicted


def write(image, mask, weights, out, exposure=None, overwrite=False, device="cpu"):
    """Predict and write everything. Raises InputError: bad picture, mask or weights, or files that
    are there already.
    """
    out = Path(out)
    files.reserve_outputs(out, WRITTEN, overwrite, (image, mask))
    if mask is not None and Path(image).is_dir():
        raise InputError(
            "--mask",
            "a photograph: a dataset's records have masks",
            f"the dataset {image}",
            "leave --mask out",
        )
    network, metadata = checkpoint.load_parts(weights, device)
    radiance, covered, exposure = (
        _from_record(image, exposure)
        if Path(image).is_dir()
        else (*photographs.read(image, mask), exposure)
    )
    framed = photographs.framed(radiance, covered, metadata["size"], exposure, image)
    batch, predicted = of(framed, network)
    seen = replace(batch, n=predicted.n, label=predicted.label, light=predicted.light)
    again = validation.picture(predicted.n, predicted.label, predicted.light, seen)[0]
    out.mkdir(parents=True, exist_ok=True)
    n = array((predicted.n[0] * batch.mask[0]).movedim(0, -1))
    light = array(predicted.light[0].movedim(0, -1))
    bright = tone.auto_exposure(framed.radiance, framed.mask)
    cells = training_sheet.parts(batch, predicted, again, bright)
    names = {"picture": "photograph", "rendering": "rendered again"}
    with files.transaction():
        photographs.write_exr(out / "normals.exr", n, "XYZ")
        photographs.write_exr(out / "light.exr", light)
        photographs.write_exr(out / "rendering.exr", again)
        for name, cell in cells.items():
            _save(out / f"{name}.png", cell)
        _save(out / "mask.png", 255.0 * framed.mask)
        _save(
            out / "sheet.png",
            captioned([[(names.get(name, name), cell) for name, cell in cells.items()]], TILE),
        )
        write_material(out / "material.json", array(predicted.label[0]), framed, metadata, weights)


def _from_record(folder, exposure):
    """radiance, mask and exposure of a dataset's first record on the test side, or its first; its
    light has unit mean: exposure 1.
    """
    records = Records(folder)
    if not len(records):
        raise InputError(
            folder, "records", "none", "render some: python -m factory render JOB --out DIR"
        )
    record = next((r for r in records.records if r.split == "test"), records.records[0])
    _, _, segments = records.geometry(record)
    return records.image(record), segments > 0, 1.0 if exposure is None else exposure


def write_material(path, labels, framed, metadata, weights):
    """Labels (S, 108), the catalogue's materials nearest to each by code, and how the picture was
    brought to the network.
    """
    report = {"label": _rounded(labels[0]), "nearest": nearest(labels[0], metadata["ranges"])}
    if len(labels) > 1:
        report = {
            "labels": [_rounded(label) for label in labels],
            "nearest": [nearest(label, metadata["ranges"]) for label in labels],
        }
    report |= {
        "box": framed.box,
        "exposure": framed.exposure,
        "weights": Path(weights).name,
        "run": metadata["run"].get("name"),
    }
    files.write_json(path, report)


def nearest(label, ranges):
    """Names of the catalogue's materials nearest to a label (108,) by code."""
    catalogue = load_catalogue()
    names = sorted(catalogue)
    codes = ranges.code(
        torch.from_numpy(np.stack([catalogue[name].label.reshape(-1) for name in names])).float()
    )
    order = ((codes - ranges.code(torch.from_numpy(label))) ** 2).mean(-1).argsort()[:NEAREST]
    return [names[i] for i in order]


def _rounded(label):
    return [round(float(x), 6) for x in label]


def _save(path, cell):
    photographs.require_finite(path, cell)
    files.write_image(path, np.clip(cell, 0, 255).astype(np.uint8))
