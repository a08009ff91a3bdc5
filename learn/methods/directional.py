"""Sums over any set of directional lights, each method's inner work: by the compiled kernels where
they apply, else by exact.ExactSum.

T lights, P pixels, one material.
w         (T, 3) unit, camera frame, constant
E         (T, 3) radiance × solid angle
left_out  radiance that may be missing from a pixel in a channel: blocks of lights are skipped up to
that

The kernels serve float32 on the CPU: learn.engines.culled a distant viewer, learn.engines.general a
view per pixel (and leaves out nothing that counts). With a distant viewer a normal may also look
away from the viewer (nodes of a reflectance map just beyond the silhouette): c = h·n is held above
0, so values and derivatives stay finite.
"""

import functools
import math
from dataclasses import dataclass

import numpy as np
import torch

from learn.engines import cpu, machine_code, pixel_selection, threads
from learn.engines.derivatives import Step, last
from learn.engines.layout import (
    CONE_ENERGY,
    CONE_H_X,
    CONE_KAPPA,
    CONE_ROWS,
    CULLED_CHUNKS,
    CULLED_SCRATCH,
    CULLED_TILE,
    CUTS,
    LANES,
    SELECT_ROWS,
)
from learn.engines.lights import Slab, blocked, cutoff, general_tables, lobe_first, unblocked
from learn.methods import lobe_shapes, refusal
from learn.methods.exact import ExactSum
from shaders.dsbrdf import MAX_EXPONENT, half_angles
from shaders.envmap import directions
from shaders.spline import basis

FEW = 512  # pixels from which the backward pass is worth a second thread
PASS = 65536  # pixels whose lists are made at a time
KEPT = 2**26  # bytes of lists that a picture keeps for the backward pass
ALL_LOBES = (0, 1, 2)
LARGEST_CONTROL = (MAX_EXPONENT,), (math.inf,)  # of κ and of γ
VIEWER = np.array([0.0, 0.0, 1.0])
# eight bits over the even places of sixteen
SPREAD_BITS = np.array([int(f"{number:b}", 4) for number in range(256)], np.uint16)
# seconds to test sixteen blocks for a tile, and to sum a listed block for a pixel of it
TESTED, LISTED = 7e-8, 1e-8
# of the highest lobe's κ: lobes below it count as if they had it where the derivative by κ is
# wanted
DIM = 0.01
SLACK = 1e-5  # radians by which cones are widened against rounding
FEW_TEXELS = 512  # of a map of 16 × 32, up to which gradients are those of the whole sum
# pairs of a pixel and a light up to which a sum leaves nothing out: it takes no longer than a plan
# with its check
WHOLE = 2**19


@dataclass(frozen=True)
class Lights:
    """Directions of lights in blocks of 16 neighbours, with what the kernels need to know of them.

    w         (T, 3) float64
    geometry  (blocks, 9, 16) float32: w, h, and what rounding took off h; the last block is filled
    up with its last light
    cones     (wide blocks, CONE_ROWS, 16) float32 for learn.engines.culled: the cones about w and
    about h; the material's rows are 0
    axes      (blocks, 3) float32: the axes of the cones about h
    basis     (blocks, 6, 16) float32: the spline's basis at each light's θ_d
    """

    w: np.ndarray
    geometry: np.ndarray
    cones: np.ndarray
    axes: np.ndarray
    basis: np.ndarray

    @property
    def blocks(self):
        return len(self.geometry)


def lights_at(w):
    """The `Lights` of directions (T, 3), numpy; neighbours in the order given should be neighbours
    on the sphere.
    """
    filled = np.concatenate([w, np.broadcast_to(w[-1], (-len(w) % LANES, 3))])
    h, theta_d = half_angles(filled, VIEWER)
    rest = h.T - h.T.astype(np.float32)
    cones = np.concatenate([cone(filled.reshape(-1, LANES, 3)), cone(h.reshape(-1, LANES, 3))], -1)
    rows = np.zeros((CONE_ROWS, len(cones) + -len(cones) % LANES))
    rows[:CONE_ENERGY, : len(cones)] = cones.T
    axes = np.ascontiguousarray(cones[:, CONE_H_X : CONE_H_X + 3], np.float32)
    return Lights(
        w,
        blocked(np.concatenate([filled.T, h.T, rest])),
        blocked(rows),
        axes,
        blocked(basis(theta_d).T),
    )


