"""Refinement of pictures whose truth is known, one setting changed at a time (refinement_ablation).

rows.jsonl     a line for each picture and setting, with figures before and after refinement
settings.json  what those lines depend on: a folder made with others is refused

Figures are display L2 of the re-rendering over the mask, with exposure from the truth; of the edit,
as a mean over the other materials that the data set has of the scene; and errors of normals and
light. Settings are a, b, c, the number of outer iterations and of pixels (0: all).
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from learn.data import pairs
from learn.data.batch import ExampleBatch
from learn.data.records import Records
from learn.experiments import runner
from learn.layer import predictions
from learn.metrics.radiometry import irradiance_error
from learn.networks.prediction import Prediction
from learn.refinement import NAMED, RefinementSettings, refine
from manifests import outputs
from manifests.errors import InputError
from manifests.renamed_keys import current_name
from shaders import tone

FIGURES = {
    "image": "re-rendering, display L2",
    "edit": "edit, display L2",
    "angle_deg": "normals, mean angle (°)",
    "light": "irradiance, relative error",
}
SWEEPS = {
    "a": (0.01, 0.05, 0.1, 1.0),
    "b": (0.002, 0.02, 0.2, 10.0),
    "c": (0.0, 0.05, 0.1, 1.0),
    "outer_iterations": (1, 2, 3),
    "pixels": (0, 600),
}
Predict = Callable[[ExampleBatch], Prediction]


def settings_of(name: str) -> RefinementSettings:
    """Return the settings of a name such as "a=0.1", or of NAMED. Raises InputError."""
    if name in NAMED:
        return NAMED[name]
    moved, _, value = _current(name).partition("=")
    try:
        if moved == "pixels":
            return replace(
                RefinementSettings(),
                levels=tuple(
                    replace(level, pixels=int(value)) for level in RefinementSettings().levels
                ),
            )
        if moved not in SWEEPS:
            raise ValueError(moved)
        number = int(value) if moved == "outer_iterations" else float(value)
        return replace(RefinementSettings(), **{moved: number})  # type: ignore[arg-type]  # of SWEEPS
    except ValueError:
        raise InputError(
            f"--only {name}", "a setting", "none of that name", f"one of {', '.join(names())}"
        ) from None


def _current(name: str) -> str:
    """Return a setting's name with its key of today: rows and commands may say "passes=3"."""
    moved, sign, value = name.partition("=")
    return f"{current_name(moved)}{sign}{value}"


def value_of(moved: str, settings: RefinementSettings = RefinementSettings()) -> float:  # noqa: B008 -- frozen
    """Return what the settings have for a name of SWEEPS."""
    return settings.levels[0].pixels if moved == "pixels" else getattr(settings, moved)


def names() -> list[str]:
    """Return all settings' names: those of NAMED, and each value of SWEEPS."""
    return [
        *NAMED,
        *(f"{letter}={value:g}" for letter, values in SWEEPS.items() for value in values),
    ]


@dataclass(frozen=True)
class Case:
    """A picture whose edits are known.

    id      of its record
    batch   of this one picture
    truths  [(label (S, 108), picture (H, W, 3))]
    """

    id: str
    batch: ExampleBatch
    truths: list[tuple[torch.Tensor, np.ndarray]]


def cases(records: Records, count: int, seed: int) -> list[Case]:
    """Return the first `count` cases in an order that the seed determines.

    Raises InputError where the data set has no edits.
    """
    results = []
    for edits in pairs.edits_by_picture(records.records, seed)[:count]:
        truths = [(pairs.target_label(records, edit), records.image(edit.truth)) for edit in edits]
        results.append(Case(edits[0].source.id, pairs.make_source_batch(records, edits[0]), truths))
    return results


def picture(parts: Prediction, label: torch.Tensor, batch: ExampleBatch) -> np.ndarray:
    """Return radiance (H, W, 3) of a prediction's normals and light in a material (S, 108)."""
    assert parts.n is not None and parts.light is not None  # refined networks predict all parts
    return predictions.picture(
        parts.n, label[None], parts.light, batch.segments, batch.elevation, predictions.ABLATION
    )[0].numpy()


