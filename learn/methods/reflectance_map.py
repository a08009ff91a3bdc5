"""Radiance at the nodes of a map over normals, interpolated for each pixel of a distant viewer.

Under a distant viewer radiance depends on the normal alone.

n       unit normal, camera frame; p = (n_x, n_y) / √(1 + n_z), the equal-area disk: |p| ≤ 1 where
        the viewer sees the surface
size    nodes along a side; node (i, j) stands at p = ((j − 2) h − 1, (i − 2) h − 1), h = 2 / (size
        − 5): two rows lie outside the disk, where n looks away from the viewer and radiance goes on
        smoothly
values  (N, 3) radiance at the nodes that some pixel needs, with flat indices nodes (N,); others
        are never read

Interpolation between nodes is by Catmull–Rom weights: exact for quadratics, error h³ and, near a
lobe of standard deviation σ, small once h < σ/2. Gradients in n pass through the weights, those in
m and L through the nodes' sum. Pictures that share one material and one light, each one tensor
expanded over the batch, share a map.
"""

import math
from collections.abc import Callable

import numpy as np
import torch

from learn.engines import machine_code, threads
from learn.engines.derivatives import Context, Step, last
from learn.engines.layout import MAP_CHUNKS
from learn.methods import (
    Batch,
    Card,
    directional,
    light_tables,
    lobe_shapes,
    merge_groups,
    radiance_by_numbered_group,
    refusal,
    wants_gradient,
)

CARD = Card(
    name="reflectance_map",
    approximates=(
        "radiance between normals by bicubic interpolation; all lights at the nodes. Small sums are"
        " made whole"
    ),
    error=1e-2,
    cost="nodes × texels + 16 × pixels; nodes grow with the sharpest lobe",
    memory="size² × 16 bytes, size ≤ 512, and 4 copies of it in the backward pass",
    needs=frozenset({"orthographic"}),
    gradient=0.1,
)
SMALLEST, LARGEST = 12, 512
BACKMOST = -0.9999  # least z of a node's normal
MARGIN = 2
TOUCH, READ, READ_BACKWARD = 7e-9, 2.3e-8, 6e-8  # seconds of a kernel for each pixel


def radiance(batch: Batch, tolerance: float) -> torch.Tensor:
    """Return outgoing radiance (P, 3) of a batch."""
    if batch.view is not None:
        raise ValueError(
            'method: "reflectance_map" needs an orthographic camera (view omitted), found a view'
            ' per pixel; try "auto"'
        )
    batch = merge_groups(batch)

    def one_group(
        g: int, n: torch.Tensor, view: torch.Tensor | None, m: torch.Tensor, light: torch.Tensor
    ) -> torch.Tensor:
        size = size_for(lobe_shapes.sharpness(m).max(), tolerance)
        lights, E = light_tables.lights_and_energy(light, batch.camera_from_light)
        if directional.is_small(len(n), len(lights.w), wants_gradient(n, m, light)):
            return directional.radiance(n, None, m, E, lights, method=CARD.name)
        return radiance_by_nodes(
            n,
            size,
            lambda nodes: directional.approximate_radiance(
                nodes, None, m, E, lights, 0.1 * tolerance, CARD.name
            ),
        )

    return radiance_by_numbered_group(batch, one_group)


def radiance_by_size(batch: Batch, size: int) -> torch.Tensor:
    """Return radiance by maps of one given size."""
    batch = merge_groups(batch)

    def one_group(
        g: int, n: torch.Tensor, view: torch.Tensor | None, m: torch.Tensor, light: torch.Tensor
    ) -> torch.Tensor:
        lights, E = light_tables.lights_and_energy(light, batch.camera_from_light)
        return radiance_by_nodes(
            n, size, lambda nodes: directional.radiance(nodes, None, m, E, lights)
        )

    return radiance_by_numbered_group(batch, one_group)


