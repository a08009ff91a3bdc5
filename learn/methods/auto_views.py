"""The strategies of `auto` for a view per pixel: sums at the pixels, or maps for a few views.

As for a distant viewer (learn/methods/auto.py), each lobe takes the strategy of less predicted
time, broad lobes see the light through larger texels, and the picture is checked on a sample.
"""

import functools
import math
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
    planned_views,
    radiance_by_numbered_group,
    reflectance_map,
)
from learn.methods.checked_plan import CHEAP, Miss, plan_and_check
from learn.methods.cost_model import (
    CULL_NODES,
    GUARANTEED,
    LIGHT_SHARE,
    MAP_SHARE,
    coarsest_level,
    map_size,
    next_larger_map,
    sum_seconds,
)
from learn.methods.planned import Strategy
from learn.methods.view_maps import slope_map_level, slope_map_size

LOOK_UP = 1.1e-7  # seconds for each pixel and view, forward and backward
DEARER = 2.1  # times as long as for a distant viewer, whose h and splines belong to the light
# as CULL_PIXELS: a tile's views widen the bound, not what is left out
CULL_VIEWS = 30.0
# of the tolerance, that one view may be predicted to cost, by whether maps are read mirrored, and
# that more may. Where they are, one view is worth trying: the check finds where it is too few
ONE_VIEW, MORE = {False: 0.05, True: 2.5}, 1.0
# the factor of culling and the maps' share of the tolerance where a derivative by the view is
# requested: it is a small difference of large parts in matte materials
FINER_CULLING, FINER_MAPS = 0.25, 0.1
# where the check fails: parts that are kept of culling; growth of a map's size, by the power of it
# with which errors fall; the share of nodes from which lobes are summed at the pixels instead
LEAST_KEPT, MOST_KEPT = 0.25, 0.7
LEAST_GROWTH, MOST_GROWTH, ORDER = 1.15, 1.3, 3.0
WORTHWHILE = 0.7
BROAD = 15.0  # sharpness up to which a lobe is read at the pixel's own normal
SIMILAR = 1.3  # times a map's size: maps whose largest is below it take its size
MORE_VIEWS = {(1, False): 3, (3, False): 6, (6, False): 0, (1, True): 3, (3, True): 0}


def radiance(batch: Batch, rotation: Rotation, tolerance: float) -> torch.Tensor:
    """Return outgoing radiance (P, 3) of a batch with a view per pixel, by the kernels."""
    plan = functools.partial(plan_sums, rotation=rotation, tolerance=tolerance)

    def one_group(
        g: int, n: torch.Tensor, view: torch.Tensor, m: torch.Tensor, light: torch.Tensor
    ) -> torch.Tensor:
        # κ above the kernels' largest takes part with that, without a derivative
        clamped = torch.minimum(m, m.new_tensor(directional.LARGEST_CONTROL))
        return planned_views.radiance(n, view, clamped, light, plan)

    return radiance_by_numbered_group(batch, one_group)


def plan_sums(
    n: np.ndarray,
    view: np.ndarray,
    m: np.ndarray,
    light: np.ndarray,
    gradients: Sequence[bool],
    rotation: Rotation,
    tolerance: float,
) -> planned_views.Sums:
    """Return sums of one group that keep the tolerance on the sample."""
    material_gradient = gradients[2]
    scene = planned_views.Scene(n, view, m, light, rotation, tolerance, *gradients[1:])
    lobes = (
        block_lists.ALL_LOBES
        if material_gradient
        else tuple(np.flatnonzero(lobe_shapes.sharpness(m) > 0).tolist())
    )
    if len(n) < CHEAP or directional.is_small(len(n), scene.texels, any(gradients)) or not lobes:
        return scene.sums([Strategy(lobes, 0, 0, 0.0)] if lobes else [], {})
    return plan_and_check(scene, lobes, tolerance, choose_strategies, improve_strategy)


def improve_strategy(part: planned_views.Sum, miss: Miss) -> Strategy:
    """Return a strategy of smaller error, or the same one if there is none.

    It has more lights, and what `improve_maps` or less culling gives.
    """
    strategy, scene = part.strategy, part.scene
    level = strategy.level
    if level:
        loss = scene.light_loss(strategy.lobes, level, miss.pick, miss.truth)
        level -= loss > LIGHT_SHARE * scene.budget
    if strategy.size:
        return replace(improve_maps(part, miss), level=level)
    error = part.error(miss.pick, miss.truth)
    share = min(max(1 - miss.excess / max(error, 1e-30), LEAST_KEPT), MOST_KEPT)
    return replace(strategy, level=level, culled=max(share * strategy.culled, GUARANTEED))


