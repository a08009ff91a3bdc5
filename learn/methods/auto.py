"""The cheapest way that keeps the tolerance: planned from a few numbers about the lobes, then checked on sample pixels.

Distant viewer: f is a sum over lobes, and each lobe goes its own way, the one of less predicted time: through a reflectance map, the
smallest whose predicted error is within MAP_SHARE × tolerance, or through the culled sum at the pixels. The whole is then compared with
the exact sum on SAMPLE pixels, the same every time; if the mean error there exceeds CHECK × tolerance, the maps grow, and a lobe whose
map no longer pays is summed at the pixels. At last culling is given less to leave out, down to what its bound guarantees.

View per pixel: the light is cut into few lights (learn/methods/median_cut.py, hybrid.py) and checked in the same way; if the light's
derivative is wanted too, which a cut light gives coarsely, the sum is exact.

The error is the mean absolute difference over the mean radiance, both over pixels and channels, of each material and light.
Constants are fitted by `python -m learn calibrate` and kept in calibration.json beside this file.
"""

import functools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from learn.methods import Batch, Card, directional, hybrid, load, lobe_shapes, merged, per_group, reflectance_map

CARD = Card(
    name="auto",
    approximates="whatever the tolerance allows: reflectance map, culled sum, few lights, or the exact sum",
    error=1e-2,
    cost="the least that its model predicts, plus a check of 64 pixels",
    memory="as the method chosen",
    gradient=0.1,
)
MAP_SHARE, CHECK = 0.6, 0.6  # of the tolerance
CULL = (10.0, 0.5)  # times the tolerance: culling's bound is some 500 times what it leaves out in the mean; the second is guaranteed
SAMPLE = 64
GROWTH = 1.4  # of the map's size where the check fails
CUTS = (64, 256, 1024)
CHEAP = 24  # pixels below which nothing is worth planning


@functools.cache
def calibration():
    """Fitted numbers: error of a map, seconds of each kind of work."""
    return json.loads((Path(__file__).parent / "calibration.json").read_text())


def radiance(batch: Batch, tolerance):
    if batch.n.device.type != "cpu" or min(batch.counts) < CHEAP:
        return load("exact").radiance(batch, tolerance)
    if batch.view is not None:
        return per_group(batch, lambda g, *_: few_lights(part(batch, g), tolerance))
    batch = merged(batch)

    def one_group(g, n, view, m, light):
        lights, E = directional.of_map(light, batch.camera_from_light)
        return distant(n, m, E, lights, tolerance)

    return per_group(batch, one_group)


def part(batch, g):
    """The batch of one group alone."""
    n, view = batch.n.split(batch.counts)[g], None if batch.view is None else batch.view.split(batch.counts)[g]
    return replace(batch, n=n, view=view, m=batch.m[g : g + 1], counts=batch.counts[g : g + 1], light_of=batch.light_of[g : g + 1])


def distant(n, m, E, lights, tolerance):
    """Radiance (P, 3) of one group for a distant viewer."""
    pick = directional.sample(len(n), SAMPLE, n.device)
    with torch.no_grad():
        truth = directional.radiance(n[pick], None, m, E, lights)
    level = truth.mean().item()
    sizes, cull = best_plan(m, len(n), len(E), tolerance), CULL[0]
    done = {}  # parts already computed: (lobes, size, cull) → radiance
    while True:
        out = 0
        for size in sorted(set(sizes[sizes >= 0])):
            lobes = sizes == size
            key = (*lobes.tolist(), int(size), cull)
            if key not in done:
                done[key] = some_lobes(n, lobe_shapes.only(m, lobes), E, lights, size, cull * tolerance * level)
            out = out + done[key]
        if not torch.is_tensor(out):  # no lobe reflects anything
            return n * 0 + 0 * (m.sum() + E.sum())
        if good((out.detach()[pick] - truth).abs(), level, tolerance) or (cull == CULL[1] and not (sizes > 0).any()):
            return out
        if (sizes > 0).any():
            sizes = grown(sizes, len(n))
        else:
            cull = CULL[1]


def some_lobes(n, m, E, lights, size, left_out):
    """Radiance (P, 3) by a map of the size, or where it is 0 at the pixels."""
    if size == 0:
        return directional.radiance(n, None, m, E, lights, left_out)
    return reflectance_map.with_nodes(n, int(size), lambda nodes: directional.radiance(nodes, None, m, E, lights, left_out))


