"""`learn predict`: the decomposition of one picture, without refinement.

It writes normals.exr (X, Y, Z, camera frame), light.exr (64×128, light frame) and rendering.exr,
each with a PNG beside it, material.json, and sheet.png.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from learn.data import framing, photographs
from learn.data.batch import ExampleBatch
from learn.data.devices import to_numpy
from learn.editing import light_colour, material_file, photograph
from learn.editing.decomposition import Parts, predict_framed, require_parts
from learn.editing.edit_files import save_png
from learn.editing.exposure import correct_exposure, measure_background, render_prediction
from learn.figures import montage
from learn.networks import weights as checkpoint
from learn.networks.prediction import Prediction
from learn.training import contact_sheet
from manifests import files, outputs
from shaders import tone

TILE = 160
# pictures of the parts, in the order of the contact sheet
CELLS = ("picture", "normals", "light", "material", "rendering")
CAPTIONS = {"picture": "photograph", "rendering": "rendered again"}
WRITTEN = (
    "material.json",
    "normals.exr",
    "light.exr",
    "rendering.exr",
    "mask.png",
    "sheet.png",
    *(f"{name}.png" for name in CELLS),
)


@dataclass(frozen=True)
class PredictedPicture:
    """What `learn predict` computes: a framed picture as a batch of one, and what was read from it.

    parts      of the prediction
    rendering  (H, W, 3) radiance of these parts
    metadata   of the network's weights
    """

    framed: framing.Framed
    batch: ExampleBatch
    prediction: Prediction
    parts: Parts
    rendering: np.ndarray
    metadata: dict


def run(
    image: Path,
    mask: Path | None,
    weights: Path,
    out: Path,
    exposure: float | None = None,
    overwrite: bool = False,
    device: str | torch.device = "cpu",
    fit_mask: bool | None = None,
) -> None:
    """Decompose a picture and write all results into the folder `out`.

    fit_mask  whether to fit the mask's edge to the picture; None: only if it is black and white
    Raises    InputError: an unusable picture, mask or weights, or files that are there already
    """
    out = Path(out)
    outputs.reserve_outputs(out, WRITTEN, overwrite, (image, mask))
    write(out, predict_picture(image, mask, weights, exposure, device, fit_mask), weights)


def predict_picture(
    image: Path,
    mask: Path | None,
    weights: Path,
    exposure: float | None,
    device: str | torch.device,
    fit_mask: bool | None = None,
) -> PredictedPicture:
    """Return the prediction of a picture, of a dataset's record, or of an example.

    Regions are one object here: there is one material.
    """
    network, metadata = checkpoint.load_full_network(weights, device)
    masks = [] if mask is None else [mask]
    opened = photograph.open_photograph(image, masks, exposure=exposure, fit_mask=fit_mask)
    framed = framing.frame_object(
        opened.radiance, opened.mask, metadata["size"], opened.exposure, image, opened.clipped
    )
    batch, predicted = predict_framed(framed, network)
    batch = replace(batch, elevation=opened.elevation)
    parts = light_colour.remove_green(require_parts(predicted))
    if opened.exposure is None:
        rendered = render_prediction(batch, predicted)
        framed, batch, _ = correct_exposure(framed, batch, rendered, measure_background(opened))
    shown = predicted._replace(label=parts.label, light=parts.light)
    rendering = render_prediction(batch, shown)
    return PredictedPicture(framed, batch, shown, parts, rendering, metadata)


def write(out: Path, result: PredictedPicture, weights: Path) -> None:
    """Write every file into the folder `out`, all or none."""
    framed, parts = result.framed, result.parts
    n = to_numpy((parts.n[0] * result.batch.mask[0]).movedim(0, -1))
    exposure = tone.auto_exposure(framed.radiance, framed.mask)
    cells = contact_sheet.draw_decomposition(
        result.batch, result.prediction, result.rendering, exposure
    )
    row = [(CAPTIONS.get(name, name), cell) for name, cell in cells.items()]
    out.mkdir(parents=True, exist_ok=True)
    with files.transaction():
        photographs.write_exr(out / "normals.exr", n, "XYZ")
        photographs.write_exr(out / "light.exr", to_numpy(parts.light[0].movedim(0, -1)))
        photographs.write_exr(out / "rendering.exr", result.rendering)
        for name, cell in cells.items():
            save_png(out / f"{name}.png", cell)
        save_png(out / "mask.png", 255.0 * framed.mask)
        save_png(out / "sheet.png", montage.contact_sheet([row], TILE))
        material_file.write(
            out / "material.json", to_numpy(parts.label[0]), framed, result.metadata, weights
        )
