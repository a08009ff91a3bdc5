"""Sums of a scene that keep a tolerance on a sample of its pixels: planned, checked, made better.

A scene is one of learn.methods.planned (a distant viewer) or learn.methods.planned_views (a view
per pixel).
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from learn.methods.cost_model import good, samples
from learn.methods.planned import Strategy

CHEAP = 24  # pixels below which nothing is worth planning

# (scene, lobes, tolerance) → strategies; (strategy, scene) → one of smaller error, or the same
Plan = Callable[[Any, tuple[int, ...], float], list[Strategy]]
Better = Callable[[Strategy, Any], Strategy]


def checked_sums(
    scene: Any, lobes: tuple[int, ...], tolerance: float, plan: Plan, better: Better
) -> Any:
    """Sums of a scene's lobes whose error on the sample is within the tolerance.

    Where it is not, the part with the largest error is computed again by a better strategy.
    """
    strategies: list[Strategy] = []
    known: dict[Strategy, Any] = {}
    for pick in samples(len(scene.n), scene.texels):
        truth = scene.truth(pick, lobes)
        level = float(truth.mean())
        if not strategies:
            scene.budget = tolerance * level
            strategies = plan(scene, lobes, tolerance)
            sums = scene.sums(strategies, known)
        while not good(np.abs(sums.at_sample(pick) - truth), level, tolerance):
            open_to_change = [
                part for part in sums.parts() if better(part.strategy, scene) != part.strategy
            ]
            if not open_to_change:
                break
            worst = max(
                open_to_change,
                key=lambda part: part.error(pick, scene.truth(pick, part.strategy.lobes)),
            )
            strategies[strategies.index(worst.strategy)] = better(worst.strategy, scene)
            sums = scene.sums(strategies, known)
    return sums
