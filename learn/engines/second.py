"""Second derivatives of the exact sum on the CPU: the kernels' backward pass differentiated, group
by group on threads. numpy only.

Arguments and what they promise as in learn.engines.cpu; n', view', m', light' are the derivatives
of some loss by the results of `cpu.gradients`, all float32. learn.methods.exact_second says what is
differentiated, and does the same in plain torch.
"""

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
from learn.engines.machine_code import call


def gradients(direction, g, n, view, m, light, rotation, counts, light_of, workers):
    """Derivatives by g, n, view (None without one), m and light, in their shapes, of Σ direction ·
    cpu.gradients(g, n, view, m, light).

    direction  n' (P, 3), view' (P, 3) or None, m' (G, 3, 3, 2, 6), light' (B, height, width, 3)
    Those by n and view are right in their tangential part.
    """
    along_n, along_view, along_m, along_light = direction
    by_g, by_n, by_m, by_light = (
        np.zeros_like(g),
        np.zeros_like(n),
        np.zeros_like(m),
        np.zeros_like(light),
    )
    by_view = None if view is None else np.zeros_like(view)
    for slab in lights.slabs(*light.shape[1:3], rotation):
        prepared = Prepared(slab, m, light, distant=view is None)
        for k, pixels in enumerate(groups(counts)):
            image = light_of[k]
            lit = Lit(slab, *prepared.energy(image), slab.energy(along_light[image]), workers)
            material, along = prepared.material(k), along_m[k].astype(np.float64)
            if view is None:
                per_pixel, energy_sums, by_material = lit.distant(
                    n[pixels], g[pixels], along_n[pixels], material, along
                )
            else:
                vectors = n[pixels], view[pixels], g[pixels], along_n[pixels], along_view[pixels]
                per_pixel, energy_sums, by_material = lit.general(
                    *vectors, material, m[k].astype(np.float64), along
                )
                by_view[pixels] += per_pixel[2]
            by_n[pixels] += per_pixel[0]
            by_g[pixels] += per_pixel[1]
            by_m[k] += by_material
            slab.add_light_gradient(energy_sums, by_light[image].reshape(-1, 3))
    return by_g, by_n, by_view, by_m, by_light


class Lit:
    """A group's lights of one slab: passes of pixels are summed in float64, as by `cpu.Group`."""

    def __init__(self, slab, energy, cut, energy_along, workers):
        self.slab, self.energy, self.cut, self.energy_along, self.workers = (
            slab,
            energy,
            cut,
            energy_along,
            workers,
        )

    def distant(self, n, g, along_n, material, along_m):
        """by n and g, by energy, by m (3, 3, 2, 6)."""
        lobes, least, _ = material
        lobes_along = lights.blocked(lights.lobe_first(along_m).reshape(18, 6) @ self.slab.basis.T)
        lobe_part, lobe_sums, scratch = (
            np.empty_like(lobes),
            np.zeros(lobes.shape),
            np.empty(LIGHT_CHUNKS * DISTANT_SECOND_SCRATCH, np.float32),
        )

        def one_pass(n, g, along_n, n_part, g_part, energy_part):
            arrays = (
                n,
                self.slab.distant,
                self.energy,
                lobes,
                least,
                self.cut,
                scratch,
                g,
                along_n,
                self.energy_along,
                lobes_along,
            )
            self.run(
                "distant_second.second", len(n), *arrays, n_part, g_part, energy_part, lobe_part
            )
            np.add(lobe_sums, lobe_part, out=lobe_sums)

        per_pixel, energy_sums = self.passes(one_pass, 2, n, g, along_n)
        by_kappa_gamma = lights.unblocked(lobe_sums).reshape(3, 3, 2, -1) @ self.slab.basis
        return per_pixel, energy_sums, lights.lobe_first(by_kappa_gamma[:, :, ::-1])

    def general(self, n, view, g, along_n, along_view, material, m, along_m):
        """by n, g and view, by energy, by m (3, 3, 2, 6)."""
        values, _, least = material
        values_along = lights.lobe_first(along_m)
        tables = (
            flat(x)
            for x in (
                lights.spline_steps(lights.lobe_first(m)),
                values_along,
                lights.spline_steps(values_along),
            )
        )
        steps, values_along, steps_along = tables
        by_values, by_steps, scratch = (
            np.zeros(VALUES),
            np.zeros(STEPS),
            np.empty(LIGHT_CHUNKS * GENERAL_SECOND_SCRATCH, np.float32),
        )

        def one_pass(n, view, g, along_n, along_view, n_part, g_part, view_part, energy_part):
            m_part, steps_part = (
                np.empty((LIGHT_CHUNKS, -(-len(n) // GENERAL_TILE), size), np.float32)
                for size in (VALUES, STEPS)
            )
            arrays = (
                n,
                view,
                self.slab.general,
                self.energy,
                values,
                steps,
                least,
                self.cut,
                scratch,
                g,
                along_n,
                along_view,
            )
            tables = self.energy_along, values_along, steps_along
            self.run(
                "general_second.second",
                len(n),
                *arrays,
                *tables,
                n_part,
                view_part,
                g_part,
                energy_part,
                m_part,
                steps_part,
            )
            np.add(by_values, m_part.sum((0, 1), dtype=np.float64), out=by_values)
            np.add(by_steps, steps_part.sum((0, 1), dtype=np.float64), out=by_steps)

        per_pixel, energy_sums = self.passes(one_pass, 3, n, view, g, along_n, along_view)
        by_m = (
            by_values.reshape(3, 3, 2, 6)
            + by_steps.reshape(3, 3, 2, STEPS_OF_CURVE) @ lights.spline_steps(np.eye(6)).T
        )
        return per_pixel, energy_sums, lights.lobe_first(by_m)

    def passes(self, one_pass, results, *vectors):
        """`results` arrays (p, 3), and the energy sums.

        one_pass is given the vectors of a pass, each result's parts (LIGHT_CHUNKS, pass, 3) and the
        energy part to fill.
        """
        matches = [np.empty_like(vectors[0]) for _ in range(results)]
        energy_part, energy_sums = np.empty_like(self.energy), np.zeros(self.energy.shape)
        for first in range(0, len(vectors[0]), PASS):
            given = [x[first : first + PASS] for x in vectors]
            parts = [np.empty((LIGHT_CHUNKS, *given[0].shape), np.float32) for _ in matches]
            one_pass(*given, *parts, energy_part)
            for result, part in zip(matches, parts, strict=True):
                result[first : first + PASS] = part.sum(0)
            energy_sums += energy_part
        return matches, energy_sums

    def run(self, kernel, pixels, *arrays):
        sizes = pixels, self.slab.blocks
        threads.run(
            lambda first, last: call(kernel, first, last, *sizes, *arrays),
            threads.split(LIGHT_CHUNKS, LIGHT_CHUNKS),
            self.workers,
        )


def flat(table):
    return np.ascontiguousarray(table, np.float32).reshape(-1)
