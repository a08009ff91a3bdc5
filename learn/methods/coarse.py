"""A light of fewer, larger texels that serves broad lobes: the sum over texels with what is summed interpolated between coarser ones.

    Σ_t F(w_t) E_t ≈ Σ_t Σ_j φ_j(w_t) F(w_j) E_t = Σ_j F(w_j) (Σ_t φ_j(w_t) E_t)

φ_j are the Catmull–Rom weights of a grid of texels 2^level times as large, along rows and columns; they go on across the poles. The
coarse energies are linear in the light, so that its derivative comes back through the same weights, to the accuracy of the values: a
texel is not given its region's mean. Some coarse energies are negative. The error is that of bicubic interpolation of F = f max(0, n·w).
"""

import functools

import numpy as np

from learn.methods import directional
from shaders.envmap import LUMINANCE, directions

MARGIN = 2  # rows beyond each pole that weights may reach


def has_level(height, width, level):
    """Whether a map parts evenly into texels 2^level times as large, with enough of them to interpolate between."""
    step = 2**level
    return height % step == 0 and width % (2 * step) == 0 and height // step >= 8


@functools.lru_cache(maxsize=8)
def weights(height, width, level):
    """Matrices of rows (coarse height + 2 MARGIN, height) and of columns (width, coarse width), float32."""
    return stencil(height, level, False), np.ascontiguousarray(stencil(width, level, True).T)


def stencil(count, level, turns):
    """Weight of each coarse place (rows) for each fine one (columns): cyclic, or with MARGIN places more at both ends."""
    step = 2**level
    place = (np.arange(count) + 0.5) / step - 0.5
    corner = np.floor(place).astype(int)
    t = place - corner
    found = np.zeros((count // step + (0 if turns else 2 * MARGIN), count))
    four = 0.5 * np.stack([((2 - t) * t - 1) * t, (3 * t - 5) * t * t + 2, ((4 - 3 * t) * t + 1) * t, (t - 1) * t * t])
    for i in range(4):
        row = corner + i - 1
        np.add.at(found, (row % (count // step) if turns else row + MARGIN, np.arange(count)), four[i])
    return found.astype(np.float32)


def energy(E, level):
    """Coarse energies (coarse height, coarse width, 3) of E (height, width, 3)."""
    rows, columns = weights(*E.shape[:2], level)
    along = np.tensordot(rows, np.einsum("hwk,wc->hck", E, columns, optimize=True), 1)
    half = along.shape[1] // 2
    found = along[MARGIN:-MARGIN]
    for i in range(MARGIN):  # beyond a pole lies the same row's other half
        found[i] += np.roll(along[MARGIN - 1 - i], half, 0)
        found[-1 - i] += np.roll(along[len(along) - MARGIN + i], half, 0)
    return found


def gradient(by_coarse, height, width, level):
    """Derivative (height, width, 3) by E, from the one (coarse height, coarse width, 3) by the coarse energies."""
    rows, columns = weights(height, width, level)
    half = by_coarse.shape[1] // 2
    above = [np.roll(by_coarse[MARGIN - 1 - i], half, 0) for i in range(MARGIN)]
    below = [np.roll(by_coarse[-1 - i], half, 0) for i in range(MARGIN)]
    along = np.concatenate([np.stack(above), by_coarse, np.stack(below)])
    return np.einsum("hck,wc->hwk", np.tensordot(rows.T, along, 1), columns, optimize=True)


class Light:
    """A light map at several levels of detail, level 0 its own texels: `Lights`, energy in blocks, and the way back from them.

    light  (height, width, 3) float32 numpy;  rotation  nine numbers, camera_from_light
    """

    def __init__(self, light, rotation):
        self.height, self.width = self.size = light.shape[:2]
        self.rotation, self.solid_angle = rotation, solid_angles(self.height, self.width)
        self.E = light * self.solid_angle
        self.known = {}

    def at(self, level):
        """`Lights` and energy (blocks, 3, 16) of a level."""
        if level not in self.known:
            lights, order = self.places(level)
            E = energy(self.E, level) if level else self.E
            self.known[level] = lights, directional.energy_blocks(E.reshape(-1, 3)[order], lights)
        return self.known[level]

    def detail(self):
        """How much of the light varies how fast: parts (levels + 1,) of it that each level loses to the next, and what remains; sum 1.

        Part k lives on texels of level k, finer than those of level k + 1 can follow. One lit texel loses twice its energy: it is half
        of what is lost that counts.
        """
        brightness = (self.E @ LUMINANCE.astype(np.float32))[..., None]
        total, seen, parts = float(brightness.sum()) or 1.0, brightness, []
        for level in range(1, 4):
            if not has_level(*self.size, level):
                break
            share = energy(self.solid_angle, level)
            smooth = gradient(energy(brightness, level) / share, *self.size, level) * self.solid_angle
            parts.append(min(0.5 * float(np.abs(seen - smooth).sum()) / total, 1.0 - sum(parts)))
            seen = smooth
        return [*parts, 1.0 - sum(parts)]

    def places(self, level):
        lights, order = directional.map_lights(self.height >> level, self.width >> level, self.rotation)
        return lights, order.numpy()

    def gradient(self, by_E, level):
        """Derivative (height, width, 3) by the light, from the one (T, 3) by a level's energies."""
        by_texel = np.empty_like(by_E)
        by_texel[self.places(level)[1]] = by_E
        by_texel = by_texel.reshape(self.height >> level, self.width >> level, 3)
        return (gradient(by_texel, self.height, self.width, level) if level else by_texel) * self.solid_angle


@functools.lru_cache(maxsize=8)
def solid_angles(height, width):
    """(height, width, 1) float32."""
    return directions(height, width)[1].astype(np.float32)[..., None]
