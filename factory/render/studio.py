"""A studio: a Blender scene that renders shot after shot with the given shape, light and materials.

The one scene is rendered in two ways: as a picture, with light and materials, and as geometry,
where each segment emits its own number. (Two scenes would be simpler, but when Blender renders one
of them it drops the persistent data of the other.) Camera and light are fixed, and the object turns
by −azimuth, because the light turns with the camera (shaders.frames).

radiance  (height, width, 3) float32, linear Rec.709, black outside the object; row 0 at the top
"""

from __future__ import annotations

import contextlib
import platform
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any, Literal

import bpy
import numpy as np

from factory.render import (
    body,
    camera,
    canary,
    denoiser,
    device,
    light,
    points,
    render_result,
    scene,
    self_shading,
    window,
)
from factory.render.direct_light import USUAL
from factory.render.estimators.renderer import DirectPicture, DirectWork, Effort, Portion, Share
from factory.render.geometry import Geometry, Surface, facets_of, surface_of, turn_to_viewer
from factory.render.segment_materials import SegmentMaterials
from factory.render.settings import (
    ALWAYS,
    GEOMETRY,
    PIXELS,
    TIERS,
    Setting,
    apply,
    assign,
    effective,
    portion_of_samples,
)
from factory.render.view_light import ShownView, ViewLight
from factory.shapes.mesh import Mesh
from manifests.arrays import LIGHT_SHAPE
from manifests.schema import Camera, LightResolution, Tier
from shaders.mixture import Mixture

Purpose = Literal["picture", "geometry"]


