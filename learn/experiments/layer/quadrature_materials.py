"""Times and errors of quadrature for measured materials (quadrature_accuracy)."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch

from learn.experiments import runner
from learn.experiments.layer import chart_cases, chart_measurement
from learn.methods import load
from learn.methods.directional import sample
from manifests import materials
from shaders import envmap
from shaders.frames import ELEVATION, camera_from_light

LIGHT = "sun in a texel"
CAMERAS = ("orthographic", "perspective")
METHODS = ("exact", "quadrature")
ROUNDS = 3
HEAD = [
    "camera",
    "materials",
    "time, of exact's: median",
    "longest",
    "above 3 times",
    "largest error",
    "exact's",
    "quadrature's under suns at 20 to 90°",
    "at 125°",
]
SUNS = (
    20,
    55,
    90,
    125,
)  # degrees from the viewer; the last is behind the shape, and lights its rim
SUNS_SIZE = 32  # of pictures under these


def sun_at(degrees: float) -> np.ndarray:
    """Return light (64, 128, 3) with a sun in one texel, so far from a distant viewer.

    The texel is one of those that are at least nine tenths of the largest.
    """
    w, solid_angle = envmap.directions(*chart_cases.SIZE)
    off = np.abs((w @ camera_from_light(ELEVATION).T)[..., 2] - np.cos(np.radians(degrees)))
    off[solid_angle < 0.9 * solid_angle.max()] = np.inf
    row, column = np.unravel_index(np.argmin(off), off.shape)
    return chart_cases.sun_in((int(row), int(column)))


def choose_materials(names: Sequence[str]) -> list[materials.Material]:
    """Return the built-in materials of these names, or all if one of them is `all`.

    Raises  InputError: an unknown name
    """
    every = materials.load_catalogue()
    return list(every.values()) if "all" in names else [materials.find(name) for name in names]


def compare_materials(
    tolerance: float, of: Sequence[materials.Material], size: int, path: Path
) -> list[dict[str, Any]]:
    """Return a row per camera and material: seconds and error of both methods, and further errors.

    Seconds are the least of ROUNDS of one thread's processor time, forward and backward, with the
    gradients of normals, material and light. Errors are mean absolute differences over the mean, to
    the integral over texels of constant radiance. The further ones are of quadrature under a sun at
    each angle of SUNS.

    size  of pictures, in pixels
    path  of a file that keeps the rows, so that a stopped measurement continues
    """
    light = chart_cases.computed_lights()[LIGHT]
    cases = [
        (
            {"camera": camera, "material": each.name, "tolerance": tolerance, "size": size},
            chart_measurement.Case(each.name, each.label, LIGHT, light, camera, size),
        )
        for camera, each in product(CAMERAS, of)
    ]
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    suns = [sun_at(degrees) for degrees in SUNS]
    rows = runner.resume(path, cases, lambda case: _measure(case, tolerance, suns), "case")
    torch.set_num_threads(before)
    return rows


def _measure(
    case: chart_measurement.Case, tolerance: float, suns: Sequence[np.ndarray]
) -> dict[str, Any]:
    """Return {method: {"seconds", "error"}, "further errors": [of each sun]}."""
    batch, _ = case.batch()
    truth = chart_measurement.truth_at(batch, sample(len(batch.n), chart_measurement.SAMPLE))
    row: dict[str, Any] = {}
    for method in METHODS:
        setting = chart_cases.Setting(
            method, f"{tolerance:g}", partial(load(method).radiance, tolerance=tolerance)
        )
        seconds, pictures = zip(
            *(chart_measurement.time_picture(setting, case, True) for _ in range(ROUNDS)),
            strict=True,
        )
        errors = truth.errors(pictures[0].numpy()[truth.pick])
        row[method] = {"seconds": min(seconds), "error": errors["integral"]}
    row["further errors"] = [_error(case, light, tolerance) for light in suns]
    return row


def _error(case: chart_measurement.Case, light: np.ndarray, tolerance: float) -> float:
    """Return the error of a case's picture of SUNS_SIZE under another light."""
    batch, _ = replace(case, light=light, size=SUNS_SIZE).batch()
    pick = sample(len(batch.n), chart_measurement.SAMPLE)
    with torch.no_grad():
        picture = load("quadrature").radiance(batch, tolerance)[pick]
        right = chart_measurement.converged_radiance(chart_measurement.pick_pixels(batch, pick))
    return float((picture - right).abs().mean() / right.mean())


def summary(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """Return a row of a table per camera; see HEAD."""
    result = []
    for camera in CAMERAS:
        here = [row for row in rows if row["camera"] == camera]
        times = {
            row["material"]: row["quadrature"]["seconds"] / row["exact"]["seconds"] for row in here
        }
        slowest = max(times, key=lambda name: times[name])
        worst = max(here, key=lambda row: row["quadrature"]["error"])
        further = {row["material"]: row["further errors"] for row in here}
        *_, in_front = sorted((max(errors[:-1]), name) for name, errors in further.items())
        *_, behind = sorted((errors[-1], name) for name, errors in further.items())
        result.append(
            [
                camera,
                str(len(here)),
                f"{statistics.median(times.values()):.2f}",
                f"{times[slowest]:.2f} ({slowest})",
                str(sum(each > 3 for each in times.values())),
                f"{worst['quadrature']['error']:.2%} ({worst['material']})",
                f"{max(row['exact']['error'] for row in here):.0%}",
                *(f"{error:.2%} ({name})" for error, name in (in_front, behind)),
            ]
        )
    return result
