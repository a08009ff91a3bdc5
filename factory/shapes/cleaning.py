"""Cleaning of meshes: defects are dropped or refused, and faces are turned outward.

Defects are doubled vertices and faces, and faces of no area. vertices (V, 3), faces (F, 3). Each
step reports in words; nothing is repaired by adding faces.
"""

from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from factory.shapes.creases import edge_pairs, face_normals
from factory.shapes.enclosing import smallest_sphere
from factory.shapes.raster import back_faces
from factory.shapes.raw import WELD
from manifests.errors import InputError
from manifests.wording import number_of

FLAT = 1e-13  # of the size squared: a face of less area is none


def clean(
    vertices: np.ndarray, faces: np.ndarray, where: str | Path
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[str]]:
    """Return a mesh without its defects.

    Returns  vertices, faces, kept (F',) the indices of the given faces that remain, notes on what
             was done
    Raises   InputError: a coordinate that is not finite, an index outside the vertices, or no
             surface left
    """
    vertices, faces = np.asarray(vertices, float), np.asarray(faces, np.int64)
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise InputError(
            where,
            f"faces among {len(vertices)} vertices",
            f"vertex {faces.max()}",
            "download or export it again",
        )
    used = np.unique(faces)
    broken = used[~np.isfinite(vertices[used]).all(1)]
    if len(broken):
        raise InputError(
            where,
            "finite coordinates",
            f"{number_of(len(broken), 'vertex', 'vertices')} with NaN or infinity, the first number"
            f" {broken[0] + 1}",
            "repair or export it again",
        )
    size = float(np.ptp(vertices[used], axis=0).max()) if len(used) else 0.0
    if not (0 < size < 1e150):
        raise InputError(
            where,
            "a mesh of some extent",
            f"a size of {size:.3g}",
            "check the file in a viewer, or export it again",
        )
    notes = []
    if len(used) < len(vertices):
        notes.append(f"{len(vertices) - len(used)} unused vertices dropped")
    centred = (vertices[used] - vertices[used].mean(0)) / size
    cell, first, inverse = np.unique(
        np.round(centred / WELD), axis=0, return_index=True, return_inverse=True
    )
    if len(cell) < len(used):
        notes.append(f"{len(used) - len(cell)} doubled vertices welded")
    vertices = centred[first]
    faces = inverse.reshape(-1)[np.searchsorted(used, faces)]

    flat = face_normals(vertices, faces)[1] <= FLAT
    flat |= (
        (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
    )
    if flat.any():
        notes.append(f"{int(flat.sum())} faces of no area dropped")
    kept = np.flatnonzero(~flat)
    _, single = np.unique(np.sort(faces[kept], axis=1), axis=0, return_index=True)
    if len(single) < len(kept):
        notes.append(f"{len(kept) - len(single)} doubled faces dropped")
    kept = kept[np.sort(single)]
    if not len(kept):
        raise InputError(
            where,
            "a mesh with a surface",
            f"{number_of(len(flat), 'triangle')} of no area",
            "check the file in a viewer, or export it again",
        )
    compact, faces = np.unique(faces[kept], return_inverse=True)
    return vertices[compact], faces.reshape(-1, 3), kept, notes


def orient(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, float, list[str]]:
    """Return the faces wound consistently within each piece, and turned outward where possible.

    A closed piece is turned so that its volume is positive; an open one so that more of its outer
    side is visible from around.

    Returns  faces, the share of the visible surface that remains inner side, notes
    """
    wound, piece = _wind_alike(faces)
    notes = []
    first, second, _, _ = edge_pairs(wound)
    corners = vertices[wound]
    volume = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    count = piece.max() + 1
    pieces = np.bincount(piece, minlength=count)
    paired = np.bincount(np.concatenate([piece[first // 3], piece[second // 3]]), minlength=count)
    closed = paired == 3 * pieces
    seen = _seen(vertices, wound)
    votes = np.stack([np.bincount(piece, seen[:, side], count) for side in (0, 1)], axis=1)
    inward = np.where(closed, np.bincount(piece, volume, count) < 0, votes[:, 1] > votes[:, 0])
    turn = inward[piece]
    oriented = np.where(turn[:, None], wound[:, ::-1], wound)
    turned = int((_cyclic(oriented) != _cyclic(faces)).any(1).sum())
    if turned:
        notes.append(f"{turned} faces turned round")
    votes[inward] = votes[inward][:, ::-1]
    both = (~closed) & (votes.min(1) > 0.1 * votes.sum(1))
    if both.any():
        notes.append(f"{int(both.sum())} open pieces seen from both sides")
    return oriented, float(votes[:, 1].sum() / max(votes.sum(), 1)), notes


def _cyclic(faces):
    """Return the faces rotated to begin with their least vertex."""
    return np.take_along_axis(faces, (faces.argmin(1)[:, None] + np.arange(3)) % 3, axis=1)


def _seen(vertices, faces):
    centre, radius = smallest_sphere(vertices)
    return back_faces((vertices - centre) / radius, faces)


def _wind_alike(faces):
    """Return faces wound consistently across edges of two faces, and the piece (F,) of each.

    Each face stands twice in a graph, as it is and reversed; two faces that share an edge are
    joined in
    the states that agree. A piece in which a face meets its own reversed self (a Möbius strip) has
    no sides and stays as it was.
    """
    count = len(faces)
    first, second, same, _ = edge_pairs(faces)
    first, second = first // 3, second // 3
    flip = same * count  # agreeing faces pair as they are; the others with one turned
    rows = np.concatenate([first, first + count])
    columns = np.concatenate([second + flip, second + count - flip])
    links = coo_matrix((np.ones(len(rows), bool), (rows, columns)), shape=(2 * count, 2 * count))
    state = connected_components(links, directed=False)[1]
    plain, turned = state[:count], state[count:]
    # Each orientable piece is two components, mirror images: the one with the lower number is
    # taken, for all of its faces
    turn = (turned < plain)[:, None]
    piece = np.unique(np.minimum(plain, turned), return_inverse=True)[1].reshape(-1)
    return np.where(turn, faces[:, ::-1], faces), piece
