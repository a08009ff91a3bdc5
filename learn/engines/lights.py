"""Tables of lights and materials for the kernels, and derivatives from the kernels' sums.

R × LIGHTS   rows of numbers over lights, float64
blocked      (blocks, R, 16) float32: sixteen neighbouring lights side by side; the last block is
             padded with lights of energy 0 at w = (0, 0, −1)
slab         at most SLAB lights that are summed together, so that memory does not grow with the map

Lights go in 4×4 tiles of the map, so that a block sits close together on the sphere and is skipped
as one. Everything that does not depend on radiance or material is made once for each map size and
rotation.
"""

import functools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from learn.engines.layout import LANES, NEGLIGIBLE
from shaders.dsbrdf import half_angles
from shaders.envmap import directions
from shaders.spline import basis

SLAB = 16384
Rotation = tuple[float, ...]  # nine numbers, row by row: a key for caches
LOG2_E = 1.4426950408889634
LN2 = 0.6931471805599453


def blocked(rows: np.ndarray) -> np.ndarray:
    """Return rows (R, LIGHTS) as blocks (LIGHTS/16, R, 16) float32; LIGHTS is a multiple of 16."""
    return np.ascontiguousarray(
        rows.reshape(len(rows), -1, LANES).transpose(1, 0, 2), dtype=np.float32
    )


def unblocked(blocks: np.ndarray) -> np.ndarray:
    """Return blocks (blocks, R, 16) as rows (R, LIGHTS)."""
    return blocks.transpose(1, 0, 2).reshape(blocks.shape[1], -1)


def _rounding_rest(rows: np.ndarray) -> np.ndarray:
    """The part of each number that rounding to float32 removes."""
    return rows - rows.astype(np.float32)


@dataclass(frozen=True)
class Slab:
    """Some of a map's lights, for one size of map and one rotation.

    order        (lights,) places in the flattened map
    solid_angle  (lights,) sr
    distant      (blocks, 9, 16): geometry for learn.engines.distant
    general      (blocks, 6, 16): geometry for learn.engines.general
    basis        (padded lights, 6) float64: the spline's basis at each light's θ_d for a distant
                 viewer
    """

    order: np.ndarray
    solid_angle: np.ndarray
    distant: np.ndarray
    general: np.ndarray
    basis: np.ndarray

    @property
    def blocks(self) -> int:
        """Number of blocks, padded lights included."""
        return len(self.distant)

    def energy(self, light: np.ndarray) -> np.ndarray:
        """Radiance × solid angle (blocks, 3, 16) of light (height, width, 3)."""
        rows = np.zeros((3, self.blocks * LANES))
        rows[:, : len(self.order)] = (
            light.reshape(-1, 3)[self.order] * self.solid_angle[:, None]
        ).T
        return blocked(rows)

    def add_light_gradient(self, energy_sums: np.ndarray, gradient: np.ndarray) -> None:
        """Add the derivative by energy (blocks, 3, 16) to the one by light (height·width, 3)."""
        by_energy = unblocked(energy_sums)[:, : len(self.order)]
        gradient[self.order] += by_energy.T * self.solid_angle[:, None]


