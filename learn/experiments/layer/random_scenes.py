"""Random materials, lights and cameras, each rendered exactly and by auto (tolerance_check)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from learn.experiments.layer import chart_cases
from learn.methods import load
from manifests.progress import tqdm
from shaders import envmap

TOLERANCES = (5e-2, 1e-2, 1e-3, 1e-4)


def random_light(rng: np.random.Generator) -> np.ndarray:
    """Return a light map (64, 128, 3) of unit mean: a smooth base, lamps, sometimes a sun.

    There are zero to six lamps, from one texel to a quarter of the sky.
    """
    w, solid_angle = envmap.directions(*chart_cases.SIZE)
    L = rng.uniform(0.02, 1.0) * (1 + 0.9 * (w @ unit(rng)))[..., None] * rng.uniform(0.5, 1.0, 3)
    for _ in range(rng.integers(0, 7)):
        width = 10 ** rng.uniform(0.5, 4)
        L = L + 10 ** rng.uniform(-0.5, 2) * np.exp(width * ((w @ unit(rng)) - 1))[
            ..., None
        ] * rng.uniform(0.5, 1.0, 3)
    if rng.random() < 0.3:
        place = rng.integers(4, 60), rng.integers(0, 128)
        L[place] += 10 ** rng.uniform(1, 4) * 0.01 / solid_angle[place]
    if rng.random() < 0.3:
        L = L * 10 ** rng.normal(0, 0.3, (*chart_cases.SIZE, 1))  # texture
    return envmap.unit_mean(L)[0]


def unit(rng: np.random.Generator) -> np.ndarray:
    """Return a random unit vector (3,)."""
    d = rng.normal(size=3)
    return d / np.linalg.norm(d)


def random_label(rng: np.random.Generator, labels: Sequence[np.ndarray]) -> np.ndarray:
    """Return a random label (3, 3, 2, 6).

    A quarter is drawn freely; the others are of the catalogue, two thirds of them with all lobes
    stretched and scaled.
    """
    if rng.random() < 0.25:
        m = np.log(
            np.stack([10 ** rng.uniform(-3, 1, (3, 3)), 10 ** rng.uniform(-2, 4.5, (3, 3))], -1)
        )[..., None]
        return m + 0.2 * rng.normal(size=(3, 3, 2, 6))
    label = np.asarray(labels[rng.integers(len(labels))]).reshape(3, 3, 2, 6).copy()
    if rng.random() < 0.67:
        label[:, :, 1] += rng.normal(0, 0.7)
        label[:, :, 0] += rng.normal(0, 0.3)
    return label


def compare_scenes(
    labels: Sequence[np.ndarray], count: int, size: int, seed: int
) -> list[dict[str, Any]]:
    """Return rows of case, camera, tolerance, error and kept; a quarter of cases in perspective."""
    rows = []
    for case in tqdm(range(count), desc="tolerances", unit="case", mininterval=2):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(case,)))
        label, light = random_label(rng, labels), random_light(rng)
        camera = "perspective" if case % 4 == 3 else "orthographic"
        batch, _ = chart_cases.batch_of(label, light, size, camera)
        with torch.no_grad():
            truth = load("exact").radiance(batch, 1e-2)
            for tolerance in TOLERANCES:
                error = (
                    (load("auto").radiance(batch, tolerance) - truth).abs().mean() / truth.mean()
                ).item()
                rows.append(
                    {
                        "case": case,
                        "camera": camera,
                        "tolerance": tolerance,
                        "error": error,
                        "kept": error <= tolerance,
                    }
                )
    return rows
