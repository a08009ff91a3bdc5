"""Whether samples are saved by giving noisy pixels more of them than quiet ones.

python -m factory.render.validation.adaptive_sampling --shots 36 --out DIR

shots    drawn from a seed (validation.scenes), tiers in turn
noise    the variance of each pixel's display value at one sample, by PORTIONS independent pictures
best     mean(σ²) / mean(σ)² over the object: by how much the division of samples with the least
         mean error, n ∝ σ, needs fewer of them than the same number for all pixels
tiles    the same of the best division over squares of TILE pixels, which Cycles could render one
         by one, with samples of their own
piloted  the same of a division by the first two of these pictures, whose own samples are not
         counted, at the noise of the others; σ is averaged over 3×3 pixels
Cycles   its own adaptive sampling, against path tracing with as many samples for all pixels as take
         the same processor time. Both are rendered by two seeds; errors and squared biases are
         those of scenes.compare
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from factory.render.estimators.adaptive_sampling import stop_where_noise_is_below
from factory.render.validation import command_line
from factory.render.validation.sample_division import (
    TILE,
    best_gain,
    display_variance,
    gain_of,
    over_tiles,
    piloted_share,
)
from factory.render.validation.scenes import TIERS, Scene, Stage, compare, draw_scene
from manifests.provenance import provenance

if TYPE_CHECKING:
    from factory.render.studio import Studio

PORTIONS, EACH = 16, 8  # pictures that say how noisy pixels are, and their samples
THRESHOLDS = (0.1, 0.03, 0.01)
MOST = 256  # samples of a pixel under adaptive sampling
TIMED = 64  # samples that say how long one takes


def _time_picture(
    studio: Studio, samples: int, seed: int, scene: Scene
) -> tuple[np.ndarray, float]:
    """Return a picture and its processor seconds."""
    start = time.process_time()
    picture = studio.picture(samples, seed, scene.tier)[0]
    return picture, time.process_time() - start


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return a row for each shot."""
    stage, rows = Stage(options.size, 1), []
    studio = stage.studio
    for number in range(options.shots):
        scene = draw_scene(number, options.seed, stage.materials)
        scene = replace(scene, tier=TIERS[number % len(TIERS)])
        mask = stage.show(scene)
        pictures = np.array(
            [
                studio.portion(0, EACH, scene.seed + 2 + k, scene.tier).noisy[mask]
                for k in range(PORTIONS)
            ]
        )
        rest = display_variance(pictures[2:], mask)
        share = piloted_share(display_variance(pictures[:2], mask), mask)
        known = display_variance(pictures, mask)
        row: dict[str, Any] = {
            **asdict(scene),
            "best": best_gain(known),
            "tiles": best_gain(over_tiles(known, mask)),
            "piloted": gain_of(share, rest),
            "cycles": [],
        }
        reference = stage.reference(scene, mask, options.reference)
        per_sample = _time_picture(studio, TIMED, scene.seed, scene)[1] / TIMED
        for threshold in THRESHOLDS:
            with stop_where_noise_is_below(studio._scene, threshold):
                adaptive = [_time_picture(studio, MOST, scene.seed + k, scene) for k in (2, 3)]
            seconds = (adaptive[0][1] + adaptive[1][1]) / 2
            samples = int(np.clip(round(seconds / per_sample), 1, MOST))
            equal = [_time_picture(studio, samples, scene.seed + k, scene) for k in (2, 3)]
            row["cycles"].append(
                {
                    "threshold": threshold,
                    "seconds": seconds,
                    "samples": samples,
                    "equal_seconds": (equal[0][1] + equal[1][1]) / 2,
                    **_errors("", [each[0] for each in adaptive], reference),
                    **_errors("equal_", [each[0] for each in equal], reference),
                }
            )
        rows.append(row)
        print(f"{number + 1} of {options.shots}: {scene}", flush=True)
    return rows


def _errors(prefix: str, pair: Sequence[np.ndarray], reference: Any) -> dict[str, float]:
    """Return the mean error of two pictures by independent seeds, and their squared bias."""
    error = sum(compare(each, each, reference).error for each in pair) / 2
    bias = compare(pair[0], pair[1], reference).error
    return {f"{prefix}error": error, f"{prefix}squared_bias": bias}