def size_for(sharpness: float, tolerance: float) -> int:
    """Return the nodes along a side for lobes up to a sharpness: h/σ = (tolerance / 0.1)^(1/3).

    The rule is from `python -m learn.experiments calibrate-auto`.
    """
    spacing = (tolerance / 0.1) ** (1 / 3) / math.sqrt(max(sharpness, 2.0))
    return int(np.clip(math.ceil(2 * math.sqrt(2) / spacing) + 5, SMALLEST, LARGEST))


def radiance_by_nodes(
    n: torch.Tensor, size: int, at_nodes: Callable[[torch.Tensor], torch.Tensor]
) -> torch.Tensor:
    """Return radiance read from a map, differentiable in n and in the nodes' radiance.

    at_nodes  normals (N, 3) of the nodes → radiance (N, 3)
    """
    needed = needed_nodes(n.detach(), size)
    return look_up(
        n, at_nodes(torch.from_numpy(normals(needed.cpu().numpy(), size)).to(n)), needed, size
    )


def has_kernel(n: torch.Tensor) -> bool:
    """Return whether the kernels serve a tensor: float32 on the CPU, with numba installed."""
    return n.dtype == torch.float32 and n.device.type == "cpu" and machine_code.is_available()


def places(n: torch.Tensor, size: int) -> torch.Tensor:
    """Return the row and column (P, 2) of each normal, in nodes."""
    p = n[:, :2] * torch.rsqrt(1.0 + n[:, 2:])
    return ((p + 1.0) * (0.5 * (size - 1 - 2 * MARGIN)) + MARGIN).flip(-1)


def needed_nodes(n: torch.Tensor, size: int) -> torch.Tensor:
    """Flat indices (N,) of the nodes that have a weight for some pixel, in the order of the map."""
    if has_kernel(n):
        return torch.from_numpy(nodes_for(np.ascontiguousarray(n.numpy()), size))
    corner = places(n, size).floor().long().clamp(1, size - 3)
    touched = np.zeros((size, size), bool)
    touched[tuple(corner.T.cpu().numpy())] = True
    return torch.from_numpy(nodes_with_weight(touched)).to(n.device)


def nodes_for(n: np.ndarray, size: int) -> np.ndarray:
    """As `needed_nodes`, by learn.engines.interpolation, in numpy."""
    touched = np.zeros((size, size), np.float32)
    run_in_slices(
        len(n),
        TOUCH,
        lambda first, last: machine_code.call("interpolation.touch", first, last, size, n, touched),
    )
    return nodes_with_weight(touched > 0)


def nodes_with_weight(touched: np.ndarray) -> np.ndarray:
    """Return flat indices (N,) of the nodes that have a weight for some pixel.

    touched  (size, size): marks the node before each pixel's place
    """
    for _ in range(2):  # along columns, then along rows: one before that node, two after
        near = touched.copy()
        near[:-1] |= touched[1:]
        near[1:] |= touched[:-1]
        near[2:] |= touched[:-2]
        touched = near.T
    return np.flatnonzero(touched)


def normals(nodes: np.ndarray, size: int) -> np.ndarray:
    """Return unit normals (N, 3) of flat node indices, float64 numpy.

    Outside the disk |p| ≤ 1 they look away from the viewer, beyond |p| = √2 not quite straight:
    straight away every p is the same, and a map could not be read there.
    """
    line = (np.arange(size) - MARGIN) * (2.0 / (size - 1 - 2 * MARGIN)) - 1.0
    row, column = np.divmod(nodes, size)
    x, y, result = line[column], line[row], np.empty((len(nodes), 3))
    z = np.maximum(1.0 - (x * x + y * y), BACKMOST)
    stretch = np.sqrt(1.0 + z)
    result[:, 0], result[:, 1], result[:, 2] = x * stretch, y * stretch, z
    return result


