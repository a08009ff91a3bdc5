"""Bases of lights: sets of light maps whose weighted sums stand for other light maps.

L        (64, 128, 3) radiance, as the camera sees it (factory.render.light.as_seen)
maps     (B, 64, 128) ≥ 0: each is rendered in white
weights  (B, 3) of a light: its red, green and blue in units of each map; they may be negative
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from manifests.arrays import LIGHT_SHAPE
from shaders import envmap

STEPS = 150  # of the factorisation
LEAST = 1e-9  # nothing is divided by less


@dataclass(frozen=True, eq=False)
class Basis:
    """A name, maps, and a function that returns the weights of a light."""

    name: str
    maps: np.ndarray
    weights: Callable[[np.ndarray], np.ndarray]

    def light(self, L: np.ndarray) -> np.ndarray:
        """Return the light (64, 128, 3) that stands for L."""
        return np.einsum("bhw,bc->hwc", self.maps, self.weights(L))


def cells(rows: int, columns: int) -> Basis:
    """Return rows × columns cells of the map, each of radiance 1; a light's weight is its mean."""
    height, width, _ = LIGHT_SHAPE
    _, solid_angle = envmap.directions(height, width)
    number = np.arange(height)[:, None] * rows // height * columns
    number = number + np.arange(width) * columns // width
    maps = (number == np.arange(rows * columns)[:, None, None]).astype(np.float32)
    share = maps * solid_angle
    share /= share.sum((1, 2), keepdims=True)
    return Basis(
        f"{rows * columns} cells", maps, lambda L: np.einsum("bhw,hwc->bc", share, L).astype("f4")
    )


def harmonics() -> Basis:
    """Return spherical harmonics up to order 3, split into their positive and negative parts."""
    w, solid_angle = envmap.directions(*LIGHT_SHAPE[:2])
    x, y, z = np.moveaxis(w, -1, 0).astype(np.float64)
    one = np.ones_like(x)
    shapes = [one, x, y, z, x * y, y * z, x * z, x * x - y * y, 3 * z * z - 1]
    shapes += [y * (3 * x * x - y * y), x * y * z, y * (5 * z * z - 1), z * (5 * z * z - 3)]
    shapes += [x * (5 * z * z - 1), z * (x * x - y * y), x * (x * x - 3 * y * y)]
    each = np.stack(shapes)
    each /= np.sqrt((each**2 * solid_angle).sum((1, 2)))[:, None, None]
    maps = np.concatenate([np.maximum(each, 0), np.maximum(-each[1:], 0)]).astype(np.float32)

    def weights(L: np.ndarray) -> np.ndarray:
        of = np.einsum("bhw,hwc->bc", each * solid_angle, L)
        return np.concatenate([of, -of[1:]]).astype(np.float32)

    return Basis(f"{len(maps)} harmonics", maps, weights)


def factors(lights: Sequence[np.ndarray], count: int) -> Basis:
    """Return the maps whose sums are nearest to given lights (non-negative factorisation).

    The weights hold for these lights alone. Nearest is by energy (Kullback-Leibler), so that lamps
    count as much as they shine.
    """
    height, width, _ = LIGHT_SHAPE
    _, solid_angle = envmap.directions(height, width)
    energy = np.concatenate([np.moveaxis(L, -1, 0) for L in lights]) * solid_angle
    x = energy.reshape(len(energy), -1).astype(np.float32)
    rng = np.random.default_rng(0)
    w = rng.uniform(0.5, 1.5, (len(x), count)).astype(np.float32)
    h = x[rng.integers(len(x), size=count)] + x.mean(0)
    h /= h.sum(1, keepdims=True)
    w *= x.sum(1, keepdims=True) / count
    for _ in range(STEPS):
        w *= (x / np.maximum(w @ h, LEAST)) @ h.T / np.maximum(h.sum(1), LEAST)
        h *= w.T @ (x / np.maximum(w @ h, LEAST)) / np.maximum(w.sum(0), LEAST)[:, None]
    maps = (h.reshape(count, height, width) / solid_angle).astype(np.float32)
    # as bright as the others, so that Cycles' numbers are
    scale = np.maximum((maps * solid_angle).sum((1, 2)) / (4 * np.pi), LEAST)
    maps /= scale[:, None, None].astype(np.float32)
    by_light = (w * scale).reshape(len(lights), 3, count)

    def weights(L: np.ndarray) -> np.ndarray:
        (k,) = (k for k, each in enumerate(lights) if each is L)
        return by_light[k].T.astype(np.float32)

    return Basis(f"{count} factors", maps, weights)
