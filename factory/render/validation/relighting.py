"""Whether one view and material is cheaper to render under a basis of lights than light by light.

python -m factory.render.validation.relighting --scenes 6 --out DIR

A measurement that was stopped is continued by the same command.

Light is added up linearly, so a picture under any light is a sum of pictures under a basis of
lights, in so far as the basis can show that light (factory.render.validation.light_bases).

scenes    drawn from a seed (validation.scenes), in the tier `full`, each with LIGHTS lights: the
          maps that come with the program, each turned eight ways
sums      of pictures of the basis, rendered once
ratios    the closed form of each light's direct light, times the ratio of two such sums, with and
          without shadows and interreflection; it takes out what the basis does to direct light
error     display L2 over the mask against a reference, of SHOWN lights of each scene
seconds   of a processor in one thread: once for the basis, and for each picture with its light. The
          closed form counts without maps of earlier pictures, which another light does not have
result    it pays from 12 to 26 pictures of a view and material, at errors above 20 on a matte white
          and above 70 on other materials, and never at smaller ones: no estimator was made of it
speed     by how much faster a basis makes N pictures than the fastest of path tracing, denoiser and
          ratio makes them at its error (speed_accuracy_report.at_error)
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from factory.lights import load as load_light
from factory.render import light as worlds
from factory.render.estimators import ratio
from factory.render.estimators.relighting import sum_basis_pictures
from factory.render.estimators.renderer import Shown
from factory.render.validation import command_line, scenes, speed_accuracy
from factory.render.validation.light_bases import Basis, cells, factors, harmonics
from factory.render.validation.relighting_report import chart, figures, report
from manifests.line_files import Lines
from manifests.provenance import provenance

if TYPE_CHECKING:
    from factory.render.studio import Studio

LIGHTS = 64
SHOWN = (0, 27)  # of them, of which errors are measured
SAMPLES = {"32 cells": (4, 16), "128 cells": (4,), "31 harmonics": (4,), "32 factors": (16,)}
BASELINES = {"path tracing": (4, 16, 64), "denoised": (4, 16, 64), "ratio": (4, 16)}


def lights() -> list[np.ndarray]:
    """Return the lights as the camera sees them; successive ones are of other maps."""
    maps = [load_light(name).L64 for name in scenes.LIGHTS]
    return [worlds.as_seen(maps[k % 8], k // 8 * 16 + 5 * k % 16) for k in range(LIGHTS)]


class _Clock:
    """Processor seconds since it was made."""

    def __init__(self) -> None:
        self._start = time.process_time()

    @property
    def seconds(self) -> float:
        return time.process_time() - self._start


def render_under_maps(
    studio: Studio, basis: Basis, samples: int, seed: int
) -> Iterator[list[np.ndarray]]:
    """Yield each map's pictures (height, width, 3), with all light paths and unblocked."""
    for k, each in enumerate(basis.maps):
        studio.set_light(np.repeat(each[..., None], 3, axis=-1), 0)
        yield [studio.portion(0, samples, seed + k, tier).noisy for tier in ("full", "direct")]


def by_basis(
    studio: Studio, basis: Basis, samples: int, seed: int, shown: list[np.ndarray]
) -> Iterator[tuple[str, int, np.ndarray, float, float]]:
    """Yield (family, number of the light, picture, seconds once, seconds of this picture)."""
    clock = _Clock()
    pairs = np.array(
        list(render_under_maps(studio, basis, samples, seed))
    )  # (B, 2, height, width, 3)
    once = clock.seconds
    for number, L in enumerate(shown):
        clock = _Clock()
        weights = basis.weights(L)
        full = sum_basis_pictures(pairs[:, 0], weights)
        # without the unblocked pictures the basis takes half as long, or a little more
        yield f"{basis.name}, sum", number, full, once / 2, clock.seconds
        studio._direct_light.forget_closed_forms()
        clock = _Clock()
        studio.set_light(L, 0)
        exact = studio.direct_light()
        assert exact is not None
        picture = ratio.multiply_by_ratio(
            exact.radiance, full, sum_basis_pictures(pairs[:, 1], weights)
        )
        yield f"{basis.name}, ratio", number, picture, once, clock.seconds


def light_by_light(studio: Studio, shown: Shown, L: np.ndarray) -> Iterator[tuple[str, int, Any]]:
    """Yield (family, samples, (picture, seconds)) of the estimators that the product has."""
    known = speed_accuracy.methods(studio)
    for family, counts in BASELINES.items():
        for samples in counts:
            method = known[family, f"{samples} samples"]
            method(replace(shown, seed=shown.seed ^ 2))  # as speed_accuracy.warm does
            studio._direct_light.forget_closed_forms()
            clock = _Clock()
            studio.set_light(L, 0)
            yield family, samples, (method(shown), clock.seconds)


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return a row for each scene, setting and light that is shown.

    Rows of an earlier, stopped measurement are kept.
    """
    lines = Lines(options.out / "rows.jsonl")
    measured = [json.loads(line) for line in lines.read().splitlines()][: options.scenes]
    stage, all_lights = scenes.Stage(options.size, 1), lights()
    studio, some = stage.studio, [all_lights[k] for k in SHOWN]
    bases = [cells(4, 8), cells(8, 16), harmonics(), factors(all_lights, 32)]
    for number in range(len(measured), options.scenes):
        rows: list[dict[str, Any]] = []
        scene = replace(scenes.draw_scene(number, options.seed, stage.materials), tier="full")
        mask = stage.show(scene)
        studio.direct_light()  # compiles its kernels
        made = []
        for basis in bases:
            for samples in SAMPLES[basis.name]:
                of = by_basis(studio, basis, samples, scene.seed, some)
                made += [(f, samples, k, p, once, each) for f, k, p, once, each in of]
        shown = Shown(studio, scene.seed, scene.tier, mask)
        for k, L in enumerate(some):
            studio.set_light(L, 0)
            made += [(f, s, k, p, 0.0, t) for f, s, (p, t) in light_by_light(studio, shown, L)]
            studio.set_light(L, 0)
            reference = stage.reference(scene, mask, options.reference)
            for family, samples, at, picture, once, each in made:
                if at == k:
                    rows.append(
                        {
                            **asdict(scene),
                            "scene": number,
                            "number_of_light": SHOWN[k],
                            "family": family,
                            "samples": samples,
                            "once": once,
                            "each": each,
                            "error": scenes.compare(picture, picture, reference).error,
                        }
                    )
        lines.append(rows)
        measured.append(rows)
        print(f"{number + 1} of {options.scenes}: {scene}", flush=True)
    return [row for rows in measured for row in rows]


def main() -> None:
    """Measure, and write report.json, report.md and chart.png."""
    parser = command_line.parser(__doc__, "scenes", 6, seed=7, size=96, reference=256)
    options = command_line.parse(parser)
    rows = measure(options)
    result = {
        **provenance(),
        **{key: getattr(options, key) for key in ("scenes", "size", "reference")},
        "figures": figures(rows),
        "rows": rows,
    }
    command_line.write_report(options.out, result, report(result))
    chart(result["figures"], options.out / "chart.png")
    print(f"See {options.out / 'report.md'}")


if __name__ == "__main__":
    main()