def grown(sizes, pixels):
    """The next larger maps; 0 where a map would have more nodes than there are pixels."""
    larger = np.where(sizes > 0, np.ceil(GROWTH * sizes), sizes).astype(int)
    return np.where((larger > reflectance_map.LARGEST) | (node_count(larger) > pixels), np.minimum(sizes, 0), larger)


def good(error, level, tolerance):
    """Whether errors (S, 3) on a sample keep the tolerance with room for what the sample did not see."""
    return error.mean().item() <= CHECK * tolerance * level and error.max().item() <= 30 * tolerance * level


def best_plan(m, pixels, lights, tolerance):
    """Size of the map for each lobe (3,): 0 where it is summed at the pixels, −1 where it reflects nothing. m (3, 3, 2, 6)."""
    sharp, strength = lobe_shapes.sharpness(m), lobe_shapes.strength(m)
    share = np.clip(3 * strength / max(strength.sum(), 1e-300), 0.1, 1.0)
    sizes = np.full(3, -1)
    for s in np.flatnonzero(sharp > 0):
        size = map_size(sharp[s], MAP_SHARE * tolerance / share[s])
        nodes = min(node_count(size), 16 * pixels)
        by_map = sum_seconds(sharp[s], nodes, lights, tolerance) + pixels * calibration()["seconds"]["look_up"]
        pays = size <= reflectance_map.LARGEST and nodes < pixels and by_map < sum_seconds(sharp[s], pixels, lights, tolerance)
        sizes[s] = size if pays else 0
    if (sizes > 0).sum() > 1 and sizes[sizes > 0].max() < 1.5 * sizes[sizes > 0].min():
        sizes[sizes > 0] = sizes.max()  # lobes of like width share a map's geometry
    return sizes


def map_size(sharp, error):
    """The smallest map whose predicted error is within `error`; LARGEST + 1 if there is none."""
    size = reflectance_map.SMALLEST
    while size <= reflectance_map.LARGEST and map_error(size, sharp) > error:
        size = math.ceil(size * 1.08)
    return min(size, reflectance_map.LARGEST + 1)


def map_error(size, sharp):
    """Predicted relative error of a map for a lobe of given sharpness: that of bicubic interpolation, and of the light's detail."""
    fit = calibration()["map_error"]
    spacing = 2 * math.sqrt(2) / (size - 5)
    return fit["of_lobe"] * (spacing * math.sqrt(max(sharp, fit["least_sharpness"]))) ** fit["power"] + fit["of_light"] * spacing**2


def node_count(size):
    """Nodes of a map that a whole hemisphere of normals needs."""
    return 0.72 * size * size


def sum_seconds(sharp, pixels, lights, tolerance):
    """Predicted time of the culled sum of one lobe, forward and backward: the lights in its cone for each pixel (or node)."""
    fit = calibration()["seconds"]
    tile = math.sqrt(2 * 16 / max(pixels, 1))  # radius of a tile of normals on the hemisphere
    cone = fit["cone"] * (1 + 0.1 * math.log10(1 / tolerance)) / math.sqrt(max(sharp, 1e-9)) + fit["block"] + 2 * tile
    share = 0.5 * (1 - math.cos(min(cone, math.pi / 2)))
    return pixels * (lights * share * fit["pair"] + fit["pixel"]) + fit["call"]


def few_lights(batch, tolerance):
    """Radiance (P, 3) of one group seen from a view per pixel."""
    exact = load("exact").radiance
    if torch.is_grad_enabled() and batch.light.requires_grad:
        return exact(batch, tolerance)
    pick = directional.sample(len(batch.n), SAMPLE, batch.n.device)
    sampled = replace(batch, n=batch.n[pick], view=batch.view[pick], counts=(len(pick),))
    with torch.no_grad():
        truth = exact(sampled, tolerance)
        level = truth.mean().item()
        works = [c for c in CUTS if good((hybrid.with_lights(sampled, c, 0.25 * tolerance) - truth).abs(), level, tolerance)]
    return hybrid.with_lights(batch, works[0], 0.25 * tolerance) if works else exact(batch, tolerance)