def figures(
    parts: Prediction, batch: ExampleBatch, truths: Sequence[tuple[torch.Tensor, np.ndarray]]
) -> dict[str, float]:
    """Return {figure: value} of a prediction."""
    assert parts.n is not None and parts.label is not None and parts.light is not None
    inside = batch.segments[0] > 0
    seen = batch.image[0].movedim(0, -1).numpy()

    def error(mine: np.ndarray, truth: np.ndarray) -> float:
        mask = inside.numpy()
        return float(tone.display_l2(mine, truth, tone.auto_exposure(truth, mask), mask))

    cosine = (parts.n[0] * batch.n[0]).sum(0)[inside].clamp(-1, 1)
    return {
        "image": error(picture(parts, parts.label[0], batch), seen),
        "edit": float(
            np.mean([error(picture(parts, label, batch), truth) for label, truth in truths])
        ),
        "angle_deg": float(cosine.arccos().rad2deg().mean()),
        "light": float(irradiance_error(parts.light, batch.light)),
    }


def sweep(
    predict: Predict, known: Sequence[Case], out: Path, requested: Sequence[str] | None = None
) -> dict[str, Any]:
    """Return the summary of each requested setting over cases; None stands for all settings.

    Rows that `out` has are not measured again.
    """
    requested = list(dict.fromkeys(map(_current, requested or names())))
    settings = {name: settings_of(name) for name in requested}

    def measure(chosen: tuple[str, Case]) -> dict[str, Any]:
        name, case = chosen
        start = predict(case.batch)
        report = refine(case.batch, start, settings[name])
        return {
            "seconds": report.seconds,
            "before": figures(start, case.batch, case.truths),
            "after": figures(report.prediction, case.batch, case.truths),
            "energy": [report.before["total"], report.after["total"]],
        }

    todo = [
        ({"setting": name, "picture": case.id}, (name, case))
        for name in requested
        for case in known
    ]
    rows = runner.resume(Path(out) / "rows.jsonl", todo, measure, "refinement", _with_current_name)
    return summary(rows)


def _with_current_name(row: dict[str, Any]) -> dict[str, Any]:
    """Return a row of rows.jsonl, its setting by its name of today."""
    return row | {"setting": _current(row["setting"])}


def pin_settings(out: Path, about: dict[str, Any]) -> None:
    """Write down what rows in `out` depend on: data, weights and the default settings.

    Raises InputError where they depend on something else.
    """
    outputs.pin_settings(
        Path(out) / "settings.json", about | {"defaults": asdict(RefinementSettings())}
    )


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return {setting: {figure: [median before, median after, mean before, mean after], …}}.

    A setting also has "edit_ratio", the edits' ratio of means, "pictures" and "seconds".
    """
    by_setting = defaultdict(list)
    for row in rows:
        by_setting[row["setting"]].append(row)
    result: dict[str, Any] = {}
    for name, mine in by_setting.items():
        values = {
            f: np.array([[row["before"][f], row["after"][f]] for row in mine]) for f in FIGURES
        }
        result[name] = {
            f: [*np.median(v, 0).tolist(), *v.mean(0).tolist()] for f, v in values.items()
        }
        edit = values["edit"]
        result[name] |= {"edit_ratio": float(edit[:, 1].mean() / edit[:, 0].mean())}
        result[name] |= {
            "pictures": len(mine),
            "seconds": float(np.median([row["seconds"] for row in mine])),
        }
    return result


def time_refinement(
    predict: Predict,
    batch: ExampleBatch,
    settings: RefinementSettings = RefinementSettings(),  # noqa: B008 -- frozen
) -> dict[str, float]:
    """Return seconds of a prediction and of its refinement, the best of two (one may compile)."""
    results = []
    for _ in range(2):
        began = time.perf_counter()
        start = predict(batch)
        predicted = time.perf_counter() - began
        results.append((predicted, refine(batch, start, settings).seconds))
    return dict(zip(("predict", "refine"), map(min, zip(*results, strict=True)), strict=True))


def double_size(batch: ExampleBatch) -> ExampleBatch:
    """Return the same picture at twice the size, with each pixel four times."""

    def larger(x: torch.Tensor) -> torch.Tensor:
        return x.repeat_interleave(2, -1).repeat_interleave(2, -2)

    return replace(
        batch,
        image=larger(batch.image),
        mask=larger(batch.mask),
        n=larger(batch.n),
        segments=larger(batch.segments),
    )
