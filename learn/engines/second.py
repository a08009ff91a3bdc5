"""Second derivatives of the exact sum on the CPU: the derivative of the kernels' backward pass.

Arguments and promises are those of learn.engines.cpu; n', view', m', light' are the derivatives of
some loss by the results of `cpu.gradients`, all float32. learn.methods.exact_second states what is
differentiated, and does the same in plain torch. Their kernels repeat the loops of the first-order
ones on purpose: each loop is unrolled around values that stay in registers.
"""

from collections.abc import Callable, Sequence

import numpy as np

from learn.engines import lights, threads
from learn.engines.cpu import PASS, Prepared, groups
from learn.engines.layout import (
    DISTANT_SECOND_SCRATCH,
    GENERAL_SECOND_SCRATCH,
    GENERAL_TILE,
    LIGHT_CHUNKS,
    STEPS,
    STEPS_OF_CURVE,
    VALUES,
)
from learn.engines.lights import DistantTables, GeneralTables, Rotation, Slab
from learn.engines.machine_code import call

# derivatives by vectors per pixel, each (p, 3); by energy (blocks, 3, 16); by m (3, 3, 2, 6)
Derivatives = tuple[list[np.ndarray], np.ndarray, np.ndarray]


def gradients(
    direction: Sequence[np.ndarray | None],
    g: np.ndarray,
    n: np.ndarray,
    view: np.ndarray | None,
    m: np.ndarray,
    light: np.ndarray,
    rotation: Rotation,
    counts: Sequence[int],
    light_of: Sequence[int],
    workers: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray, np.ndarray]:
    """Derivatives of Σ direction · cpu.gradients(g, n, view, m, light) by these five.

    direction  n' (P, 3), view' (P, 3) or None, m' (G, 3, 3, 2, 6), light' (B, height, width, 3)
    Returns    derivatives by g, n, view (None without one), m and light, in their shapes; those by
               n and view are right in their tangential part
    """
    along_n, along_view, along_m, along_light = direction
    if along_n is None or along_m is None or along_light is None:
        raise ValueError("direction: expected arrays for n, m and light, found None")
    by_g, by_n, by_m = np.zeros_like(g), np.zeros_like(n), np.zeros_like(m)
    by_light = np.zeros_like(light)
    by_view = None if view is None else np.zeros_like(view)
    for slab in lights.slabs(light.shape[1], light.shape[2], rotation):
        prepared = Prepared(slab, m, light)
        for k, pixels in enumerate(groups(counts)):
            image = light_of[k]
            energies = *prepared.energy(image), slab.energy(along_light[image])
            lit = LitGroup(slab, n[pixels], g[pixels], along_n[pixels], *energies, workers)
            along = along_m[k].astype(np.float64)
            if view is None or by_view is None or along_view is None:
                vectors, energy_sums, by_material = lit.distant(prepared.distant(k), along)
            else:
                material = m[k].astype(np.float64)
                vectors, energy_sums, by_material = lit.general(
                    view[pixels], along_view[pixels], prepared.general(k), material, along
                )
                by_view[pixels] += vectors[2]
            by_n[pixels] += vectors[0]
            by_g[pixels] += vectors[1]
            by_m[k] += by_material
            slab.add_light_gradient(energy_sums, by_light[image].reshape(-1, 3))
    return by_g, by_n, by_view, by_m, by_light


