"""The strategies of `auto` for a view per pixel: sums at the pixels, or maps for a few views.

As for a distant viewer (learn/methods/auto.py), each lobe takes the strategy of less predicted
time, broad lobes see the light through larger texels, and the picture is checked on a sample.
"""

import functools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from learn.engines.lights import Rotation
from learn.methods import (
    Batch,
    block_lists,
    directional,
    lobe_shapes,
    per_group,
    planned_views,
    reflectance_map,
)
from learn.methods.checked_plan import CHEAP, checked_sums
from learn.methods.cost_model import (
    CULL_NODES,
    GUARANTEED,
    LIGHT_SHARE,
    MAP_SHARE,
    coarsest,
    grown,
    map_size,
    node_count,
    sum_seconds,
)
from learn.methods.planned import Strategy

# times as long as for a distant viewer, whose h and splines belong to the light
DEARER = 2.4
LOOK_UP = 1.1e-7  # seconds for each pixel and view, forward and backward
# of the error of interpolating between so many views: factor × spread^power, by whether maps are
# read where they mirror the light
VIEW_ERROR = {
    False: {1: (0.35, 1.0), 3: (0.1, 2.0), 6: (0.05, 3.0)},
    True: {1: (0.02, 1.0), 3: (0.1, 2.0), 6: (0.1, 2.5)},
}
MORE_VIEWS = {1: 3, 3: 6, 6: 0}
VIEW_SHARE = 0.4  # of the tolerance
NOTICED = 1e-3  # XX
CULL_VIEWS = 30.0  # as CULL_PIXELS; cones of a tile's views widen the bound, not what is left out
BROAD = 15.0  # sharpness up to which a lobe is read at the pixel's own normal
SIMILAR = 1.3  # times a map's size: maps whose largest is below it take its size


def radiance(batch: Batch, rotation: Rotation, tolerance: float) -> torch.Tensor:
    """Outgoing radiance (P, 3) of a batch with a view per pixel, by the kernels."""
    plan = functools.partial(planned_sums, rotation=rotation, tolerance=tolerance)

    def one_group(
        g: int, n: torch.Tensor, view: torch.Tensor, m: torch.Tensor, light: torch.Tensor
    ) -> torch.Tensor:
        # κ above the kernels' largest takes part with that, without a derivative
        clamped = torch.minimum(m, m.new_tensor(directional.LARGEST_CONTROL))
        return planned_views.radiance(n, view, clamped, light, plan)

    return per_group(batch, one_group)


def planned_sums(
    n: np.ndarray,
    view: np.ndarray,
    m: np.ndarray,
    light: np.ndarray,
    gradients: Sequence[bool],
    rotation: Rotation,
    tolerance: float,
) -> planned_views.Sums:
    """Sums of one group that keep the tolerance on the sample."""
    _, _, material_gradient, light_gradient = gradients
    scene = planned_views.Scene(
        n, view, m, light, rotation, tolerance, light_gradient, material_gradient
    )
    lobes = (
        block_lists.ALL_LOBES
        if material_gradient
        else tuple(np.flatnonzero(lobe_shapes.sharpness(m) > 0).tolist())
    )
    if len(n) < CHEAP or directional.is_small(len(n), scene.texels, any(gradients)) or not lobes:
        return scene.sums([Strategy(lobes, 0, 0, 0.0)] if lobes else [], {})
    return checked_sums(scene, lobes, tolerance, best_plan, better)


def better(strategy: Strategy, scene: planned_views.Scene) -> Strategy:
    """A strategy of smaller error: more views and a larger map, more lights, less culling."""
    culled = max(strategy.culled / 2.5, GUARANTEED)
    if strategy.size:
        size, views = grown(strategy.size, len(scene.n)), strategy.views
        factor, power = VIEW_ERROR[strategy.mirrored].get(views, (1.0, 1.0))
        if strategy.culled < CULL_NODES and factor * scene.views.spread**power > NOTICED:
            views = MORE_VIEWS[views]
        if not (size and views):
            size, views = 0, 1
        mirrored = strategy.mirrored and size > 0
        strategy = replace(strategy, size=size, views=views, mirrored=mirrored)
    return replace(strategy, level=max(strategy.level - 1, 0), culled=culled)


def best_plan(
    scene: planned_views.Scene, lobes: tuple[int, ...], tolerance: float
) -> list[Strategy]:
    """The strategy of each group of a scene's lobes.

    Lobes that reflect nothing count only for derivatives by the material.
    """
    sharp, strength = lobe_shapes.sharpness(scene.m), lobe_shapes.strength(scene.m)
    sharp = np.where(sharp > 0, sharp, lobe_shapes.sharpness(scene.m, dark=True))
    share = np.clip(3 * strength / max(strength.sum(), 1e-300), 0.1, 1.0)
    sizes, levels, views = np.zeros(3, int), np.zeros(3, int), np.ones(3, int)
    mirrored = sharp > BROAD
    detail, pixels = scene.light.detail(), len(scene.n)
    for s in lobes:
        levels[s] = coarsest(sharp[s], LIGHT_SHARE * tolerance / share[s], scene.light.size)
        lights = scene.texels >> 2 * levels[s]
        size = map_size(sharp[s], MAP_SHARE * tolerance / share[s], detail, scene.light.size[0])
        count = view_count(scene.views.spread, mirrored[s], VIEW_SHARE * tolerance / share[s])
        if count and size <= reflectance_map.LARGEST:
            by_map = DEARER * sum_seconds(sharp[s], count * node_count(size), lights, tolerance)
            by_map += count * LOOK_UP * pixels
            if by_map < DEARER * sum_seconds(sharp[s], pixels, lights, tolerance):
                sizes[s], views[s] = size, count
    for kind in (mirrored, ~mirrored):  # lobes of similar width share their maps' geometry
        alike = kind & (sizes > 0)
        alike &= SIMILAR * sizes > sizes.max(where=alike, initial=0)
        sizes[alike] = sizes.max(where=alike, initial=0)
        views[alike] = views.max(where=alike, initial=1)
    groups: dict[tuple[int, int, int, bool], list[int]] = {}
    for s in lobes:
        key = int(sizes[s]), int(levels[s]), int(views[s]), bool(mirrored[s] and sizes[s])
        groups.setdefault(key, []).append(s)
    return [
        Strategy(tuple(lobes), size, level, CULL_NODES if size else CULL_VIEWS, count, mirrors)
        for (size, level, count, mirrors), lobes in groups.items()
    ]


def view_count(spread: float, mirrored: bool, error: float) -> int:
    """The fewest views that keep a predicted error; 0 if none do."""
    for count, (factor, power) in VIEW_ERROR[bool(mirrored)].items():
        if factor * spread**power <= error:
            return count
    return 0
