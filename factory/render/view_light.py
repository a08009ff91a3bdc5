"""Direct light without noise of what a studio shows, and what grids of points see of the view.

The closed forms are those of factory.render.direct_light. A limit on the error asks for the same
points repeatedly, so what they see is kept until another view, or another shape, is shown.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from factory.render import camera
from factory.render.direct_light import (
    DirectLights,
    Points,
    leaning_share,
    merge_pictures,
    picture_of,
    points_of,
    turn_points,
)
from factory.render.estimators.renderer import DirectPicture, DirectWork, Share
from factory.render.geometry import Surface
from factory.render.ray_tree import RayTree
from factory.render.seen_points import SeenPoints
from factory.render.shadow_rays import ShadowRays
from factory.shapes.mesh import Mesh
from manifests.schema import Camera
from shaders.mixture import Mixture

if TYPE_CHECKING:
    from shaders.direct_light import DirectLight

MOST_KEPT = 1 << 23  # points on the object whose normals are kept, of 33 bytes each


class ShownView(NamedTuple):
    """What a studio shows.

    azimuth   radians
    mixtures  of the segments, in the order of their ids
    light     (height, width, 3) the map as the camera sees it; None unless it is looked up texel by
              texel
    centres   returns what rays through the pixels' centres meet, as Blender sees it
    """

    azimuth: float
    lens: Camera
    mixtures: Sequence[Mixture]
    light: np.ndarray | None
    centres: Callable[[], Surface]


class Grid(NamedTuple):
    """What a grid of points sees, and where: (height, width) bool, None: in all pixels."""

    where: np.ndarray | None
    surface: Surface

    def covers(self, where: np.ndarray | None) -> bool:
        """Whether it is known what the grid sees in all these pixels."""
        if self.where is None:
            return True
        return where is not None and not (where & ~self.where).any()


class ViewLight:
    """Direct light of the views that a studio shows, one after the other."""

    def __init__(self) -> None:
        self._closed_forms = DirectLights()
        # of the view that was seen last, by points across a pixel and place of the grid
        self.grids: dict[tuple[int, tuple[float, float]], Grid] = {}
        self._grids_of: tuple[float, Camera] | None = None
        # of the shape
        self._rays: ShadowRays | None = None
        self._points: SeenPoints | None = None

    def set_shape(self, mesh: Mesh) -> None:
        """Set the shape that is shown."""
        tree = RayTree(mesh.vertices.astype(np.float32), mesh.faces)
        self._rays, self._points = ShadowRays(tree), SeenPoints(mesh, tree)
        self.forget_grids()

    def forget_grids(self) -> None:
        """Forget what points have seen of the view."""
        self.grids.clear()
        self._grids_of = None

    def forget_closed_forms(self) -> None:
        """Forget the closed forms of all materials and lights."""
        self._closed_forms.clear()

    def closed_forms(self, view: ShownView) -> list[DirectLight]:
        """Return the direct light of each segment's material under the light that is shown.

        There is none for cameras in perspective and for lights that are not looked up by texel.
        """
        if view.lens.fov_deg is not None or view.light is None:
            return []
        return [self._closed_forms.of(each, view.light, view.lens) for each in view.mixtures]

    def work(self, view: ShownView, points: int) -> DirectWork | None:
        """Return the work of `picture` with so many points per pixel; None if it does not hold."""
        direct = self.closed_forms(view)
        at = points_of(direct, view.lens, points) if direct else None
        if at is None:
            return None
        maps = sum(each.map_size for each in dict.fromkeys(direct))
        return DirectWork(at.per_pixel, leaning_share(view.centres()), maps)

    def picture(
        self,
        view: ShownView,
        points: int,
        known: DirectPicture | None = None,
        where: np.ndarray | None = None,
    ) -> DirectPicture | None:
        """Return the direct light with so many points per pixel; None if it does not hold.

        where  (height, width) bool, the pixels that are computed; the others are as in `known`.
               None: all. If so many points do not fit, there is no picture, either
        """
        direct = self.closed_forms(view)
        at = points_of(direct, view.lens, points, where) if direct else None
        if at is None or (where is not None and at.per_pixel < points):
            return None
        picture = picture_of(direct, self._grids_at(view, at, where), view.lens, at, where)
        return picture if known is None or where is None else merge_pictures(known, picture, where)

    def share(
        self,
        view: ShownView,
        points: int,
        each: int,
        seed: int,
        half: int,
        where: np.ndarray | None = None,
        turn: int = 0,
    ) -> Share | None:
        """Return the share of direct light that arrives; None where `picture` is.

        points  per pixel, every other grid of which is one half's
        each    rays from each point
        where   (height, width) bool, the pixels that rays are cast for; None: all
        turn    points of each turn lie between those of the others
        """
        direct = self.closed_forms(view)
        at = points_of(direct, view.lens, points, where) if direct else None
        if at is None or self._rays is None:
            return None
        if (
            turn and view.lens.pixel != "centre"
        ):  # else the one point of a pixel stays in its centre
            at = turn_points(at, turn)
        grids = self._grids_at(view, at, where)
        if len(grids) > 1:
            grids, at = grids[half::2], at._replace(shifts=at.shifts[half::2])
        rotation = camera.camera_from_object(view.azimuth, view.lens)
        return self._rays.share(direct, grids, view.lens, rotation, at, each, seed, where)

    def _grids_at(self, view: ShownView, at: Points, where: np.ndarray | None) -> list[Surface]:
        """Return what grids of points see in `where`; as many as MOST_KEPT allows are kept."""
        if self._grids_of != (view.azimuth, view.lens):
            self.forget_grids()
            self._grids_of = view.azimuth, view.lens
        result = []
        for shift in at.shifts:
            grid = self.grids.get((at.across, shift))
            if grid is None or not grid.covers(where):
                grid = Grid(where, self._look(view, at.across, shift, where))
                self.grids.pop((at.across, shift), None)
                kept = sum(len(each.surface.depth) for each in self.grids.values())
                if kept + len(grid.surface.depth) <= MOST_KEPT:
                    self.grids[at.across, shift] = grid
            result.append(grid.surface)
        return result

    def _look(
        self,
        view: ShownView,
        across: int,
        shift: tuple[float, float],
        where: np.ndarray | None,
    ) -> Surface:
        """Return what a grid of points sees; arguments as SeenPoints.look takes them."""
        if view.lens.pixel == "centre":  # the geometry that is published
            return view.centres()
        assert self._points is not None  # there is a shape
        return self._points.look(view.lens, view.azimuth, across, shift, where)
