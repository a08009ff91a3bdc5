"""Whether pictures keep the error to which their job limits them, and what that costs.

python -m factory.render.validation.error_target law --shots 60
python -m factory.render.validation.error_target check --shots 300 --out DIR
python -m factory.render.validation.error_target check --shots 100 --meshes FOLDER --out DIR

A check that was stopped is continued by the same command.

shots    drawn from a seed: shape, material, light, view, tier and, in turn, the error requested
law      of the denoiser (validation.denoiser_law)
check    renders each shot twice to its error. A reference in two halves, of at least four times the
         picture's samples, gives achieved errors as (P − R1)(P − R2) and squared biases as
         (P1 − R1)(P2 − R2), in display values: the references' noise cancels in the mean
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
from factory.render.estimators.renderer import Shown
from factory.render.validation import command_line
from factory.render.validation.denoiser_law import law
from factory.render.validation.error_target_report import FIXED, group, report
from factory.render.validation.scenes import ERRORS, Stage, compared, drawn, meshes_of, named
from manifests.errors import InputError
from manifests.line_files import Lines
from manifests.option_types import positive
from manifests.provenance import provenance

LEAST_REFERENCE = 256  # samples of each half of a reference
MOST_REFERENCE = 2048


def check(stage: Stage, options: argparse.Namespace) -> dict[str, Any]:
    """Return a row for each shot; with --out, rows of an earlier, stopped check are kept."""
    meshes, rows, lines = meshes_of(options.meshes), [], None
    if options.out:
        path = options.out / "rows.jsonl"
        lines = Lines(path)
        rows = [json.loads(line) for line in lines.read().splitlines()]
        for number, row in enumerate(rows[: options.shots]):
            scene = named(drawn(number, options.seed, stage.materials, meshes))
            if any(row[key] != value for key, value in asdict(scene).items()):
                raise InputError(
                    str(path),
                    f"the shots of seed {options.seed}",
                    f"another shot {number}",
                    "name another folder, or the same seed and meshes as before",
                )
    for number in range(len(rows), options.shots):
        scene = drawn(number, options.seed, stage.materials, meshes)
        mask = stage.show(scene)
        shown = [
            Shown(stage.studio, seed, scene.tier, mask) for seed in (scene.seed, scene.seed ^ 1)
        ]
        start = time.process_time()
        first = choice.picture(shown[0], scene.requested)
        seconds = time.process_time() - start
        second = choice.picture(shown[1], scene.requested)
        start = time.process_time()
        fixed, _ = stage.studio.picture(FIXED, scene.seed, scene.tier)
        fixed_seconds = time.process_time() - start
        samples = int(np.clip(2 * first.samples, LEAST_REFERENCE, MOST_REFERENCE))
        reference = stage.reference(scene, mask, samples)
        achieved = compared(first.radiance, first.radiance, reference)
        rows.append(
            {
                **asdict(named(scene)),
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
                "second_achieved": compared(second.radiance, second.radiance, reference).error,
                "squared_bias": compared(first.radiance, second.radiance, reference).error,
                "reference_noise": reference.estimate().error,
                "fixed": compared(fixed, fixed, reference).error,
                "fixed_seconds": fixed_seconds,
            }
        )
        last = rows[-1]
        if lines:
            lines.append(last)
        print(
            f"{number}: {last['estimator']} {last['samples']}, achieved {last['achieved']:.3g} of"
            f" {scene.requested:g}, {seconds:.2f} s; {last['shape']} {scene.material} {scene.light}"
            f" {scene.tier}",
            flush=True,
        )
    rows = rows[: options.shots]
    return {"groups": [group(rows, requested) for requested in (*ERRORS, None)], "rows": rows}


def main() -> None:
    """Measure what the arguments name; print the figures, or write them."""
    parser = command_line.parser(__doc__, "shots", 60, seed=0, size=64, meshes=True)
    parser.add_argument("measure", choices=("law", "check"))
    parser.add_argument("--threads", type=positive, default=2, metavar="N")
    options = command_line.parse(parser, out_required=False)
    stage = Stage(options.size, options.threads)
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
