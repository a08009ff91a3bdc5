"""Assemblies of named parts, which become one mesh."""

import numpy as np
from numpy.typing import ArrayLike

from factory.shapes.closed_surface import Surface
from factory.shapes.mesh import Mesh, finish


class Assembly:
    """Surfaces added part by part; each face keeps its part's name and its segment (1, 2, …)."""

    def __init__(self) -> None:
        self._vertices: list[np.ndarray] = []
        self._faces: list[np.ndarray] = []
        self._segment: list[np.ndarray] = []
        self._part: list[np.ndarray] = []
        self._parts: dict[str, int] = {}
        self._count = 0

    def add(self, part: str, surface: Surface, segment: ArrayLike) -> None:
        """Add one closed surface (metres); segment: one number, or (F,) one per face."""
        self._vertices.append(surface.vertices)
        self._faces.append(surface.faces + self._count)
        self._count += len(surface.vertices)
        self._segment.append(np.broadcast_to(np.asarray(segment, np.uint8), len(surface.faces)))
        self._part.append(
            np.full(len(surface.faces), self._parts.setdefault(part, len(self._parts)), np.int32)
        )

    def pair(self, part: str, surface: Surface, segment: ArrayLike) -> None:
        """Add a surface and its mirror image on the other side."""
        self.add(part, surface, segment)
        self.add(part, surface.mirrored(), segment)

    def bend(self, curvature: float) -> None:
        """Bend everything added so far about a vertical axis in front (curvature > 0, 1/m).

        y becomes an arc whose ends come forward.
        """
        for k, vertices in enumerate(self._vertices):
            radius = 1 / curvature - vertices[:, 0]
            angle = vertices[:, 1] * curvature
            self._vertices[k] = np.column_stack(
                [1 / curvature - radius * np.cos(angle), radius * np.sin(angle), vertices[:, 2]]
            )

    def turn(self, axis: str, angle: float) -> None:
        """Turn everything added so far about the origin's x, y or z axis, right-handed, radians."""
        for k, (vertices, faces) in enumerate(zip(self._vertices, self._faces, strict=True)):
            self._vertices[k] = Surface(vertices, faces).turned(axis, angle).vertices

    def drop_unused_vertices(self) -> None:
        """Drop the vertices that no face has, such as the centre of a lid that collapsed."""
        old, new = 0, 0
        for k, (vertices, faces) in enumerate(zip(self._vertices, self._faces, strict=True)):
            used, compact = np.unique(faces - old, return_inverse=True)
            old += len(vertices)
            self._vertices[k], self._faces[k] = vertices[used], compact.reshape(-1, 3) + new
            new += len(used)
        self._count = new

    def surface(self) -> Surface:
        """Return all parts as one Surface."""
        return Surface(np.concatenate(self._vertices), np.concatenate(self._faces))

    def finish(self, name: str, category: str) -> Mesh:
        """Return the Mesh; segments are renumbered 1, 2, … in case one has no face."""
        surface = self.surface()
        segment = np.unique(np.concatenate(self._segment), return_inverse=True)[1].reshape(-1) + 1
        return finish(
            name,
            category,
            surface.vertices,
            surface.faces,
            segment=segment,
            parts=tuple(self._parts),
            part=np.concatenate(self._part),
        )
