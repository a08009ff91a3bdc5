"""What putting back detail that a denoiser took away is worth.

python -m factory.render.validation.detail_put_back --shots 40 --out DIR
python -m factory.render.validation.detail_put_back --shots 10 --meshes FOLDER --size 256 --out DIR

shots        drawn from a seed (validation.scenes), at full light transport
pictures     of SAMPLES of each half: denoised, by the ratio, and by shadow rays, of which only the
             indirect light is denoised. The latter's direct light is taken from the reference
reference    two pictures of `--reference` samples with other seeds. The product of what a picture
             is off by each of them has no noise of theirs
errors       by the display curve's slope at the reference. Overexposed pixels, where it is 0, do
             not count; `error_target check` compares display values, in which they do
least limit  that a blend keeps, on its error and on a third of it for its squared bias. It is the
             least of all blends by the reference, with lost detail put back and without. The
             program has to choose by the halves
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from factory.render.estimators import blends, closed_form, denoised, ratio, shadow_rays
from factory.render.estimators.halves import Halves, half_seed
from factory.render.estimators.renderer import Shown
from factory.render.validation import command_line
from factory.render.validation.scenes import Stage, draw_scene, meshes_of, name_of_file
from manifests.provenance import provenance
from shaders import tone

SAMPLES = (8, 32, 128)  # of each half
LIMIT = 5.0  # for which the closed form chooses its points
LEAST_NOISE = 0.1  # display L2 of pictures that are worth denoising
LEAST_LIMIT = 0.05  # smaller ones are lost in the reference's noise
Pair = Sequence[np.ndarray]


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return a row for each shot, estimator and number of samples."""
    stage, meshes = Stage(options.size, 1), meshes_of(options.meshes)
    rows: list[dict[str, Any]] = []
    for number in range(options.shots):
        scene = replace(draw_scene(number, options.seed, stage.materials, meshes), tier="full")
        shown = Shown(stage.studio, scene.seed, "full", stage.show(scene))
        if not shown.mask.any():
            continue
        about = asdict(name_of_file(scene))
        new = [about | row for row in measure_shot(shown, options.reference)]
        rows += new
        print(f"{number}: {about['shape']} {scene.material} {scene.light}", flush=True)
    return rows


def measure_shot(shown: Shown, samples: int) -> list[dict[str, Any]]:
    """Return a row for each estimator and number of samples; samples: of either reference."""
    # seeds that neither half has: the second half's is a hash of the first one's
    reference = Halves(replace(shown, seed=half_seed(half_seed(shown.seed, 1), 1)))
    reference.grow(samples)
    direct = closed_form.compute_direct_light(shown, LIMIT)
    halves, rows = Halves(shown), []
    for count in SAMPLES:
        halves.grow(count - halves.samples)
        smooth, noisy = halves.denoised_pictures(), halves.pictures
        rows.append(_compare(denoised.NAME, halves, smooth, noisy, reference.pictures))
        if direct is not None:
            unblocked = halves.unblocked_pictures()
            pairs = zip(smooth, halves.denoised_unblocked_pictures(), strict=True)
            by_ratio = [ratio.multiply_by_ratio(direct.radiance, *pair) for pair in pairs]
            slope = halves.slope_map(smooth)
            less_noisy = ratio.reduce_noise(direct.radiance, noisy, unblocked, slope)
            rows.append(_compare(ratio.NAME, halves, by_ratio, less_noisy, reference.pictures))
        one, other = reference.traced_direct_pictures()
        shadowed = (one + other) / np.float32(2)
        by_rays, as_rendered, truths = (
            [shadowed + each for each in pictures]
            for pictures in (
                halves.indirect_pictures(denoised=True),
                halves.indirect_pictures(),
                reference.indirect_pictures(),
            )
        )
        rows.append(_compare(shadow_rays.NAME, halves, by_rays, as_rendered, truths))
    return [row for row in rows if row["noise"] >= LEAST_NOISE]


