"""Under a distant viewer radiance depends on the normal alone: computed at the nodes of a map over normals, looked up for each pixel.

n       unit normal, camera frame; p = (n_x, n_y) / √(1 + n_z), the equal-area disk: |p| ≤ 1 where the viewer sees the surface
size    nodes along a side; node (i, j) stands at p = ((j − 2) h − 1, (i − 2) h − 1), h = 2 / (size − 5): two rows lie outside the disk,
        where n looks away from the viewer and radiance goes on smoothly
table   (size, size, 3) radiance at the nodes that some pixel needs, 0 at the others

Between nodes Catmull–Rom weights: exact for quadratics, error h³ and, near a lobe of standard deviation σ, small once h < σ/2.
Gradients in n pass through the weights, those in m and L through the nodes' sum. Pictures of a batch that are given one material and one
light (tensors expanded over the batch, or equal ones that need no gradient) share a map.
"""

import math

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from learn.engines import interpolation, machine_code, threads
from learn.methods import Batch, Card, directional, lobe_shapes, merged, per_group

CARD = Card(
    name="reflectance_map",
    approximates="radiance between normals by bicubic interpolation; all lights at the nodes",
    error=1e-2,
    cost="nodes × texels + 16 × pixels; nodes grow with the sharpest lobe",
    memory="size² × 12 bytes, size ≤ 512, and 4 copies of it in the backward pass",
    needs=frozenset({"orthographic"}),
    gradient=0.1,
)
SMALLEST, LARGEST = 12, 512
MARGIN = 2


def radiance(batch: Batch, tolerance):
    if batch.view is not None:
        raise ValueError('method: "reflectance_map" needs an orthographic camera (view omitted), found a view per pixel; try "auto"')
    batch = merged(batch)

    def one_group(g, n, view, m, light):
        size = size_for(lobe_shapes.sharpness(m).max(), tolerance)
        lights, E = directional.of_map(light, batch.camera_from_light)
        return with_nodes(n, size, lambda nodes: directional.near(nodes, None, m, E, lights, 0.1 * tolerance))

    return per_group(batch, one_group)


def with_size(batch, size):
    """Radiance by maps of one given size."""
    batch = merged(batch)

    def one_group(g, n, view, m, light):
        lights, E = directional.of_map(light, batch.camera_from_light)
        return with_nodes(n, size, lambda nodes: directional.radiance(nodes, None, m, E, lights))

    return per_group(batch, one_group)


def size_for(sharpness, tolerance):
    """Nodes along a side for lobes up to an exponent: h/σ = (tolerance / 0.1)^(1/3), found by `python -m learn calibrate`."""
    spacing = (tolerance / 0.1) ** (1 / 3) / math.sqrt(max(sharpness, 2.0))
    return int(np.clip(math.ceil(2 * math.sqrt(2) / spacing) + 5, SMALLEST, LARGEST))


def with_nodes(n, size, at_nodes):
    """Radiance (P, 3) looked up in a map whose nodes have radiance at_nodes(normals (N, 3)) → (N, 3); differentiable through both."""
    place = places(n, size)
    needed = needed_nodes(place.detach(), size)
    table = n.new_zeros(size * size, 3).index_copy(0, needed, at_nodes(normals(needed, size).to(n)))
    return look_up(place, table.reshape(size, size, 3))


def places(n, size):
    """Row and column (P, 2) of each normal, in nodes."""
    p = n[:, :2] * torch.rsqrt(1.0 + n[:, 2:])
    return ((p + 1.0) * (0.5 * (size - 1 - 2 * MARGIN)) + MARGIN).flip(-1)


def needed_nodes(place, size):
    """Flat indices (N,) of the nodes that have a weight for some pixel, in the order of the map."""
    corner = place.floor().long().clamp(1, size - 3)
    touched = torch.zeros(size, size, dtype=torch.bool, device=place.device)
    touched.view(-1)[corner[:, 0] * size + corner[:, 1]] = True
    grown = touched.clone()
    for i in (-1, 0, 1, 2):
        for j in (-1, 0, 1, 2):
            grown |= touched.roll((i, j), (0, 1))
    return grown.view(-1).nonzero().squeeze(-1)


def normals(nodes, size):
    """Unit normals (N, 3) of flat node indices, float64; outside the disk |p| < √2 they look away from the viewer."""
    place = torch.stack([nodes % size, torch.div(nodes, size, rounding_mode="floor")], -1).double()
    p = (place - MARGIN) * (2.0 / (size - 1 - 2 * MARGIN)) - 1.0
    z = 1.0 - (p * p).sum(-1, keepdim=True)
    return torch.cat([p * (1.0 + z).clamp(min=0).sqrt(), z], -1)


def look_up(place, table):
    """(P, 3) values of table (size, size, 3) at places (P, 2)."""
    if place.dtype == torch.float32 and place.device.type == "cpu" and machine_code.is_available():
        return LookUp.apply(place, table)
    size = table.shape[0]
    corner = place.detach().floor().clamp(1, size - 3)
    t = (place - corner)[..., None]
    weights = 0.5 * torch.cat([((2 - t) * t - 1) * t, (3 * t - 5) * t * t + 2, ((4 - 3 * t) * t + 1) * t, (t - 1) * t * t], -1)
    step = torch.arange(-1, 3, device=place.device)
    corner = corner.long()
    index = (corner[:, :1] + step)[:, :, None] * size + (corner[:, 1:] + step)[:, None]
    return torch.einsum("pi,pj,pijk->pk", weights[:, 0], weights[:, 1], table.reshape(-1, 3)[index])


class LookUp(torch.autograd.Function):
    """place (P, 2), table (size, size, 3) → (P, 3) by learn.engines.interpolation."""

    @staticmethod
    def forward(ctx, place, table):
        place, table = place.contiguous(), table.contiguous()
        ctx.save_for_backward(place, table)
        out = np.empty((len(place), 3), np.float32)
        arrays = place.numpy(), table.numpy(), out

        def kernel(first, last):
            machine_code.call("interpolation.forward", first, last, table.shape[0], *arrays)

        workers = torch.get_num_threads()
        threads.run(kernel, threads.split(len(place), workers), workers)
        return torch.from_numpy(out)

    @staticmethod
    @once_differentiable
    def backward(ctx, g):
        place, table = ctx.saved_tensors
        by_place = np.empty((len(place), 2), np.float32)
        by_table = np.empty((interpolation.CHUNKS, *table.shape), np.float32)
        arrays = place.numpy(), table.numpy(), g.contiguous().numpy(), by_place, by_table

        def kernel(first, last):
            machine_code.call("interpolation.backward", first, last, len(place), table.shape[0], *arrays)

        workers = torch.get_num_threads()
        threads.run(kernel, threads.split(interpolation.CHUNKS, interpolation.CHUNKS), workers)
        return torch.from_numpy(by_place), torch.from_numpy(by_table.sum(0))
