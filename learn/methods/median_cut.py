"""A few lights instead of thousands, one for each of the map's regions of equal energy.

The map is halved repeatedly where its energy (luminance × solid angle) is halved, across the
longer side of each region, so that after k rounds there are 2^k lights. Regions of one texel stay.
A light has its region's whole energy, per channel, so nothing of the light is lost; its
direction is the energy's mean direction and is held constant in the backward pass.

Source: Debevec, A Median Cut Algorithm for Light Probe Sampling, 2005. Rectangles are (top, bottom,
left, right), half open, in texels.
"""

import math

import numpy as np
import torch

from learn.methods import (
    COMPILED,
    HELD_LIGHTS,
    Batch,
    Card,
    directional,
    forbid_second_derivatives,
    light_tables,
    radiance_by_group,
)
from learn.methods.light_tables import Lights
from shaders.envmap import directions
from shaders.tone import LUMINANCE

CARD = Card(
    name="median_cut",
    approximates="the light by 2^k directional lights of equal energy",
    error=2e-2,
    cost="pixels × lights, 64 to 4096 of them by tolerance, plus a few milliseconds for the cut",
    memory="pixels and lights only",
    gradient=0.5,
)
LEAST, MOST = 64, 4096


def light_count(tolerance: float) -> int:
    """Return the number of lights for a tolerance without sharp lobes.

    The error falls about as 1 / lights.
    """
    return int(np.clip(2 ** math.ceil(math.log2(4.0 / tolerance)), LEAST, MOST))


def radiance(batch: Batch, tolerance: float) -> torch.Tensor:
    """Return outgoing radiance (P, 3) of a batch."""
    return radiance_by_lights(prepare_batch(batch, CARD.name), light_count(tolerance))


def prepare_batch(batch: Batch, name: str) -> Batch:
    """Return the batch for a method that cuts the light.

    Second derivatives exist in torch's own sums alone, while the light is constant.
    """
    if directional.has_kernels(batch.n):
        return forbid_second_derivatives(batch, name, COMPILED)
    return (
        forbid_second_derivatives(batch, name, HELD_LIGHTS) if batch.light.requires_grad else batch
    )


def radiance_by_lights(batch: Batch, lights: int) -> torch.Tensor:
    """Return radiance (P, 3) with a cut light of at most `lights` regions."""

    def one_group(
        n: torch.Tensor, view: torch.Tensor | None, m: torch.Tensor, light: torch.Tensor
    ) -> torch.Tensor:
        few, E = cut_light(light, batch.camera_from_light, lights)
        return directional.radiance(n, view, m, E, few)

    return radiance_by_group(batch, one_group)


def cut_light(
    light: torch.Tensor, camera_from_light: torch.Tensor, count: int
) -> tuple[Lights, torch.Tensor]:
    """`Lights` of at most `count` regions, and their E (T, 3), differentiable in light.

    light  (height, width, 3); a map of no more texels is not cut, since halving by energy would
           join dark texels beside a bright one
    """
    height, width = light.shape[:2]
    if height * width <= count:
        return light_tables.lights_and_energy(light, camera_from_light)
    w, solid_angle = directions(height, width)
    brightness = light.detach().double().cpu().numpy() @ LUMINANCE
    # dark regions have a centre too
    energy = (brightness + 1e-6 * max(brightness.mean(), 1e-30)) * solid_angle
    region = regions(energy, count)
    total = region.max() + 1
    flat = region.reshape(-1)
    centre = np.stack(
        [np.bincount(flat, (energy * w[..., i]).reshape(-1), total) for i in range(3)], -1
    )
    length = np.linalg.norm(centre, axis=-1, keepdims=True)
    first = np.zeros(total, int)
    first[flat[::-1]] = np.arange(len(flat))[::-1]
    centre = np.where(
        length > 1e-12 * energy.sum(), centre / np.maximum(length, 1e-300), w.reshape(-1, 3)[first]
    )
    E = light.new_zeros(total, 3).index_add(
        0,
        torch.as_tensor(flat, device=light.device),
        (
            light * torch.as_tensor(solid_angle, dtype=light.dtype, device=light.device)[..., None]
        ).reshape(-1, 3),
    )
    return light_tables.lights_at(centre @ camera_from_light.double().cpu().numpy().T), E


def regions(energy: np.ndarray, count: int) -> np.ndarray:
    """Return the number of each texel's region (height, width), 0 … R − 1 with R ≤ count.

    Neighbours in number are neighbours in the map.
    """
    height, width = energy.shape
    table = np.pad(energy.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    boxes = np.array([[0, height, 0, width]])
    for _ in range(int(math.log2(count))):
        boxes = halve_boxes(boxes, table)
    number = np.zeros((height + 1, width + 1), int)
    # Paint by differences: +k at a box's corners, so that two cumulative sums fill all boxes at
    # once.
    top, bottom, left, right = boxes.T
    k = np.arange(len(boxes))
    for rows, columns, sign in (
        (top, left, 1),
        (top, right, -1),
        (bottom, left, -1),
        (bottom, right, 1),
    ):
        np.add.at(number, (rows, columns), sign * k)
    return number.cumsum(0).cumsum(1)[:height, :width]


def halve_boxes(boxes: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Return two halves of equal energy for each box (R, 4), and boxes of one texel as they are."""
    height = table.shape[0] - 1
    top, bottom, left, right = boxes.T
    tall, wide = bottom - top, (right - left) * np.sin(np.pi * (top + bottom) / (2 * height))
    by_rows = ((tall >= wide) & (tall > 1)) | (right - left == 1)
    low, high = np.where(by_rows, top, left), np.where(by_rows, bottom, right)
    below = energy_up_to(boxes, table, by_rows, low)
    half = 0.5 * (below + energy_up_to(boxes, table, by_rows, high))
    # The last place whose energy is still at most half, then whichever of it and the next is
    # nearer.
    first, last = low.copy(), high.copy()
    while (last - first > 1).any():
        middle = (first + last) // 2
        under = energy_up_to(boxes, table, by_rows, middle) <= half
        first, last = np.where(under, middle, first), np.where(under, last, middle)
    nearer = (
        half - energy_up_to(boxes, table, by_rows, first)
        <= energy_up_to(boxes, table, by_rows, last) - half
    )
    place = np.clip(np.where(nearer, first, last), low + 1, np.maximum(high - 1, low + 1))
    one, other = boxes.copy(), boxes.copy()
    one[:, 1], other[:, 0] = np.where(by_rows, place, bottom), np.where(by_rows, place, top)
    one[:, 3], other[:, 2] = np.where(by_rows, right, place), np.where(by_rows, left, place)
    single = (tall == 1) & (right - left == 1)
    one[single] = boxes[single]
    both = np.stack([one, other], 1).reshape(-1, 4)
    return both[np.stack([np.ones(len(boxes), bool), ~single], 1).reshape(-1)]


def energy_up_to(
    boxes: np.ndarray, table: np.ndarray, by_rows: np.ndarray, place: np.ndarray
) -> np.ndarray:
    """Return energy (R,) of each box's part before `place`, a row where by_rows, else a column."""
    top, bottom, left, right = boxes.T
    bottom, right = np.where(by_rows, place, bottom), np.where(by_rows, right, place)
    return table[bottom, right] - table[top, right] - table[bottom, left] + table[top, left]
