"""The cheapest strategy that keeps the tolerance: planned by predicted times, checked on pixels.

Distant viewer: f is a sum over lobes, and each lobe takes the strategy of less predicted time: a
reflectance map, the smallest whose predicted error is within MAP_SHARE × tolerance, or the culled
sum at the pixels. Broad lobes see the light through larger texels (learn/methods/coarse.py), whose
derivative is as good as their value. The result is compared with the exact sum on SAMPLE pixels,
the same every time. Where the mean error there, with its uncertainty, exceeds CHECK × tolerance,
the part with the largest error is computed again: with more lights, with a larger map, or at the
pixels where a map is no faster, and with less culling. Where the compiled kernels do not apply
(float64, numba missing, CUDA) the sum is exact.

View per pixel: likewise, with maps whose nodes have views of their own
(learn/methods/auto_views.py). Where the kernels do not apply, the light is cut into few lights for
all lobes, or for the broad ones (learn/methods/hybrid.py); if the derivative by light is requested
too, which a cut light gives coarsely, the sum is exact.

The error is the mean absolute difference over the mean radiance, both over pixels and channels, of
each material and light. learn/methods/cost_model.py predicts errors and times.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch

from learn.engines.lights import Rotation
from learn.methods import (
    COMPILED,
    Batch,
    Card,
    auto_views,
    block_lists,
    directional,
    forbid_second_derivatives,
    hybrid,
    load,
    lobe_shapes,
    median_cut,
    merge_groups,
    planned,
    radiance_by_numbered_group,
    reflectance_map,
    wants_gradient,
)
from learn.methods.checked_plan import CHEAP, Miss, plan_and_check
from learn.methods.cost_model import (
    CULL_NODES,
    CULL_PIXELS,
    GUARANTEED,
    LIGHT_SHARE,
    MAP_SHARE,
    choose_samples,
    coarsest_level,
    keeps_tolerance,
    map_size,
    next_larger_map,
    node_count,
    sum_seconds,
)

CARD = Card(
    name="auto",
    approximates=(
        "whatever the tolerance allows: reflectance maps, culled sum, coarser lights, or the"
        " exact sum"
    ),
    error=1e-2,
    cost="the least that its model predicts, plus a check of 64 pixels",
    memory="as the method chosen",
    gradient=0.1,
)
CUTS = (64, 256, 1024)
ALONE = 24  # size of the largest map below which all maps take it


def radiance(batch: Batch, tolerance: float) -> torch.Tensor:
    """Return outgoing radiance (P, 3) of a batch."""
    if batch.n.device.type != "cpu":
        return load("exact").radiance(batch, tolerance)
    if not reflectance_map.has_kernel(batch.n):
        if batch.view is not None:
            return radiance_by_numbered_group(
                batch, lambda g, *_: radiance_by_few_lights(batch_of_group(batch, g), tolerance)
            )
        return load("exact").radiance(batch, tolerance)
    batch, rotation = merge_groups(batch), tuple(batch.camera_from_light.flatten().tolist())
    if batch.view is not None:
        return auto_views.radiance(batch, rotation, tolerance)
    plan = functools.partial(plan_sums, rotation=rotation, tolerance=tolerance)
    return radiance_by_numbered_group(
        batch, lambda g, n, view, m, light: planned.radiance(n, m, light, plan)
    )


def batch_of_group(batch: Batch, g: int) -> Batch:
    """Return the batch of one group alone."""
    n, view = (
        batch.n.split(batch.counts)[g],
        (None if batch.view is None else batch.view.split(batch.counts)[g]),
    )
    return replace(
        batch,
        n=n,
        view=view,
        m=batch.m[g : g + 1],
        counts=batch.counts[g : g + 1],
        light_of=batch.light_of[g : g + 1],
    )


def plan_sums(
    n: np.ndarray,
    m: np.ndarray,
    light: np.ndarray,
    gradients: Sequence[bool],
    rotation: Rotation,
    tolerance: float,
) -> planned.Sums:
    """Return sums of one group for a distant viewer that keep the tolerance on the sample."""
    _, material_gradient, light_gradient = gradients
    scene = planned.Scene(n, m, light, rotation, light_gradient, material_gradient)
    lobes = (
        block_lists.ALL_LOBES
        if material_gradient
        else tuple(np.flatnonzero(lobe_shapes.sharpness(m) > 0).tolist())
    )
    texels = light.shape[0] * light.shape[1]
    if len(n) < CHEAP or directional.is_small(len(n), texels, any(gradients)) or not lobes:
        return planned.Sums(scene, [planned.Strategy(lobes, 0, 0, 0.0)] if lobes else [], {})
    return plan_and_check(scene, lobes, tolerance, choose_strategies, improve_strategy)


def improve_strategy(part: planned.Sum, _: Miss) -> planned.Strategy:
    """Return a strategy of smaller error, or the same one if there is none.

    It has more lights, a larger map or less culling.
    """
    strategy, scene = part.strategy, part.scene
    culled = max(strategy.culled / 2.5, GUARANTEED)
    if strategy.size:
        strategy = replace(strategy, size=next_larger_map(strategy.size, len(scene.n)))
    return replace(strategy, level=max(strategy.level - 1, 0), culled=culled)


def choose_strategies(
    scene: planned.Scene, lobes: tuple[int, ...], tolerance: float
) -> list[planned.Strategy]:
    """Return the strategy of each group of a scene's lobes.

    Lobes that reflect nothing count only for derivatives by the material.
    """
    sharp, strength = lobe_shapes.sharpness(scene.m), lobe_shapes.strength(scene.m)
    sharp = np.where(sharp > 0, sharp, lobe_shapes.sharpness(scene.m, dark=True))
    share = np.clip(3 * strength / max(strength.sum(), 1e-300), 0.1, 1.0)
    sizes, levels, pixels = np.full(3, -1), np.zeros(3, int), len(scene.n)
    detail = scene.light.detail()
    for s in lobes:
        levels[s] = coarsest_level(sharp[s], LIGHT_SHARE * tolerance / share[s], scene.light.size)
        lights = scene.light.size[0] * scene.light.size[1] >> 2 * levels[s]
        sizes[s] = map_size(sharp[s], MAP_SHARE * tolerance / share[s], detail, scene.light.size[0])
        by_map = sum_seconds(sharp[s], node_count(sizes[s]), lights, tolerance)
        if sizes[s] > reflectance_map.LARGEST or by_map > sum_seconds(
            sharp[s], pixels, lights, tolerance
        ):
            sizes[s] = 0
    # lobes of similar width share a map's geometry; a map is not resampled at a small one's nodes
    if (mapped := sizes > 0).sum() > 1:
        sizes[mapped & ((1.3 * sizes > sizes.max()) | (sizes.max() < ALONE))] = sizes.max()
    groups: dict[tuple[int, int], list[int]] = {}
    for s in lobes:
        groups.setdefault((int(sizes[s]), int(levels[s])), []).append(s)
    return [
        planned.Strategy(tuple(lobes), size, level, CULL_NODES if size else CULL_PIXELS)
        for (size, level), lobes in groups.items()
    ]


def radiance_by_few_lights(batch: Batch, tolerance: float) -> torch.Tensor:
    """Return radiance (P, 3) of one group seen from a view per pixel."""
    exact, (height, width) = load("exact").radiance, batch.light.shape[1:3]
    if len(batch.n) < CHEAP or directional.is_small(
        len(batch.n), height * width, wants_gradient(batch.n, batch.view, batch.m)
    ):
        return exact(batch, tolerance)
    if wants_gradient(batch.light):
        return exact(batch, tolerance)
    with torch.no_grad():
        checks = [
            Check(batch, pick, tolerance) for pick in choose_samples(len(batch.n), height * width)
        ]
        strategies = [
            strategy
            for count in CUTS
            for strategy in (
                functools.partial(median_cut.radiance_by_lights, lights=count),
                functools.partial(
                    hybrid.radiance_by_lights, count=count, left_out=0.25 * tolerance
                ),
            )
        ]
        chosen = next(
            (
                strategy
                for strategy in strategies
                if all(check.keeps_tolerance(strategy) for check in checks)
            ),
            None,
        )
    if not chosen:
        return exact(batch, tolerance)
    return chosen(
        forbid_second_derivatives(batch, CARD.name, COMPILED)
        if directional.has_kernels(batch.n)
        else batch
    )


class Check:
    """Pixels `pick` of a batch of one group with a view per pixel, and their exact radiance.

    It is summed when first needed.
    """

    def __init__(self, batch: Batch, pick: np.ndarray, tolerance: float):
        index = torch.from_numpy(pick)
        view = None if batch.view is None else batch.view[index]
        self.batch = replace(batch, n=batch.n[index], view=view, counts=(len(index),))
        self.tolerance = tolerance

    @functools.cached_property
    def truth(self) -> torch.Tensor:
        """The exact radiance (S, 3)."""
        return load("exact").radiance(self.batch, self.tolerance)

    def keeps_tolerance(self, strategy: Callable[[Batch], torch.Tensor]) -> bool:
        """Return whether strategy(batch) keeps the tolerance there."""
        return keeps_tolerance(
            (strategy(self.batch) - self.truth).abs().numpy(),
            self.truth.mean().item(),
            self.tolerance,
        )
