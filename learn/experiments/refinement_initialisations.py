"""Refinement from starts as bad as they come: none may end above itself, none may leave the finite.

starts.jsonl  a line a start: the same command goes on from them
starts.json   how many ended above their start, how many were not finite, how the re-rendering
changed, by kind of start
"""

import math
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from tqdm import tqdm

from learn.data.records import Records
from learn.experiments.refinement_ablation import picture, write
from learn.metrics.pictures import display_l2
from learn.networks.prediction import Prediction
from learn.refinement import RefinementSettings, refine
from manifests import files
from manifests.materials import load_catalogue
from manifests.store import Lines

STARTS = ("network", "random material", "mean light", "noisy normals", "untrained")


def labels_of(records: Records, materials: str) -> list[np.ndarray]:
    """Labels (108,) that random materials are drawn from, in order of name.

    materials  "dataset": all of the data set's; "built-in": all of the built-in catalogue's
    """
    if materials == "built-in":
        return [m.label.reshape(108) for _, m in sorted(load_catalogue().items())]
    return [records.label(name) for name in sorted(records.materials)]


def measured(predict, known, count, out, labels, settings=RefinementSettings()):  # noqa: B008 -- frozen
    """starts.json: `count` refinements from starts of every kind in turn.

    known   Cases of learn.experiments.refinement_ablation, taken in turn
    labels  (M, 108) of the materials that random ones are drawn from
    """
    done = {row["start"]: row for row in files.read_lines(Path(out) / "starts.jsonl")}
    lines = Lines(Path(out) / "starts.jsonl")
    for i in tqdm([i for i in range(count) if i not in done], unit="start"):
        batch, kind = known[i // len(STARTS) % len(known)].batch, STARTS[i % len(STARTS)]
        rng = torch.Generator().manual_seed(i)
        start = perturbed(predict(batch), kind, rng, labels)
        report = refine(batch, start, settings)
        parts = (report.prediction.label, report.prediction.light, report.prediction.n)
        seen = batch.image[0].movedim(0, -1).numpy()
        mask = (batch.segments[0] > 0).numpy()
        image = [
            display_l2(picture(p, p.label[0], batch), seen, mask)
            for p in (start, report.prediction)
        ]
        finite = all(bool(torch.isfinite(part).all()) for part in parts) and math.isfinite(
            report.after["total"]
        )
        done[i] = {
            "start": i,
            "kind": kind,
            "energy": [report.before["total"], report.after["total"]],
            "finite": finite,
            "image": image,
        }
        done[i]["seconds"] = report.seconds
        lines.append(done[i])
    lines.close()
    rows = [done[i] for i in range(count)]
    images = np.array([row["image"] for row in rows], float)  # null, read again, is NaN
    report = {
        "starts": len(rows),
        "above_their_start": sum(
            row["finite"] and row["energy"][1] > row["energy"][0] for row in rows
        ),
        "not_finite": sum(not row["finite"] for row in rows),
        "image_median": np.median(images, 0).tolist(),
        "median_change": float(np.median(images[:, 1]) / np.median(images[:, 0]) - 1),
        "by_kind": {
            kind: np.median([row["image"] for row in rows if row["kind"] == kind], 0).tolist()
            for kind in STARTS[: len(rows)]
        },
        "seconds_median": float(np.median([row["seconds"] for row in rows])),
        "rows": rows,
    }
    write(Path(out) / "starts.json", report)
    return report


def perturbed(start, kind, rng, labels):
    """A Prediction with one property replaced by what knows nothing of the picture; "untrained":
    all three.

    labels  (M, 108): a random material is one of these
    """
    label, light, n = start.label, start.light, start.n
    if kind in ("random material", "untrained"):
        chosen = labels[int(torch.randint(len(labels), (1,), generator=rng))]
        label = torch.from_numpy(chosen).float().expand_as(label).clone()
    if kind in ("mean light", "untrained"):
        light = torch.ones_like(light)
    if kind in ("noisy normals", "untrained"):
        n = n + 0.7 * torch.randn(n.shape, generator=rng)
        n = F.normalize(torch.cat([n[:, :2], n[:, 2:].abs() + 1e-3], 1), dim=1)
    return Prediction(n, None, label, None, light)