@functools.lru_cache(maxsize=8)
def slabs(height: int, width: int, camera_from_light: Rotation) -> tuple[Slab, ...]:
    """The `Slab`s of a map of some size, under a rotation."""
    w, solid_angle = (a.reshape(height * width, -1) for a in directions(height, width))
    row, column = np.divmod(np.arange(height * width), width)
    order = np.lexsort((column, row, column // 4, row // 4))
    rotation = np.array(camera_from_light, dtype=np.float64).reshape(3, 3)
    parts = [order[i : i + SLAB] for i in range(0, len(order), SLAB)]
    return tuple(_slab(part, w[part] @ rotation.T, solid_angle[part, 0]) for part in parts)


def _slab(order: np.ndarray, w: np.ndarray, solid_angle: np.ndarray) -> Slab:
    fill = np.broadcast_to((0.0, 0.0, -1.0), (-len(order) % LANES, 3))
    w = np.concatenate([w, fill])
    h, theta_d = half_angles(w, np.array([0.0, 0.0, 1.0]))
    h = h.T.copy()
    distant = blocked(np.concatenate([w.T, h, _rounding_rest(h)]))
    general = blocked(np.concatenate([w.T, _rounding_rest(w.T)]))
    return Slab(order, solid_angle, distant, general, basis(theta_d))


def cutoff(energy: np.ndarray, negligible: float = NEGLIGIBLE) -> np.ndarray:
    """log2 of c^γ (blocks,) below which a lobe is left out of a block.

    negligible  log2 of the part of a lobe's own integral that is left out under an even light:
                ∫ c^γ beyond c₀ is c₀^γ of the whole
    It is lower where a block outshines the mean, so that the omitted part of the sum stays small
    even under a sun.
    """
    brightest = energy.max((1, 2)).astype(np.float64)
    mean = brightest.mean()
    ratio = np.maximum(brightest / mean, 1.0) if mean > 0 else np.ones_like(brightest)
    return (negligible - np.log2(ratio)).astype(np.float32)


def lobe_first(m: np.ndarray) -> np.ndarray:
    """Return control values in the kernels' order, or back from it.

    (3 channels, 3 lobes, (κ, γ), 6) ↔ (3 lobes, 3 channels, (γ, κ), 6)
    """
    return m.transpose(1, 0, 2, 3)[:, :, ::-1]


class DistantTables(NamedTuple):
    """A material at each light, for learn.engines.distant.

    lobes  (blocks, 3, 3, 2, 16) float32; least: (blocks, 3) float32, the least γ
    kappa  (3, 3, lights) float64
    """

    lobes: np.ndarray
    least: np.ndarray
    kappa: np.ndarray


class GeneralTables(NamedTuple):
    """A material for learn.engines.general, float32.

    values  (108,) control values; steps: (90,) slopes of the splines; least: (3,) the least γ
    """

    values: np.ndarray
    steps: np.ndarray
    least: np.ndarray


def distant_tables(m: np.ndarray, slab: Slab) -> DistantTables:
    """The material m (3, 3, 2, 6) float64 at each light of a slab, for a distant viewer."""
    curves = lobe_first(m).reshape(18, 6) @ slab.basis.T
    gamma, kappa = curves[0::2], curves[1::2].copy()
    least = gamma.reshape(3, 3, -1, LANES).min((1, 3)).T
    curves[1::2] *= LOG2_E
    least = np.ascontiguousarray(least, dtype=np.float32)
    return DistantTables(blocked(curves), least, kappa.reshape(3, 3, -1))


def distant_material_gradient(
    lobe_sums: np.ndarray, energy: np.ndarray, kappa: np.ndarray, slab: Slab
) -> np.ndarray:
    """Derivative (3, 3, 2, 6) by m from the sums of learn.engines.distant.backward."""
    sums = unblocked(lobe_sums).reshape(3, 3, 2, -1) * unblocked(energy).astype(np.float64)[:, None]
    by_gamma, by_kappa = sums[:, :, 1] * kappa * LN2, sums[:, :, 0]
    return lobe_first(np.stack([by_gamma, by_kappa], 2) @ slab.basis)


def general_tables(m: np.ndarray) -> GeneralTables:
    """The material m (3, 3, 2, 6) float64 for a view per pixel."""
    values = lobe_first(m).copy()
    steps = spline_steps(values * np.array([LN2**2, 1.0])[:, None])
    least = values[:, :, 0].min((1, 2))
    values[:, :, 1] *= LOG2_E
    arrays = (np.ascontiguousarray(a, dtype=np.float32) for a in (values, steps, least))
    return GeneralTables(*(array.reshape(-1) for array in arrays))


def general_material_gradient(m_sums: np.ndarray) -> np.ndarray:
    """Derivative (3, 3, 2, 6) by m from the sums (…, 108) of learn.engines.general.backward."""
    sums = m_sums.reshape(-1, 3, 3, 2, 6).sum(0, dtype=np.float64)
    return lobe_first(sums * np.array([LN2**2, 1.0])[:, None])


def spline_steps(values: np.ndarray) -> np.ndarray:
    """Slopes (…, 5) at x = 0 … 4 of curves with control values (…, 6), by x of engines.splines."""
    return np.diff(values, axis=-1) * np.array([2.0, 1.0, 1.0, 1.0, 2.0])
