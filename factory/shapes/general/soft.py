"""What gives way: cushions, folded and hanging cloth."""

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.closed_surface import close_surface, grid_faces
from factory.shapes.curves import smooth_path
from factory.shapes.general import fields
from factory.shapes.general.draws import Generator, rotation, waves
from factory.shapes.general.isosurface import surface_of
from factory.shapes.lofts import tube


def cushion(a: Assembly, rng: Generator) -> None:
    """A pillow, bolster or bean bag: puffed between its seams, with wrinkles, perhaps piped or
    buttoned.
    """
    wide, tall = 1.0, rng.uniform(0.55, 1.0)
    puff = rng.uniform(0.18, 0.5)
    corner, edge = rng.uniform(2.5, 8.0), rng.uniform(0.35, 0.7)
    ears = rng.uniform(0.0, 0.12)
    wrinkle = waves(rng, rng.uniform(0.01, 0.04), 5, 14)
    button = rng.random() < 0.25
    dent = rng.uniform(0.1, 0.25)

    def height(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        inside = np.clip(1 - np.abs(u) ** corner, 0, 1) * np.clip(1 - np.abs(v) ** corner, 0, 1)
        drop = dent * np.exp(-(u**2 + v**2) / 0.03) if button else 0.0
        return puff * inside**edge * (1 - drop / puff)

    count = 72
    t = np.linspace(-1, 1, count)
    t = np.sign(t) * (1 - (1 - np.abs(t)) ** 1.5)  # closer together at the seams
    u, v = np.meshgrid(t, t, indexing="ij")
    swell = 1 + ears * (np.abs(u * v) ** 2)
    narrow = 1 - 0.12 * (1 - u**2) * np.abs(v) ** 4, 1 - 0.12 * (1 - v**2) * np.abs(u) ** 4
    flat = np.stack([wide * u * swell * narrow[1], tall * v * swell * narrow[0]], -1)
    layers = []
    for side in (1, -1):
        z = height(u, v)
        points = np.concatenate([flat, side * z[..., None]], -1)
        share = np.clip(z / puff, 0, 1)
        points[..., 2] += side * wrinkle(points) * share * (1 - 0.7 * share)
        layers.append(points)
    body = _joined_at_the_rim(*layers)
    turn = rotation(rng) if rng.random() < 0.3 else np.eye(3)
    standing = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]) if rng.random() < 0.5 else np.eye(3)
    turn = turn @ standing
    a.add("cushion", body._replace(vertices=body.vertices @ turn.T), 1)
    if rng.random() < 0.35:
        rim = np.concatenate([flat[:-1, 0], flat[-1, :-1], flat[:0:-1, -1], flat[0, :0:-1]])
        line = np.column_stack([rim, np.zeros(len(rim))]) @ turn.T
        a.add("piping", tube(line, 0.025, around=10, ring=True), 2)


def cloth(a: Assembly, rng: Generator) -> None:
    """A sheet with thickness: hanging in folds, draped over a ball or a box, or crumpled."""
    kind = rng.choice(["hanging", "draped", "crumpled"])
    thickness = rng.uniform(0.05, 0.09)
    if kind == "draped":
        return _draped(a, rng, thickness)
    count = 72
    u, v = np.meshgrid(np.linspace(-1, 1, count), np.linspace(-1, 1, count), indexing="ij")
    plane = np.stack([u, v, 0 * u], -1)
    if kind == "hanging":
        folds, depth = rng.uniform(2, 7), rng.uniform(0.06, 0.25)
        spread = 1 + rng.uniform(-0.3, 0.3) * v
        lean = waves(rng, 0.6, 0.7, 2.5)
        height = depth * np.sin(folds * np.pi / 2 * u * spread + lean(plane)) * (1.2 - 0.5 * v)
        points = np.stack([height, u, v * rng.uniform(0.5, 1.3)], -1)
        turn = np.eye(3)
    else:
        height = waves(rng, rng.uniform(0.15, 0.4), 1.5, rng.uniform(3, 7), 10)(plane)
        points = np.stack([u, v, height], -1)
        turn = rotation(rng) if rng.random() < 0.5 else np.eye(3)
    surface = _sheet(points @ turn.T, thickness)
    a.add("cloth", surface, 1)


def _sheet(points, thickness):
    """A closed surface about a grid of points (R, C, 3), its rim round."""
    rows, columns, _ = points.shape
    normal = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    inward = np.minimum(np.minimum(i, rows - 1 - i), np.minimum(j, columns - 1 - j))
    half = thickness / 2 * np.sqrt(1 - np.clip(1 - inward / 2, 0, 1) ** 2)
    return _joined_at_the_rim(*(points + s * half[..., None] * normal for s in (1, -1)))


def _joined_at_the_rim(front, back):
    """A closed surface from two grids of points (R, C, 3) that share their border points."""
    rows, columns, _ = front.shape
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    border = ((i == 0) | (i == rows - 1) | (j == 0) | (j == columns - 1)).ravel()
    faces = grid_faces(rows, columns)
    faces = faces[~border[faces].all(1)]  # a corner's triangle would stand in both grids
    vertices = np.concatenate([front.reshape(-1, 3), back.reshape(-1, 3)])
    return close_surface(vertices, np.concatenate([faces, faces[:, ::-1] + rows * columns]))


