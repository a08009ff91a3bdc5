"""The cheapest way that keeps the tolerance: planned from a few numbers about the lobes, then checked on sample pixels.

Distant viewer: f is a sum over lobes, and each lobe goes its own way, the one of less predicted time: through a reflectance map, the
smallest whose predicted error is within MAP_SHARE × tolerance, or through the culled sum at the pixels. The whole is then compared with
the exact sum on SAMPLE pixels, the same every time; if the mean error there exceeds CHECK × tolerance, the part that errs most is done
again: with a larger map, or the sum at the pixels where a map no longer pays, and culling held to what its bound guarantees.

Where the light's own derivative is not wanted, the lights are first cut to as few as the sample allows (learn/methods/median_cut.py).
View per pixel: the light is cut in the same way, for all lobes or for the broad ones (learn/methods/hybrid.py); if the light's
derivative is wanted too, which a cut light gives coarsely, the sum is exact.

The error is the mean absolute difference over the mean radiance, both over pixels and channels, of each material and light.
The constants in calibration.json beside this file were measured on 2026-11-21 and trimmed by hand on six materials, where they beat the
first fit; `python -m learn calibrate` fits them for another machine.
"""

import functools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from learn.methods import Batch, Card, directional, hybrid, load, lobe_shapes, median_cut, merged, per_group, reflectance_map

CARD = Card(
    name="auto",
    approximates="whatever the tolerance allows: reflectance map, culled sum, few lights, or the exact sum",
    error=1e-2,
    cost="the least that its model predicts, plus a check of 64 pixels",
    memory="as the method chosen",
    gradient=0.1,
)
MAP_SHARE, CHECK = 0.8, 0.75  # of the tolerance
CULL_NODES, CULL_PIXELS, GUARANTEED = 3.0, 10.0, 0.5  # times the tolerance: culling's bound is far above what it leaves out in the mean
CUT_SHARE = 0.5  # of the tolerance, for fewer lights
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
        # A cut light has the derivative of whole regions only: it serves where the light's own is not wanted.
        wanted = torch.is_grad_enabled() and light.requires_grad
        few = [] if wanted else [functools.partial(median_cut.cut, light, batch.camera_from_light, count) for count in CUTS]
        return distant(n, m, E, lights, few, tolerance)

    return per_group(batch, one_group)


def part(batch, g):
    """The batch of one group alone."""
    n, view = batch.n.split(batch.counts)[g], None if batch.view is None else batch.view.split(batch.counts)[g]
    return replace(batch, n=n, view=view, m=batch.m[g : g + 1], counts=batch.counts[g : g + 1], light_of=batch.light_of[g : g + 1])


def distant(n, m, E, lights, few, tolerance):
    """Radiance (P, 3) of one group for a distant viewer; few: functions that give fewer lights and their E, the fewest first."""
    present = lobe_shapes.sharpness(m) > 0
    if not present.any():
        return n * 0 + 0 * (m.sum() + E.sum())
    pick = directional.sample(len(n), SAMPLE, n.device)
    with torch.no_grad():
        truth = directional.radiance(n[pick], None, m, E, lights)
        level = truth.mean().item()
        for cut in few:
            fewer, energy = cut()
            error = directional.radiance(n[pick], None, m, energy, fewer) - truth
            if good(error.abs(), level, CUT_SHARE * tolerance):
                lights, E = fewer, energy
                break
    sizes = best_plan(m, len(n), len(E), tolerance)
    sums = [
        Sum(n, m, E, lights, tuple(np.flatnonzero(sizes == size).tolist()), int(size), tolerance * level)
        for size in sorted(set(sizes[sizes >= 0]))
    ]
    while not good((sum(part.sampled(pick) for part in sums) - truth).abs(), level, tolerance):
        open_to_change = [part for part in sums if part.size or part.culled > GUARANTEED]
        if not open_to_change:
            break
        max(open_to_change, key=lambda part: part.error(pick)).improve()
    return sum(part.radiance() for part in sums)


class Sum:
    """Radiance of some lobes, by a map of a size or, where it is 0, at the pixels: tried on a few of them, then on all.

    A map's nodes are computed once for both; so is the sum at the pixels.
    """

    def __init__(self, n, m, E, lights, lobes, size, budget):
        self.n, self.m, self.E, self.lights, self.lobes, self.budget = n, m, E, lights, lobes, budget
        self.plan(size, CULL_NODES if size else CULL_PIXELS)

    def plan(self, size, culled):
        self.size, self.culled = size, culled
        self.nodes = reflectance_map.needed_nodes(self.n.detach(), size) if size else None
        at = reflectance_map.normals(self.nodes, size).to(self.n) if size else self.n
        self.values = self.exact(at, culled * self.budget)

    def exact(self, n, left_out=0.0):
        return directional.radiance(n, None, self.m, self.E, self.lights, left_out, self.lobes)

    def radiance(self):
        """(P, 3), differentiable."""
        return reflectance_map.look_up(self.n, self.values, self.nodes, self.size) if self.size else self.values

    @torch.no_grad()
    def sampled(self, pick):
        """The same at pixels pick (S,)."""
        return reflectance_map.look_up(self.n[pick], self.values, self.nodes, self.size) if self.size else self.values[pick]

    @torch.no_grad()
    def error(self, pick):
        """Mean absolute error at pixels pick (S,)."""
        return (self.sampled(pick) - self.exact(self.n[pick])).abs().mean().item()

    def improve(self):
        """A larger map where there is one, and no more left out than is guaranteed to matter little."""
        self.plan(grown(self.size, len(self.n)) if self.size else 0, GUARANTEED)


def grown(size, pixels):
    """The next larger map; 0 where it would have more nodes than there are pixels."""
    larger = math.ceil(GROWTH * size)
    return 0 if larger > reflectance_map.LARGEST or node_count(larger) > pixels else larger


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
        ways = [
            way
            for count in CUTS
            for way in (
                functools.partial(median_cut.with_lights, lights=count),
                functools.partial(hybrid.with_lights, count=count, left_out=0.25 * tolerance),
            )
        ]
        chosen = next((way for way in ways if good((way(sampled) - truth).abs(), level, tolerance)), None)
    return chosen(batch) if chosen else exact(batch, tolerance)
