"""Strategies of upsampling an edit, measured on rendered pictures with their truth (upsampling).

Each edit is made twice: with our refined decomposition, and with the true one at the network's
size, where all that remains is the error of upsampling.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F

from learn.data import framing, pairs
from learn.data.records import Records
from learn.editing import decomposition, photograph
from learn.experiments import runner
from learn.experiments.editing import upsampling_strategies
from learn.metrics import bootstrap
from learn.metrics.pictures import l2_and_ssim
from learn.networks import weights as checkpoint
from learn.networks.prediction import Prediction
from learn.refinement import RefinementSettings
from manifests import outputs
from manifests.errors import InputError
from manifests.store_paths import file_hash


def compare(records: Records, weights: Path, out: Path, count: int) -> dict[str, Any]:
    """Return the report: each strategy's figures, and ratios to the strategy in use.

    Rows that `out` has are not measured again. Raises InputError where pictures have several
    materials or are too small.
    """
    network, metadata = checkpoint.load_full_network(weights)
    size = metadata["size"]
    edits = pairs.choose_edits(records.records, count, 0)
    if any(edit.per_segment for edit in edits):
        raise InputError(
            records.folder,
            "pictures of one material each",
            "several",
            "render without segment_materials",
        )
    if min(edits[0].source.camera.size) < 2 * size:
        raise InputError(
            records.folder,
            f"pictures of {2 * size} pixels or more, twice the network's",
            " × ".join(map(str, edits[0].source.camera.size)),
            'render them with "size"',
        )
    settings = RefinementSettings()
    outputs.pin_settings(
        out / "settings.json", {"weights": file_hash(weights), "refinement": asdict(settings)}
    )
    painters: dict[str, dict] = {}  # of the last picture: {its id: {"ours" | "true": painters}}

    def measure(edit: pairs.EditPair) -> dict[str, Any]:
        if edit.source.id not in painters:
            painters.clear()
            opened = photograph.open_photograph(records.folder, record=edit.source.id)
            ours = decomposition.decompose(opened, network, size, settings)
            painters[edit.source.id] = {
                "ours": upsampling_strategies.painters(ours),
                "true": upsampling_strategies.painters(with_truth(records, ours)),
            }
        return _row(records, edit, painters[edit.source.id])

    rows = runner.resume(
        out / "rows.jsonl",
        [({"edit": edit.id}, edit) for edit in edits],
        measure,
        "edit",
        group=lambda edit: edit.source.id,
    )
    about = {"edits": len(edits), "size": edits[0].source.camera.size, "network": size}
    return {"about": about, "parts": summary(rows)}


def _row(records: Records, edit: pairs.EditPair, painters: dict[str, dict]) -> dict[str, Any]:
    """An edit's shape and material, and each strategy's figures."""
    label, truth = pairs.target_label(records, edit)[0].numpy(), records.image(edit.truth)
    row: dict[str, Any] = {"shape": edit.source.shape, "material": edit.truth.materials[0]}
    for parts, strategies in painters.items():
        mask = strategies["normals enlarged"].decomposition.photograph.mask
        row[parts] = {
            name: compare_pictures(painter.edit([label]), truth, mask)
            for name, painter in strategies.items()
        }
    return row


def with_truth(records: Records, ours: decomposition.Decomposition) -> decomposition.Decomposition:
    """Return a decomposition with its record's true normals, light and material.

    Normals are at the network's size.
    """
    assert ours.photograph.record is not None  # it is one of the data set's
    sample, mask = records.load(ours.photograph.record), ours.framed.mask
    square = framing.cut_square(sample.n.numpy(), ours.framed.box)
    n = F.normalize(torch.from_numpy(framing.resize_square(square, len(mask))), dim=-1).movedim(
        -1, 0
    )[None]
    toward = torch.tensor([0.0, 0.0, 1.0])[:, None, None]
    n = torch.where(torch.from_numpy(mask) & (n.norm(dim=1, keepdim=True) > 0.5), n, toward)
    label, light = (
        sample.label[None, : ours.parts.label.shape[1]],
        sample.light.movedim(-1, 0)[None],
    )
    return replace(ours, start=Prediction(n, None, label, None, light), refined=None)


def compare_pictures(picture: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> dict[str, float]:
    """Return display L2 and SSIM over the mask."""
    figures = l2_and_ssim(picture, truth, mask)
    return {name: value for name in ("l2", "ssim") if (value := figures[name]) is not None}


def summary(rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return {"ours" | "true": {strategy: {figure: [mean, low, high]}}} of rows."""
    result: dict[str, dict[str, Any]] = {}
    weights = bootstrap.draws_of_rows(rows, ("shape", "material"))
    for parts in ("ours", "true"):
        names = list(rows[0][parts])
        l2, ssim = (
            {name: np.array([row[parts][name][key] for row in rows]) for name in names}
            for key in ("l2", "ssim")
        )
        result[parts] = {
            name: {
                "l2": bootstrap.interval(l2[name], weights),
                "l2_ratio": bootstrap.relative(l2[names[0]], l2[name], weights),
                "ssim": bootstrap.interval(ssim[name], weights),
                "ssim_gain": bootstrap.interval(ssim[name] - ssim[names[0]], weights),
            }
            for name in names
        }
    return result
