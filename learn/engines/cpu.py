"""The exact sum and its derivatives on the CPU: the kernels of this folder, run group by group on
threads. numpy only.

P pixels, G groups (one image and one material each; pixels lie sorted by group), B images; float32
throughout.
n, view   (P, 3); view None: orthographic, (0, 0, 1) for every pixel
m         (G, 3, 3, 2, 6) κ and γ control values
light     (B, height, width, 3) linear radiance, light frame
rotation  nine numbers, camera_from_light
counts    pixels of each group, and light_of: its light's index

Results do not depend on the number of threads nor on what else is in the batch, to the last bit: a
pixel's sum runs over the lights in one order; derivatives are summed in fixed chunks of lights and
passes of pixels, pass by pass in float64. Memory beyond inputs and outputs: the tables of a slab of
lights and a pass of pixels, about 20 MiB.
"""

import numpy as np

from learn.engines import lights, threads
from learn.engines.layout import (
    DISTANT_SCRATCH,
    DISTANT_TILE,
    GENERAL_SCRATCH,
    GENERAL_TILE,
    LIGHT_CHUNKS,
    VALUES,
)
from learn.engines.machine_code import call

PASS = 8192  # pixels whose derivatives are summed in float32
KEPT_TABLES = 4  # materials whose tables are kept while a batch runs


def radiance(n, view, m, light, rotation, counts, light_of, workers):
    """Radiance (P, 3)."""
    out = np.zeros_like(n)
    for slab in lights.slabs(*light.shape[1:3], rotation):
        prepared = Prepared(slab, m, light, distant=view is None)
        for g, pixels in enumerate(groups(counts)):
            v = None if view is None else view[pixels]
            out[pixels] += _forward(
                n[pixels], v, slab, prepared.material(g), prepared.energy(light_of[g]), workers
            )
    return out


def gradients(g_radiance, n, view, m, light, rotation, counts, light_of, workers, with_view=True):
    """Derivatives of Σ g_radiance · radiance: by n, view, m and light, in their shapes.

    with_view  whether the derivative by view is wanted; otherwise, and without a view, None stands
    in its place Those by n and view are right in their tangential part, which is what scaling to
    unit length lets through.
    """
    by_n, by_m, by_light = np.zeros_like(n), np.zeros_like(m), np.zeros_like(light)
    with_view = with_view and view is not None
    by_view = np.zeros_like(view) if with_view else None
    for slab in lights.slabs(*light.shape[1:3], rotation):
        prepared = Prepared(slab, m, light, distant=view is None)
        for g, pixels in enumerate(groups(counts)):
            backward = _distant_backward if view is None else _general_backward
            energy = prepared.energy(light_of[g])
            group = Group(
                n[pixels],
                None if view is None else view[pixels],
                g_radiance[pixels],
                slab,
                energy,
                workers,
                with_view,
            )
            group_by_n, group_by_view, energy_sums, group_by_m = backward(
                group, *prepared.material(g)
            )
            by_n[pixels] += group_by_n
            if with_view:
                by_view[pixels] += group_by_view
            by_m[g] += group_by_m
            slab.add_light_gradient(energy_sums, by_light[light_of[g]].reshape(-1, 3))
    return by_n, by_view, by_m, by_light


def groups(counts):
    """The slice of pixels of each group."""
    ends = np.cumsum((0, *counts))
    return [slice(a, b) for a, b in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)]


class Prepared:
    """Tables of the materials and lights of a batch for one slab, made when asked for; the last few
    are kept.
    """

    def __init__(self, slab, m, light, distant):
        self._slab, self._m, self._light, self._distant = slab, m, light, distant
        self._tables, self._energy = {}, (None, None)

    def material(self, g):
        m = self._m[g].astype(np.float64)
        key = m.tobytes()
        if key not in self._tables:
            if len(self._tables) == KEPT_TABLES:
                self._tables.pop(next(iter(self._tables)))
            self._tables[key] = (
                lights.distant_tables(m, self._slab) if self._distant else lights.general_tables(m)
            )
        return self._tables[key]

    def energy(self, image):
        """Energy (blocks, 3, 16) and its cutoff (blocks,)."""
        if self._energy[0] != image:
            energy = self._slab.energy(self._light[image])
            self._energy = image, (energy, lights.cutoff(energy))
        return self._energy[1]


