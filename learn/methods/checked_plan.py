"""Sums of a scene that keep a tolerance on a sample of its pixels: planned, checked, made better.

A scene is one of learn.methods.planned (a distant viewer) or learn.methods.planned_views (a view
per pixel).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from learn.methods.cost_model import choose_samples, excess, keeps_tolerance
from learn.methods.planned import Strategy

CHEAP = 24  # pixels below which nothing is worth planning


@dataclass(frozen=True)
class Miss:
    """How a part of a picture misses the tolerance on a sample.

    pick    pixels (S,)
    truth   the sum of the part's lobes there, (S, 3)
    excess  mean absolute error of the whole picture that is to be removed
    """

    pick: np.ndarray
    truth: np.ndarray
    excess: float


# (scene, lobes, tolerance) → strategies; (part of the sums, its miss) → a strategy of smaller
# error, or the same
Plan = Callable[[Any, tuple[int, ...], float], list[Strategy]]
Better = Callable[[Any, Miss], Strategy]


def plan_and_check(
    scene: Any, lobes: tuple[int, ...], tolerance: float, plan: Plan, better: Better
) -> Any:
    """Return sums of a scene's lobes whose error on the sample is within the tolerance.

    Where it is not, the part with the largest error is computed again by a better strategy.
    """
    strategies: list[Strategy] = []
    known: dict[Strategy, Any] = {}
    for pick in choose_samples(len(scene.n), scene.texels):
        truth = scene.truth(pick, lobes)
        level = float(truth.mean())
        if not strategies:
            scene.budget = tolerance * level
            strategies = plan(scene, lobes, tolerance)
            sums = scene.sums(strategies, known)
        while not keeps_tolerance(error := np.abs(sums.at_sample(pick) - truth), level, tolerance):
            too_much = excess(error, level, tolerance)
            parts = sums.parts()
            truths = [scene.truth(pick, part.strategy.lobes) for part in parts[1:]]
            truths.insert(0, truth - sum(truths))
            misses = [
                (part, Miss(pick, exact, too_much))
                for part, exact in zip(parts, truths, strict=True)
            ]
            misses.sort(key=lambda each: -each[0].error(pick, each[1].truth))
            for part, miss in misses:
                if (strategy := better(part, miss)) != part.strategy:
                    break
            else:
                break
            strategies[strategies.index(part.strategy)] = strategy
            sums = scene.sums(strategies, known)
    return sums
