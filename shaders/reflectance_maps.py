"""Radiance by the normal alone: a map over the visible hemisphere, filled where it is asked for.

Under distant light and for a distant viewer radiance is a function of the normal, a reflectance map
(Ramamoorthi and Hanrahan 2001).

nodes  of a map: polar angle θ and azimuth φ of the normal at ((θ cos φ, θ sin φ) 2/π + 1)/2; a row
       of nodes lies beyond each edge, for interpolation
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shaders import direct_light_kernels
from shaders.normal_groups import FACING


@dataclass(frozen=True, eq=False)
class ReflectanceMap:
    """Radiance of a closure of unit weight: nodes (S, S, 4), the last 0, and known (S, S) uint8."""

    nodes: np.ndarray
    known: np.ndarray

    def normals(self, nodes: np.ndarray) -> np.ndarray:
        """Return the normals (N, 3) of nodes (N, 2), by row and column."""
        place = ((nodes[:, ::-1] - 1) / (len(self.known) - 3) * 2 - 1) * (np.pi / 2)
        theta = np.linalg.norm(place, axis=1)
        along = place / np.maximum(theta[:, None], 1e-12)
        theta = np.minimum(theta, np.arccos(FACING))
        n = np.concatenate([np.sin(theta)[:, None] * along, np.cos(theta)[:, None]], axis=1)
        return np.ascontiguousarray(n, np.float32)  # its layout decides what is compiled

    def set(self, nodes: np.ndarray, radiance: np.ndarray) -> None:
        """Keep the radiance (N, 3) of nodes (N, 2)."""
        rows, columns = nodes.T
        self.nodes[rows, columns, :3] = radiance
        self.known[rows, columns] = 1

    def add(self, n: np.ndarray, horizon: float, table: np.ndarray, out: np.ndarray) -> np.ndarray:
        """Add to out (N, 3) the radiance at normals (N, 3) times the weights of a table (S, 5).

        horizon  n·v of normals below which nothing is done
        Returns  indices of normals where nothing was added, because nodes are not known; they are 2
        """
        lacking = np.empty(len(n), np.int32)
        count = direct_light_kernels.interpolate(
            n, np.float32(horizon), self.known, self.nodes, table, lacking, out
        )
        return lacking[:count]

    @classmethod
    def empty(cls, size: int) -> ReflectanceMap:
        """Return a map of `size` nodes across, none of which is known."""
        return cls(np.zeros((size, size, 4), np.float32), np.zeros((size, size), np.uint8))
