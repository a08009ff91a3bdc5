"""What `auto` predicts of maps, coarser lights and culled sums, and how it checks a picture.

The constants in calibration.json beside this file were measured on 2026-11-21 and trimmed by hand
on six materials, where they beat the first fit; `python -m learn.experiments calibrate-auto` fits
them for another machine.
"""

import functools
import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from learn.methods import coarse, directional, reflectance_map

MAP_SHARE, LIGHT_SHARE, CHECK = 0.5, 0.15, 0.8  # of the tolerance
AIM = 0.65  # of the tolerance, what is aimed at where the check fails
COARSEST = 2  # level of the light: coarser ones save nothing that shows
SOFT = 0.8  # standard deviation of what texels of a size can follow, in texels
# times the tolerance: culling's bound is far above what it leaves out in the mean
CULL_NODES, CULL_PIXELS, GUARANTEED = 8.0, 20.0, 0.5
SAMPLE = 64
# of a pixel and a light that the check may cost: a small map shows single dots, which 64 pixels
# miss
SAMPLE_PAIRS = 2**17
GROWTH = 1.4  # of the map's size where the check fails
# of maps, 6 % apart
SIZES = np.unique(np.geomspace(reflectance_map.SMALLEST, reflectance_map.LARGEST, 66).astype(int))


@functools.cache
def calibration() -> dict[str, dict[str, float]]:
    """Return fitted numbers: error of a map, seconds of each kind of work."""
    return json.loads((Path(__file__).parent / "calibration.json").read_text())


def choose_samples(pixels: int, texels: int) -> list[np.ndarray]:
    """Return the pixels (S,) to plan by and to check; then more to check, where the map is small.

    There they cost little.
    """
    few, many = (
        directional.spread_indices(pixels, count)
        for count in (SAMPLE, max(SAMPLE, SAMPLE_PAIRS // texels))
    )
    return [few] if len(many) == len(few) else [few, many]


def keeps_tolerance(error: np.ndarray, level: float, tolerance: float) -> bool:
    """Return whether errors (S, 3) on a sample keep the tolerance.

    A margin by their spread stands for the pixels that are not in the sample.
    """
    by_pixel = error.mean(-1)
    uncertainty = _uncertainty(by_pixel)
    return (
        float(by_pixel.mean()) + uncertainty <= CHECK * tolerance * level
        and float(error.max()) <= 30 * tolerance * level
    )


def excess(error: np.ndarray, level: float, tolerance: float) -> float:
    """What is to be removed of the mean of errors (S, 3), for AIM × tolerance with the margin.

    The margin is proportional to the error.
    """
    by_pixel = error.mean(-1)
    uncertainty = _uncertainty(by_pixel)
    mean = float(by_pixel.mean())
    return mean - mean * AIM * tolerance * level / max(mean + uncertainty, 1e-30)


def _uncertainty(by_pixel: np.ndarray) -> float:
    """Return the standard error of the mean of errors (S,); inf where their squares overflow.

    A line search of refinement may try materials of radiance 1e20.
    """
    with np.errstate(over="ignore"):
        return float(by_pixel.std()) / math.sqrt(len(by_pixel))


def next_larger_map(size: int, pixels: int, growth: float = GROWTH) -> int:
    """Return the next larger map; 0 where it would have more nodes than there are pixels."""
    larger = math.ceil(growth * size)
    return 0 if larger > reflectance_map.LARGEST or node_count(larger) > pixels else larger


def coarsest_level(sharp: float, error: float, light_size: tuple[int, int]) -> int:
    """Return the coarsest level of the light whose predicted error for a lobe is within `error`."""
    level = 0
    while (
        level < COARSEST
        and coarse.has_level(light_size[0], light_size[1], level + 1)
        and light_error(light_size[0] >> level + 1, sharp) <= error
    ):
        level += 1
    return level


def light_error(rows: int, sharp: float) -> float:
    """Return the predicted relative error of a light interpolated between `rows` rows of texels.

    One part depends on the lobe's width, one on the horizon's edge.
    """
    fit, spacing = calibration()["light_error"], math.pi / (2 * rows)
    return (
        fit["of_lobe"] * (spacing * math.sqrt(sharp)) ** fit["power"]
        + fit["of_horizon"] * spacing**2
    )


def map_size(sharp: float, error: float, detail: Sequence[float] = (1.0,), rows: int = 64) -> int:
    """Return the size of the smallest map whose predicted error is within `error`.

    It is LARGEST + 1 if there is none.
    """
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
    """Return the number of nodes of a map that a whole hemisphere of normals needs."""
    return 0.72 * size * size


def sum_seconds(sharp: float, pixels: float, lights: int, tolerance: float) -> float:
    """Return the predicted seconds of the culled sum of one lobe, forward and backward.

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
