"""Whether Cycles' adaptive sampling saves time before the denoiser, in two halves as a limit's.

python -m factory.render.validation.adaptive_denoiser --numbers 2 5 --out DIR
python -m factory.render.validation.adaptive_denoiser --scenes 8 --meshes FOLDER --out DIR
python -m factory.render.validation.adaptive_denoiser --charts REPORT.json --out DIR

scenes   those of factory.render.validation.speed_accuracy, at full transport
equal    the numbers of --equal, samples for every pixel of each half
adaptive samples of each half until Cycles sees less noise in a pixel than one of --thresholds, at
         most MOST. Where a threshold took longer than LONGEST, the smaller ones are left out
error    of the picture that a limit has, the mean of both denoised halves, and its squared bias,
         against a reference in two halves; ± is what the reference's noise gives
estimate of that error and bias by the two halves alone, as a limit on the error makes it
seconds  of the processor, for both halves and the denoiser
gain     the seconds that equal samples take for the adaptive picture's error, divided by its own;
         between the settings, and beyond them at the rate of the nearest two, which flatters where
         noise is most of the error
pilot    mean(σ²) / mean(σ)² over squares of pixels, by the variance σ² of the display values of the
         first PILOT samples of each half: what a division of samples over squares could save

The third form renders nothing. Of reports of factory.render.validation.speed_accuracy it says how
long equal samples and the denoiser take for the error of BlenderProc's defaults, which are Cycles'
adaptive sampling and the same denoiser: one picture each, whose error need not be known.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from factory.render.estimators.adaptive_sampling import stop_where_noise_is_below
from factory.render.estimators.halves import Halves, half_seed
from factory.render.estimators.renderer import Shown, effort
from factory.render.validation import command_line
from factory.render.validation.sample_division import best_gain, display_variance, over_tiles
from factory.render.validation.scenes import Stage, compare, draw_scene, meshes_of, name_of_file
from factory.render.validation.speed_accuracy import doubt
from factory.render.validation.speed_accuracy_report import (
    LEAST_OF_LOGARITHMS,
    PEER_DEFAULTS,
    PEER_NAME,
    by_error,
)
from manifests.option_types import above_zero, positive, whole
from manifests.provenance import provenance

EQUAL = (16, 64, 192)  # samples of each half, of which the first are those of the one before
THRESHOLDS = (0.1, 0.03, 0.01)
MOST = 1024  # samples of a pixel of each half, as many as BlenderProc has by default
LONGEST = 30.0  # seconds of both halves
PILOT, PARTS = 16, 4  # samples of each half, and the pictures that they are divided into


def measure_scene(
    stage: Stage,
    shown: Shown,
    reference: Halves,
    counts: Sequence[int] = EQUAL,
    thresholds: Sequence[float] = THRESHOLDS,
) -> dict[str, Any]:
    """Return the pilot's figure and a row for each setting, of the scene that the stage shows.

    counts      samples of every pixel of each half, rising; at least two
    thresholds  of adaptive sampling, falling
    """
    halves, seconds, equal = Halves(shown), 0.0, []
    shown.renderer.denoise(shown.renderer.portion(0, 1, 0, shown.tier), effort(0))  # loads it
    for samples in counts:
        start = time.process_time()
        halves.grow(samples - halves.samples)
        seconds += time.process_time() - start
        equal.append({"setting": f"{samples} samples", **_judge(halves, seconds, reference)})
    adaptive = []
    for threshold in thresholds:
        halves, start = Halves(shown), time.process_time()
        with stop_where_noise_is_below(stage.studio._scene, threshold):
            halves.grow(MOST)
        seconds = time.process_time() - start
        row: dict[str, Any] = {"setting": f"threshold {threshold:g}"}
        row |= _judge(halves, seconds, reference)
        row["gain"] = seconds_at(equal, row["error"]) / row["seconds"]
        adaptive.append(row)
        if seconds > LONGEST:
            break
    return {"pilot": _gain_by_pilot(shown), "equal": equal, "adaptive": adaptive}


def _judge(halves: Halves, seconds: float, reference: Halves) -> dict[str, float]:
    """Return what denoised halves are worth, and what they cost with their samples' seconds."""
    start = time.process_time()
    pair = halves.denoised_pictures()
    seconds += time.process_time() - start
    picture = (pair[0] + pair[1]) / 2
    estimate, bias = halves.error_and_bias(pair, halves.pictures, halves.slope(pair))
    noisy = halves.picture
    return {
        "seconds": seconds,
        "error": compare(picture, picture, reference).error,
        "standard_error": doubt(picture[None], reference),
        "squared_bias": compare(pair[0], pair[1], reference).error,
        "estimated": estimate.error,
        "estimated_standard_error": estimate.standard_error,
        "estimated_squared_bias": bias,
        "error_without_denoiser": compare(noisy, noisy, reference).error,
        "estimated_without_denoiser": halves.estimate().error,
    }


