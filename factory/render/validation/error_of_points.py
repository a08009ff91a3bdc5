"""By how much direct light at a few points per pixel misses that at many.

python -m factory.render.validation.error_of_points --shots 60 --out DIR
python -m factory.render.validation.error_of_points --shots 60 --meshes FOLDER --size 256 --out DIR

shots        drawn from a seed (validation.scenes); no light is blocked
limits       for each of which the closed form chooses its points, from few of all pixels on
reference    the same closed form with the points that `--finest`, a limit, needs
error        display L2 over the mask, with the display curve's slope, against the reference
differences  what the error would be if the points' grids were placed at random, by their
             differences; the error in units of these is what `closed_form.LEFT` says
"""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from factory.render.estimators import closed_form
from factory.render.estimators.renderer import DirectPicture, Shown
from factory.render.validation import command_line
from factory.render.validation.scenes import Stage, draw_scene, meshes_of, name_of_file
from manifests.option_types import above_zero
from manifests.provenance import provenance
from shaders import tone

FEWEST = 1e9  # a limit that the first points keep
LIMITS = (FEWEST, 20.0, 5.0, 2.0)
FINEST = 0.3
PERCENTILE = 95


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return a row for each shot that a closed form holds for."""
    stage, meshes = Stage(options.size, 1), meshes_of(options.meshes)
    rows: list[dict[str, Any]] = []
    for number in range(options.shots):
        scene = replace(draw_scene(number, options.seed, stage.materials, meshes), tier="direct")
        shown = Shown(stage.studio, scene.seed, "direct", stage.show(scene))
        if not shown.mask.any() or stage.studio.direct_light_work(closed_form.POINTS) is None:
            continue
        finest, _ = _compute(shown, options.finest)
        measured = [_compare(shown, limit, finest) for limit in LIMITS]
        about = {"pixels": int(shown.mask.sum()), "sampled": finest.sampled, "limits": measured}
        rows.append(asdict(name_of_file(scene)) | about)
        first = measured[0]
        print(
            f"{number}: {rows[-1]['shape']} {scene.material} {scene.light}: error of the first"
            f" points {first['error']:.3f}, by their differences {first['differences']:.3f}",
            flush=True,
        )
    return rows


def _compute(shown: Shown, limit: float) -> tuple[DirectPicture, float]:
    """Return direct light for a limit, with what it sees found again, and its seconds."""
    shown.renderer.forget_grids()
    start = time.process_time()
    direct = closed_form.compute_direct_light(shown, limit)
    assert direct is not None  # its work is known
    return direct, time.process_time() - start


def _compare(shown: Shown, limit: float, finest: DirectPicture) -> dict[str, float]:
    """Return what the points that a limit needs miss of the finest ones."""
    direct, seconds = _compute(shown, limit)
    mask = shown.mask
    off = (direct.radiance - finest.radiance)[mask]
    slope = tone.display_slope(finest.radiance[mask], tone.auto_exposure(finest.radiance, mask))
    return {
        "limit": limit,
        "error": float(((off * slope) ** 2).mean(dtype=np.float64)),
        "differences": closed_form.error_by_differences(direct, mask),
        "seconds": seconds,
    }


def report(result: dict[str, Any]) -> str:
    """Return the page of a measurement."""
    lines = [
        "# What points miss of direct light",
        "",
        f"    {result['command']}",
        "",
        f"Commit {result['commit']}, {result['date']}, {result['machine']}; pictures of"
        f" {result['size']}×{result['size']}. The reference has the points for a limit of"
        f" {result['finest']:g}.",
        "",
        "The error in units of what it would be if grids were placed at random:",
        "",
        "| lobes are sampled | limit | shots | mean | standard deviation | median"
        f" | {PERCENTILE}th percentile | worst | seconds |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    worst: list[tuple[float, str]] = []
    for sampled in (False, True):
        rows = [row for row in result["rows"] if row["sampled"] == sampled]
        for number, limit in enumerate(LIMITS):
            points = [row["limits"][number] for row in rows]
            shares = np.array([each["error"] / max(each["differences"], 1e-9) for each in points])
            if not points:
                continue
            name = "first points" if limit == FEWEST else f"{limit:g}"
            lines.append(
                f"| {'yes' if sampled else 'no'} | {name} | {len(points)} | {shares.mean():.3f}"
                f" | {shares.std():.3f} | {np.median(shares):.3f}"
                f" | {np.percentile(shares, PERCENTILE):.3f} | {shares.max():.3f}"
                f" | {np.mean([each['seconds'] for each in points]):.2f} |"
            )
            if limit < FEWEST:
                worst += [
                    (
                        each["error"] / limit,
                        f"| {row['shape']}, {row['material']}, {row['light']} | {limit:g}"
                        f" | {each['error']:.2f} | {each['differences']:.2f} |",
                    )
                    for row, each in zip(rows, points, strict=True)
                ]
    lines += ["", "| the largest errors for their limits | limit | error | differences |"]
    lines += ["|---|---|---|---|", *(line for _, line in sorted(worst, reverse=True)[:8])]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, and write report.json and report.md."""
    parser = command_line.parser(__doc__, "shots", 60, seed=5, size=64, meshes=True)
    parser.add_argument(
        "--finest",
        type=above_zero,
        default=FINEST,
        metavar="LIMIT",
        help="whose points are the reference",
    )
    options = command_line.parse(parser)
    rows = measure(options)
    result = {**provenance(), "size": options.size, "finest": options.finest, "rows": rows}
    command_line.write_report(options.out, result, report(result))
    print(f"See {options.out / 'report.md'}")


if __name__ == "__main__":
    main()
