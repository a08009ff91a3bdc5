"""A light of fewer, larger texels for broad lobes, by interpolation between coarser texels.

    Σ_t F(w_t) E_t ≈ Σ_t Σ_j φ_j(w_t) F(w_j) E_t = Σ_j F(w_j) (Σ_t φ_j(w_t) E_t)

φ_j are the Catmull–Rom weights of a grid of texels 2^level times as large, along rows and columns;
they go on across the poles. The coarse energies are linear in the light, so that its derivative
passes through the same weights, to the accuracy of the values: a texel does not receive its
region's mean. Some coarse energies are negative. The error is that of bicubic interpolation of F =
f max(0, n·w).
"""

import functools

import numpy as np

from learn.engines import machine_code
from learn.engines.lights import Rotation
from learn.methods import light_tables
from learn.methods.light_tables import Lights
from shaders.envmap import directions
from shaders.tone import LUMINANCE


def has_level(height: int, width: int, level: int) -> bool:
    """Return whether a map divides into texels 2^level times as large, enough for interpolation."""
    step = 2**level
    return height % step == 0 and width % (2 * step) == 0 and height // step >= 8


@functools.lru_cache(maxsize=8)
def stencil(level: int) -> np.ndarray:
    """Weights (4 · 2^level,) float32 of fine texels in a coarse one, the same for each coarse one.

    The first belongs to the fine texel 3/2 · 2^level before the coarse one's first.
    """
    step = 2**level
    x = np.abs((np.arange(4 * step) + 0.5) / step - 2.0)
    near, far = (1.5 * x - 2.5) * x * x + 1.0, ((2.5 - 0.5 * x) * x - 4.0) * x + 2.0
    return np.where(x < 1, near, far).astype(np.float32)


def energy(E: np.ndarray, level: int) -> np.ndarray:
    """Return coarse energies (planes, coarse height, coarse width) of E (planes, height, width)."""
    planes, height, width = E.shape
    result, along = (
        np.empty((planes, height >> level, width >> level), np.float32),
        np.empty(width, np.float32),
    )
    machine_code.call(
        "coarsening.gather", 0, planes, height, width, 2**level, stencil(level), E, along, result
    )
    return result


def gradient(by_coarse: np.ndarray, level: int) -> np.ndarray:
    """Return the derivative (planes, height, width) by E, from the one by the coarse energies."""
    planes, height, width = len(by_coarse), by_coarse.shape[1] << level, by_coarse.shape[2] << level
    result, along = np.empty((planes, height, width), np.float32), np.empty(width, np.float32)
    machine_code.call(
        "coarsening.scatter",
        0,
        planes,
        height,
        width,
        2**level,
        stencil(level),
        by_coarse,
        along,
        result,
    )
    return result


class Light:
    """A light map at several levels of detail; level 0 has its own texels.

    light     (height, width, 3) float32 numpy
    rotation  nine numbers, camera_from_light
    E         (3, height, width) radiance × solid angle
    """

    def __init__(self, light: np.ndarray, rotation: Rotation):
        self.height, self.width = self.size = light.shape[0], light.shape[1]
        self.rotation, self.solid_angle = rotation, solid_angles(self.height, self.width)
        self.E = np.ascontiguousarray(light.transpose(2, 0, 1)) * self.solid_angle
        self.levels: dict[int, tuple[Lights, np.ndarray]] = {}

    def at(self, level: int) -> tuple[Lights, np.ndarray]:
        """`Lights` and energy (blocks, 3, 16) of a level."""
        if level not in self.levels:
            lights, order = self.places(level)
            E = energy(self.E, level) if level else self.E
            self.levels[level] = (
                lights,
                light_tables.energy_blocks(E.reshape(3, -1)[:, order], lights),
            )
        return self.levels[level]

    def detail(self) -> list[float]:
        """Return the parts of the light (levels + 1,) by how fast they vary, with sum 1.

        Part k varies over texels of level k, too fast for those of level k + 1; the last part is
        the remainder. One lit texel loses twice its energy, so half of the loss counts.
        """
        weights = LUMINANCE.astype(np.float32)[:, None, None]
        brightness = (weights * self.E).sum(
            0, keepdims=True
        )  # not by BLAS, whose threads spin as torch's do (learn/engines/pixel_selection.py)
        total, seen = float(brightness.sum()) or 1.0, brightness
        parts: list[float] = []
        for level in range(1, 4):
            if not has_level(self.height, self.width, level):
                break
            smooth = (
                gradient(energy(brightness, level) / shares(*self.size, level), level)
                * self.solid_angle
            )
            parts.append(min(0.5 * float(np.abs(seen - smooth).sum()) / total, 1.0 - sum(parts)))
            seen = smooth
        return [*parts, 1.0 - sum(parts)]

    def places(self, level: int) -> tuple[Lights, np.ndarray]:
        """Return a level's `Lights`, and the place of each in the flattened map."""
        return light_tables.map_lights(self.height >> level, self.width >> level, self.rotation)

    def gradient(self, by_E: np.ndarray, level: int) -> np.ndarray:
        """Derivative (3, height, width) by the light, from the one (3, T) by a level's energies."""
        by_texel = np.empty_like(by_E)
        by_texel[:, self.places(level)[1]] = by_E
        by_texel = by_texel.reshape(3, self.height >> level, self.width >> level)
        return (gradient(by_texel, level) if level else by_texel) * self.solid_angle


@functools.lru_cache(maxsize=8)
def solid_angles(height: int, width: int) -> np.ndarray:
    """Return solid angles of a map's texels, (1, height, 1) or (1, height, width) float32."""
    return directions(height, width)[1].astype(np.float32)[None]


@functools.lru_cache(maxsize=8)
def shares(height: int, width: int, level: int) -> np.ndarray:
    """Return the solid angle (1, coarse height, coarse width) that each coarse place stands for."""
    return energy(
        np.ascontiguousarray(np.broadcast_to(solid_angles(height, width), (1, height, width))),
        level,
    )