def _gain_by_pilot(shown: Shown) -> float:
    """Return what a division of samples over squares could save, by the pilot's noise."""
    each = PILOT // PARTS
    parts = [
        shown.renderer.portion(k * each, each, half_seed(shown.seed, half), shown.tier).noisy
        for half in (0, 1)
        for k in range(PARTS)
    ]
    variance = display_variance(np.array([part[shown.mask] for part in parts]), shown.mask)
    return best_gain(over_tiles(variance, shown.mask))


def seconds_at(rows: Sequence[dict[str, Any]], error: float) -> float:
    """Return the seconds that settings take for an error, by the logarithms of both.

    rows  of two settings or more, with `error` and `seconds`. Beyond them the rate of the nearest
          two continues, and none where their errors are equal
    """
    x, y = by_error(rows)
    target = np.log(max(error, LEAST_OF_LOGARITHMS))
    if x[0] <= target <= x[-1]:
        return float(np.exp(np.interp(target, x, y)))
    end, other = (0, 1) if target < x[0] else (-1, -2)
    span = x[other] - x[end]
    slope = (y[other] - y[end]) / span if span else 0.0
    return float(np.exp(y[end] + slope * (target - x[end])))


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return the figures of each scene."""
    stage, result = Stage(options.size, 1), []
    meshes = meshes_of(options.meshes)
    for number in options.numbers or range(options.scenes):
        scene = replace(draw_scene(number, options.seed, stage.materials, meshes), tier="full")
        shown = Shown(stage.studio, scene.seed, scene.tier, stage.show(scene))
        reference = stage.reference(scene, shown.mask, options.reference)
        figures = measure_scene(
            stage,
            shown,
            reference,
            sorted(set(options.equal)),
            sorted(set(options.thresholds), reverse=True),
        )
        result.append({"scene": number, **asdict(name_of_file(scene)), **figures})
        print(f"{name_of_file(scene)}: {figures}", flush=True)
        # after every scene, so that a run that is stopped has those that it has measured
        words = {key: getattr(options, key) for key in ("size", "reference", "seed")}
        report = {**provenance(), **words, "scenes": result}
        command_line.write_report(options.out, report, page(report))
    return result


def page(result: dict[str, Any]) -> str:
    """Return the page of a measurement."""
    scenes = result["scenes"]
    lines = [
        "# Adaptive sampling before the denoiser",
        "",
        f"    {result['command']}",
        "",
        f"Commit {result['commit']}, {result['date']}, {result['machine']}; {len(scenes)} scenes of"
        f" {result['size']}×{result['size']} at full transport; references of"
        f" {2 * result['reference']} samples.",
        "",
        "The picture is the mean of two denoised halves. The gain is how many times as long equal"
        " samples take for the same error; * is continued beyond them at the rate of the last two"
        " numbers, which flatters where noise is most of the error.",
    ]
    for scene in scenes:
        lines += [
            "",
            f"**{scene['shape']}, {scene['material']}, {scene['light']}.** By the first {PILOT}"
            f" samples of each half a division over squares could save {scene['pilot']:.2f} times.",
            "",
            "| samples of each half | seconds | error | estimated | squared bias | estimated"
            " | error without denoiser | estimated | gain |",
            "|---|---|---|---|---|---|---|---|---|",
        ]
        for row in (*scene["equal"], *scene["adaptive"]):
            gain = "–"
            if "gain" in row:
                is_continued = row["error"] < scene["equal"][-1]["error"]
                gain = f"{row['gain']:.2f}" + " *" * is_continued
            lines.append(
                f"| {row['setting']} | {row['seconds']:.2f}"
                f" | {row['error']:.2f} ± {row['standard_error']:.2f}"
                f" | {row['estimated']:.2f} ± {row['estimated_standard_error']:.2f}"
                f" | {row['squared_bias']:.2f} | {row['estimated_squared_bias']:.2f}"
                f" | {row['error_without_denoiser']:.2f}"
                f" | {row['estimated_without_denoiser']:.2f} | {gain} |".replace("-", "−")
            )
    return "\n".join(lines) + "\n"


def beside_defaults(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return for each scene of a chart what BlenderProc's defaults and equal samples take.

    rows  of the report of factory.render.validation.speed_accuracy
    """
    result = []
    for number in dict.fromkeys(row["scene"] for row in rows):
        here = [row for row in rows if row["scene"] == number]
        peer = next(
            row for row in here if (row["family"], row["setting"]) == (PEER_NAME, PEER_DEFAULTS)
        )
        equal = sorted(
            (row for row in here if row["family"] == "denoised"), key=lambda row: row["seconds"]
        )
        seconds = seconds_at(equal, peer["error"])
        result.append(
            {
                "shape": peer["shape"],
                "material": peer["material"],
                "error": peer["error"],
                "seconds": peer["seconds"],
                "equal_seconds": seconds,
                "speed": peer["seconds"] / seconds,
                "is_continued": peer["error"] < equal[-1]["error"],
            }
        )
    return result