def figures(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return medians, geometric means and extremes over shots."""
    result: dict[str, Any] = {}
    for name in ("best", "tiles", "piloted"):
        values = np.array([row[name] for row in rows])
        result[name] = {
            "median": float(np.median(values)),
            "mean": float(np.exp(np.log(values).mean())),
            "most": float(values.max()),
            "above_a_half": int((values > 1.5).sum()),
        }
    result["cycles"] = []
    for k, threshold in enumerate(THRESHOLDS):
        of = [row["cycles"][k] for row in rows]
        # the time that was spent may differ a little: noise is in proportion to 1/time
        gains = np.array(
            [
                (each["equal_error"] * each["equal_seconds"]) / (each["error"] * each["seconds"])
                for each in of
                if min(each["error"], each["equal_error"]) > 0
            ]
        )
        result["cycles"].append(
            {
                "threshold": threshold,
                "error": float(np.mean([each["error"] for each in of])),
                "seconds": float(np.mean([each["seconds"] for each in of])),
                "shots": len(gains),
                "median": float(np.median(gains)),
                "mean": float(np.exp(np.log(gains).mean())),
                "least": float(gains.min()),
                "most": float(gains.max()),
                "above_a_half": int((gains > 1.5).sum()),
                "squared_bias": float(np.mean([each["squared_bias"] for each in of])),
            }
        )
    return result


def report(result: dict[str, Any]) -> str:
    """Return the page of a measurement."""
    of, rows = result["figures"], result["rows"]
    lines = [
        "# Adaptive sampling",
        "",
        f"    {result['command']}",
        "",
        f"Commit {result['commit']}, {result['date']}, {result['machine']};"
        f" {len(rows)} shots of {result['size']}×{result['size']}.",
        "",
        "How many times fewer samples a division over pixels needs than the same number for all, at"
        " the same mean error:",
        "",
        "| division | median | geometric mean | most | shots above 1.5 |",
        "|---|---|---|---|---|",
    ]
    names = {
        "best": "best, by known noise",
        "tiles": f"best over squares of {TILE} pixels, by known noise",
        "piloted": "by the noise of 16 samples, not counted",
    }
    for key, name in names.items():
        g = of[key]
        lines.append(
            f"| {name} | {g['median']:.2f} | {g['mean']:.2f} | {g['most']:.2f}"
            f" | {g['above_a_half']} |"
        )
    lines += [
        "",
        "Cycles' adaptive sampling: error of path tracing in the same processor time, divided by"
        " its own (below 1 path tracing is better):",
        "",
        "| threshold | error | seconds | median | geometric mean | least | most | shots above 1.5"
        " | squared bias |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for g in of["cycles"]:
        lines.append(
            f"| {g['threshold']:g} | {g['error']:.1f} | {g['seconds']:.2f} | {g['median']:.2f}"
            f" | {g['mean']:.2f} | {g['least']:.2f} | {g['most']:.2f} | {g['above_a_half']} of"
            f" {g['shots']} | {g['squared_bias']:.2f} |"
        )
    lines += [
        "",
        "Shots where the best division saves most:",
        "",
        "| shot | best | over squares | piloted |",
        "|---|---|---|---|",
    ]
    for row in sorted(rows, key=lambda row: -row["best"])[:8]:
        lines.append(
            f"| {row['shape']}, {row['material']}, {row['light']}, {row['tier']}"
            f" | {row['best']:.2f} | {row['tiles']:.2f} | {row['piloted']:.2f} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, and write report.json and report.md."""
    parser = command_line.parser(__doc__, "shots", 36, seed=7, size=64, reference=256)
    options = command_line.parse(parser)
    rows = measure(options)
    result = {**provenance(), "size": options.size, "figures": figures(rows), "rows": rows}
    command_line.write_report(options.out, result, report(result))
    print(f"See {options.out / 'report.md'}")


if __name__ == "__main__":
    main()
