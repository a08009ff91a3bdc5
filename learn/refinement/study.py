"""What refinement does on pictures whose truth is known, weight by weight, and how long it takes.

rows.jsonl  a line for each picture and setting: a study is continued by what it holds
study.json  medians and means over pictures against a, b, c, how many passes and how many pixels (0: all), one at a time about the defaults

Display L2 over the mask, exposure from the truth; edit: the mean over the other materials that the dataset has of the same scene.
"""

import contextlib
import json
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from learn.evaluation import pairs
from learn.layer import render
from learn.refinement import NAMED, Settings, refine
from learn.training.measures import irradiance
from manifests.problems import Problem
from manifests.store import Lines
from shaders import tone

SWEEPS = {
    "a": (0.01, 0.05, 0.1, 1.0),
    "b": (0.002, 0.02, 0.2, 10.0),
    "c": (0.0, 0.05, 0.1, 1.0),
    "passes": (1, 2, 3),
    "pixels": (0, 600),
}
FIGURES = ("image", "edit", "angle_deg", "light")
TOLERANCE = 2e-2


def settings_of(name):
    """Settings of a name such as "a=0.1", or of NAMED. Raises Problem."""
    if name in NAMED:
        return NAMED[name]
    moved, _, value = name.partition("=")
    try:
        if moved == "pixels":
            return replace(Settings(), levels=tuple(replace(level, pixels=int(value)) for level in Settings().levels))
        if moved not in SWEEPS:
            raise ValueError(moved)
        return replace(Settings(), **{moved: int(value) if moved == "passes" else float(value)})
    except ValueError:
        raise Problem(f"--only {name}", "a setting", "none of that name", f"one of {', '.join(names())}") from None


def value_of(moved, settings=Settings()):  # noqa: B008 -- frozen
    """What the settings have for a name of SWEEPS."""
    return settings.levels[0].pixels if moved == "pixels" else getattr(settings, moved)


def names():
    """All settings' names: those of NAMED, and each of SWEEPS moved alone."""
    return [*NAMED, *(f"{letter}={value:g}" for letter, values in SWEEPS.items() for value in values)]


def cases(records, count, seed):
    """[(Batch of one, [(label (1, 108), truth (H, W, 3))])] of `count` pictures. Raises Problem where the dataset has no edits."""
    by_source = defaultdict(list)
    for edit in pairs.chosen(records.records, 3 * count + 3, seed):
        by_source[edit.source.id].append(edit)
    found = []
    for edits in list(by_source.values())[:count]:
        truths = [(pairs.wanted(records, edit), records.image(edit.truth)) for edit in edits]
        found.append((pairs.shown(records, edits[0]), truths))
    return found


def picture(parts, label, batch):
    """(H, W, 3) numpy radiance by the layer of a Prediction's normals and light in a label (S, 108)."""
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
        "edit": float(np.mean([error(picture(parts, label, batch), truth) for label, truth in truths])),
        "angle_deg": float(cosine.arccos().rad2deg().mean()),
        "light": float(((lit - truth) ** 2).mean().sqrt() / (truth**2).mean().sqrt()),
    }


def weights(predict, known, out, wanted=None):
    """Rows of every setting over cases; study.json and study.png in `out`. predict: Batch → Prediction."""
    out = Path(out)
    done = {(row["setting"], row["picture"]): row for row in read(out / "rows.jsonl")}
    with contextlib.closing(Lines(out / "rows.jsonl")) as lines:
        todo = [(name, i) for name in wanted or names() for i in range(len(known)) if (name, known[i][0].names[0]) not in done]
        for name, i in tqdm(todo, unit="refinement"):
            batch, truths = known[i]
            start = predict(batch)
            told = refine(batch, start, settings_of(name))
            row = {"setting": name, "picture": batch.names[0], "seconds": told.seconds, "before": figures(start, batch, truths)}
            row |= {"after": figures(told.prediction, batch, truths), "energy": [told.before["total"], told.after["total"]]}
            lines.append(row)
            done[name, batch.names[0]] = row
    told = summary(list(done.values()))
    write(out / "study.json", told)
    return told


def summary(rows):
    """{setting: {figure: [median before, median after, mean before, mean after]}, the edits' ratio of means, pictures, seconds}."""
    by_setting = defaultdict(list)
    for row in rows:
        by_setting[row["setting"]].append(row)
    found = {}
    for name, mine in by_setting.items():
        values = {f: np.array([[row["before"][f], row["after"][f]] for row in mine]) for f in FIGURES}
        found[name] = {f: [*np.median(v, 0).tolist(), *v.mean(0).tolist()] for f, v in values.items()}
        edit = values["edit"]
        found[name] |= {"edit_ratio": float(edit[:, 1].mean() / edit[:, 0].mean())}
        found[name] |= {"pictures": len(mine), "seconds": float(np.median([row["seconds"] for row in mine]))}
    return found


def timed(predict, batch, settings=Settings()):  # noqa: B008 -- frozen
    """Seconds of a prediction and of its refinement, the best of two: the first may compile."""
    found = []
    for _ in range(2):
        began = time.perf_counter()
        start = predict(batch)
        predicted = time.perf_counter() - began
        found.append((predicted, refine(batch, start, settings).seconds))
    return {"predict": min(f[0] for f in found), "refine": min(f[1] for f in found)}


def doubled(batch):
    """The same picture at twice the size, each pixel four times: what a larger picture costs."""

    def larger(x):
        return x.repeat_interleave(2, -1).repeat_interleave(2, -2)

    return replace(batch, **{name: larger(getattr(batch, name)) for name in ("image", "mask", "n", "segments")})


def read(path):
    """Rows of a file of JSON lines; none where it is not there. A last line cut short by a kill is left out."""
    if not path.is_file():
        return []
    lines = path.read_text(encoding="utf-8").split("\n")
    return [json.loads(line) for line in lines[:-1] if line]


def write(path, told):
    temporary = path.with_name(f".{path.name}")
    temporary.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    temporary.replace(path)
