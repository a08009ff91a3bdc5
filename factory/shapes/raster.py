"""A small z-buffer in numpy: the faces of a mesh visible from one side.

It serves previews without Blender and counts back faces. The projection is orthographic, and the
unit sphere fills the frame; camera frame: x right, y up, z towards the viewer (shaders.frames).
"""

import numpy as np

from factory.shapes.mesh import Mesh
from factory.shapes.ragged import ranges
from shaders.frames import ELEVATION, camera_from_world

CHUNK = 4_000_000  # candidate pixels tested at a time: about 250 MB at most
HALF_EXTENT = 1.02
# pixels tested for back faces, a minute; a mesh of 2,000,000 small faces has a quarter
MOST_LOOKED_AT = 500_000_000
INSIDE = 1e-9  # a pixel on the edge between two faces is in one of them, whatever the rounding
EDGE_ON = 0.02  # a face seen at less than 1.1° shows neither side


def look(
    vertices: np.ndarray, faces: np.ndarray, camera: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return which face each pixel sees, and where in it.

    vertices  (V, 3);  faces (F, 3);  camera (3, 3) camera_from_world;  size  pixels along the
              square frame's side
    Returns   face (size, size) int, -1: none;  barycentric (size, size, 3)

    Time and memory follow the pixels that faces cover and the rows that they cross, not the boxes
    around them: a fan of thousands of slivers would fill the frame with boxes thousands of times.
    """
    corner_x, corner_y, depth = _corners(vertices, faces, camera, size)
    box = _boxes(corner_x, corner_y, size)
    left, right, top, bottom = box.T
    area = _area(corner_x, corner_y)
    wide, high = np.maximum(right - left + 1, 0), np.maximum(bottom - top + 1, 0)
    pixels = np.where(np.abs(area) > 1e-12, wide * high, 0)

    nearest = np.full(size * size, -np.inf)
    winner = np.full(size * size, -1)
    kept = np.zeros((size * size, 3))
    shown = np.flatnonzero(pixels)
    # Of two faces equally near, the later one of a block is seen, and that of the earlier block
    block = np.cumsum(pixels)[shown] // CHUNK
    cost = np.minimum(np.abs(area[shown]) / 2 + 4 * high[shown], pixels[shown])
    for part in _parts(block, cost):
        chosen = shown[part]
        face, column, row = _candidates(chosen, corner_x, corner_y, box)
        weight = _barycentric(corner_x[face], corner_y[face], area[face], column, row)
        inside = (weight >= -INSIDE).all(1)
        face, weight, place = face[inside], weight[inside], (row * size + column)[inside]
        z = (weight * depth[face]).sum(1)
        earlier = -block[part][np.searchsorted(chosen, face)]
        order = np.lexsort((earlier, z, place))  # the last of each pixel's run is the nearest
        last = np.flatnonzero(np.append(np.diff(place[order]) != 0, True)) if len(order) else order
        best = order[last]
        best = best[z[best] > nearest[place[best]]]
        nearest[place[best]], winner[place[best]], kept[place[best]] = (
            z[best],
            face[best],
            weight[best],
        )
    return winner.reshape(size, size), kept.reshape(size, size, 3)


def _corners(vertices, faces, camera, size):
    """Return columns, rows and depths (F, 3) of the corners; pixel centres are whole numbers."""
    seen = vertices @ camera.T
    x = (seen[:, 0] / HALF_EXTENT + 1) * size / 2 - 0.5
    y = (1 - seen[:, 1] / HALF_EXTENT) * size / 2 - 0.5
    return x[faces], y[faces], seen[:, 2][faces]


def _cost(vertices, faces, camera, size):
    """Return about how many pixels `look` tests."""
    x, y, _ = _corners(vertices, faces, camera, size)
    return float((np.abs(_area(x, y)) / 2 + 4 * (np.ptp(y, axis=1) + 1)).sum())


def _boxes(x, y, size):
    """Return columns and rows (F, 4), first and last, that may hold pixels of faces."""
    spans = []
    for corner in (x, y):
        spans += [np.ceil(corner.min(1)).clip(0, size), np.floor(corner.max(1)).clip(-1, size - 1)]
    return np.stack(spans, axis=1).astype(int)


def _parts(block, cost):
    """Return slices of faces, of whole blocks and about CHUNK / 4 pixels, at least a block."""
    if not len(block):
        return []
    first = np.flatnonzero(np.diff(block, prepend=-1))
    part = np.cumsum(np.add.reduceat(cost, first)) // (CHUNK // 4)
    starts = first[np.flatnonzero(np.diff(part, prepend=-1))]
    return [slice(*ends) for ends in zip(starts, [*starts[1:], len(block)], strict=True)]


def _candidates(chosen, x, y, box):
    """Return faces, columns and rows (K,) of the pixels that may lie in the chosen faces.

    They are in order of rows, and few others are among them.
    """
    left, right, top, bottom = box[chosen].T
    high = bottom - top + 1
    row = ranges(top, high)
    first, last = np.repeat(left, high).astype(float), np.repeat(right, high).astype(float)
    x, y = x[chosen], y[chosen]
    area = _area(x, y)
    for k in range(3):
        run, rise = x[:, k - 2] - x[:, k], y[:, k - 2] - y[:, k]
        steep = np.abs(rise) > 1e-4  # a flatter side limits no row more than the box does
        slope = np.divide(run, rise, out=np.zeros_like(run), where=steep)
        slack = 1e-3 + np.divide(
            INSIDE * np.abs(area), np.abs(rise), out=np.zeros_like(run), where=steep
        )
        # the face lies to the right of this side, or to its left
        ahead = np.where(steep, -np.sign(area) * np.sign(rise), 0)
        at = (
            np.repeat(x[:, k] - slope * y[:, k] - ahead * slack, high)
            + np.repeat(slope, high) * row
        )
        ahead = np.repeat(ahead, high)
        np.maximum(first, np.ceil(at), out=first, where=ahead > 0)
        np.minimum(last, np.floor(at), out=last, where=ahead < 0)
    wide = np.maximum(last - first + 1, 0).astype(int)
    column = ranges(first.astype(int), wide)
    return np.repeat(np.repeat(chosen, high), wide), column, np.repeat(row, wide)


def _area(x, y):
    """Return the doubled area (F,) of faces with corners x, y (F, 3)."""
    return _cross(x[:, 1] - x[:, 0], y[:, 1] - y[:, 0], x[:, 2] - x[:, 0], y[:, 2] - y[:, 0])


def _cross(ax, ay, bx, by):
    return ax * by - ay * bx


def _barycentric(x, y, area, column, row):
    """Return weights (K, 3) of the pixel (column, row) in triangles with corners x, y (K, 3)."""
    dx, dy = x - column[:, None], y - row[:, None]
    weight = np.stack(
        [_cross(dx[:, k], dy[:, k], dx[:, m], dy[:, m]) for k, m in ((1, 2), (2, 0), (0, 1))],
        axis=1,
    )
    return weight / area[:, None]


def silhouette(mesh: Mesh, azimuth: float, elevation: float, size: int = 64) -> np.ndarray:
    """Return the mask (size, size) of the pixels that see the mesh."""
    return look(mesh.vertices, mesh.faces, camera_from_world(azimuth, elevation), size)[0] >= 0


COLOURS = np.array(
    [
        [0.62, 0.64, 0.67],
        [0.30, 0.42, 0.62],
        [0.66, 0.45, 0.28],
        [0.36, 0.55, 0.38],
        [0.6, 0.33, 0.4],
        [0.5, 0.5, 0.25],
    ]
)


def picture(
    mesh: Mesh, azimuth: float, elevation: float = ELEVATION, size: int = 160, oversample: int = 2
) -> np.ndarray:
    """Return a shaded picture (size, size, 3) in [0, 1], display values.

    A headlight shines from the upper left, and segments have different colours.
    """
    camera = camera_from_world(azimuth, elevation)
    face, weight = look(mesh.vertices, mesh.faces, camera, size * oversample)
    hit = face >= 0
    normal = np.einsum("pc,pci->pi", weight[hit], mesh.corner_normals[face[hit]]) @ camera.T
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    normal *= np.where(normal[:, 2:] < 0, -1.0, 1.0)
    key, fill = np.array([-0.45, 0.65, 0.61]), np.array([0.7, 0.1, 0.7])
    half = key + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half)
    light = 0.18 + 0.75 * np.clip(normal @ key, 0, None) + 0.22 * np.clip(normal @ fill, 0, None)
    shine = 0.25 * np.clip(normal @ half, 0, None) ** 40
    image = np.ones((*face.shape, 3))
    image[hit] = np.clip(
        COLOURS[(mesh.segment[face[hit]] - 1) % len(COLOURS)] * light[:, None] + shine[:, None],
        0,
        1,
    )
    return image.reshape(size, oversample, size, oversample, 3).mean((1, 3))


def back_faces(vertices: np.ndarray, faces: np.ndarray, size: int = 96) -> np.ndarray:
    """Return how many pixels see each face's outer and inner side (F, 2).

    They are counted from 14 sides: the cube's sides and corners. The frame is coarser where faces
    would fill it thousands of times (MOST_LOOKED_AT).
    """
    counts = np.zeros((len(faces), 2), int)
    views = [(k * np.pi / 2, 0.0) for k in range(4)] + [(0.0, np.pi / 2), (0.0, -np.pi / 2)]
    views += [
        ((k + 0.5) * np.pi / 2, sign * np.arctan(0.5**0.5)) for k in range(4) for sign in (1, -1)
    ]
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    cameras = [camera_from_world(azimuth, elevation) for azimuth, elevation in views]
    while (
        size > 8
        and sum(_cost(vertices, faces, camera, size) for camera in cameras) > MOST_LOOKED_AT
    ):
        size //= 2
    for camera in cameras:
        face = look(vertices, faces, camera, size)[0]
        face = face[face >= 0]
        facing = normal[face] @ camera[2]
        np.add.at(counts, (face, (facing < 0).astype(int)), np.abs(facing) > EDGE_ON)
    return counts
