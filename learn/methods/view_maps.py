"""Reflectance maps for a view per pixel: of radiance for one view per normal, and of its slopes.

What maps hold and where they are read is described in learn/methods/view_places.py. The slopes are
a small part of a picture, so that a map of far fewer nodes serves them.
"""

import functools
import math
from typing import Any

import numpy as np

from learn.methods import reflectance_map
from learn.methods.cost_model import coarsest_level
from learn.methods.planned import Strategy
from learn.methods.view_places import coefficients, dot

# size of the maps of slopes: a part of the main map's, and the least
BESIDE, LEAST_BESIDE = 0.5, 10
# of the tolerance, the error of a lobe by the light's level that serves slopes; times the culling
LIGHT_BESIDE, CULL_BESIDE = 5.0, 4.0


def slope_map_size(size: int) -> int:
    """Return the nodes along a side of the maps of slopes that belong to a map."""
    return max(math.ceil(BESIDE * size), LEAST_BESIDE)


def slope_map_level(scene: Any, lobes: tuple[int, ...]) -> int:
    """Return the coarsest level of the light that serves the maps of slopes of some lobes."""
    share = np.clip(3 * scene.shares, 0.1, 1.0)
    return min(
        coarsest_level(
            scene.sharpness[s], LIGHT_BESIDE * scene.tolerance / share[s], scene.light.size
        )
        for s in lobes
    )


class Maps:
    """Maps of some lobes, read at the pixels: the sum of a polynomial's terms t_j times maps C_j.

    With one view it has the constant alone, whose map is M; maps of slopes lack the constant.
    values   (P, 3)
    read     of each map, (P, 3)
    listing  the sums at the nodes (K·N, 3)
    level    of the light's detail
    """

    def __init__(self, scene: Any, strategy: Strategy, size: int, views: int, slopes: bool = False):
        """scene: a learn.methods.planned_views.Scene; views: K, of which 1 is V itself."""
        self.size, self.views = size, views
        self.places, self.chart = scene.map_places(strategy.mirrored)
        self.nodes = reflectance_map.nodes_for(self.chart.drawn, size)
        at = self.chart.normals(reflectance_map.normals(self.nodes, size))
        normals, beside = (
            np.ascontiguousarray(a.reshape(-1, 3))
            for a in scene.views.beside(at, views, strategy.mirrored)
        )
        lobes, self.level, culled = strategy.lobes, strategy.level, strategy.culled
        if slopes:
            self.level, culled = (
                max(slope_map_level(scene, lobes), self.level),
                CULL_BESIDE * culled,
            )
        budget = culled * scene.budget
        self.listing = scene.list_lobes(normals, beside, lobes, self.level, budget, scene.view_gap)
        self.first = int(slopes)
        self.factors, self.terms = (
            a[self.first :] for a in (coefficients(views), self.places.terms(views))
        )
        held = np.einsum("jk,knc->jnc", self.factors, self.listing.radiance.reshape(views, -1, 3))
        self.tables = [reflectance_map.kernel_table(values, self.nodes, size) for values in held]
        self.read = [reflectance_map.read_values(self.chart.drawn, t, size) for t in self.tables]
        parts = (term[:, None] * read for term, read in zip(self.terms, self.read, strict=True))
        self.values = functools.reduce(np.add, parts)

    def backward(self, g: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives by the drawn places, by the offsets (2, P), and by the sums at the nodes."""
        by_drawn, by_held = np.zeros_like(g), []
        for term, table in zip(self.terms, self.tables, strict=True):
            by_part, by_nodes = reflectance_map.read_backward(
                self.chart.drawn, table, self.size, term[:, None] * g, self.nodes
            )
            by_drawn += by_part
            by_held.append(by_nodes)
        by_terms = np.stack([dot(read, g)[:, 0] for read in self.read])
        by_sums = np.einsum("jk,jnc->knc", self.factors, np.stack(by_held))
        by_offsets = self.places.terms_backward(by_terms, self.first)
        return by_drawn, by_offsets, by_sums.reshape(-1, 3)
