"""Ways to enlarge an edit (learn.experiments.upsampling), measured on rendered pictures larger than
the network's, beside their truth.

Each twice: with our parts, refined, and with true ones at the network's size, where what is left is
the enlarging alone. OUT/rows.jsonl  a line an edit: the same command goes on from them, and with
more --edits adds to them
"""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from tqdm import tqdm

from learn.data import pairs, photographs
from learn.editing import decomposition, photograph
from learn.experiments import upsampling
from learn.metrics import bootstrap
from learn.metrics.pictures import l2_and_ssim
from learn.networks import weights as checkpoint
from learn.networks.prediction import Prediction
from learn.refinement import RefinementSettings
from manifests import files, lock
from manifests.errors import InputError
from manifests.provenance import provenance
from manifests.store import Lines, file_hash


def measure_upsampling(records, weights, out, count, seed=0):
    """enlarging.json: a row for each way and kind of parts; ratios against the way in use. records:
    learn.data.records.Records.
    """
    network, metadata = checkpoint.load_parts(weights)
    size = metadata["size"]
    edits = pairs.chosen(records.records, count, seed)
    if any(edit.several for edit in edits):
        raise InputError(
            records.folder,
            "pictures of one material each",
            "several",
            "render without segment_materials",
        )
    if min(edits[0].source.camera.size) < 2 * size:
        result = " × ".join(map(str, edits[0].source.camera.size))
        raise InputError(
            records.folder,
            f"pictures of {2 * size} pixels or more, twice the network's",
            result,
            'render them with "size"',
        )
    with lock.writing(out, patience=0):
        return _measured(records, weights, network, size, edits, Path(out))


def _measured(records, weights, network, size, edits, out):
    """enlarging.json of learn.data.pairs.EditPairs, as far as they are not there."""
    settings, known = RefinementSettings(), {}
    files.pin_settings(
        out / "settings.json", {"weights": file_hash(weights), "refinement": asdict(settings)}
    )
    done, lines = (
        {row["edit"] for row in files.read_lines(out / "rows.jsonl")},
        Lines(out / "rows.jsonl"),
    )
    for edit in tqdm([edit for edit in edits if edit.id not in done], "edits", unit="edit"):
        if edit.source.id not in known:
            opened = photograph.opened(records.folder, record=edit.source.id)
            ours = decomposition.decompose(opened, network, size, settings)
            known = {
                edit.source.id: {
                    "ours": upsampling.painters(ours),
                    "true": upsampling.painters(true(records, ours)),
                }
            }
        label, truth = pairs.target_label(records, edit)[0].numpy(), records.image(edit.truth)
        row = {"edit": edit.id, "shape": edit.source.shape, "material": edit.truth.materials[0]}
        for parts, painters in known[edit.source.id].items():
            mask = painters["normals enlarged"].decomposition.photograph.mask
            row[parts] = {
                name: compared(painter.edited([label]), truth, mask)
                for name, painter in painters.items()
            }
        lines.append(row)
    lines.close()
    requested = {edit.id for edit in edits}
    rows = [row for row in files.read_lines(out / "rows.jsonl") if row["edit"] in requested]
    return written(
        out, rows, {"edits": len(edits), "size": edits[0].source.camera.size, "network": size}
    )


def true(records, found):
    """An Apart with its record's true normals, at the network's size, light and material."""
    sample, mask = records.load(found.photograph.record), found.framed.mask
    square = photographs.placed(sample.n.numpy(), found.framed.box)
    n = F.normalize(torch.from_numpy(photographs.resized(square, len(mask))), dim=-1).movedim(
        -1, 0
    )[None]
    toward = torch.tensor([0.0, 0.0, 1.0])[:, None, None]
    n = torch.where(torch.from_numpy(mask) & (n.norm(dim=1, keepdim=True) > 0.5), n, toward)
    label, light = (
        sample.label[None, : found.parts.label.shape[1]],
        sample.light.movedim(-1, 0)[None],
    )
    return replace(found, start=Prediction(n, None, label, None, light), refined=None)


def compared(picture, truth, mask):
    """Display L2 and SSIM over the mask."""
    figures = l2_and_ssim(picture, truth, mask)
    return {name: figures[name] for name in ("l2", "ssim")}


def written(out, rows, about):
    """enlarging.json of rows as rows.jsonl has them."""
    result = {"made_by": provenance(), "about": about, "parts": {}}
    weights = bootstrap.draws(
        bootstrap.groups_of([row["shape"] for row in rows], [row["material"] for row in rows])
    )
    for parts in ("ours", "true"):
        names = list(rows[0][parts])
        l2, ssim = (
            {name: np.array([row[parts][name][key] for row in rows]) for name in names}
            for key in ("l2", "ssim")
        )
        result["parts"][parts] = {
            name: {
                "l2": bootstrap.interval(l2[name], weights),
                "l2_ratio": bootstrap.relative(l2[names[0]], l2[name], weights),
                "ssim": bootstrap.interval(ssim[name], weights),
                "ssim_gain": bootstrap.interval(ssim[name] - ssim[names[0]], weights),
            }
            for name in names
        }
    files.write_json(out / "enlarging.json", result | {"rows": rows})
    return result