def improve_maps(part: planned_views.Sum, miss: Miss) -> Strategy:
    """Return more views or a larger map, by what the error on the sample comes from, or no maps."""
    strategy, scene = part.strategy, part.scene
    by_view, by_map = part.causes(miss.pick, miss.truth)
    allowed = max(part.error(miss.pick, miss.truth) - miss.excess, 0.0)
    size, views, culled = strategy.size, strategy.views, strategy.culled
    more = MORE_VIEWS[views, strategy.mirrored]
    if more and by_view > by_map:
        views = more
    else:
        growth = (by_map / max(allowed - by_view, 1e-30)) ** (1 / ORDER)
        size = next_larger_map(size, len(scene.n), min(max(growth, LEAST_GROWTH), MOST_GROWTH))
        culled = max(culled / 2.5, GUARANTEED)
    most = WORTHWHILE * len(scene.n)
    if not size or count_nodes(scene, strategy.lobes, strategy.level, size, views) > most:
        return Strategy(strategy.lobes, 0, strategy.level, initial_culling(scene)[0])
    return replace(strategy, size=size, views=views, culled=culled)


def count_nodes(
    scene: planned_views.Scene, lobes: tuple[int, ...], level: int, size: int, views: int
) -> float:
    """Return the number of nodes of the maps for so many views, as if all saw a level of the light.

    size  of the main map
    """
    nodes = scene.node_count(size)
    if scene.view_gradient:
        nodes *= views
    elif views > 1:
        finer = 4.0 ** (level - max(slope_map_level(scene, lobes), level))
        nodes += views * scene.node_count(slope_map_size(size)) * finer
    return nodes


def initial_culling(scene: planned_views.Scene) -> tuple[float, float]:
    """`Strategy.culled` at pixels and at nodes, before the check."""
    factor = FINER_CULLING if scene.view_gradient else 1.0
    return factor * CULL_VIEWS, factor * CULL_NODES


def choose_strategies(
    scene: planned_views.Scene, lobes: tuple[int, ...], tolerance: float
) -> list[Strategy]:
    """Return the strategy of each group of a scene's lobes.

    Lobes that reflect nothing count only for derivatives by the material.
    """
    sharp, share = scene.sharpness, np.clip(3 * scene.shares, 0.1, 1.0)
    sizes, levels, views = np.zeros(3, int), np.zeros(3, int), np.ones(3, int)
    mirrored, culled = sharp > BROAD, initial_culling(scene)
    least, map_share = (3, FINER_MAPS) if scene.view_gradient else (1, MAP_SHARE)
    detail, pixels = scene.light.detail(), len(scene.n)
    for s in lobes:
        levels[s] = coarsest_level(sharp[s], LIGHT_SHARE * tolerance / share[s], scene.light.size)
        lights = scene.texels >> 2 * levels[s]
        size = map_size(sharp[s], map_share * tolerance / share[s], detail, scene.light.size[0])
        if mirrored[s]:  # reflected directions turn faster than a distant viewer's, by V's part
            size = math.ceil(size * (1 + scene.views.steepness))
        count = view_count(scene, s, bool(mirrored[s]), least)
        if count and size <= reflectance_map.LARGEST:
            nodes = count_nodes(scene, (s,), levels[s], size, count)
            by_map = DEARER * sum_seconds(sharp[s], nodes, lights, tolerance)
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
        Strategy(tuple(lobes), size, level, culled[int(size > 0)], count, mirrors)
        for (size, level, count, mirrors), lobes in groups.items()
    ]


def view_count(scene: planned_views.Scene, lobe: int, mirrored: bool, least: int) -> int:
    """Return the fewest views that keep their part of the tolerance, 0 if none do.

    least  of them that are tried
    """
    for count in (1, 3) if mirrored else (1, 3, 6):
        share = ONE_VIEW[mirrored] if count == 1 else MORE
        if count >= least and view_error(scene, lobe, count, mirrored) <= share * scene.tolerance:
            return count
    return 0


def view_error(scene: planned_views.Scene, lobe: int, count: int, mirrored: bool) -> float:
    """Return the predicted error of a picture, of reading a lobe from maps of so many views.

    It grows with what normals do not tell of the views. Fitted to 24 lobes under two lights, from
    two distances (docs/log.md, a view per pixel).
    """
    spread, share = scene.views.spread, scene.shares[lobe]
    if not math.isfinite(spread):
        return math.inf
    if not mirrored:
        sharp = math.sqrt(max(float(scene.sharpness[lobe]), 0.5))
        return share * {1: 0.08 * sharp * spread, 3: 0.25 * spread**2, 6: 0.1 * spread**2.5}[count]
    return share * spread * (0.04 + 0.15 * scene.steepness[lobe] if count == 1 else 0.08)
