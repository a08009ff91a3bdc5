"""Refinement from bad initialisations: none may end above itself, none may leave the finite.

starts.jsonl of refinement_ablation keeps a line per initialisation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F

from learn.data.records import Records
from learn.experiments import runner
from learn.experiments.editing.refinement_sweep import Case, Predict, picture
from learn.metrics.pictures import display_l2
from learn.networks.prediction import Prediction
from learn.refinement import RefinementSettings, refine
from manifests.materials import load_catalogue

KINDS = ("network", "random material", "mean light", "noisy normals", "untrained")


def labels_of(records: Records, materials: str) -> list[np.ndarray]:
    """Return labels (108,) that random materials are drawn from, in order of name.

    materials  "dataset": all of the data set's; "built-in": all of the built-in catalogue's
    """
    if materials == "built-in":
        return [m.label.reshape(108) for _, m in sorted(load_catalogue().items())]
    return [records.label(name) for name in sorted(records.materials)]


def measure_refinements(
    predict: Predict,
    known: Sequence[Case],
    count: int,
    out: Path,
    labels: Sequence[np.ndarray],
    settings: RefinementSettings = RefinementSettings(),  # noqa: B008 -- frozen
) -> dict[str, Any]:
    """Return how `count` refinements ended, from initialisations of every kind in turn.

    known   cases, taken in turn
    labels  (M, 108) of the materials that random ones are drawn from
    """

    def measure(i: int) -> dict[str, Any]:
        kind = KINDS[i % len(KINDS)]
        batch = known[i // len(KINDS) % len(known)].batch
        rng = torch.Generator().manual_seed(i)
        start = perturb(predict(batch), kind, rng, labels)
        report = refine(batch, start, settings)
        parts = (report.prediction.label, report.prediction.light, report.prediction.n)
        seen = batch.image[0].movedim(0, -1).numpy()
        mask = (batch.segments[0] > 0).numpy()
        finite = all(bool(torch.isfinite(part).all()) for part in parts if part is not None)
        return {
            "kind": kind,
            "energy": [report.before["total"], report.after["total"]],
            "finite": finite and math.isfinite(report.after["total"]),
            "image": [
                display_l2(picture(p, label[0], batch), seen, mask)
                for p in (start, report.prediction)
                if (label := p.label) is not None
            ],
            "seconds": report.seconds,
        }

    todo = [({"start": i}, i) for i in range(count)]
    return summary(runner.resume(Path(out) / "starts.jsonl", todo, measure, "initialisation"))


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return counts of what went wrong, and medians of the re-rendering's display L2 by kind."""
    images = np.array([row["image"] for row in rows], float)  # null, read again, is NaN
    before, after = np.median(images, 0).tolist()
    return {
        "starts": len(rows),
        "above_their_start": sum(
            row["finite"] and row["energy"][1] > row["energy"][0] for row in rows
        ),
        "not_finite": sum(not row["finite"] for row in rows),
        "image_median": [before, after],
        "median_change": float(after / before - 1),
        "by_kind": {
            kind: np.median([row["image"] for row in rows if row["kind"] == kind], 0).tolist()
            for kind in KINDS[: len(rows)]
        },
        "seconds_median": float(np.median([row["seconds"] for row in rows])),
    }


def perturb(
    start: Prediction, kind: str, rng: torch.Generator, labels: Sequence[np.ndarray]
) -> Prediction:
    """Return a prediction of which one property does not depend on the picture.

    kind    of KINDS; "untrained" replaces all three properties
    labels  (M, 108): a random material is one of these
    """
    label, light, n = start.label, start.light, start.n
    assert label is not None and light is not None and n is not None  # as in refinement_sweep
    if kind in ("random material", "untrained"):
        chosen = labels[int(torch.randint(len(labels), (1,), generator=rng))]
        label = torch.from_numpy(chosen).float().expand_as(label).clone()
    if kind in ("mean light", "untrained"):
        light = torch.ones_like(light)
    if kind in ("noisy normals", "untrained"):
        n = n + 0.7 * torch.randn(n.shape, generator=rng)
        n = F.normalize(torch.cat([n[:, :2], n[:, 2:].abs() + 1e-3], 1), dim=1)
    return Prediction(n, None, label, None, light)
