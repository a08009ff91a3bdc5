"""A small z-buffer in numpy: what is seen of a mesh from one side, for previews without Blender and for counting back faces.

Orthographic, the unit sphere fills the frame; camera frame: x right, y up, z towards the viewer (shaders.frames).
"""

import numpy as np

from shaders.frames import ELEVATION, camera_from_world

CHUNK = 4_000_000  # candidate pixels tested at a time: about 250 MB at most
HALF_EXTENT = 1.02
EDGE_ON = 0.02  # a face seen at less than 1.1° shows neither side


def look(vertices, faces, camera, size):
    """Which face each pixel sees, and where in it.

    vertices  (V, 3);  faces (F, 3);  camera (3, 3) camera_from_world;  size  pixels along the square frame's side
    Returns   face (size, size) int, -1: none;  barycentric (size, size, 3)
    """
    seen = vertices @ camera.T
    x = (seen[:, 0] / HALF_EXTENT + 1) * size / 2 - 0.5
    y = (1 - seen[:, 1] / HALF_EXTENT) * size / 2 - 0.5
    corner_x, corner_y, depth = x[faces], y[faces], seen[:, 2][faces]
    left, right = np.ceil(corner_x.min(1)).clip(0, size).astype(int), np.floor(corner_x.max(1)).clip(-1, size - 1).astype(int)
    top, bottom = np.ceil(corner_y.min(1)).clip(0, size).astype(int), np.floor(corner_y.max(1)).clip(-1, size - 1).astype(int)
    wide = np.maximum(right - left + 1, 0)
    area = _cross(
        corner_x[:, 1] - corner_x[:, 0], corner_y[:, 1] - corner_y[:, 0], corner_x[:, 2] - corner_x[:, 0], corner_y[:, 2] - corner_y[:, 0]
    )
    pixels = np.where(np.abs(area) > 1e-12, wide * np.maximum(bottom - top + 1, 0), 0)

    nearest = np.full(size * size, -np.inf)
    winner = np.full(size * size, -1)
    kept = np.zeros((size * size, 3))
    chunk = np.cumsum(pixels) // CHUNK
    for group in np.unique(chunk[pixels > 0]):
        chosen = np.flatnonzero((chunk == group) & (pixels > 0))
        face = np.repeat(chosen, pixels[chosen])
        within = np.arange(len(face)) - np.repeat(np.cumsum(pixels[chosen]) - pixels[chosen], pixels[chosen])
        column, row = left[face] + within % wide[face], top[face] + within // wide[face]
        weight = _barycentric(corner_x[face], corner_y[face], area[face], column, row)
        inside = (weight >= -1e-9).all(1)
        face, weight, place = face[inside], weight[inside], (row * size + column)[inside]
        z = (weight * depth[face]).sum(1)
        order = np.lexsort((z, place))  # the last of each pixel's run is the nearest
        last = np.flatnonzero(np.append(np.diff(place[order]) != 0, True)) if len(order) else order
        best = order[last]
        best = best[z[best] > nearest[place[best]]]
        nearest[place[best]], winner[place[best]], kept[place[best]] = z[best], face[best], weight[best]
    return winner.reshape(size, size), kept.reshape(size, size, 3)


def _cross(ax, ay, bx, by):
    return ax * by - ay * bx


def _barycentric(x, y, area, column, row):
    """Weights (K, 3) of the pixel (column, row) in triangles with corners x, y (K, 3)."""
    dx, dy = x - column[:, None], y - row[:, None]
    weight = np.stack([_cross(dx[:, k], dy[:, k], dx[:, m], dy[:, m]) for k, m in ((1, 2), (2, 0), (0, 1))], axis=1)
    return weight / area[:, None]


def silhouette(mesh, azimuth, elevation, size=64):
    """Mask (size, size): where the mesh is seen."""
    return look(mesh.vertices, mesh.faces, camera_from_world(azimuth, elevation), size)[0] >= 0


COLOURS = np.array([[0.62, 0.64, 0.67], [0.30, 0.42, 0.62], [0.66, 0.45, 0.28], [0.36, 0.55, 0.38], [0.6, 0.33, 0.4], [0.5, 0.5, 0.25]])


def picture(mesh, azimuth, elevation=ELEVATION, size=160, oversample=2):
    """A shaded picture (size, size, 3) in [0, 1], display values: a headlight from the upper left, segments in different colours."""
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
    image[hit] = np.clip(COLOURS[(mesh.segment[face[hit]] - 1) % len(COLOURS)] * light[:, None] + shine[:, None], 0, 1)
    return image.reshape(size, oversample, size, oversample, 3).mean((1, 3))


def back_faces(vertices, faces, size=96):
    """How many pixels see each face's outer and inner side (F, 2), counted from 14 sides: the cube's sides and corners."""
    counts = np.zeros((len(faces), 2), int)
    views = [(k * np.pi / 2, 0.0) for k in range(4)] + [(0.0, np.pi / 2), (0.0, -np.pi / 2)]
    views += [((k + 0.5) * np.pi / 2, sign * np.arctan(0.5**0.5)) for k in range(4) for sign in (1, -1)]
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    for azimuth, elevation in views:
        camera = camera_from_world(azimuth, elevation)
        face = look(vertices, faces, camera, size)[0]
        face = face[face >= 0]
        facing = normal[face] @ camera[2]
        np.add.at(counts, (face, (facing < 0).astype(int)), np.abs(facing) > EDGE_ON)
    return counts
