"""The cheapest strategy that keeps the tolerance: planned by predicted times, checked on pixels.

Distant viewer: f is a sum over lobes, and each lobe takes the strategy of less predicted time: a
reflectance map, the smallest whose predicted error is within MAP_SHARE × tolerance, or the culled
sum at the pixels. Broad lobes see the light through larger texels (learn/methods/coarse.py), whose
derivative is as good as their value. The result is compared with the exact sum on SAMPLE pixels,
the same every time. Where the mean error there, with its uncertainty, exceeds CHECK × tolerance,
the part with the largest error is computed again: with more lights, with a larger map, or at the
pixels where a map is no faster, and with less culling. Where the compiled kernels do not apply
(float64, numba missing, CUDA) the sum is exact.

View per pixel: the light is cut into few lights for all lobes, or for the broad ones
(learn/methods/hybrid.py); if the derivative by light is requested too, which a cut light gives
coarsely, the sum is exact.

The error is the mean absolute difference over the mean radiance, both over pixels and channels, of
each material and light. The constants in calibration.json beside this file were measured on
2026-11-21 and trimmed by hand on six materials, where they beat the first fit; `python -m
learn.experiments calibrate-auto` fits them for another machine.
"""

import functools
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from learn.engines.lights import Rotation
from learn.methods import (
    COMPILED,
    Batch,
    Card,
    block_lists,
    coarse,
    directional,
    first_only,
    hybrid,
    load,
    lobe_shapes,
    median_cut,
    merged,
    per_group,
    planned,
    reflectance_map,
    wants_gradient,
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
MAP_SHARE, LIGHT_SHARE, CHECK = 0.5, 0.15, 0.8  # of the tolerance
COARSEST = 2  # level of the light: coarser ones save nothing that shows
SOFT = 0.8  # standard deviation of what texels of a size can follow, in texels
# times the tolerance: culling's bound is far above what it leaves out in the mean
CULL_NODES, CULL_PIXELS, GUARANTEED = 8.0, 20.0, 0.5
SAMPLE = 64
# of a pixel and a light that the check may cost: a small map shows single dots, which 64 pixels
# miss
SAMPLE_PAIRS = 2**17
GROWTH = 1.4  # of the map's size where the check fails
CUTS = (64, 256, 1024)
# of maps, 6 % apart
SIZES = np.unique(np.geomspace(reflectance_map.SMALLEST, reflectance_map.LARGEST, 66).astype(int))
ALONE = 24  # size of the largest map below which all maps take it
CHEAP = 24  # pixels below which nothing is worth planning


@functools.cache
def calibration() -> dict[str, dict[str, float]]:
    """Fitted numbers: error of a map, seconds of each kind of work."""
    return json.loads((Path(__file__).parent / "calibration.json").read_text())


def radiance(batch: Batch, tolerance: float) -> torch.Tensor:
    """Outgoing radiance (P, 3) of a batch."""
    if batch.n.device.type != "cpu":
        return load("exact").radiance(batch, tolerance)
    if batch.view is not None:
        return per_group(batch, lambda g, *_: few_lights(part(batch, g), tolerance))
    if not reflectance_map.has_kernel(batch.n):
        return load("exact").radiance(batch, tolerance)
    batch, rotation = merged(batch), tuple(batch.camera_from_light.flatten().tolist())
    plan = functools.partial(planned_sums, rotation=rotation, tolerance=tolerance)
    return per_group(batch, lambda g, n, view, m, light: planned.radiance(n, m, light, plan))


def part(batch: Batch, g: int) -> Batch:
    """The batch of one group alone."""
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


def planned_sums(
    n: np.ndarray,
    m: np.ndarray,
    light: np.ndarray,
    gradients: Sequence[bool],
    rotation: Rotation,
    tolerance: float,
) -> planned.Sums:
    """Sums of one group for a distant viewer that keep the tolerance on the sample."""
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
    strategies: list[planned.Strategy] = []
    known: dict[planned.Strategy, planned.Sum] = {}
    for pick in samples(len(n), texels):
        truth = scene.at(n[pick], lobes).radiance
        level = float(truth.mean())
        if not strategies:
            scene.budget = tolerance * level
            strategies = best_plan(scene, lobes, tolerance)
            sums = planned.Sums(scene, strategies, known)
        while not good(np.abs(sums.at_sample(pick) - truth), level, tolerance):
            open_to_change = [
                part for part in sums.parts() if better(part.strategy, len(n)) != part.strategy
            ]
            if not open_to_change:
                break
            worst = max(
                open_to_change,
                key=lambda part: part.error(pick, scene.at(n[pick], part.strategy.lobes).radiance),
            )
            strategies[strategies.index(worst.strategy)] = better(worst.strategy, len(n))
            sums = planned.Sums(scene, strategies, known)
    return sums


def samples(pixels: int, texels: int) -> list[np.ndarray]:
    """Pixels (S,) to plan by and to check; then more to check, where the map is small.

    There they cost little.
    """
    few, many = (
        directional.spread_over(pixels, count)
        for count in (SAMPLE, max(SAMPLE, SAMPLE_PAIRS // texels))
    )
    return [few] if len(many) == len(few) else [few, many]


def better(strategy: planned.Strategy, pixels: int) -> planned.Strategy:
    """A strategy of smaller error: more lights, a larger map, less culling; the same if none is."""
    culled = max(strategy.culled / 2.5, GUARANTEED)
    if strategy.size:
        strategy = replace(strategy, size=grown(strategy.size, pixels))
    return replace(strategy, level=max(strategy.level - 1, 0), culled=culled)


def grown(size: int, pixels: int) -> int:
    """The next larger map; 0 where it would have more nodes than there are pixels."""
    larger = math.ceil(GROWTH * size)
    return 0 if larger > reflectance_map.LARGEST or node_count(larger) > pixels else larger


def good(error: np.ndarray, level: float, tolerance: float) -> bool:
    """Whether errors (S, 3) on a sample keep the tolerance, with a margin by their spread."""
    by_pixel = error.mean(-1)
    uncertainty = float(by_pixel.std()) / math.sqrt(len(by_pixel))
    return (
        float(by_pixel.mean()) + uncertainty <= CHECK * tolerance * level
        and float(error.max()) <= 30 * tolerance * level
    )


def best_plan(
    scene: planned.Scene, lobes: tuple[int, ...], tolerance: float
) -> list[planned.Strategy]:
    """The strategy of each group of a scene's lobes.

    Lobes that reflect nothing count only for derivatives by the material.
    """
    sharp, strength = lobe_shapes.sharpness(scene.m), lobe_shapes.strength(scene.m)
    sharp = np.where(sharp > 0, sharp, lobe_shapes.sharpness(scene.m, dark=True))
    share = np.clip(3 * strength / max(strength.sum(), 1e-300), 0.1, 1.0)
    sizes, levels, pixels = np.full(3, -1), np.zeros(3, int), len(scene.n)
    detail = scene.light.detail()
    for s in lobes:
        levels[s] = coarsest(sharp[s], LIGHT_SHARE * tolerance / share[s], scene.light.size)
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


def coarsest(sharp: float, error: float, light_size: tuple[int, int]) -> int:
    """The coarsest level of the light whose predicted error for a lobe is within `error`."""
    level = 0
    while (
        level < COARSEST
        and coarse.has_level(light_size[0], light_size[1], level + 1)
        and light_error(light_size[0] >> level + 1, sharp) <= error
    ):
        level += 1
    return level


def light_error(rows: int, sharp: float) -> float:
    """Predicted relative error of a light interpolated between `rows` rows of texels.

    One part depends on the lobe's width, one on the horizon's edge.
    """
    fit, spacing = calibration()["light_error"], math.pi / (2 * rows)
    return (
        fit["of_lobe"] * (spacing * math.sqrt(sharp)) ** fit["power"]
        + fit["of_horizon"] * spacing**2
    )


def map_size(sharp: float, error: float, detail: Sequence[float] = (1.0,), rows: int = 64) -> int:
    """The smallest map whose predicted error is within `error`; LARGEST + 1 if there is none."""
    enough = np.flatnonzero(map_error(SIZES, sharp, detail, rows) <= error)
    return int(SIZES[enough[0]]) if len(enough) else reflectance_map.LARGEST + 1


def map_error(
    size: np.ndarray | int, sharp: float, detail: Sequence[float] = (1.0,), rows: int = 64
) -> np.ndarray | float:
    """Predicted relative error of maps for a lobe, by bicubic interpolation of its radiance.

    size          of a map, or an array of sizes
    detail, rows  parts of the light by how fast they vary (coarse.Light.detail), and rows of its
                  map. Slowly varying parts make a highlight wider than the lobe, unless the lobe is
                  so narrow that the sum over texels shows them one by one
    """
    fit = calibration()["map_error"]
    spacing, texel = 2 * math.sqrt(2) / (size - 5), math.pi / (2 * rows)
    alone = min(2 * math.exp(-2 * (math.pi / texel) ** 2 / sharp), 1.0)
    error = fit["of_light"] * spacing**2
    for k, part in enumerate(detail):
        softness = SOFT * texel * 2**k if k else 0.0
        for share, wide in ((part * (1 - alone), softness), (part * alone, 0.0)):
            seen = 1 / (1 / max(sharp, 1e-9) + wide**2)
            error += (
                share
                * fit["of_lobe"]
                * (spacing * math.sqrt(max(seen, fit["least_sharpness"]))) ** fit["power"]
            )
    return error


def node_count(size: int) -> float:
    """Nodes of a map that a whole hemisphere of normals needs."""
    return 0.72 * size * size


def sum_seconds(sharp: float, pixels: float, lights: int, tolerance: float) -> float:
    """Predicted seconds of the culled sum of one lobe, forward and backward.

    They follow the number of lights in its cone for each pixel (or node).
    """
    fit = calibration()["seconds"]
    tile = math.sqrt(2 * 16 / max(pixels, 1))  # radius of a tile of normals on the hemisphere
    cone = (
        fit["cone"] * (1 + 0.1 * math.log10(1 / tolerance)) / math.sqrt(max(sharp, 1e-9))
        + fit["block"]
        + 2 * tile
    )
    share = 0.5 * (1 - math.cos(min(cone, math.pi / 2)))
    return pixels * (lights * share * fit["pair"] + fit["pixel"]) + fit["call"]


def few_lights(batch: Batch, tolerance: float) -> torch.Tensor:
    """Radiance (P, 3) of one group seen from a view per pixel."""
    exact, (height, width) = load("exact").radiance, batch.light.shape[1:3]
    if len(batch.n) < CHEAP or directional.is_small(
        len(batch.n), height * width, wants_gradient(batch.n, batch.view, batch.m)
    ):
        return exact(batch, tolerance)
    if wants_gradient(batch.light):
        return exact(batch, tolerance)
    with torch.no_grad():
        checks = [Check(batch, pick, tolerance) for pick in samples(len(batch.n), height * width)]
        strategies = [
            strategy
            for count in CUTS
            for strategy in (
                functools.partial(median_cut.with_lights, lights=count),
                functools.partial(hybrid.with_lights, count=count, left_out=0.25 * tolerance),
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
        first_only(batch, CARD.name, COMPILED) if directional.has_kernels(batch.n) else batch
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
        """Whether strategy(batch) keeps the tolerance there."""
        return good(
            (strategy(self.batch) - self.truth).abs().numpy(),
            self.truth.mean().item(),
            self.tolerance,
        )
