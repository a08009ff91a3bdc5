"""Error and time of direct light by the closed form, against many samples of Cycles.

python -m factory.render.validation.direct_light_error --shots 24 --out DIR
python -m factory.render.validation.direct_light_error --shots 24 --meshes FOLDER --out DIR

shots    drawn from a seed (validation.scenes), all of the tier `direct`
error    display L2 over the mask against a reference in two halves, whose noise cancels in the
         mean; "facing" is the part of pixels with n·v above 0.3
seconds  of one thread: of a first view under a new light, and of a second one, for which most of
         the maps are there already
samples  of each half of a picture that take as long
"""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from factory.render.validation import command_line
from factory.render.validation.scenes import Stage, draw_scene, meshes_of, name_of_file
from manifests.provenance import provenance
from shaders import tone

TIMED = 16  # samples of a picture by which time is counted in samples
GRAZING = 0.3  # n·v


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return a row for each shot."""
    stage = Stage(options.size, 1)
    meshes = meshes_of(options.meshes)
    rows: list[dict[str, Any]] = []
    for number in range(options.shots):
        scene = draw_scene(number, options.seed, stage.materials, meshes)
        scene = replace(scene, tier="direct")
        stage.show(replace(scene, azimuth=scene.azimuth + 1))
        start = time.process_time()
        first = stage.studio.direct_light()
        first_seconds = time.process_time() - start
        mask = stage.show(scene)
        start = time.process_time()
        exact = stage.studio.direct_light()
        seconds = time.process_time() - start
        assert first is not None and exact is not None
        start = time.process_time()
        stage.studio.portion(0, TIMED, scene.seed, "direct")
        per_sample = (time.process_time() - start) / TIMED
        reference = stage.reference(scene, mask, options.reference)
        exposure = tone.auto_exposure(reference.picture, mask)
        a, b, c = (
            tone.display(each[mask], exposure) for each in (exact.radiance, *reference.pictures)
        )
        errors = ((a - b) * (a - c)).mean(-1)
        facing = stage.studio.geometry().normals[mask][:, 2] > GRAZING
        rows.append(
            asdict(name_of_file(scene))
            | {
                "pixels": int(mask.sum()),
                "error": float(errors.mean()),
                "facing": float(errors[facing].sum() / len(errors)),
                "reference_noise": reference.estimate().error,
                "first_seconds": first_seconds,
                "seconds": seconds,
                "samples": seconds / (2 * per_sample),
            }
        )
        last = rows[-1]
        print(
            f"{number}: {last['shape']} {scene.material} {scene.light}: error {last['error']:.2f},"
            f" {seconds:.2f} s",
            flush=True,
        )
    return rows


def report(result: dict[str, Any]) -> str:
    """Return the page of a measurement."""
    rows = result["rows"]
    lines = [
        "# Direct light by the closed form",
        "",
        f"    {result['command']}",
        "",
        f"Commit {result['commit']}, {result['date']}, {result['machine']}; pictures of"
        f" {result['size']}×{result['size']}.",
        "",
        "| | mean | median | worst |",
        "|---|---|---|---|",
    ]
    for key, title in (
        ("error", "error"),
        ("facing", f"of that, where n·v > {GRAZING}"),
        ("reference_noise", "noise of the reference"),
        ("first_seconds", "seconds, first view"),
        ("seconds", "seconds, second view"),
        ("samples", "samples of each half that take as long"),
    ):
        values = np.array([row[key] for row in rows])
        lines.append(
            f"| {title} | {values.mean():.2f} | {np.median(values):.2f} | {values.max():.2f} |"
        )
    lines += ["", "| shape, material, light | error | facing |", "|---|---|---|"]
    for row in sorted(rows, key=lambda row: -row["error"])[:8]:
        lines.append(
            f"| {row['shape']}, {row['material']}, {row['light']} | {row['error']:.2f}"
            f" | {row['facing']:.2f} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, and write report.json and report.md."""
    parser = command_line.parser(__doc__, "shots", 24, seed=3, size=128, reference=256, meshes=True)
    options = command_line.parse(parser)
    rows = measure(options)
    result = {**provenance(), "size": options.size, "rows": rows}
    command_line.write_report(options.out, result, report(result))
    print(f"See {options.out / 'report.md'}")


if __name__ == "__main__":
    main()
