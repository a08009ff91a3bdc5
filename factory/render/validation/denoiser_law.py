"""The law by which samples of the denoiser are planned (factory.render.estimators.denoised).

shots    drawn from a seed; each in frames of SIZES, in which the denoiser is tried on TRIED samples
bias     of denoised halves, squared, by the comparison with the other half's noisy pixels
noise    error of the same samples without denoiser, by the halves' difference
fit      log (bias / what the effort leaves) = a factor of the shot + power · log noise
         + size · log (STANDARD / pixels)
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

from factory.render.estimators import blends
from factory.render.estimators.halves import Halves
from factory.render.estimators.renderer import STANDARD, Shown, effort
from factory.render.validation.scenes import TIERS, Stage, draw_scene
from manifests.schema import Camera

SIZES = (64, 128, 256)
TRIED = (4, 8, 16, 32, 64)  # samples of each half
LEAST = 0.05  # squared bias that is not lost in its uncertainty


def law(stage: Stage, options: argparse.Namespace) -> dict[str, Any]:
    """Return the law's numbers over shots, and the denoiser's time in samples by tier."""
    rows: list[dict[str, Any]] = []
    for number in range(options.shots):
        scene = draw_scene(number, options.seed, stage.materials)
        for size in SIZES:
            stage.studio.set_camera(Camera(size=(size, size)))
            mask = stage.show(scene)
            for samples in TRIED:
                shown = Shown(stage.studio, scene.seed + samples, scene.tier, mask)
                rows.append({"shot": number, "tier": scene.tier, **_try(shown, samples)})
        print(f"{number}: {scene}", flush=True)
    return {**fit_law(rows), "cost_in_samples": _costs(rows), "rows": rows}


def _try(shown: Shown, samples: int) -> dict[str, Any]:
    """Return noise, bias and error of denoised halves, and the seconds of samples and denoiser."""
    halves = Halves(shown)
    start = time.process_time()
    halves.grow(samples)
    rendered = time.process_time()
    smooth = halves.denoised_pictures()
    seconds, denoiser = rendered - start, time.process_time() - rendered
    blend = blends.choose_blend(halves, smooth, halves.pictures, 0.0, shares=(0.0,))
    return {
        "pixels": shown.mask.size,
        "samples": samples,
        "noise": halves.estimate().noise,
        "bias": blend.bias_alone,
        "error": blend.estimate.error,
        "seconds": seconds,
        "denoiser": denoiser,
    }


def fit_law(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return power, size, the scale's percentiles over shots, and error over bias (median)."""
    usable = [row for row in rows if row["bias"] > LEAST and row["noise"] > 0]
    noise = np.log([row["noise"] for row in usable])
    bias = np.log([row["bias"] / effort(row["samples"]).leaves for row in usable])
    fewer = np.log([STANDARD / row["pixels"] for row in usable])
    shots, of = np.unique([row["shot"] for row in usable], return_inverse=True)
    columns = np.column_stack([noise, fewer, np.eye(len(shots))[of]])
    power, size, *scales = np.linalg.lstsq(columns, bias, rcond=None)[0]
    return {
        "power": float(power),
        "size": float(size),
        "scale_10_50_90": np.exp(np.percentile(scales, [10, 50, 90])).tolist(),
        "error_over_bias": float(np.median([row["error"] / row["bias"] for row in usable])),
    }


def _costs(rows: list[dict[str, Any]]) -> dict[str, float | None]:
    """Return denoised.COST by tier; None for one without a shot."""
    costs: dict[str, float | None] = {}
    for tier in TIERS:
        of = [row for row in rows if row["tier"] == tier and row["samples"] >= 16]
        ratios = [
            row["denoiser"] / effort(row["samples"]).cost / (row["seconds"] / row["samples"])
            for row in of
        ]
        costs[tier] = float(np.median(ratios)) if ratios else None
    return costs
