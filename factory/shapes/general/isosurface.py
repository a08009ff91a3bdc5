"""Triangles from a signed distance: naive surface nets, then every vertex moved onto the surface.

A *field* is a function of points (…, 3) that returns (…): negative inside, positive outside, and
about the distance to the surface. All arithmetic is float64 and the grid meets no plane of
symmetry, so that the same seed gives the same triangles, and thus the same hash, on every machine.

Source: Gibson, "Constrained elastic surface nets" (1998), without the relaxation: Newton's steps
along the gradient take its place.
"""

from collections.abc import Callable

import numpy as np

from factory.shapes.closed_surface import Surface, signed_volume
from factory.shapes.mesh import face_components

Field = Callable[[np.ndarray], np.ndarray]

CELLS = 80  # along an axis
SCOUT_CELLS = 40  # of the coarse grid that finds where the surface is
BLOCK = 8  # cells along a block's edge; a block that the surface cannot cross is not evaluated
OFFSET = 0.3819660113  # of a cell, by which the grid is shifted off planes of symmetry
STEEPEST = 1.6  # times a distance that a field may be: blocks nearer than this are evaluated
NEWTON_STEPS = 3
DIFFERENCE = 1e-4  # of central differences


def surface_of(field: Field, half_extent: float = 1.25, cells: int = CELLS) -> Surface:
    """Return the closed surface where a field is zero, its largest piece only.

    half_extent  the surface lies inside the cube of this half edge about the origin
    cells        along an axis of the cube that just holds the surface; a multiple of BLOCK
    Raises ValueError where the field has no surface.
    """
    corner, size = _enclosing_grid(field, half_extent, cells)
    vertices, faces = _surface_net(_sample(field, corner, size, cells))
    if not len(faces):
        raise ValueError("the field has no surface")
    vertices, faces = _largest_piece(vertices * size + corner, faces)
    return Surface(_project(field, vertices, size), faces)


def _enclosing_grid(field: Field, half_extent: float, cells: int) -> tuple[np.ndarray, float]:
    """First node (3,) and step of the grid of a cube that holds what a coarse look shows."""
    step = 2 * half_extent / SCOUT_CELLS
    ticks = -half_extent + (np.arange(SCOUT_CELLS + 1) - OFFSET) * step
    points = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), -1)
    near = points[field(points) < 0.75 * step]
    if not len(near):
        raise ValueError("the field has no surface")
    low, high = near.min(0) - step, near.max(0) + step
    size = float((high - low).max()) / cells
    return (low + high) / 2 - (cells / 2 + OFFSET) * size, size


def _sample(field: Field, corner: np.ndarray, size: float, cells: int) -> np.ndarray:
    """The field at the grid's nodes (cells + 1,)*3, positive on the border.

    Blocks far from the surface hold the value of their centre, which has the right sign.
    """
    blocks = cells // BLOCK
    centre = (np.arange(blocks) + 0.5) * BLOCK * size
    coarse = field(corner + np.stack(np.meshgrid(centre, centre, centre, indexing="ij"), -1))
    values = np.empty((cells + 1,) * 3)
    values[:-1, :-1, :-1] = coarse.repeat(BLOCK, 0).repeat(BLOCK, 1).repeat(BLOCK, 2)
    near = np.abs(coarse) < STEEPEST * np.sqrt(3) / 2 * (BLOCK + 1) * size
    local = np.arange(BLOCK + 1)
    local = np.stack(np.meshgrid(local, local, local, indexing="ij"), -1).reshape(-1, 3)
    nodes = (np.argwhere(near)[:, None] * BLOCK + local).reshape(-1, 3)
    values[tuple(nodes.T)] = field(corner + nodes * size)
    for axis in range(3):
        for end in (0, -1):
            border = np.moveaxis(values, axis, 0)[end]
            np.maximum(border, 0.5 * size, out=border)
    return values


def _surface_net(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One vertex for each cell that the surface crosses, and two faces for each crossed edge."""
    inside = values < 0
    count = np.zeros(tuple(n - 1 for n in values.shape), np.int8)
    corners = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    for i, j, k in corners:
        count += _shifted(inside, i, j, k)
    cell = np.argwhere((count > 0) & (count < 8))
    index = np.full(count.shape, -1)
    index[tuple(cell.T)] = np.arange(len(cell))

    total, crossings = np.zeros((len(cell), 3)), np.zeros(len(cell))
    at = {c: values[tuple((cell + c).T)] for c in corners}
    for axis in range(3):
        for start in corners:
            if start[axis]:
                continue
            finish = [c + (n == axis) for n, c in enumerate(start)]
            a, b = at[start], at[finish[0], finish[1], finish[2]]
            crossed = (a < 0) != (b < 0)
            share = np.where(crossed, a / np.where(crossed, a - b, 1.0), 0.0)
            point = np.broadcast_to(np.array(start, float), total.shape).copy()
            point[:, axis] = share
            total += point * crossed[:, None]
            crossings += crossed
    vertices = cell + total / crossings[:, None]

    faces = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        first = np.moveaxis(inside, axis, 0)
        change = np.moveaxis(first[:-1] != first[1:], 0, axis)
        edge = np.argwhere(change)
        edge = edge[(edge[:, u] > 0) & (edge[:, v] > 0)]
        along = np.eye(3, dtype=int)
        cells = [
            index[tuple((edge - a * along[u] - b * along[v]).T)]
            for a, b in ((1, 1), (0, 1), (0, 0), (1, 0))
        ]
        outward = inside[tuple(edge.T)]
        quad = np.stack(cells, 1)
        quad = np.where(outward[:, None], quad, quad[:, ::-1])
        faces += [quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]
    return vertices, np.concatenate(faces)


def _shifted(values: np.ndarray, i: int, j: int, k: int) -> np.ndarray:
    """The values at corner (i, j, k) of every cell."""
    a, b, c = values.shape
    return values[i : a - 1 + i, j : b - 1 + j, k : c - 1 + k]


def _largest_piece(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The connected piece of most volume; cavities and splinters are left out."""
    piece = face_components(faces)
    volumes = [signed_volume(vertices, faces[piece == k]) for k in range(piece.max() + 1)]
    used, kept = np.unique(faces[piece == int(np.argmax(volumes))], return_inverse=True)
    return vertices[used], kept.reshape(-1, 3)


def _project(field: Field, vertices: np.ndarray, size: float) -> np.ndarray:
    """The vertices moved onto the surface by Newton's steps, each of at most half a cell."""
    for _ in range(NEWTON_STEPS):
        slope = gradient(field, vertices)
        square = np.maximum((slope**2).sum(1), 1e-4)
        step = -field(vertices)[:, None] * slope / square[:, None]
        length = np.linalg.norm(step, axis=1, keepdims=True)
        vertices = vertices + step * np.minimum(1.0, 0.5 * size / np.maximum(length, 1e-12))
    return vertices


def gradient(field: Field, points: np.ndarray) -> np.ndarray:
    """The field's gradient at points (N, 3), by central differences."""
    return np.stack(
        [
            (field(points + DIFFERENCE * axis) - field(points - DIFFERENCE * axis))
            / (2 * DIFFERENCE)
            for axis in np.eye(3)
        ],
        1,
    )