def cone(vectors):
    """Axis, cos and sin of the half angle (…, 5) of a cone that holds vectors (…, K, 3); the whole
    sphere where one is 0.
    """
    axis = vectors.sum(-2)
    length = np.linalg.norm(axis, axis=-1, keepdims=True)
    axis = np.where(length > 1e-6, axis / np.maximum(length, 1e-6), VIEWER)
    cosine = np.clip((vectors * axis[..., None, :]).sum(-1).min(-1), -1.0, 1.0)
    whole = (np.abs(vectors).max(-1) == 0).any(-1)
    angle = np.where(whole, np.pi, np.minimum(np.arccos(cosine) + SLACK, np.pi))
    return np.concatenate([axis, np.cos(angle)[..., None], np.sin(angle)[..., None]], -1)


@functools.lru_cache(maxsize=8)
def map_lights(height, width, camera_from_light):
    """The `Lights` of a map's texels in 4×4 tiles, and their places (T,) in the flattened map;
    camera_from_light as nine numbers.

    All in numpy: a tensor that is kept from torch's inference mode could not be part of a graph
    later.
    """
    row, column = np.divmod(np.arange(height * width), width)
    order = np.lexsort((column, row, column // 4, row // 4))
    rotation = np.array(camera_from_light).reshape(3, 3)
    return lights_at(directions(height, width)[0].reshape(-1, 3)[order] @ rotation.T), order


def of_map(light, camera_from_light):
    """`Lights` and E (T, 3), differentiable in light (height, width, 3)."""
    height, width = light.shape[:2]
    lights, order = map_lights(height, width, tuple(camera_from_light.double().flatten().tolist()))
    solid_angle = torch.as_tensor(
        directions(height, width)[1], dtype=light.dtype, device=light.device
    )
    return (
        lights,
        (light * solid_angle[..., None]).reshape(-1, 3)[torch.from_numpy(order).to(light.device)],
    )


def has_kernels(n):
    return n.dtype == torch.float32 and n.device.type == "cpu" and machine_code.is_available()


def radiance(n, view, m, E, lights, left_out=0.0, lobes=ALL_LOBES, method="directional"):
    """(P, 3) of some lobes of one material m (3, 3, 2, 6) under lights E; differentiable in n,
    view, m and E, by the kernels once.

    method  the name under which they refuse to be differentiated again
    """
    if has_kernels(n) and view is None:
        return ListedSum.apply(n, m, E, lights, float(left_out), lobes, method)
    if lobes != ALL_LOBES:
        m = lobe_shapes.only(m, np.isin(ALL_LOBES, lobes))
    if has_kernels(n):
        return ViewedSum.apply(
            n, view.expand_as(n), torch.minimum(m, m.new_tensor(LARGEST_CONTROL)), E, lights, method
        )
    return ExactSum.apply(n, view, m, E, torch.as_tensor(lights.w, dtype=n.dtype, device=n.device))


def is_small(pixels, lights, with_gradients=False):
    """Whether a sum of so many pixels and lights is to be made whole: an approximation would save
    no time, or its gradients would be wrong.

    Few texels are large ones. Each one's max(0, n·w) has a corner where the texel comes up over a
    pixel's horizon, which no interpolation between normals and no coarser light has where it should
    be.
    """
    return pixels * lights <= WHOLE or (with_gradients and lights <= FEW_TEXELS)


def near(n, view, m, E, lights, error, method="directional"):
    """(P, 3), with what may be left out of a pixel given as a part of the picture's mean
    radiance.
    """
    return radiance(n, view, m, E, lights, error * scale(n, view, m, E, lights), method=method)


def scale(n, view, m, E, lights, pixels=32):
    """Mean radiance of evenly chosen pixels: what errors are measured against."""
    with torch.no_grad():
        pick = sample(len(n), pixels, n.device)
        return radiance(n[pick], None if view is None else view[pick], m, E, lights).mean().item()


def sample(count, pixels, device=None):
    """Indices (pixels,) spread evenly over range(count), the same every time; steps of the golden
    ratio fall into no pattern.
    """
    return torch.from_numpy(spread_over(count, pixels)).to(device)


@functools.lru_cache(maxsize=64)
def spread_over(count, pixels):
    """The same in numpy."""
    places = (np.arange(min(pixels, count)) * ((math.sqrt(5) - 1) / 2) + 0.5) % 1.0
    return np.unique((places * count).astype(np.int64))


class ListedSum(Step):
    """n (P, 3), m (3, 3, 2, 6), E (T, 3), Lights, left_out, numbers of lobes, a method's name →
    radiance (P, 3) by learn.engines.culled.
    """

    @staticmethod
    def forward(ctx, n, m, E, lights, left_out, lobes, method):
        ctx.refusal = refusal(method)
        ctx.save_for_backward(n, m, E)
        _, by_m, by_E, *_ = ctx.needs_input_grad
        tables = Tables(
            m.double().numpy(), energy_blocks(E.numpy().T, lights), lights, by_E, lobes, by_m
        )
        ctx.listing = Listing(n.numpy(), tables, left_out)
        return torch.from_numpy(ctx.listing.radiance)

    @staticmethod
    @last
    def backward(ctx, g):
        by_n, by_m, by_E = ctx.listing.backward(g.numpy())
        return (
            torch.from_numpy(by_n),
            torch.from_numpy(by_m).float(),
            torch.from_numpy(by_E.T.copy()),
            None,
            None,
            None,
            None,
        )


class Listing:
    """Radiance (P, 3) at normals n (P, 3) by the lights of each tile's list, and the way back;
    arrays are numpy, float32.

    taken  bytes of lists that others keep for the way back: from KEPT on, lists are made a second
    time then
    kept   bytes of lists that this one keeps
    """

    def __init__(self, n, tables, left_out, taken=0):
        self.tables, self.left_out, self.order = tables, left_out, by_place(n)
        self.n, self.lists, self.kept = n.take(self.order, 0), {}, 0
        out = np.empty_like(self.n)
        for start in range(0, len(n), PASS):
            part = self.n[start : start + PASS]
            lists = select(part, tables, tables.cones, left_out)
            run_forward(part, tables, lists, out[start : start + PASS])
            if taken + self.kept < KEPT and tables.way_back is tables.cones:
                self.lists[start] = lists
                self.kept += sum(array.nbytes for array in lists)
        self.radiance = put_back(out, self.order)

    def backward(self, g, with_n=True):
        """Derivatives of Σ g·radiance: by n (P, 3) or None, by m (3, 3, 2, 6) float64, by E (3,
        T).
        """
        g = g.take(self.order, 0)
        by_sorted_n, by_m, by_E = (
            np.empty_like(g),
            np.zeros((3, 3, 2, 6)),
            np.zeros((3, len(self.tables.lights.w)), np.float32),
        )
        for start in range(0, len(g), PASS):
            part = slice(start, start + PASS)
            lists = self.lists.get(start) or select(
                self.n[part], self.tables, self.tables.way_back, self.left_out
            )
            energy_sums, lobe_sums = run_backward(
                self.n[part], self.tables, lists, g[part], by_sorted_n[part], with_n
            )
            by_m += self.tables.material_gradient(lobe_sums)
            by_E += unblocked(energy_sums)[:, : by_E.shape[1]]
        if not with_n:
            return None, by_m, by_E
        return put_back(by_sorted_n, self.order), by_m, by_E


class ViewedSum(Step):
    """n, view (P, 3), m (3, 3, 2, 6), E (T, 3), Lights, a method's name → radiance (P, 3) by
    learn.engines.general.

    A view per pixel, all lights.
    """

    @staticmethod
    def forward(ctx, n, view, m, E, lights, method):
        ctx.refusal = refusal(method)
        ctx.save_for_backward(n, view, m, E)
        energy = energy_blocks(E.numpy().T, lights)
        ctx.lights, ctx.energy = lights, (energy, cutoff(energy))
        arrays = (np.ascontiguousarray(a.numpy()) for a in (n, view))
        return torch.from_numpy(
            cpu._forward(
                *arrays,
                slab(lights),
                general_tables(m.double().numpy()),
                ctx.energy,
                torch.get_num_threads(),
            )
        )

    @staticmethod
    @last
    def backward(ctx, g):
        n, view, m, _ = ctx.saved_tensors
        arrays = (np.ascontiguousarray(a.numpy()) for a in (n, view, g))
        group = cpu.Group(
            *arrays, slab(ctx.lights), ctx.energy, torch.get_num_threads(), ctx.needs_input_grad[1]
        )
        by_n, by_view, energy_sums, by_m = cpu._general_backward(
            group, *general_tables(m.double().numpy())
        )
        by_E = unblocked(energy_sums)[:, : len(ctx.lights.w)].T
        by_view = torch.from_numpy(by_view) if ctx.needs_input_grad[1] else None
        by_m = torch.from_numpy(np.ascontiguousarray(by_m)).float()
        return torch.from_numpy(by_n), by_view, by_m, torch.from_numpy(by_E).float(), None, None


def slab(lights):
    """What learn.engines.cpu wants to know of lights for a view per pixel."""
    w = np.concatenate([lights.w, np.broadcast_to(lights.w[-1], (-len(lights.w) % LANES, 3))]).T
    general = blocked(np.concatenate([w, w - w.astype(np.float32)]))
    return Slab(None, None, lights.blocks, lights.geometry, general, None)


def energy_blocks(E, lights):
    """E (3, T), numpy, as (blocks, 3, 16) float32; the lights that fill up the last block are
    dark.
    """
    rows = np.zeros((3, LANES * lights.blocks), np.float32)
    rows[:, : E.shape[1]] = E
    return blocked(rows)


class Tables:
    """Some lobes of a material m (3, 3, 2, 6) at each light of energy (blocks, 3, 16), as
    learn.engines.culled wants to know them.

    lobes     (blocks, many, 3, 2, 16);  cones  (wide blocks, CONE_ROWS, 16)
    way_back  the cones by which lists are made for the backward pass: the same, unless a lobe is
    dim and its derivative wanted
    """

    def __init__(self, m, energy, lights, light_gradient, lobes=ALL_LOBES, material_gradient=False):
        self.lights, self.energy, self.numbers, self.many = lights, energy, list(lobes), len(lobes)
        self.lobes, self.cones = (
            np.empty((lights.blocks, self.many, 3, 2, LANES), np.float32),
            lights.cones.copy(),
        )
        chosen = np.ascontiguousarray(lobe_first(m)[self.numbers], np.float32)
        machine_code.call(
            "tables.make",
            0,
            lights.blocks,
            self.many,
            chosen,
            lights.basis,
            energy,
            self.lobes,
            self.cones,
        )
        if light_gradient:  # a dark block matters too: it counts as one of a tenth of the mean
            brightness = self.cones[:, CONE_ENERGY]
            np.maximum(brightness, 0.1 * brightness.sum() / lights.blocks or 1.0, out=brightness)
        self.way_back = self.with_dim_lobes() if material_gradient else self.cones

    def with_dim_lobes(self):
        """The cones, with no lobe lower than a part DIM of the highest.

        A lobe of next to no height adds next to nothing and so may be left out everywhere, but its
        derivative by κ, c^γ, does not depend on its height.
        """
        # the largest κ log2 e of each lobe
        rows = slice(CONE_KAPPA, CONE_KAPPA + self.many)
        height = self.cones[:, rows]
        least = np.where(
            np.arange(self.cones.shape[0] * LANES) < self.lights.blocks,
            np.float32(DIM) * height.max(),
            np.float32(0.0),
        )
        raised = np.maximum(height, least.reshape(-1, 1, LANES))
        if np.array_equal(raised, height):
            return self.cones
        result = self.cones.copy()
        result[:, rows] = raised
        return result

    def material_gradient(self, lobe_sums):
        """(3, 3, 2, 6) float64 by m, from the sums (chunks, blocks, many, 3, 2, 16) of
        learn.engines.culled.backward.
        """
        sums, by_m = np.empty((self.many, 3, 2, 6, LANES), np.float32), np.zeros((3, 3, 2, 6))
        sizes = self.many, self.lights.blocks, len(lobe_sums), lobe_sums[0].size
        machine_code.call(
            "tables.gradient", *sizes, self.lights.basis, self.energy, self.lobes, lobe_sums, sums
        )
        by_m[self.numbers] = sums.sum(-1, dtype=np.float64)
        return lobe_first(by_m)


def by_place(n):
    """An order (P,) of pixels in which neighbours have like unit normals (P, 3): along a Morton
    curve over the normals' x and y.
    """
    x, y = (
        (np.ascontiguousarray(n[:, axis]) * np.float32(127.5) + np.float32(128.0)).astype(np.uint8)
        for axis in (0, 1)
    )
    return np.argsort(SPREAD_BITS.take(x) | (SPREAD_BITS << 1).take(y), kind="stable")


def put_back(values, order):
    """(P, 3) with values (P, 3) at the places order (P,)."""
    result = np.empty_like(values)
    pixel_selection.run("pixels.spread", len(order), order, values, result)
    return result


def tile_size(pixels):
    """Pixels that share a list: few where there are few, for their normals are far apart."""
    return 16 if pixels < 12288 else 32 if pixels < 24576 else CULLED_TILE


def select(n, tables, cones, left_out):
    """Each tile's list, as learn.engines.culled has it: cuts, lengths, entries; cones are those of
    the tables, or their way back's.
    """
    size = tile_size(len(n))
    tiles = -(-len(n) // size)
    room, budget = (
        tables.lights.blocks,
        np.array([min(left_out, np.finfo(np.float32).max)], np.float32),
    )
    cuts, lengths, entries = (
        np.empty((tiles, room, CUTS), np.float32),
        np.empty(tiles, np.int32),
        np.empty((tiles, room), np.int32),
    )

    def kernel(first, last):
        scratch = np.empty(cones.shape[0] * SELECT_ROWS * LANES, np.float32)
        sizes = first, last, len(n), size, len(cones), room, tables.many
        machine_code.call(
            "culled.select", *sizes, budget, n, cones, scratch, cuts, lengths, entries
        )

    workers = threads.worth(torch.get_num_threads(), tiles * len(cones) * TESTED)
    threads.run(kernel, threads.split(tiles, workers), workers)
    return cuts, lengths, entries


def run_forward(n, tables, lists, out):
    cuts, lengths, entries = lists

    def kernel(first, last):
        scratch = np.empty(CULLED_SCRATCH, np.float32)
        sizes = first, last, len(n), tile_size(len(n)), entries.shape[1], tables.many
        arrays = (
            n,
            tables.lights.axes,
            tables.lights.geometry,
            tables.energy,
            tables.lobes,
            scratch,
            out,
        )
        machine_code.call("culled.forward", *sizes, *arrays, cuts, lengths, entries)

    workers = threads.worth(
        torch.get_num_threads(), int(lengths.sum()) * tile_size(len(n)) * LISTED
    )
    threads.run(kernel, threads.split(len(lengths), 2 * workers), workers)


def run_backward(n, tables, lists, g, by_n, with_n=True):
    """Energy sums (blocks, 3, 16) and lobe sums (chunks, blocks, many, 3, 2, 16); by_n is written
    if wanted.
    """
    cuts, lengths, entries = lists
    blocks, many = tables.lights.blocks, tables.many
    # by the pixels, never by the threads: sums must come out the same
    chunks = min(CULLED_CHUNKS, 1 + len(n) // FEW)
    energy_sums, lobe_sums = (
        np.empty((chunks, blocks, 3, LANES), np.float32),
        np.empty((chunks, blocks, many, 3, 2, LANES), np.float32),
    )
    scratch = np.empty(chunks * CULLED_SCRATCH, np.float32)

    def kernel(first, last):
        sizes = (
            first,
            last,
            len(n),
            tile_size(len(n)),
            len(lengths),
            blocks,
            entries.shape[1],
            many,
            chunks,
            int(with_n),
        )
        arrays = (
            n,
            tables.lights.axes,
            tables.lights.geometry,
            tables.energy,
            tables.lobes,
            scratch,
            g,
            by_n,
            energy_sums,
            lobe_sums,
        )
        machine_code.call("culled.backward", *sizes, *arrays, cuts, lengths, entries)

    workers = threads.worth(
        torch.get_num_threads(), int(lengths.sum()) * tile_size(len(n)) * LISTED
    )
    threads.run(kernel, threads.split(chunks, workers), workers)
    return added(energy_sums), lobe_sums


def added(parts):
    """The sum over the first axis, in its order, into the first part."""
    for part in parts[1:]:
        parts[0] += part
    return parts[0]