def _compare(
    name: str, halves: Halves, smooth: Pair, unbiased: Pair, truths: Pair
) -> dict[str, Any]:
    """Return errors and squared biases of an estimator's blends by the reference."""
    mask = halves.shown.mask
    mean = (truths[0] + truths[1]) / np.float32(2)
    slope = tone.display_slope(mean[mask], tone.auto_exposure(mean, mask))

    def noise_of(pair: Pair) -> float:
        difference = (pair[0] - pair[1])[mask] * slope
        return float((difference**2).mean(dtype=np.float64)) / 4

    shares = blends.SHARES if name == denoised.NAME else blends.UP_TO_ALL
    alone: dict[bool, dict[str, float]] = {}
    limits: dict[bool, list[float]] = {False: [], True: []}
    for blend in blends.make_blends(halves, smooth, unbiased, shares, with_detail=True):
        picture = (blend.pair[0] + blend.pair[1]) / np.float32(2)
        one, other = ((picture - truth)[mask] * slope for truth in truths)
        error = float((one * other).mean(dtype=np.float64))
        bias = error - noise_of(blend.pair)
        limits[blend.has_detail].append(max(error, bias / blends.MOST_BIAS))
        if not blend.share:
            alone[blend.has_detail] = {"error": error, "squared_bias": bias}
    return {
        "estimator": name,
        "samples": halves.samples,
        "noise": noise_of(unbiased),
        "without": alone[False] | {"least_limit": min(limits[False])},
        "with": alone[True] | {"least_limit": min(limits[False] + limits[True])},
    }


def report(result: dict[str, Any]) -> str:
    """Return the page of a measurement."""
    lines = [
        "# What putting back lost detail is worth",
        "",
        f"    {result['command']}",
        "",
        f"Commit {result['commit']}, {result['date']}, {result['machine']}; pictures of"
        f" {result['size']}×{result['size']}, references of {result['reference']:,} samples per"
        " half.",
        "",
        "Medians over shots, of pictures that are not blended with noisy ones; and the least limit"
        " that a blend keeps where detail may be put back, over that without:",
        "",
        "| estimator | samples per half | shots | noise | squared bias | share of it with detail"
        " | noise that detail adds, as a share | least limit, mean factor | best | worst |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name in (denoised.NAME, ratio.NAME, shadow_rays.NAME):
        for samples in SAMPLES:
            rows = [
                row
                for row in result["rows"]
                if row["estimator"] == name and row["samples"] == samples
            ]
            if rows:
                lines.append(f"| {name} | {samples} | {len(rows)} | {_summary(rows)} |")
    return "\n".join(lines) + "\n"


def _summary(rows: list[dict[str, Any]]) -> str:
    """Return the numbers of a line of the page."""

    def values(which: str, key: str) -> np.ndarray:
        return np.array([row[which][key] for row in rows])

    noise = np.array([row["noise"] for row in rows])
    bias = {which: values(which, "squared_bias") for which in ("without", "with")}
    own = {which: values(which, "error") - bias[which] for which in bias}
    seen = bias["without"] > 0
    limits = [np.maximum(values(which, "least_limit"), LEAST_LIMIT) for which in bias]
    factors = limits[1] / limits[0]
    return (
        f"{np.median(noise):.2f} | {np.median(bias['without']):.2f}"
        f" | {np.median((bias['with'] / bias['without'])[seen]):.2f}"
        f" | {np.median((own['with'] - own['without']) / noise):.2f}"
        f" | {np.exp(np.log(factors).mean()):.3f} | {factors.min():.2f} | {factors.max():.2f}"
    )


def main() -> None:
    """Measure, and write report.json and report.md."""
    parser = command_line.parser(__doc__, "shots", 40, seed=5, size=64, reference=512, meshes=True)
    options = command_line.parse(parser)
    rows = measure(options)
    result = {**provenance(), "size": options.size, "reference": options.reference, "rows": rows}
    command_line.write_report(options.out, result, report(result))
    print(f"See {options.out / 'report.md'}")


if __name__ == "__main__":
    main()