def page_of_charts(result: dict[str, Any]) -> str:
    """Return the page of what charts say."""
    lines = [
        "# Adaptive sampling and denoiser beside equal samples and denoiser",
        "",
        f"    {result['command']}",
        "",
        f"Commit {result['commit']}, {result['date']}. One picture each, at the error of"
        " BlenderProc's defaults; * is continued at the rate of the last two settings.",
        "",
        "| scene | error | BlenderProc's defaults: seconds | equal samples, denoised: seconds"
        " | times as fast |",
        "|---|---|---|---|---|",
    ]
    for row in result["scenes"]:
        mark = " *" if row["is_continued"] else ""
        lines.append(
            f"| {row['shape']}, {row['material']} | {row['error']:.2f} | {row['seconds']:.1f}"
            f" | {row['equal_seconds']:.1f}{mark} | {row['speed']:.2f} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, or read charts, and write report.json and report.md."""
    parser = command_line.parser(__doc__, "scenes", 8, seed=7, size=128, reference=256, meshes=True)
    parser.add_argument(
        "--numbers", type=whole, nargs="+", metavar="N", help="of the scenes (default: the first)"
    )
    parser.add_argument(
        "--equal",
        type=positive,
        nargs="+",
        default=EQUAL,
        metavar="N",
        help="samples of each half, at least two numbers (default: %(default)s)",
    )
    parser.add_argument(
        "--thresholds",
        type=above_zero,
        nargs="+",
        default=THRESHOLDS,
        metavar="T",
        help="of adaptive sampling (default: %(default)s)",
    )
    parser.add_argument(
        "--charts", type=Path, nargs="+", metavar="REPORT", help="render nothing, and read these"
    )
    options = command_line.parse(parser)
    if len(set(options.equal)) < 2:
        parser.error("--equal: a gain is read between two numbers of samples, so give two or more")
    if options.charts is None:
        measure(options)
        return
    scenes = []
    for path in options.charts:
        rows = json.loads(path.read_text())["rows"]
        if not any((row["family"], row["setting"]) == (PEER_NAME, PEER_DEFAULTS) for row in rows):
            parser.error(f"{path} has no rows of BlenderProc: make the chart with --blenderproc")
        scenes += beside_defaults(rows)
    result = {**provenance(), "scenes": scenes}
    command_line.write_report(options.out, result, page_of_charts(result))


if __name__ == "__main__":
    main()
