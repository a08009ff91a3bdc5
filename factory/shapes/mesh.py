"""A mesh that is ready for rendering: centred, scaled, smooth, its parts named, hashed.

vertices        (V, 3) float64, world frame: z up, the object's front +x; the smallest sphere around
                them is the unit sphere
faces           (F, 3) int32, counter-clockwise seen from outside
corner_normals  (F, 3, 3) float32, unit: the normal of each face's three corners, smooth below the
                crease angle
segment         (F,) uint8: 1, 2, …: the semantic region that gets a material of its own
parts, part     names, and (F,) int32 the index of each face's name
hash            sha256 of geometry and segments, not of the name or the order of vertices and faces,
                so that duplicates are found
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from factory.shapes.creases import CREASE_DEG, corner_normals, edge_pairs, face_normals
from factory.shapes.enclosing import smallest_sphere
from manifests.errors import InputError
from manifests.wording import number_of

# vertices are hashed to 1/65536 of the unit sphere's radius: twice the digits of a float16, none of
# libm's noise
HASH_GRID = 1 << 16


@dataclass(frozen=True)
class Report:
    """Properties of a mesh.

    back_faces  share of the surface visible from 14 sides that is a face's inner side; None: not
                measured
    """

    triangles: int
    watertight: bool
    components: int
    open_edges: int
    crowded_edges: int  # edges with more than two faces: not a surface there
    back_faces: float | None = None
    cleaned: tuple[str, ...] = ()

    def line(self) -> str:
        """Return the report as one line of text."""
        back = "" if self.back_faces is None else f", {self.back_faces:.1%} seen from behind"
        tight = (
            "watertight"
            if self.watertight
            else f"{self.open_edges} open and {self.crowded_edges} crowded edges"
        )
        notes = f"; {', '.join(self.cleaned)}" if self.cleaned else ""
        triangles = number_of(self.triangles, "triangle")
        components = number_of(self.components, "component")
        return f"{triangles}, {components}, {tight}{back}{notes}"


@dataclass(frozen=True, eq=False)
class Mesh:
    """A mesh; the module's first lines give shapes and frames. Arrays are read-only."""

    name: str
    category: str
    vertices: np.ndarray
    faces: np.ndarray
    corner_normals: np.ndarray
    segment: np.ndarray
    parts: tuple[str, ...]
    part: np.ndarray
    hash: str
    report: Report

    def __post_init__(self) -> None:
        for array in (self.vertices, self.faces, self.corner_normals, self.segment, self.part):
            array.setflags(write=False)

    @property
    def segments(self) -> int:
        """How many semantic regions there are; their ids are 1 … segments."""
        return int(self.segment.max())


def finish(
    name: str,
    category: str,
    vertices: np.ndarray,
    faces: np.ndarray,
    *,
    segment: np.ndarray | None = None,
    parts: Sequence[str] = ("body",),
    part: np.ndarray | None = None,
    normals: np.ndarray | None = None,
    crease_deg: float = CREASE_DEG,
    **known: Any,
) -> Mesh:
    """Return a Mesh from welded, outward triangles: centred, scaled, smooth, counted and hashed.

    vertices, faces  (V, 3), (F, 3); world axes, any place and size
    segment, part    (F,) each, or None: one segment, one part
    normals          (F, 3, 3) analytic corner normals, or None: derived below crease_deg
    known            back_faces=, cleaned=: facts that the caller has measured, kept in the report
    Raises           InputError if there is no area to scale
    """
    vertices, faces = (
        np.ascontiguousarray(vertices, np.float64),
        np.ascontiguousarray(faces, np.int32),
    )
    centre, radius = smallest_sphere(vertices[np.unique(faces)]) if len(faces) else (0.0, 0.0)
    if not radius > 0 or not face_normals(vertices, faces)[1].sum() > 1e-12 * radius**2:
        raise InputError(
            name,
            "a mesh with a surface",
            f"{number_of(len(faces), 'triangle')} of no area",
            "check the file in a viewer, or export it again",
        )
    vertices = (vertices - centre) / radius
    segment = np.ones(len(faces), np.uint8) if segment is None else np.array(segment, np.uint8)
    part = np.zeros(len(faces), np.int32) if part is None else np.array(part, np.int32)
    hash_ = geometry_hash(vertices, faces, segment, crease_deg if normals is None else CREASE_DEG)
    normals = (
        corner_normals(vertices, faces, crease_deg)
        if normals is None
        else np.array(normals, np.float32)
    )
    return Mesh(
        name,
        category,
        vertices,
        faces,
        normals,
        segment,
        tuple(parts),
        part,
        hash_,
        describe(faces, **known),
    )


def describe(faces: np.ndarray, **known: Any) -> Report:
    """Return the Report of faces (F, 3)."""
    counts = edge_pairs(faces)[3]
    open_edges, crowded = int((counts == 1).sum()), int((counts > 2).sum())
    return Report(
        len(faces),
        open_edges == 0 and crowded == 0,
        int(face_components(faces).max()) + 1,
        open_edges,
        crowded,
        **known,
    )


def face_components(faces: np.ndarray) -> np.ndarray:
    """Return the index (F,) of the connected piece of each face; shared vertices connect faces."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    used, compact = np.unique(faces, return_inverse=True)
    compact = compact.reshape(faces.shape)
    rows, columns = compact[:, [0, 1]].ravel(), compact[:, [1, 2]].ravel()
    links = coo_matrix((np.ones(len(rows), bool), (rows, columns)), shape=(len(used), len(used)))
    return connected_components(links, directed=False)[1][compact[:, 0]]


def geometry_hash(
    vertices: np.ndarray, faces: np.ndarray, segment: np.ndarray, crease_deg: float = CREASE_DEG
) -> str:
    """Return the sha256 (hex) of the set of triangles, their segments and the crease angle.

    It depends on neither their order nor their names. Each triangle is its three corners on a grid,
    beginning with the least; the triangles are sorted.
    """
    grid = np.round(vertices * HASH_GRID).astype(np.int64) + 2 * HASH_GRID  # positive, 18 bits each
    key = (grid[:, 0] << 36) | (grid[:, 1] << 18) | grid[:, 2]
    corners = key[faces]
    first = corners.argmin(axis=1)
    corners = np.take_along_axis(corners, (first[:, None] + np.arange(3)) % 3, axis=1)
    order = np.lexsort((segment, corners[:, 2], corners[:, 1], corners[:, 0]))
    digest = hashlib.sha256(b"brdfactory mesh 1\n")
    digest.update(corners[order].astype("<i8").tobytes())
    digest.update(np.asarray(segment, np.uint8)[order].tobytes())
    if crease_deg != CREASE_DEG:
        digest.update(f"crease {float(crease_deg)!r}".encode())
    return digest.hexdigest()