def _draped(a, rng, thickness):
    """A round cloth over a ball, a box or a post: it falls in folds below the edge."""
    solid = rng.choice(["ball", "box", "post"])
    folds = int(rng.integers(4, 11))
    depth = rng.uniform(0.04, 0.14)
    radius, fall = rng.uniform(0.35, 0.6), rng.uniform(0.5, 1.2)
    rings, around = 64, 144
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    length = np.linspace(0.002, radius + fall, rings)[:, None]
    square = {"ball": 2.0, "box": 5.0, "post": 2.0}[solid]
    c, s = np.abs(np.cos(angle)), np.abs(np.sin(angle))
    edge = radius * (c**square + s**square) ** (-1 / square)
    bend = 0.9 * radius if solid == "ball" else 0.15
    over = np.clip(length - (edge - bend), 0, None)
    turn = np.minimum(over / bend, np.pi / 2)
    out = np.minimum(length, edge - bend) + bend * np.sin(turn)
    down = bend * (1 - np.cos(turn)) + np.clip(over - bend * np.pi / 2, 0, None)
    share = np.clip(down / fall, 0, 1)
    phase = folds * angle + 0.6 * np.sin(2 * angle + rng.uniform(0, 6))
    out = out + share * (depth * np.cos(phase) + rng.uniform(0.05, 0.25))
    points = np.stack([out * np.cos(angle), out * np.sin(angle), -down + 0 * angle], -1)
    wall = np.gradient(points, axis=0)
    across = (np.roll(points, -1, 1) - np.roll(points, 1, 1)) / 2
    normal = np.cross(wall, across)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    half = thickness / 2 * np.minimum(1, (np.arange(rings)[::-1, None, None] / 3) ** 0.5)
    layers = [points + half * normal, points - half * normal]
    size = rings * around
    faces = grid_faces(rings, around, wrap_columns=True)
    vertices = np.concatenate([layer.reshape(-1, 3) for layer in layers])
    caps = []
    for number in (0, 1):
        centre = len(vertices) + number
        ring = np.arange(around) + number * size
        triangle = np.stack([np.full(around, centre), ring, np.roll(ring, -1)], 1)
        caps.append(triangle if number == 0 else triangle[:, ::-1])
    tops = np.stack([layer[0].mean(0) for layer in layers])
    vertices = np.concatenate([vertices, tops])
    a.add(
        "cloth", close_surface(vertices, np.concatenate([faces, faces[:, ::-1] + size, *caps])), 1
    )
    if solid == "post" and rng.random() < 0.5:
        knob = fields.moved(fields.ellipsoid([0.12] * 3), (0, 0, 0))
        a.add("knob", surface_of(knob, 0.3, 32).moved(z=0.1), 2)


def bag(a: Assembly, rng: Generator) -> None:
    """A sack tied at its neck, a parcel, or a hat: soft forms that stand."""
    kind = rng.choice(["sack", "hat"])
    wrinkle = waves(rng, rng.uniform(0.01, 0.025), 3, 10, 10)
    if kind == "sack":
        neck = rng.uniform(0.1, 0.2)
        parts = [
            fields.superquadric((0.75, rng.uniform(0.5, 0.75), 0.6), rng.uniform(2, 3.5)),
            fields.moved(fields.cone(0.3, neck, 0.3, 0.04), (0, 0, 0.7)),
            fields.moved(fields.cone(neck, neck * 2.2, 0.14, 0.03), (0, 0, 1.08)),
        ]
        folds = int(rng.integers(6, 14))
        body = fields.union(parts, 0.2)

        def height(p: np.ndarray) -> np.ndarray:
            gather = np.clip((p[..., 2] - 0.2) / 0.6, 0, 1)
            gather = gather * np.clip(np.hypot(p[..., 0], p[..., 1]) / 0.3, 0, 1)
            return wrinkle(p) + 0.03 * gather * np.cos(folds * np.arctan2(p[..., 1], p[..., 0]))

        field = fields.scaled_values(fields.displaced(body, height), 0.75)
        rope = tube(_circle(neck + 0.05, 0.98), 0.045, around=12, ring=True)
        a.add("sack", surface_of(field, 1.5), 1)
        a.add("rope", rope, 2)
        return
    tall, brim = rng.uniform(0.4, 0.9), rng.uniform(0.9, 1.3)
    crown = fields.moved(fields.superquadric((0.55, 0.5, tall), 3.0), (0, 0, tall * 0.5))
    disc = fields.cylinder(brim, 0.09, 0.05)
    curl = rng.uniform(-0.12, 0.25)

    def curled(p: np.ndarray) -> np.ndarray:
        q = p.copy()
        q[..., 2] -= curl * p[..., 1] ** 2
        return disc(q)

    hollow = fields.moved(
        fields.superquadric((0.38, 0.33, tall - 0.1), 3.0), (0, 0, tall * 0.5 - 0.14)
    )
    field = fields.cut(fields.union([crown, curled], 0.08), [hollow], 0.03)
    field = fields.scaled_values(fields.displaced(field, wrinkle), 0.75)
    a.add("hat", surface_of(field, 1.5), 1)


def _circle(radius, z):
    t = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    points = np.stack([radius * np.cos(t), radius * np.sin(t), np.full(48, z)], 1)
    return smooth_path(np.vstack([points, points[:1]]), 64)[:-1]