def look_up(n: torch.Tensor, values: torch.Tensor, nodes: torch.Tensor, size: int) -> torch.Tensor:
    """Values (P, 3) at normals n (P, 3) in a map with values (N, 3) at flat indices nodes (N,).

    nodes  all that n needs
    """
    if has_kernel(n):
        return LookUp.apply(n, values, nodes, size)
    place = places(n, size)
    table = n.new_zeros(size * size, 3).index_copy(0, nodes, values)
    corner = place.detach().floor().clamp(1, size - 3)
    t = (place - corner)[..., None]
    weights = 0.5 * torch.cat(
        [
            ((2 - t) * t - 1) * t,
            (3 * t - 5) * t * t + 2,
            ((4 - 3 * t) * t + 1) * t,
            (t - 1) * t * t,
        ],
        -1,
    )
    step = torch.arange(-1, 3, device=place.device)
    corner = corner.long()
    index = (corner[:, :1] + step)[:, :, None] * size + (corner[:, 1:] + step)[:, None]
    return torch.einsum("pi,pj,pijk->pk", weights[:, 0], weights[:, 1], table[index])


def run_in_slices(pixels: int, seconds: float, kernel: Callable[[int, int], None]) -> None:
    """Run kernel(first, last) over all pixels, on as many threads as torch may use.

    seconds  per pixel
    """
    workers = threads.worth(torch.get_num_threads(), pixels * seconds)
    threads.run(kernel, threads.split(pixels, workers), workers)


def kernel_table(values: np.ndarray, nodes: np.ndarray, size: int) -> np.ndarray:
    """Return the kernels' table (size², 4) float32, from values (N, 3) at nodes (N,)."""
    result = np.zeros((size * size, 4), np.float32)
    result[nodes, :3] = values
    return result


def read_values(n: np.ndarray, table: np.ndarray, size: int) -> np.ndarray:
    """Return values (P, 3) at normals n (P, 3), numpy, by learn.engines.interpolation."""
    out = np.empty((len(n), 3), np.float32)
    run_in_slices(
        len(n),
        READ,
        lambda first, last: machine_code.call(
            "interpolation.forward", first, last, size, n, table, out
        ),
    )
    return out


def read_backward(
    n: np.ndarray, table: np.ndarray, size: int, g: np.ndarray, nodes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return derivatives of Σ g·out: by n (P, 3), and by the values at nodes (N, 3)."""
    by_n = np.empty((len(n), 3), np.float32)
    by_table = np.zeros((MAP_CHUNKS, *table.shape), np.float32)

    def kernel(first, last):
        machine_code.call(
            "interpolation.backward", first, last, len(n), size, n, table, g, by_n, by_table
        )

    workers = threads.worth(torch.get_num_threads(), len(n) * READ_BACKWARD)
    threads.run(kernel, threads.split(MAP_CHUNKS, workers), workers)
    for chunk in by_table[1:]:
        by_table[0] += chunk
    return by_n, np.ascontiguousarray(by_table[0].take(nodes, 0)[:, :3])


class LookUp(Step):
    """`look_up` by learn.engines.interpolation."""

    @staticmethod
    def forward(
        ctx: Context, n: torch.Tensor, values: torch.Tensor, nodes: torch.Tensor, size: int
    ) -> torch.Tensor:
        ctx.refusal = refusal(CARD.name)
        ctx.save_for_backward(n, values)
        normals, places = n.contiguous().numpy(), nodes.numpy()
        nodes_table = kernel_table(values.numpy(), places, size)
        ctx.for_backward = normals, nodes_table, size, places
        return torch.from_numpy(read_values(normals, nodes_table, size))

    @staticmethod
    @last
    def backward(ctx: Context, g: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        n, values, size, nodes = ctx.for_backward
        by_n, by_values = read_backward(n, values, size, np.ascontiguousarray(g.numpy()), nodes)
        return torch.from_numpy(by_n), torch.from_numpy(by_values), None, None
