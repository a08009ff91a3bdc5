"""The lights that stand for a light map in sums over it: its texels, parts of them, or blocks.

The map is piecewise constant over its texels. A light is nine numbers: its direction and the half
vector with the viewer, both in the camera's frame, and its energy.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from shaders import envmap

LAMPS = 64  # texels of most energy: parts of no block, and divided where the others are not
BLOCK = 4  # texels across a block of the light that counts in detail near a lobe's axis


class LightBlocks:
    """The lights of one map; what was made of it is kept.

    light              (height, width, 3) float32 radiance, light frame
    camera_from_light  (3, 3)
    """

    def __init__(self, light: np.ndarray, camera_from_light: np.ndarray):
        self.light, self.camera_from_light = light, camera_from_light
        self._lights: dict[int, np.ndarray] = {}
        self._detail: dict[int, tuple[Any, ...]] = {}
        self._texels: dict[int, tuple[np.ndarray, ...]] = {}

    @cached_property
    def density(self) -> np.ndarray:
        """By which Cycles draws directions to the light, (height, width) float32 in 1/sr."""
        # it draws texels by their mean over the channels and the sine at their middle
        _, solid_angle = envmap.directions(*self.light.shape[:2])
        drawn = self.light.mean(-1, dtype=np.float64) * solid_angle
        return (drawn / (max(drawn.sum(), 1e-30) * solid_angle)).astype(np.float32)

    def texels(self, parts: int) -> tuple[np.ndarray, ...]:
        """Return texels that are not black, divided into parts × parts, as lights in blocks.

        Returns  (9, T), as direct_light_kernels.add_lights takes them, their density (T,), and of
                 the blocks: firsts (B + 1,), centres (B, 3) and sines of radii (B,), as
                 direct_light_kernels.add_leaning takes them
        """
        if parts not in self._texels:
            height, width = self.light.shape[:2]
            w, solid_angle = envmap.directions(height * parts, width * parts)
            light, density = (
                each.repeat(parts, 0).repeat(parts, 1) for each in (self.light, self.density)
            )
            across = BLOCK * parts
            rows, columns = np.indices(light.shape[:2]) // across
            numbers = rows * -(-width // BLOCK) + columns
            lit = np.nonzero(light.any(-1).ravel())[0]
            lit = lit[np.argsort(numbers.ravel()[lit], kind="stable")]
            energy = light.reshape(-1, 3)[lit].astype(np.float64)
            energy *= solid_angle.reshape(-1)[lit][:, None]
            lights = self._lit(w.reshape(-1, 3)[lit][None], energy[None])[0]
            first = np.nonzero(np.diff(numbers.ravel()[lit], prepend=-1))[0]
            firsts = np.append(first, len(lit))
            counts = np.diff(firsts)
            at = lights[:3].T.astype(np.float64)
            centres = np.add.reduceat(at, first, axis=0) if len(lit) else np.zeros((0, 3))
            centres /= np.maximum(np.linalg.norm(centres, axis=1, keepdims=True), 1e-9)
            cosines = (at * centres.repeat(counts, axis=0)).sum(1)
            nearest = np.minimum.reduceat(cosines, first) if len(lit) else np.zeros(0)
            sines = np.sqrt(np.clip(1 - np.clip(nearest, 0, 1) ** 2, 0, 1)) + 1e-4  # rounding
            self._texels[parts] = (
                lights,
                density.ravel()[lit],
                firsts,
                centres.astype(np.float32),
                sines.astype(np.float32),
            )
        return self._texels[parts]

    def lights(self, rows: int) -> np.ndarray:
        """Return the lights that stand for blocks of the map, `rows` blocks from pole to pole.

        Returns  (9, T) float32, as direct_light_kernels.add_lights takes them
        """
        if rows not in self._lights:
            height, width = self.light.shape[:2]
            step = height // rows
            w, solid_angle = envmap.directions(height, width)
            energy = self.light.astype(np.float64) * solid_angle[..., None]
            # few lamps make most of a map's light
            lamps = np.unravel_index(self._brightest(), (height, width))
            theirs = energy[lamps]
            energy[lamps] = 0
            brightness = energy.sum(-1, keepdims=True) + 1e-12

            def blocks(values: np.ndarray) -> np.ndarray:
                return values.reshape(rows, step, width // step, step, 3).sum((1, 3)).reshape(-1, 3)

            centres, energies = blocks(w * brightness), blocks(energy)
            parts = 4 if step == 1 else 1
            w, solid_angle = envmap.directions(parts * height, parts * width)
            places = tuple(
                parts * each[:, None, None] + within
                for each, within in zip(lamps, np.indices((parts, parts)), strict=True)
            )
            inside = solid_angle[places] / solid_angle[places].sum((1, 2), keepdims=True)
            divided = theirs[:, None, None] * inside[..., None]
            centres = np.concatenate([centres, w[places].reshape(-1, 3)])
            energies = np.concatenate([energies, divided.reshape(-1, 3)])
            self._lights[rows] = self._lit(centres[None], energies[None])[0]
        return self._lights[rows]

    def listed_patches(self, rows: int) -> np.ndarray:
        """Return where lights lie in the light's frame, (T, 4) float32.

        They are those of `lights` of fewer rows than the map's, and those near a lobe of
        `detail(1)`: DirectLight.each_light has what each of them adds.

        Returns  cosines of the polar angle at the top and bottom, and azimuths of the two sides
        """
        height, width = self.light.shape[:2]
        step = height // rows
        row, column = (each.ravel() for each in np.indices((rows, width // step)))
        blocks = _corners(row, column, rows, width // step)
        lamp_row, lamp_column = np.unravel_index(self._brightest(), (height, width))
        texels = np.indices((height, width))
        across = texels.reshape(2, height // BLOCK, BLOCK, width // BLOCK, BLOCK).swapaxes(2, 3)
        near_row, near_column = across.reshape(2, -1)
        every = (
            blocks,
            _corners(lamp_row, lamp_column, height, width),
            _corners(near_row, near_column, height, width),
        )
        return np.concatenate(every).astype(np.float32)

    def listed_energies(self, rows: int) -> np.ndarray:
        """Return the energies (T,) float32 of what `listed_patches` lists, mean of the channels.

        Each direction is listed twice: in a block or as a lamp, and in a texel.
        """
        lights, near = self.lights(rows), self.detail(1)[2]
        texels = near[:, 6:].mean(1).reshape(-1)
        return np.concatenate([lights[6:].mean(0), texels]).astype(np.float32)

    def _brightest(self) -> np.ndarray:
        """Return the numbers of the texels that count as lamps."""
        _, solid_angle = envmap.directions(*self.light.shape[:2])
        energy = self.light.astype(np.float64) * solid_angle[..., None]
        return np.argsort(energy.sum(-1), axis=None)[-LAMPS:]

    def detail(self, parts: int) -> tuple[Any, ...]:
        """Return blocks of the light: centres, radii, lights in detail and few lights of each.

        Texels are divided into parts × parts. Arguments as direct_light_kernels.add_blocks has them
        """
        if parts not in self._detail:
            height, width = self.light.shape[:2]
            w, solid_angle = envmap.directions(height * parts, width * parts)
            light = self.light.repeat(parts, 0).repeat(parts, 1).astype(np.float64)
            energy = light * solid_angle[..., None]

            def gathered(values: np.ndarray, across: int) -> np.ndarray:
                """(rows, columns, 3) → (blocks, texels of each, 3), `across` a block"""
                rows, columns = values.shape[0] // across, values.shape[1] // across
                parted = values.reshape(rows, across, columns, across, 3).swapaxes(1, 2)
                return parted.reshape(rows * columns, across * across, 3)

            brightness = energy.sum(-1, keepdims=True) + 1e-12
            half = BLOCK * parts // 2
            sums = [gathered(each, half).sum(1) for each in (w * brightness, energy)]
            rows, columns = height // BLOCK * 2, width // BLOCK * 2
            few = [gathered(each.reshape(rows, columns, 3), 2) for each in sums]
            near = gathered(w, BLOCK * parts), gathered(energy, BLOCK * parts)
            centres = near[0].sum(1)
            centres /= np.linalg.norm(centres, axis=1, keepdims=True)
            nearest = np.einsum("btc,bc->bt", near[0], centres).min(1)
            radii = np.arccos(np.clip(nearest, -1, 1)) + np.pi / len(self.light)
            self._detail[parts] = (
                np.ascontiguousarray(centres @ self.camera_from_light.T, np.float32),
                np.stack([np.cos(radii), np.sin(radii)], axis=1).astype(np.float32),
                self._lit(*near),
                np.ascontiguousarray(self._lit(*few).swapaxes(0, 1).reshape(9, -1)),
            )
        return self._detail[parts]

    def _lit(self, w: np.ndarray, energy: np.ndarray) -> np.ndarray:
        """Return the kernels' lights (B, 9, T) of directions and energies (B, T, 3)."""
        w = w @ self.camera_from_light.T
        w /= np.linalg.norm(w, axis=-1, keepdims=True)
        half = w + np.array([0.0, 0.0, 1.0])
        half /= np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-9)
        every = np.concatenate([w, half, energy], axis=-1)
        return np.ascontiguousarray(every.swapaxes(1, 2), np.float32)


def _corners(row: np.ndarray, column: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return cosines of the polar angle and azimuths (P, 4) between which parts of a map lie."""
    ends = [np.cos(np.pi * (row + k) / height) for k in (0, 1)]
    sides = [2 * np.pi * (column + k) / width for k in (0, 1)]
    return np.stack([*ends, *sides], axis=1)