def _forward(n, view, slab, material, energy, workers):
    """Radiance (p, 3) of one group by one slab's lights."""
    out = np.empty_like(n)
    energy, cut = energy

    def distant(first, last):
        lobes, least, _ = material
        scratch = np.empty(DISTANT_SCRATCH, np.float32)
        sizes = first, last, len(n), slab.blocks
        call("distant.forward", *sizes, n, slab.distant, energy, lobes, least, cut, scratch, out)

    def general(first, last):
        values, _, least = material
        call(
            "general.forward",
            first,
            last,
            len(n),
            slab.blocks,
            n,
            view,
            slab.general,
            energy,
            values,
            least,
            cut,
            out,
        )

    tiles = -(-len(n) // (DISTANT_TILE if view is None else GENERAL_TILE))
    threads.run(distant if view is None else general, threads.split(tiles, 8 * workers), workers)
    return out


class Group:
    """One group's pixels and one slab's lights, to be passed backward: passes of pixels, summed in
    float64 over passes.
    """

    def __init__(self, n, view, g, slab, energy, workers, with_view):
        self.n, self.view, self.g, self.slab, self.workers, self.with_view = (
            n,
            view,
            g,
            slab,
            workers,
            with_view,
        )
        self.energy, self.cut = energy

    def passes(self):
        return [slice(i, min(i + PASS, len(self.n))) for i in range(0, len(self.n), PASS)]

    def run(self, kernel):
        threads.run(kernel, threads.split(LIGHT_CHUNKS, LIGHT_CHUNKS), self.workers)


def _distant_backward(group, lobes, least, kappa):
    """Derivatives of one group: by n, None, energy sums, by m."""
    slab = group.slab
    by_n = np.empty_like(group.n)
    energy_part, lobe_part = np.empty_like(group.energy), np.empty_like(lobes)
    energy_sums, lobe_sums = np.zeros(energy_part.shape), np.zeros(lobe_part.shape)
    scratch = np.empty(LIGHT_CHUNKS * DISTANT_SCRATCH, np.float32)
    for pixels in group.passes():
        n, g = group.n[pixels], group.g[pixels]
        n_part = np.empty((LIGHT_CHUNKS, *n.shape), np.float32)
        arrays = (
            n,
            slab.distant,
            group.energy,
            lobes,
            least,
            group.cut,
            scratch,
            g,
            n_part,
            energy_part,
            lobe_part,
        )
        group.run(
            lambda first, last, n=n, arrays=arrays: call(
                "distant.backward", first, last, len(n), slab.blocks, *arrays
            )
        )
        by_n[pixels] = n_part.sum(0)
        energy_sums += energy_part
        lobe_sums += lobe_part
    return (
        by_n,
        None,
        energy_sums,
        lights.distant_material_gradient(lobe_sums, group.energy, kappa, slab),
    )


def _general_backward(group, values, steps, least):
    """Derivatives of one group: by n, view, energy sums, by m."""
    slab = group.slab
    by_n, by_view = np.empty_like(group.n), np.empty_like(group.n)
    energy_part = np.empty_like(group.energy)
    energy_sums, m_sums = np.zeros(energy_part.shape), np.zeros(VALUES)
    scratch = np.empty(LIGHT_CHUNKS * GENERAL_SCRATCH, np.float32)
    for pixels in group.passes():
        n, v, g = group.n[pixels], group.view[pixels], group.g[pixels]
        n_part, v_part = np.zeros((2, LIGHT_CHUNKS, *n.shape), np.float32)
        m_part = np.empty((LIGHT_CHUNKS, -(-len(n) // GENERAL_TILE), VALUES), np.float32)
        arrays = (
            n,
            v,
            slab.general,
            group.energy,
            values,
            steps,
            least,
            group.cut,
            scratch,
            g,
            n_part,
            v_part,
            energy_part,
            m_part,
        )
        sizes = len(n), slab.blocks, int(group.with_view)
        group.run(
            lambda first, last, sizes=sizes, arrays=arrays: call(
                "general.backward", first, last, *sizes, *arrays
            )
        )
        by_n[pixels], by_view[pixels] = n_part.sum(0), v_part.sum(0)
        energy_sums += energy_part
        m_sums += m_part.sum((0, 1), dtype=np.float64)
    return by_n, by_view, energy_sums, lights.general_material_gradient(m_sums)