class LitGroup:
    """One group's pixels under one slab's lights; slices of pixels are summed in float64."""

    def __init__(
        self,
        slab: Slab,
        n: np.ndarray,
        g: np.ndarray,
        along_n: np.ndarray,
        energy: np.ndarray,
        cut: np.ndarray,
        energy_along: np.ndarray,
        workers: int,
    ):
        self.slab, self.workers = slab, workers
        self.n, self.g, self.along_n = n, g, along_n
        self.energy, self.cut, self.energy_along = energy, cut, energy_along

    def distant(self, tables: DistantTables, along_m: np.ndarray) -> Derivatives:
        """Derivatives by n and g, by energy, and by m, for a distant viewer."""
        basis = self.slab.basis
        lobes_along = lights.blocked(lights.lobe_first(along_m).reshape(18, 6) @ basis.T)
        lobe_part, lobe_sums = np.empty_like(tables.lobes), np.zeros(tables.lobes.shape)
        scratch = np.empty(LIGHT_CHUNKS * DISTANT_SECOND_SCRATCH, np.float32)

        def one_slice(pixels: slice, parts: list[np.ndarray], energy_part: np.ndarray) -> None:
            n, g, along_n = self.n[pixels], self.g[pixels], self.along_n[pixels]
            inputs = n, self.slab.distant, self.energy, tables.lobes, tables.least, self.cut
            directions = along_n, self.energy_along, lobes_along
            outputs = *parts, energy_part, lobe_part
            self.run("distant_second.second", len(n), *inputs, scratch, g, *directions, *outputs)
            np.add(lobe_sums, lobe_part, out=lobe_sums)

        vectors, energy_sums = self.over_slices(one_slice, 2)
        by_kappa_gamma = lights.unblocked(lobe_sums).reshape(3, 3, 2, -1) @ basis
        return vectors, energy_sums, lights.lobe_first(by_kappa_gamma[:, :, ::-1])

    def general(
        self,
        view: np.ndarray,
        along_view: np.ndarray,
        tables: GeneralTables,
        m: np.ndarray,
        along_m: np.ndarray,
    ) -> Derivatives:
        """Derivatives by n, g and view, by energy, and by m, for a view per pixel."""
        along = lights.lobe_first(along_m)
        steps = flat(lights.spline_steps(lights.lobe_first(m)))
        values_along, steps_along = flat(along), flat(lights.spline_steps(along))
        by_values, by_steps = np.zeros(VALUES), np.zeros(STEPS)
        scratch = np.empty(LIGHT_CHUNKS * GENERAL_SECOND_SCRATCH, np.float32)

        def one_slice(pixels: slice, parts: list[np.ndarray], energy_part: np.ndarray) -> None:
            n, v, g = self.n[pixels], view[pixels], self.g[pixels]
            n_part, g_part, view_part = parts
            tiles = -(-len(n) // GENERAL_TILE)
            m_part = np.empty((LIGHT_CHUNKS, tiles, VALUES), np.float32)
            steps_part = np.empty((LIGHT_CHUNKS, tiles, STEPS), np.float32)
            materials = tables.values, steps, tables.least
            inputs = n, v, self.slab.general, self.energy, *materials, self.cut
            vectors_along = self.along_n[pixels], along_view[pixels]
            directions = *vectors_along, self.energy_along, values_along, steps_along
            outputs = n_part, view_part, g_part, energy_part, m_part, steps_part
            self.run("general_second.second", len(n), *inputs, scratch, g, *directions, *outputs)
            np.add(by_values, m_part.sum((0, 1), dtype=np.float64), out=by_values)
            np.add(by_steps, steps_part.sum((0, 1), dtype=np.float64), out=by_steps)

        vectors, energy_sums = self.over_slices(one_slice, 3)
        slopes = by_steps.reshape(3, 3, 2, STEPS_OF_CURVE)
        by_m = by_values.reshape(3, 3, 2, 6) + slopes @ lights.spline_steps(np.eye(6)).T
        return vectors, energy_sums, lights.lobe_first(by_m)

    def over_slices(
        self,
        one_slice: Callable[[slice, list[np.ndarray], np.ndarray], None],
        count: int,
    ) -> tuple[list[np.ndarray], np.ndarray]:
        """`count` arrays (p, 3), and the energy sums.

        one_slice  function of a slice of pixels, of each array's parts (LIGHT_CHUNKS, slice, 3) and
                   of the energy part, which it fills
        """
        results = [np.empty_like(self.n) for _ in range(count)]
        energy_part, energy_sums = np.empty_like(self.energy), np.zeros(self.energy.shape)
        for first in range(0, len(self.n), PASS):
            pixels = slice(first, min(first + PASS, len(self.n)))
            shape = LIGHT_CHUNKS, pixels.stop - first, 3
            parts = [np.empty(shape, np.float32) for _ in results]
            one_slice(pixels, parts, energy_part)
            for result, part in zip(results, parts, strict=True):
                result[pixels] = part.sum(0)
            energy_sums += energy_part
        return results, energy_sums

    def run(self, name: str, pixels: int, *arrays: np.ndarray) -> None:
        """Run a kernel over all chunks of lights."""
        sizes = pixels, self.slab.blocks
        threads.run(
            lambda first, last: call(name, first, last, *sizes, *arrays),
            threads.split(LIGHT_CHUNKS, LIGHT_CHUNKS),
            self.workers,
        )


def flat(table: np.ndarray) -> np.ndarray:
    """The table as one contiguous row of float32."""
    return np.ascontiguousarray(table, np.float32).reshape(-1)