class Studio:
    """A scene whose camera, shape, light and materials are set, and can be set again at any time.

    `geometry` and `picture` then render it.

    device_name  one of factory.render.device.NAMES
    threads      number of CPU threads, None: all
    versions     {"blender", "numpy", "python"}
    """

    def __init__(self, device_name: str = "auto", threads: int | None = None):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        render_result.hook_cycles()
        kind, backend, processors = device.choose(device_name)
        self._always = (
            *ALWAYS,
            Setting("cycles.device", kind, f"requested: {device_name}"),
            Setting("render.threads_mode", "FIXED" if threads else "AUTO", "requested"),
            *((Setting("render.threads", threads, "requested"),) if threads else ()),
        )
        self._scene = scene.new(self._always)
        self._lens: Camera | None = None
        self._purpose: Purpose | None = None  # for which the scene is prepared
        self._tier: str | None = None
        self._seen_light: np.ndarray | None = None  # the light map as the camera sees it
        self._nearest = False  # whether Cycles looks it up as it is, texel by texel
        self._mixtures: list[Mixture] = []
        self._direct_light = ViewLight()
        self._azimuth, self._segments = 0.0, 0
        # of the shape
        self._body: Any = None
        self._object: Any = None
        self._second_object: Any = None
        self._vertices = np.zeros((0, 3), np.float32)
        self._has_convex_side = False
        self._may_shade_itself: dict[tuple[float, Camera], bool] = {}
        self._visible: tuple[float, Camera, Surface] | None = None  # what was seen last
        self._materials = SegmentMaterials()
        self.versions = {
            "blender": bpy.app.version_string,
            "numpy": np.__version__,
            "python": platform.python_version(),
        }
        self._device = {"backend": backend, "processors": list(processors)}

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that alters pixels, with the values that Blender holds."""
        world = light.settings(self._seen_light.shape[1]) if self._seen_light is not None else ()
        values: dict[str, Any] = {}
        purposes: tuple[Purpose, ...] = ("picture", "geometry")
        for purpose in purposes:
            self._show(purpose)
            values[purpose] = effective(
                self._scene,
                (
                    *self._always,
                    *self._settings_of(purpose),
                    *(world if purpose == "picture" else ()),
                ),
            )
        return {**values, "tiers": TIERS, "device": self._device}

    def set_camera(self, lens: Camera) -> None:
        """Set the camera."""
        if lens != self._lens:
            camera.place(self._scene, lens)
            self._lens, self._purpose = lens, None  # another lens may need another pixel filter

    def set_shape(self, mesh: Mesh) -> None:
        """Set the shape.

        Persistent data is dropped, because otherwise memory grows by every mesh that was rendered.
        """
        assign(self._scene, "render.use_persistent_data", False)
        if self._object is not None:
            for each in (self._object, self._second_object):
                bpy.data.objects.remove(each)
            bpy.data.meshes.remove(self._body)
        self._segments, self._tier = int(mesh.segment.max()), None
        self._vertices = mesh.vertices.astype(np.float32)
        corners = mesh.vertices[mesh.faces]
        self._has_convex_side = self_shading.has_convex_side(self._vertices, corners)
        self._may_shade_itself.clear()
        self._visible = None
        self._direct_light.set_shape(mesh)
        self._body = body.build(mesh)
        for surface in self._materials.of_new_shape(self._segments):
            self._body.materials.append(surface)
        self._object = scene.put(self._scene, self._body)
        self._second_object = scene.put_unseen(self._scene, self._body)
        assign(self._scene, "render.use_persistent_data", True)

    def _show(self, purpose: Purpose) -> None:
        """Prepare the scene for a picture or for geometry."""
        if purpose != self._purpose:
            apply(self._scene, self._settings_of(purpose))
            for each in ("use_pass_normal", "use_pass_z"):
                assign(self._scene.view_layers[0], each, purpose == "geometry")
            self._purpose = purpose
        self._materials.show(ids=purpose == "geometry")

    def _settings_of(self, purpose: Purpose) -> tuple[Setting, ...]:
        """Return the settings that differ between pictures and geometry."""
        if purpose == "geometry":
            return GEOMETRY
        return PIXELS[self._lens.pixel if self._lens else "square"]

    def set_view(self, azimuth: float) -> None:
        """Set the view.

        azimuth  radians, counter-clockwise as seen from above, 0 in front of the object
        """
        self._azimuth = float(azimuth)

    def set_light(
        self,
        L: np.ndarray,
        rotation_texels: int = 0,
        light_resolution: LightResolution = "64x128",
    ) -> None:
        """Set the light, and check through Cycles that it is the one that is used.

        L                 (height, width, 3) float32, stored layout; (64, 128, 3) for "64x128"
        rotation_texels   columns of the 64×128 map by which the camera sees it rolled
        light_resolution  "64x128": nearest look-up, as in the layer; "full": bilinear
        Raises            RuntimeError if Cycles uses another light
        """
        seen = light.as_seen(np.asarray(L, np.float32), rotation_texels)
        nearest = light_resolution == "64x128"
        if nearest and seen.shape != LIGHT_SHAPE:
            raise ValueError(
                f"light: expected shape {LIGHT_SHAPE} for {light_resolution}, found {seen.shape}"
                " (resize it first)"
            )
        light.build(self._scene, seen, nearest)
        self._seen_light, self._nearest = seen, nearest
        self._show("picture")
        canary.check(self._scene, seen, nearest)

    def set_materials(self, mixtures: Sequence[Mixture]) -> None:
        """Set the materials: one mixture per segment, in the order of the segments' ids."""
        if len(mixtures) != self._segments:
            raise ValueError(
                f"materials: expected {self._segments}, one per segment, found {len(mixtures)}"
                " (name each segment's material)"
            )
        self._materials.set(mixtures)
        self._mixtures = list(mixtures)

    def geometry(self) -> Geometry:
        """Return the Geometry of shape and view, by one ray through each pixel's centre."""
        lens = self._require_camera()
        at = self._surface()
        view = (
            None if lens.fov_deg is None else camera.view_vectors(lens)[at.mask].astype(np.float32)
        )
        facets = None
        if lens.pixel == "centre" and lens.fov_deg is None:
            around = [self._surface(x, y) for x, y in points.offsets()]
            facets = facets_of(at, around)
        shot = Geometry(
            np.zeros((*lens.size, 3), np.float32),
            at.mask,
            np.zeros(lens.size, np.float32),
            np.zeros(lens.size, np.uint8),
            facets,
        )
        shot.normals[at.mask] = turn_to_viewer(at.normals, view)
        shot.depth[at.mask] = at.depth
        shot.segments[at.mask] = at.segments
        return shot

    def _surface(self, rightwards: float = 0.0, upwards: float = 0.0) -> Surface:
        """Return what one ray through each pixel meets, so many pixels from its centre.

        Pixels that are points are seen through their centres to a hundredth of the width of Cycles'
        narrowest filter, others as Cycles' table of filters has it.
        """
        self._show("geometry")
        lens = self._require_camera()
        exact = points.BOX_SHIFT if lens.pixel == "centre" and lens.fov_deg is None else 0.0
        try:
            camera.shift(self._scene, lens, rightwards - exact, upwards - exact)
            (top, bottom, left, right), passes = self._render_passes(lens)
        finally:
            camera.shift(self._scene, lens, 0.0, 0.0)
        mask = window.paste(passes["Combined"][..., 3] > 0.5, (top, bottom, left, right), lens.size)
        return surface_of(passes, mask, (top, bottom, left, right), lens)

    def _visible_surface(self, lens: Camera) -> Surface:
        """Return what rays through the pixels' centres meet; the last one is kept."""
        if self._visible is None or self._visible[:2] != (self._azimuth, lens):
            self._visible = self._azimuth, lens, self._surface()
        return self._visible[2]

    def render(self, samples: int, seed: int, tier: Tier = "direct") -> np.ndarray:
        """Return radiance (height, width, 3); arguments as `picture` takes them."""
        return self.picture(samples, seed, tier)[0]

    def picture(
        self, samples: int, seed: int, tier: Tier = "direct"
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return radiance (height, width, 3) and the object's coverage (height, width) per pixel.

        samples  samples per pixel
        seed     any non-negative integer, of which the lowest 31 bits are used
        tier     a key of TIERS
        """
        self._show("picture")
        self._set_tier(tier)
        assign(self._scene, "cycles.samples", int(samples))
        assign(self._scene, "cycles.seed", int(seed) & 0x7FFFFFFF)
        lens = self._require_camera()
        visible, passes = self._render_passes(lens)
        rgba = window.paste(passes["Combined"], visible, lens.size)
        return np.ascontiguousarray(rgba[..., :3]), np.ascontiguousarray(rgba[..., 3])

    def portion(self, first: int, count: int, seed: int, tier: Tier) -> Portion:
        """Return samples first … first + count − 1 of a seed's sequence; others as for `picture`.

        Portions of one sequence, weighted by their counts, give the picture of all their samples to
        float32's rounding. The sequence is not the one of `picture`, which depends on its length.
        As long as the object stays, Cycles keeps the longer one, and `picture` draws from it too.
        """
        self._show("picture")
        self._set_tier(tier)
        lens = self._require_camera()
        with portion_of_samples(self._scene, first, count, seed):
            visible, rendered = self._render_passes(lens)
        indirect = sum(
            rendered[f"{kind}Col"] * rendered[f"{kind}Ind"] for kind in ("Diff", "Gloss")
        )
        rgba, guides, indirect = (
            window.paste(each, visible, lens.size)
            for each in (rendered["Combined"], denoiser.guides_of(rendered), indirect)
        )
        alpha = np.ascontiguousarray(rgba[..., 3])
        return Portion(np.ascontiguousarray(rgba[..., :3]), alpha, guides, indirect)

    def denoise(self, portion: Portion, effort: Effort) -> np.ndarray:
        """Return a portion's radiance, or that of the mean of several, without most of its noise.

        Shape, view and camera must be those with which it was rendered.
        """
        lens = self._require_camera()
        visible = window.around(self._vertices, self._azimuth, lens)
        top, bottom, left, right = visible
        noisy, alpha, guides = (each[top:bottom, left:right] for each in portion[:3])
        smooth = denoiser.denoise(self._scene, noisy, alpha, guides, effort)
        return window.paste(smooth, visible, lens.size)

    @contextlib.contextmanager
    def sample_by(self, pattern: str) -> Iterator[None]:
        """Render pictures inside the block by another cycles.sampling_pattern, for measurements."""
        usual = self._scene.cycles.sampling_pattern
        assign(self._scene, "cycles.sampling_pattern", pattern)
        try:
            yield
        finally:
            assign(self._scene, "cycles.sampling_pattern", usual)

    def may_shade_itself(self) -> bool:
        """Return False if nothing visible can be shaded by the object or lit by its light."""
        lens = self._require_camera()
        if not self._has_convex_side:
            return True
        key = self._azimuth, lens
        if key not in self._may_shade_itself:
            at = self._visible_surface(lens)
            known = lens.fov_deg is None or self_shading.are_known(
                at.facets, camera.view_vectors(lens)[at.mask]
            )
            self._may_shade_itself[key] = not known or self_shading.may_shade_itself(
                camera.vertices_from_camera(self._vertices, self._azimuth, lens),
                at.facets,
                camera.points(lens, at.mask, at.depth),
            )
        return self._may_shade_itself[key]

    def direct_light_work(self, points: int = USUAL) -> DirectWork | None:
        """Return what `direct_light` of so many points per pixel takes.

        None where it does not hold: for cameras in perspective, for lights that are not looked up
        texel by texel, and for pictures of which too few points per pixel fit into memory.
        """
        return self._direct_light.work(self._shown_view(), points)

    def direct_light(
        self,
        points: int = USUAL,
        known: DirectPicture | None = None,
        where: np.ndarray | None = None,
    ) -> DirectPicture | None:
        """Return the direct light without shadows, by the closed forms of the materials.

        A square pixel is the mean over its points (factory.render.direct_light). None where
        `direct_light_work` is.

        where  (height, width) bool, the pixels that are computed; the others are as in `known`.
               None: all
        """
        return self._direct_light.picture(self._shown_view(), points, known, where)

    def visible_share(
        self,
        points: int,
        rays: int,
        seed: int,
        half: int,
        where: np.ndarray | None = None,
        turn: int = 0,
    ) -> Share | None:
        """Return the share of `direct_light` that the object does not block; None where that is.

        points  per pixel, of which either half has every other grid
        rays    from each point, by this seed
        where   (height, width) bool, the pixels that rays are cast for; None: all
        turn    points of each turn lie between those of the others
        """
        view = self._shown_view()
        return self._direct_light.share(view, points, rays, seed, half, where, turn)

    def forget_grids(self) -> None:
        """Forget what `direct_light` has seen of the view, as another view makes it do."""
        self._direct_light.forget_grids()

    def _shown_view(self) -> ShownView:
        """Return what is shown, as direct light needs it."""
        lens = self._require_camera()
        light = self._seen_light if self._nearest else None
        return ShownView(
            self._azimuth, lens, self._mixtures, light, partial(self._visible_surface, lens)
        )

    def _require_camera(self) -> Camera:
        """Return the camera. Raises RuntimeError before camera and shape have been set."""
        if self._lens is None or self._object is None:
            raise RuntimeError("studio: expected a camera and a shape, found none (set both first)")
        return self._lens

    def _render_passes(self, lens: Camera) -> tuple[window.Window, dict[str, np.ndarray]]:
        """Return the window around the object, and the scene's render passes inside it."""
        self._object.rotation_euler = (0.0, 0.0, -self._azimuth)
        visible = window.around(self._vertices, self._azimuth, lens)
        window.open_on(self._scene, visible)
        return visible, render_result.render_passes(self._scene)

    def _set_tier(self, tier: Tier) -> None:
        """Set bounces and visibility for the light transport of a tier."""
        if tier == self._tier:
            return
        bounces = TIERS[tier]["bounces"]
        for name in ("max_bounces", "diffuse_bounces", "glossy_bounces"):
            assign(self._scene, f"cycles.{name}", bounces)
        for ray in ("shadow", "diffuse", "glossy", "transmission"):
            assign(self._object, f"visible_{ray}", not TIERS[tier]["unoccluded"])
        self._tier = tier
