"""Which share of the direct light reaches what is visible, by rays towards the light.

At each point, directions are drawn in proportion to what they would add to the picture: the
material's closed form times the light, evaluated at a grid of normals. Mirror-like lobes, which are
narrower than that grid, have further rays that follow them at each point's own normal; where a
material has several, each point follows one of them and counts for all. Either way, all noise is
that of visibility: where nothing or everything is blocked there is none. The points of a pixel
divide the light equally between them.

The share is a factor of the closed form's picture (factory.render.direct_light), which has neither
shadows nor noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from factory.render.estimators.renderer import Share
from factory.render.ray_tree import RayTree
from manifests.schema import Camera

if TYPE_CHECKING:  # Blender is not needed for the constants, which are part of fingerprints
    from factory.render.direct_light import Points
    from factory.render.geometry import Surface
    from shaders.direct_light import DirectLight

# cosine between facets and rays below which rays begin above smooth facets, as in Cycles
# (shadow_terminator_geometry_offset)
GRAZING = 0.1
MARGIN = 1e-4  # by which rays begin beside the surface, in units of the object's radius
# steps of x and y per unit, by the least α of the lobes that are not mirror-like: normals that are
# equal when they are rounded to these share one evaluation of the light
STEPS = ((0.1, 16), (0.0, 32))
ROWS = 32  # of blocks of the light, of which wide lobes reflect each as one light
AT_ONCE = 1 << 19  # numbers of evaluated light in memory, 2 MB


class ShadowRays:
    """Rays from what is visible of one shape towards the light."""

    def __init__(self, tree: RayTree):
        self._tree = tree
        self._margin = np.float32(MARGIN * tree.radius)

    def share(
        self,
        direct: Sequence[DirectLight],
        grids: Sequence[Surface],
        lens: Camera,
        rotation: np.ndarray,
        points: Points,
        rays: int,
        seed: int,
        where: np.ndarray | None = None,
    ) -> Share:
        """Return the share of direct light that arrives, by `rays` rays from each point.

        direct   of the segments' materials, in the order of their ids
        grids    the surface at the points of each of the grids of `points`
        rotation (3, 3) from the object's frame to the camera's
        seed     of the directions
        where    (height, width) bool, the pixels that rays are cast for; None: all
        """
        height, width = lens.size
        at = _points_seen(grids, lens, points, where)
        arrived, sent = np.zeros((2, height * width, 3))
        turns, counts = _numbers_within(at.pixels, height * width)
        for number, each in enumerate(direct, 1):
            here = np.nonzero(at.segments == number)[0]
            if len(here):
                self._cast(each, at, here, turns, counts, rotation, rays, seed, arrived, sent)
        shape = (height, width, 3)
        return Share(arrived.reshape(shape), sent.reshape(shape))

    def _cast(
        self,
        direct: DirectLight,
        at: _PointsSeen,
        here: np.ndarray,
        turns: np.ndarray,
        counts: np.ndarray,
        rotation: np.ndarray,
        rays: int,
        seed: int,
        arrived: np.ndarray,
        sent: np.ndarray,
    ) -> None:
        """Cast the rays of one segment's points, whose numbers are `here`."""
        from factory.render import ray_kernels
        from shaders.normal_groups import turn_to_viewer

        towards, _ = turn_to_viewer(at.normals[here], at.facets[here])
        origins, facets, smooth = (
            np.ascontiguousarray(each @ rotation, np.float32)
            for each in (at.places, at.facets, at.normals)
        )
        begun = (origins, facets, smooth, at.lift, np.float32(GRAZING), self._margin, at.pixels)
        normals, firsts, grouped = _similar_normals(direct, towards)
        members = here[grouped]
        patches = direct.blocks.listed_patches(ROWS)
        order = _in_order_of_neighbours(patches)
        some = max(1, AT_ONCE // (3 * len(patches)))
        for begin in range(0, len(normals), some):
            part = normals[begin : begin + some]
            ray_kernels.cast(
                direct.each_light(part, ROWS),
                patches,
                order,
                (rotation.T @ direct.camera_from_light).astype(np.float32),
                firsts[begin : begin + len(part) + 1],
                members,
                *begun,
                turns,
                counts,
                rays,
                seed,
                *self._tree.arrays,
                direct.blocks.listed_energies(ROWS),
                np.ascontiguousarray(part @ rotation, np.float32),
                arrived,
                sent,
            )
        if not direct.narrow:
            return
        # a point follows one of the narrow closures, and the pixel's next points follow others.
        # Where a pixel has fewer points than there are closures, each follows all of them
        some = max(1, AT_ONCE // (6 * rays))
        own, several = _numbers_within(at.pixels[here], len(counts))
        several = several[at.pixels[here]]
        few = several < direct.narrow
        for number in range(direct.narrow):
            (follow,) = np.nonzero(few | (own % direct.narrow == number))
            followers = 1 + (several - 1 - number) // direct.narrow
            weights = (several / np.where(few, several, followers)).astype(np.float32)
            for begin in range(0, len(follow), some):
                chosen = follow[begin : begin + some]
                part = here[chosen]
                places = np.empty((len(part), rays, 2))
                ray_kernels.draw_places(at.pixels[part], turns[part], counts, rays, seed, places)
                drawn, radiance = direct.draw_narrow(
                    number, towards[chosen], at.facets[part], places
                )
                ray_kernels.cast_drawn(
                    drawn,
                    radiance * weights[chosen, None, None],
                    np.ascontiguousarray(rotation.T, np.float32),
                    part,
                    *begun,
                    *self._tree.arrays,
                    arrived,
                    sent,
                )


def _numbers_within(pixels: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return numbers 0, 1, … of points (P,) within each pixel, and how many each pixel has.

    pixels  (P,) of the points, of `count`
    """
    order = np.argsort(pixels, kind="stable")
    counts = np.bincount(pixels, minlength=count)
    numbers = np.empty(len(order), np.int64)
    numbers[order] = np.arange(len(order)) - np.repeat(np.cumsum(counts) - counts, counts)
    return numbers, counts


def _similar_normals(
    direct: DirectLight, n: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return groups of similar normals of n (P, 3), each of which shares an evaluated light.

    Returns  their means (G, 3) float32; where each begins, and the last ends, (G + 1,) in an order
             (P,) of the normals
    """
    steps = next(steps for least, steps in STEPS if direct.narrowest_listed >= least)
    cells = np.round(n[:, :2] * steps).astype(np.int64) + steps
    _, group, counted = np.unique(
        cells[:, 0] * (2 * steps + 1) + cells[:, 1], return_inverse=True, return_counts=True
    )
    sums = np.stack([np.bincount(group, n[:, k]) for k in range(3)], axis=1)
    means = (sums / np.linalg.norm(sums, axis=1, keepdims=True)).astype(np.float32)
    return means, np.concatenate([[0], np.cumsum(counted)]), np.argsort(group, kind="stable")


class _PointsSeen(NamedTuple):
    """Points of a picture that lie on the object: pixels and segments (P,), and in the camera frame

    places, normals and facets (P, 3); lift (P,) as of Surface.
    """

    pixels: np.ndarray
    segments: np.ndarray
    places: np.ndarray
    normals: np.ndarray
    facets: np.ndarray
    lift: np.ndarray


def _points_seen(
    grids: Sequence[Surface], lens: Camera, points: Points, where: np.ndarray | None
) -> _PointsSeen:
    """Return what all grids see inside `where`."""
    height, width = lens.size
    across = points.across
    step = 2 * lens.half_extent / (max(lens.size) * across)
    result: list[list[np.ndarray]] = []
    for grid, (rightwards, upwards) in zip(grids, points.shifts, strict=True):
        # masks of a grid have many pixels, of which few may be seen
        rows, columns = np.divmod(np.flatnonzero(grid.mask), width * across)
        pixels = rows // across * width + columns // across
        seen: list[np.ndarray] = [grid.segments, grid.depth, grid.normals, grid.facets, grid.lift]
        if where is not None:
            kept = where.ravel()[pixels]
            rows, columns, pixels = rows[kept], columns[kept], pixels[kept]
            seen = [each[kept] for each in seen]
        segments, depth, *others = seen
        x = (columns + (0.5 + rightwards - width * across / 2)) * step
        y = (height * across / 2 - 0.5 + upwards - rows) * step
        result.append([pixels, segments, np.stack([x, y, -depth], axis=-1), *others])
    return _PointsSeen(*(np.concatenate(each) for each in zip(*result, strict=True)))


def _in_order_of_neighbours(patches: np.ndarray) -> np.ndarray:
    """Return an order of patches (T, 4) of a light in which neighbours are near (Morton's)."""
    middle = (patches[:, 0] + patches[:, 1]) / 2, (patches[:, 2] + patches[:, 3]) / 2
    row = np.clip(np.arccos(np.clip(middle[0], -1, 1)) / np.pi * 1024, 0, 1023).astype(np.int64)
    column = np.clip(middle[1] / (2 * np.pi) * 2048, 0, 2047).astype(np.int64)
    code = np.zeros(len(patches), np.int64)
    for bit in range(11):
        code |= ((column >> bit) & 1) << (2 * bit) | ((row >> bit) & 1) << (2 * bit + 1)
    return np.argsort(code, kind="stable")
