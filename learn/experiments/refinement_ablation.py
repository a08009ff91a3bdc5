"""What refinement does on pictures whose truth is known, weight by weight, and how long it takes.

rows.jsonl  a line for each picture and setting: a study is continued by what it holds
settings.json  what those lines depend on: a folder made with others is not gone on with
study.json  medians and means over pictures against a, b, c, outer iterations and how many
pixels (0: all), one at a time about the defaults

Display L2 over the mask, exposure from the truth; edit: the mean over the other materials that the
dataset has of the same scene.
"""

import contextlib
import time
from collections import defaultdict
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from learn.data import pairs
from learn.data.batch import ExampleBatch
from learn.layer import render
from learn.metrics.radiometry import irradiance
from learn.refinement import NAMED, RefinementSettings, refine
from manifests import files
from manifests.errors import InputError
from manifests.provenance import provenance
from manifests.renamed_keys import current_name
from manifests.store import Lines
from shaders import tone

SWEEPS = {
    "a": (0.01, 0.05, 0.1, 1.0),
    "b": (0.002, 0.02, 0.2, 10.0),
    "c": (0.0, 0.05, 0.1, 1.0),
    "outer_iterations": (1, 2, 3),
    "pixels": (0, 600),
}
FIGURES = ("image", "edit", "angle_deg", "light")
TOLERANCE = 2e-2


def settings_of(name):
    """Settings of a name such as "a=0.1", or of NAMED. Raises InputError."""
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
        return replace(
            RefinementSettings(),
            **{moved: int(value) if moved == "outer_iterations" else float(value)},
        )
    except ValueError:
        raise InputError(
            f"--only {name}", "a setting", "none of that name", f"one of {', '.join(names())}"
        ) from None


def _current(name):
    """A setting's name with its key of today: rows and commands may say "passes=3"."""
    moved, sign, value = name.partition("=")
    return f"{current_name(moved)}{sign}{value}"


def value_of(moved, settings=RefinementSettings()):  # noqa: B008 -- frozen
    """What the settings have for a name of SWEEPS."""
    return settings.levels[0].pixels if moved == "pixels" else getattr(settings, moved)


def names():
    """All settings' names: those of NAMED, and each of SWEEPS moved alone."""
    return [
        *NAMED,
        *(f"{letter}={value:g}" for letter, values in SWEEPS.items() for value in values),
    ]


@dataclass(frozen=True)
class Case:
    """A picture whose edits are known. id: of its record; batch: of one; truths: [(label (S, 108),
    picture (H, W, 3))].
    """

    id: str
    batch: ExampleBatch
    truths: list


def cases(records, count, seed):
    """The first `count` Cases of an order that the seed determines. Raises InputError where the
    dataset has no edits.
    """
    results = []
    for edits in pairs.by_picture(records.records, seed)[:count]:
        truths = [(pairs.target_label(records, edit), records.image(edit.truth)) for edit in edits]
        results.append(Case(edits[0].source.id, pairs.shown(records, edits[0]), truths))
    return results


def picture(parts, label, batch):
    """(H, W, 3) numpy radiance by the layer of a Prediction's normals and light in a label (S,
    108).
    """
    several = len(label) > 1
    with torch.no_grad():
        return render(
            parts.n.movedim(1, -1).contiguous(),
            (label if several else label[0]).float().exp()[None],
            parts.light.movedim(1, -1).contiguous(),
            segments=batch.segments if several else None,
            mask=batch.segments > 0,
            tolerance=TOLERANCE,
            elevation=batch.elevation,
        )[0].numpy()


def figures(parts, batch, truths):
    """{figure: float} of a Prediction."""
    inside = batch.segments[0] > 0
    seen = batch.image[0].movedim(0, -1).numpy()

    def error(mine, truth):
        mask = inside.numpy()
        return float(tone.display_l2(mine, truth, tone.auto_exposure(truth, mask), mask))

    cosine = (parts.n[0] * batch.n[0]).sum(0)[inside].clamp(-1, 1)
    lit, truth = irradiance(parts.light), irradiance(batch.light)
    return {
        "image": error(picture(parts, parts.label[0], batch), seen),
        "edit": float(
            np.mean([error(picture(parts, label, batch), truth) for label, truth in truths])
        ),
        "angle_deg": float(cosine.arccos().rad2deg().mean()),
        "light": float(((lit - truth) ** 2).mean().sqrt() / (truth**2).mean().sqrt()),
    }


def weights(predict, known, out, requested=None):
    """study.json in `out`, a row for each setting over Cases; returns its settings' figures.

    predict  ExampleBatch → Prediction
    wanted   names of settings, None for all
    """
    out, requested = Path(out), list(dict.fromkeys(map(_current, requested or names())))
    meant = {name: settings_of(name) for name in requested}
    rows = files.read_lines(out / "rows.jsonl")
    rows = [row | {"setting": _current(row["setting"])} for row in rows]
    done = {(row["setting"], row["picture"]): row for row in rows}
    todo = [(name, case) for name in requested for case in known if (name, case.id) not in done]
    with contextlib.closing(Lines(out / "rows.jsonl")) as lines:
        for name, case in tqdm(todo, unit="refinement"):
            start = predict(case.batch)
            report = refine(case.batch, start, meant[name])
            row = {
                "setting": name,
                "picture": case.id,
                "seconds": report.seconds,
                "before": figures(start, case.batch, case.truths),
            }
            row |= {
                "after": figures(report.prediction, case.batch, case.truths),
                "energy": [report.before["total"], report.after["total"]],
            }
            lines.append(row)
            done[name, case.id] = row
    report = summary([done[name, case.id] for name in requested for case in known])
    write(out / "study.json", report)
    return report


def pin_settings(out, about):
    """Write down what lines in `out` depend on; InputError where they depend on something else.

    about  {name: value} of data and weights
    """
    files.pin_settings(
        Path(out) / "settings.json", about | {"defaults": asdict(RefinementSettings())}
    )


def summary(rows):
    """{setting: {figure: [median before, median after, mean before, mean after]}, the edits' ratio
    of means, pictures, seconds}.
    """
    by_setting = defaultdict(list)
    for row in rows:
        by_setting[row["setting"]].append(row)
    result = {}
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


def timed(predict, batch, settings=RefinementSettings()):  # noqa: B008 -- frozen
    """Seconds of a prediction and of its refinement, the best of two: the first may compile."""
    results = []
    for _ in range(2):
        began = time.perf_counter()
        start = predict(batch)
        predicted = time.perf_counter() - began
        results.append((predicted, refine(batch, start, settings).seconds))
    return {"predict": min(f[0] for f in results), "refine": min(f[1] for f in results)}


def doubled(batch):
    """The same picture at twice the size, each pixel four times: what a larger picture costs."""

    def larger(x):
        return x.repeat_interleave(2, -1).repeat_interleave(2, -2)

    return replace(
        batch, **{name: larger(getattr(batch, name)) for name in ("image", "mask", "n", "segments")}
    )


def write(path, report):
    """Figures by name, and what made them."""
    files.write_json(path, {"made_by": provenance()} | report)
