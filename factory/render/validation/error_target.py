"""Whether pictures keep the error to which their job limits them, and what that costs.

python -m factory.render.validation.error_target law --shots 60
python -m factory.render.validation.error_target check --shots 300 --out DIR
python -m factory.render.validation.error_target check --shots 100 --meshes FOLDER --out DIR

A check that was stopped is continued by the same command. With --references FOLDER, the references
are kept, and a check of changed rules takes only the time of its pictures.

shots    drawn from a seed: shape, material, light, view, tier and, in turn, the error requested
law      of the denoiser (validation.denoiser_law)
check    renders each shot twice to its error. A reference in two halves, of at least four times the
         picture's samples, gives achieved errors as (P − R1)(P − R2) and squared biases as
         (P1 − R1)(P2 − R2), in display values: the references' noise cancels in the mean. Where one
         may be on the other side of its limit, the reference is given up to 8,192 samples
cost     in processor seconds, since other programs may run. It is compared with one number of
         samples for all shots: the one that gives the same mean error, and the one that keeps the
         error on as many shots, both by noise in proportion to 1/samples from 64 samples of each
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict
from typing import Any

import numpy as np

from factory.render.estimators import choice
from factory.render.estimators.blends import MOST_BIAS
from factory.render.estimators.halves import CONFIDENCE
from factory.render.estimators.renderer import Shown
from factory.render.validation import command_line
from factory.render.validation.denoiser_law import law
from factory.render.validation.error_target_report import FIXED, group, report
from factory.render.validation.scenes import (
    ERRORS,
    Scene,
    Stage,
    compare,
    draw_scene,
    meshes_of,
    name_of_file,
)
from manifests.errors import InputError
from manifests.line_files import Lines
from manifests.option_types import positive
from manifests.provenance import provenance

LEAST_REFERENCE = 256  # samples of each half of a reference
MOST_REFERENCE = 2048
CLOSEST = 8192  # of a shot whose verdicts are in doubt
AGAIN = "again"  # key of a row's number, if it takes the place of an earlier one


def check(stage: Stage, options: argparse.Namespace) -> dict[str, Any]:
    """Return a row for each shot; with --out, rows of an earlier, stopped check are kept."""
    meshes, rows, lines = meshes_of(options.meshes), [], None
    if options.out:
        path = options.out / "rows.jsonl"
        lines = Lines(path)
        rows = read(lines)
        for number, row in enumerate(rows[: options.shots]):
            scene = name_of_file(draw_scene(number, options.seed, stage.materials, meshes))
            if any(row[key] != value for key, value in asdict(scene).items()):
                raise InputError(
                    str(path),
                    f"the shots of seed {options.seed}",
                    f"another shot {number}",
                    "name another folder, or the same seed and meshes as before",
                )
    for number in range(options.shots):
        if number < len(rows) and not (is_in_doubt(rows[number]) and may_be_closer(rows[number])):
            continue
        row = measure_shot(stage, draw_scene(number, options.seed, stage.materials, meshes))
        if number < len(rows):
            rows[number] = row
            row = row | {AGAIN: number}
        else:
            rows.append(row)
        if lines:
            lines.append(row)
        print(
            f"{number}: {row['estimator']} {row['samples']}, achieved {row['achieved']:.3g} of"
            f" {row['requested']:g}, {row['seconds']:.2f} s; {row['shape']} {row['material']}"
            f" {row['light']} {row['tier']}",
            flush=True,
        )
    rows = rows[: options.shots]
    return {"groups": [group(rows, requested) for requested in (*ERRORS, None)], "rows": rows}


def read(lines: Lines) -> list[dict[str, Any]]:
    """Return the row of each shot: the last one, if it was measured again."""
    rows: list[dict[str, Any]] = []
    for line in lines.read().splitlines():
        row = json.loads(line)
        number = row.pop(AGAIN, len(rows))
        rows[number : number + 1] = [row]
    return rows


def measure_shot(stage: Stage, scene: Scene) -> dict[str, Any]:
    """Return a shot's row, by a reference of so many samples that its verdicts are not in doubt.

    Where they are, the reference is given four times as many, up to CLOSEST.
    """
    mask = stage.show(scene)
    shown = [Shown(stage.studio, seed, scene.tier, mask) for seed in (scene.seed, scene.seed ^ 1)]
    start = time.process_time()
    first = choice.render_within_error(shown[0], scene.requested)
    seconds = time.process_time() - start
    second = choice.render_within_error(shown[1], scene.requested)
    start = time.process_time()
    fixed, _ = stage.studio.picture(FIXED, scene.seed, scene.tier)
    fixed_seconds = time.process_time() - start
    reference = stage.reference(
        scene, mask, int(np.clip(2 * first.samples, LEAST_REFERENCE, MOST_REFERENCE))
    )
    while True:
        achieved = compare(first.radiance, first.radiance, reference)
        bias = compare(first.radiance, second.radiance, reference)
        row = {
            **asdict(name_of_file(scene)),
            "pixels": int(mask.sum()),
            "estimator": first.estimator,
            "samples": first.samples,
            "traced": first.traced,
            "seconds": seconds,
            "predicted": first.predicted,
            "estimated": first.estimated.error,
            "standard_error": first.estimated.standard_error,
            "achieved": achieved.error,
            "achieved_standard_error": achieved.standard_error,
            "second_estimator": second.estimator,
            "second_achieved": compare(second.radiance, second.radiance, reference).error,
            "squared_bias": bias.error,
            "squared_bias_standard_error": bias.standard_error,
            "reference_samples": reference.samples,
            "reference_noise": reference.estimate().error,
            "fixed": compare(fixed, fixed, reference).error,
            "fixed_seconds": fixed_seconds,
        }
        if not (is_in_doubt(row) and may_be_closer(row)):
            return row
        reference.grow(3 * reference.samples)


def is_in_doubt(row: dict[str, Any]) -> bool:
    """Whether a shot's error or bias may be on the other side of its limit."""
    doubts = (
        ("achieved", "achieved_standard_error", 1.0),
        # rows of older checks have no uncertainty of the bias
        ("squared_bias", "squared_bias_standard_error", MOST_BIAS),
    )
    return any(
        abs(row[name] - part * row["requested"])
        < CONFIDENCE * row.get(uncertainty, row["achieved_standard_error"])
        for name, uncertainty, part in doubts
    )


def may_be_closer(row: dict[str, Any]) -> bool:
    """Whether a shot's reference may have more samples."""
    return 4 * row.get("reference_samples", 0) <= CLOSEST


def main() -> None:
    """Measure what the arguments name; print the figures, or write them."""
    parser = command_line.parser(
        __doc__, "shots", 60, seed=0, size=64, meshes=True, references=True
    )
    parser.add_argument("measure", choices=("law", "check"))
    parser.add_argument("--threads", type=positive, default=2, metavar="N")
    options = command_line.parse(parser, out_required=False)
    stage = Stage(options.size, options.threads, options.references)
    figures = (law if options.measure == "law" else check)(stage, options)
    result = {"size": options.size, **provenance(), "figures": figures}
    if options.out:
        page = report(result) if options.measure == "check" else None
        command_line.write_report(options.out, result, page)
    shown = figures["groups"] if options.measure == "check" else [figures | {"rows": None}]
    for each in shown:
        print(each)


if __name__ == "__main__":
    main()
