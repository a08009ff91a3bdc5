"""Primitives for tests and first looks: sphere, cube, torus, disc, blob.

Normals are analytic wherever a formula gives them. Each function returns a Mesh of category
"primitive", one segment.
"""

import numpy as np

from factory.shapes.mesh import Mesh, finish


def icosphere(level: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the unit icosphere, outward: vertices (10·4^level + 2, 3), faces (20·4^level, 3)."""
    golden = (1 + 5**0.5) / 2
    corners = [(a, b * golden) for a in (-1, 1) for b in (-1, 1)]
    vertices = np.array(
        [(0, a, b) for a, b in corners]
        + [(a, b, 0) for a, b in corners]
        + [(b, 0, a) for a, b in corners],
        float,
    )
    from scipy.spatial import ConvexHull

    hull = ConvexHull(vertices)
    faces = hull.simplices.copy()
    outward = (
        np.einsum(
            "fi,fi->f",
            np.cross(*(vertices[faces[:, k]] - vertices[faces[:, 0]] for k in (1, 2))),
            vertices[faces].mean(1),
        )
        > 0
    )
    faces[~outward] = faces[~outward][:, ::-1]
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    for _ in range(level):
        vertices, faces = _split(vertices, faces)
        vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    return vertices, faces


def _split(vertices, faces):
    """Return each triangle split into four at its edges' midpoints."""
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    unique, index = np.unique(edges, axis=0, return_inverse=True)
    middle = index.reshape(-1, 3) + len(vertices)
    a, b, c = faces.T
    ab, bc, ca = middle.T
    split = np.concatenate(
        [np.stack(t, 1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
    )
    return np.vstack([vertices, vertices[unique].mean(1)]), split


def sphere(level: int = 6) -> Mesh:
    """Return the unit sphere: 81,920 triangles at level 6, sagitta 4e-5.

    Each corner normal is the vertex itself.
    """
    vertices, faces = icosphere(level)
    return finish(f"sphere:{level}", "primitive", vertices, faces, normals=vertices[faces])


def disc(segments: int = 96) -> Mesh:
    """Return a flat disc in the y–z plane facing the front, +x: one known normal."""
    angle = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    vertices = np.vstack(
        [np.zeros(3), np.stack([np.zeros(segments), np.cos(angle), np.sin(angle)], axis=1)]
    )
    around = np.arange(segments)
    faces = np.stack([np.zeros(segments, int), around + 1, (around + 1) % segments + 1], axis=1)
    return finish("disc", "primitive", vertices, faces)


def torus(tube: float = 0.4, around: int = 128, across: int = 64) -> Mesh:
    """Return a torus about z with analytic normals; tube: its tube's radius over its ring's."""
    u, v = np.meshgrid(
        *(np.linspace(0, 2 * np.pi, n, endpoint=False) for n in (around, across)), indexing="ij"
    )
    normals = np.stack([np.cos(u) * np.cos(v), np.sin(u) * np.cos(v), np.sin(v)], axis=-1).reshape(
        -1, 3
    )
    ring = np.stack([np.cos(u), np.sin(u), 0 * u], axis=-1).reshape(-1, 3)
    i, j = (g.ravel() for g in np.meshgrid(np.arange(around), np.arange(across), indexing="ij"))

    def at(i, j):
        return (i % around) * across + j % across

    quads = np.stack([at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)], axis=1)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return finish("torus", "primitive", ring + tube * normals, faces, normals=normals[faces])


def cube(bevel: float = 0.12, steps: int = 6) -> Mesh:
    """Return a cube with rounded edges; bevel: their radius over the cube's side.

    Normals are analytic: flat sides, round edges.
    """
    directions, faces = _cube_sphere(steps)
    inner = 0.5 - bevel
    vertices = inner * np.sign(directions) + bevel * directions / np.linalg.norm(
        directions, axis=1, keepdims=True
    )
    normals = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return finish("cube", "primitive", vertices, faces, normals=normals[faces])


def _cube_sphere(steps):
    """Return a cube's surface as directions (V, 3) and faces (F, 3).

    Each side is a grid that is doubled at 0, where a rounded cube's corners separate.
    """
    half = np.tan(np.linspace(0, np.pi / 4, steps + 1))
    ticks = np.concatenate([-half[::-1], half])
    side = np.concatenate([-np.ones(steps + 1), np.ones(steps + 1)])
    count = len(ticks)
    i, j = (g.ravel() for g in np.meshgrid(np.arange(count), np.arange(count), indexing="ij"))
    tiny = 1e-9 * side  # gives each zero its side without moving a vertex visibly
    quads = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()[:, None] + [
        0,
        count,
        count + 1,
        1,
    ]
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    grids: list[np.ndarray] = []
    faces: list[np.ndarray] = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            grid = np.empty((count * count, 3))
            grid[:, axis], grid[:, (axis + 1) % 3], grid[:, (axis + 2) % 3] = (
                sign * (1 + 1e-9),
                (ticks + tiny)[i],
                (ticks + tiny)[j],
            )
            faces.append(
                (triangles if sign > 0 else triangles[:, ::-1]) + sum(len(g) for g in grids)
            )
            grids.append(grid)
    vertices = np.concatenate(grids)
    _, first, inverse = np.unique(
        np.round(vertices, 10), axis=0, return_index=True, return_inverse=True
    )
    return vertices[first], inverse.reshape(-1)[np.concatenate(faces)]


def blob(seed: int = 0, level: int = 6) -> Mesh:
    """Return a star-shaped sphere with harmonic bumps, whose normals span every direction.

    r(d) = 1 + Σ a_k sin(f_k·d + p_k): the gradient of |x| − r(x/|x|) is the normal.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0xB10B,)))
    directions, faces = icosphere(level)
    frequency = rng.normal(size=(8, 3)) * np.linspace(1.2, 3.5, 8)[:, None]
    amplitude = 0.16 / np.linspace(1, 3, 8) * rng.uniform(0.5, 1, 8)
    angle = directions @ frequency.T + rng.uniform(0, 2 * np.pi, 8)
    radius = 1 + np.sin(angle) @ amplitude
    slope = (np.cos(angle) * amplitude) @ frequency
    tangential = slope - (slope * directions).sum(1, keepdims=True) * directions
    normals = directions - tangential / radius[:, None]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return finish(
        f"blob:{seed}", "primitive", radius[:, None] * directions, faces, normals=normals[faces]
    )
