"""A studio: a Blender scene that renders shot after shot with the given shape, light and materials.

The one scene is rendered in two ways: as a picture, with light and materials, and as geometry,
where each segment emits its own number. (Two scenes would be simpler, but when Blender renders one
of them it drops the persistent data of the other.) Camera and light are fixed, and the object turns
by −azimuth, because the light turns with the camera (shaders.frames).

radiance  (height, width, 3) float32, linear Rec.709, black outside the object; row 0 at the top
"""

from __future__ import annotations

import contextlib
import math
import platform
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import bpy
import msgspec
import numpy as np

from factory.render import (
    body,
    camera,
    canary,
    checks,
    device,
    light,
    materials,
    points,
    render_result,
    self_shading,
    window,
)
from factory.render.estimators.halves import DirectPicture, Portion
from factory.render.settings import (
    ALWAYS,
    DENOISED,
    GEOMETRY,
    PIXELS,
    PORTION,
    TIERS,
    Setting,
    apply,
    assign,
    effective,
)
from factory.shapes.mesh import Mesh
from manifests.arrays import LIGHT_SHAPE
from manifests.facets import Facets
from manifests.schema import Camera, LightResolution, Tier
from shaders import frames, nodes
from shaders.mixture import Mixture

if TYPE_CHECKING:
    from shaders.direct_light import DirectLight

Purpose = Literal["picture", "geometry"]
# normals across a pixel at which direct light is computed, with how many samples of a narrow lobe
# each; mirror-like materials need more, for in a pixel normals turn by more than their lobes
SUBPIXELS = {"glossy": (4, 12), "mirror-like": (8, 4)}
# cells across a pixel; in each of them light that wide lobes lose at facets is computed once
CELLS = 2
MIRROR_LIKE = 0.03  # α below which a lobe is
MOST_POINTS = 1 << 22  # of a picture, some 150 MB
MOST_DIRECT = 64  # maps of direct light in memory
MOST_GROUPS = 512  # node groups in memory: more than there are materials in a catalogue
# least n·v of a normal: near a coarse mesh's silhouette smooth normals may face away
FACING = 1e-3


@dataclass(frozen=True, eq=False)
class Geometry:
    """What is visible at each pixel's centre, without antialiasing.

    normals   (height, width, 3) float32, camera frame, unit, n·v ≥ 1e-3; 0 outside the mask
    mask      (height, width) bool
    depth     (height, width) float32, distance behind the plane through the object's centre, along
              the optical axis; 0 outside the mask
    segments  (height, width) uint8: 1, 2, …; 0 outside the mask
    facets    of points seen by a distant viewer; None for other cameras
    """

    normals: np.ndarray
    mask: np.ndarray
    depth: np.ndarray
    segments: np.ndarray
    facets: Facets | None = None


class _Surface(NamedTuple):
    """What the rays through pixels' centres meet: a mask (height, width), and of its pixels

    normals   (P, 3) float32, camera frame, as they are interpolated: they may lean away
    facets    (P, 3) normals of the facets, with n_z ≥ 0: they face a distant viewer
    depth     (P,) as in Geometry; segments (P,) uint8
    """

    mask: np.ndarray
    normals: np.ndarray
    facets: np.ndarray
    depth: np.ndarray
    segments: np.ndarray

    def pasted(self) -> points.Seen:
        """Return the surface in the frame of its mask."""

        def paste(values: np.ndarray) -> np.ndarray:
            frame = np.zeros((*self.mask.shape, *values.shape[1:]), values.dtype)
            frame[self.mask] = values
            return frame

        return points.Seen(self.mask, paste(self.normals), paste(self.facets), paste(self.segments))


class Studio:
    """See the module. Set camera, shape, light and materials, then call `geometry` and `picture`.

    Each of them can be set again at any time.

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
        self._scene = _scene(self._always)
        self._lens: Camera | None = None
        self._purpose: Purpose | None = None
        self._tier: str | None = None
        self._seen: np.ndarray | None = None  # the light map as the camera sees it
        self._nearest = False  # whether Cycles looks it up as it is, texel by texel
        self._mixtures: list[Mixture] = []
        # by mixture, light and camera, least recently used first
        self._direct: OrderedDict[tuple, DirectLight] = OrderedDict()
        self._azimuth, self._segments = 0.0, 0
        # of the shape
        self._body: Any = None
        self._object: Any = None
        self._second_object: Any = None
        self._vertices = np.zeros((0, 3), np.float32)
        self._has_convex_side = False
        self._may_shade_itself: dict[tuple[float, Camera], bool] = {}
        # one material per segment, and the node groups that it shows for each purpose
        self._surfaces: list[Any] = []
        self._id_groups: list[Any] = []
        self._material_groups: list[Any] = []
        self._groups: OrderedDict[tuple, Any] = (
            OrderedDict()
        )  # by mixture, least recently used first
        self.versions = {
            "blender": bpy.app.version_string,
            "numpy": np.__version__,
            "python": platform.python_version(),
        }
        self._device = {"backend": backend, "processors": list(processors)}

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that alters pixels, with the values that Blender holds."""
        world = light.settings(self._seen.shape[1]) if self._seen is not None else ()
        values: dict[str, Any] = {}
        purposes: tuple[Purpose, ...] = ("picture", "geometry")
        for purpose in purposes:
            self._show(purpose)
            values[purpose] = effective(
                self._scene,
                (*self._always, *self._own(purpose), *(world if purpose == "picture" else ())),
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
        self._segments, self._tier, self._material_groups = int(mesh.segment.max()), None, []
        self._add_surfaces(self._segments)
        self._vertices = mesh.vertices.astype(np.float32)
        corners = mesh.vertices[mesh.faces]
        self._has_convex_side = self_shading.has_convex_side(self._vertices, corners)
        self._may_shade_itself.clear()
        self._body = body.build(mesh)
        for surface in self._surfaces[: self._segments]:
            self._body.materials.append(surface)
        self._object = _put(self._scene, self._body)
        self._second_object = _put_unseen(self._scene, self._body)
        assign(self._scene, "render.use_persistent_data", True)

    def _add_surfaces(self, count: int) -> None:
        """Make sure that there are at least `count` materials, and as many groups that emit ids."""
        for number in range(len(self._surfaces) + 1, count + 1):
            self._surfaces.append(materials.new(f"surface {number}"))
            self._id_groups.append(materials.id_emission(number))

    def _show(self, purpose: Purpose) -> None:
        """Prepare the scene for a picture or for geometry."""
        if purpose != self._purpose:
            apply(self._scene, self._own(purpose))
            for each in ("use_pass_normal", "use_pass_z"):
                assign(self._scene.view_layers[0], each, purpose == "geometry")
            self._purpose = purpose
        groups = self._id_groups if purpose == "geometry" else self._material_groups
        for surface, group in zip(self._surfaces, groups, strict=False):
            materials.show(surface, group)

    def _own(self, purpose: Purpose) -> tuple[Setting, ...]:
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
        self._seen, self._nearest = seen, nearest
        self._show("picture")
        canary.check(self._scene, seen, nearest)

    def set_materials(self, mixtures: Sequence[Mixture]) -> None:
        """Set the materials: one mixture per segment, in the order of the segments' ids."""
        if len(mixtures) != self._segments:
            raise ValueError(
                f"materials: expected {self._segments}, one per segment, found {len(mixtures)}"
                " (name each segment's material)"
            )
        self._material_groups = [self._group(mixture) for mixture in mixtures]
        self._mixtures = list(mixtures)

    def _group(self, mixture: Mixture) -> Any:
        """Return the node group of a mixture, built on first use.

        The least recently used group is removed where there are too many.
        """
        key = _key(mixture)
        if key not in self._groups:
            self._groups[key] = materials.build(nodes.graph(mixture))
        self._groups.move_to_end(key)
        if len(self._groups) > MOST_GROUPS:
            bpy.data.node_groups.remove(self._groups.popitem(last=False)[1])
        return self._groups[key]

    def geometry(self) -> Geometry:
        """Return the Geometry of shape and view, by one ray through each pixel's centre."""
        lens = self._require_camera()
        at = self._surface()
        view = (
            None if lens.fov_deg is None else camera.view_vectors(lens)[at.mask].astype(np.float32)
        )
        facets = None
        if lens.pixel == "centre" and lens.fov_deg is None:
            facets = self._facets(lens, at)
        shot = Geometry(
            np.zeros((*lens.size, 3), np.float32),
            at.mask,
            np.zeros(lens.size, np.float32),
            np.zeros(lens.size, np.uint8),
            facets,
        )
        shot.normals[at.mask] = _facing(at.normals, view)
        shot.depth[at.mask] = at.depth
        shot.segments[at.mask] = at.segments
        return shot

    def _facets(self, lens: Camera, at: _Surface) -> Facets:
        """Return the Facets of points, of which `at` is the surface."""
        around = [self._surface(x, y).pasted() for x, y in points.offsets()]
        centre = at.pasted()
        shares, others = points.others(centre, around)
        return Facets(
            centre.facets,
            centre.normals[..., 2],
            shares,
            np.stack([other.normals for other in others]),
            np.stack([other.facets for other in others]),
            np.stack([other.segments for other in others]),
        )

    def _surface(self, rightwards: float = 0.0, upwards: float = 0.0) -> _Surface:
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
        inside = mask[top:bottom, left:right]
        world, emitted = passes["Normal"][inside], passes["Combined"][inside]
        squares = np.einsum("pi,pi->p", world, world)
        if squares.size and np.abs(squares - 1).max() > 2 * checks.UNIT_TOLERANCE:
            raise RuntimeError(
                "geometry: expected unit normals, found n·n"
                f" {squares.min():.3f}–{squares.max():.3f} (the filter mixes pixels)"
            )
        facets = np.zeros_like(world)
        facets[:, :2] = emitted[:, 1:3] - np.float32(materials.FACET_SHIFT)
        across = np.einsum("pi,pi->p", facets, facets)
        facets[:, 2] = np.sqrt(np.maximum(1 - across, 0))
        return _Surface(
            mask,
            normals=world @ camera.camera_from_fixed_world(lens).T.astype(np.float32),
            facets=facets,
            depth=passes["Depth"][inside][:, 0] - np.float32(camera.distance(lens)),
            segments=np.rint(emitted[:, 0]).astype(np.uint8),
        )

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

    def portion(
        self, first: int, count: int, seed: int, tier: Tier, denoise: bool = False
    ) -> Portion:
        """Return samples first … first + count − 1 of a seed's sequence; others as for `picture`.

        Portions of one sequence, weighted by their counts, give the picture of all their samples to
        float32's rounding. The sequence is not the one of `picture`, which depends on its length.
        """
        self._show("picture")
        self._set_tier(tier)
        passes = self._scene.view_layers[0].cycles
        earlier = {s.path: self._scene.path_resolve(s.path) for s in PORTION}
        try:
            apply(self._scene, PORTION)
            assign(self._scene, "cycles.sample_offset", int(first))
            assign(self._scene, "cycles.sample_subset_length", int(count))
            assign(self._scene, "cycles.seed", int(seed) & 0x7FFFFFFF)
            if denoise:
                apply(self._scene, DENOISED)
                assign(self._scene, "cycles.use_denoising", True)
                assign(passes, "denoising_store_passes", True)  # the noisy picture is one of them
            lens = self._require_camera()
            visible, rendered = self._render_passes(lens)
        finally:
            for path, value in earlier.items():
                assign(self._scene, path, value)
            assign(self._scene, "cycles.sample_offset", 0)
            assign(self._scene, "cycles.use_denoising", False)
            assign(passes, "denoising_store_passes", False)
        rgba = window.paste(rendered["Combined"], visible, lens.size)
        alpha = np.ascontiguousarray(rgba[..., 3])
        if not denoise:
            return Portion(np.ascontiguousarray(rgba[..., :3]), alpha)
        noisy = window.paste(rendered["Noisy Image"], visible, lens.size)
        smooth = np.maximum(rgba[..., :3], np.float32(0))
        return Portion(np.ascontiguousarray(noisy[..., :3]), alpha, smooth)

    @contextlib.contextmanager
    def sampled_by(self, pattern: str) -> Iterator[None]:
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
            at = self._surface()
            known = lens.fov_deg is None or self_shading.are_known(
                at.facets, camera.view_vectors(lens)[at.mask]
            )
            self._may_shade_itself[key] = not known or self_shading.may_shade_itself(
                camera.seen(self._vertices, self._azimuth, lens),
                at.facets,
                camera.points(lens, at.mask, at.depth),
            )
        return self._may_shade_itself[key]

    def direct_light_samples(self) -> int | None:
        """Return how many directions per pixel `direct_light` evaluates besides its maps.

        None where it does not hold: for cameras in perspective, for lights that are not looked up
        texel by texel, and for pictures of which too few points per pixel fit into memory.
        """
        lens = self._require_camera()
        if lens.fov_deg is not None or not self._nearest or not self._mixtures:
            return None
        direct = [self._direct_light(mixture, lens) for mixture in self._mixtures]
        points = self._points(direct, lens)
        if points is None:
            return None
        across, samples = points
        return 2 * across**2 * samples * max(each.narrow for each in direct)

    def direct_light(self) -> DirectPicture | None:
        """Return the direct light without shadows, by the closed forms of the materials.

        A square pixel is the mean over points of a grid (SUBPIXELS). None where
        `direct_light_samples` is.
        """
        if self.direct_light_samples() is None:
            return None
        lens = self._require_camera()
        direct = [self._direct_light(mixture, lens) for mixture in self._mixtures]
        points = self._points(direct, lens)
        assert points is not None
        across, samples = points
        height, width = lens.size
        self.set_camera(msgspec.structs.replace(lens, size=(height * across, width * across)))
        try:
            fine = self._surface()
        finally:
            self.set_camera(lens)
        values = np.zeros_like(fine.normals)
        rows, columns = (place // max(across // CELLS, 1) for place in np.nonzero(fine.mask))
        cells = rows * fine.mask.shape[1] + columns
        for number, each in enumerate(direct, 1):
            here = fine.segments == number
            of = fine.normals[here], samples, fine.facets[here]
            values[here] = each.at(*of, cells=cells[here])
        radiance = np.zeros((*fine.mask.shape, 3), np.float32)
        radiance[fine.mask] = values
        blocks = (height, across, width, across)
        return DirectPicture(
            radiance.reshape(*blocks, 3).mean((1, 3), dtype=np.float32),
            fine.mask.reshape(blocks).mean((1, 3), dtype=np.float32),
        )

    def _points(self, direct: Sequence[DirectLight], lens: Camera) -> tuple[int, int] | None:
        """Return the points across a pixel, and the samples of narrow lobes at each of them.

        None where fewer than two points across a square pixel fit into MOST_POINTS.
        """
        mirror_like = min(each.narrowest for each in direct) < MIRROR_LIKE
        across, samples = SUBPIXELS["mirror-like" if mirror_like else "glossy"]
        per_pixel = across * across * samples
        pixels = lens.size[0] * lens.size[1]
        across = 1 if lens.pixel == "centre" else min(across, math.isqrt(MOST_POINTS // pixels))
        if pixels > MOST_POINTS or (across < 2 and lens.pixel != "centre"):
            return None
        return across, -(-per_pixel // across**2)

    def _direct_light(self, mixture: Mixture, lens: Camera) -> DirectLight:
        """Return the direct light of a mixture under the light that is shown."""
        assert self._seen is not None
        key = (_key(mixture), self._seen.tobytes(), lens.elevation_deg, lens.roll_deg)
        if key not in self._direct:
            from shaders.direct_light import DirectLight  # and numba, which takes half a second

            rotation = frames.camera_from_light(
                np.radians(lens.elevation_deg), np.radians(lens.roll_deg)
            )
            self._direct[key] = DirectLight(mixture, self._seen, rotation)
        self._direct.move_to_end(key)
        if len(self._direct) > MOST_DIRECT:
            self._direct.popitem(last=False)
        return self._direct[key]

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
        if tier == self._tier:
            return
        bounces = TIERS[tier]["bounces"]
        for name in ("max_bounces", "diffuse_bounces", "glossy_bounces"):
            assign(self._scene, f"cycles.{name}", bounces)
        for ray in ("shadow", "diffuse", "glossy", "transmission"):
            assign(self._object, f"visible_{ray}", not TIERS[tier]["unoccluded"])
        self._tier = tier


def _key(mixture: Mixture) -> tuple:
    """Return what a mixture is made of."""
    arrays = (mixture.stops, mixture.log_alpha, mixture.tilt, mixture.weights)
    return mixture.kinds, *(array.tobytes() for array in arrays)


def _scene(settings: Iterable[Setting]) -> bpy.types.Scene:
    """Return a new scene with a camera."""
    scene = bpy.data.scenes.new("studio")
    apply(scene, settings)
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    return scene


def _put(scene: bpy.types.Scene, mesh: bpy.types.Mesh) -> bpy.types.Object:
    """Return a new object of `mesh` in `scene`."""
    each = bpy.data.objects.new("object", mesh)
    scene.collection.objects.link(each)
    return each


def _put_unseen(scene: bpy.types.Scene, mesh: bpy.types.Mesh) -> bpy.types.Object:
    """Return a second object of the same mesh that no ray sees.

    If a mesh has one object, Cycles bakes the object's transform into the vertices: each turn would
    transfer them again and rebuild their tree (33 ms of work for 80,000 triangles). If a mesh has
    two objects, Cycles changes a matrix, provided that materials belong to the mesh.
    """
    unseen = _put(scene, mesh)
    unseen.location = (0.0, 0.0, -10.0)
    # visible to volume scattering, which does not occur: Cycles drops an object that no ray can see
    for ray in ("camera", "shadow", "diffuse", "glossy", "transmission"):
        assign(unseen, f"visible_{ray}", False)
    return unseen


def _facing(normals: np.ndarray, view: np.ndarray | None) -> np.ndarray:
    """Return normals (P, 3) with n·v ≥ FACING: others are moved to the nearest such unit vector.

    view  (P, 3) from surface to camera, camera frame; None: (0, 0, 1)
    """
    cosine = normals[:, 2] if view is None else np.einsum("pi,pi->p", normals, view)
    (away,) = np.nonzero(cosine < FACING)
    v = np.array([0.0, 0.0, 1.0], np.float32) if view is None else view[away]
    flat = normals[away] - cosine[away, None] * v  # the part across the view
    flat /= np.maximum(np.linalg.norm(flat, axis=-1, keepdims=True), np.float32(1e-12))
    normals[away] = np.float32(np.sqrt(1 - FACING**2)) * flat + np.float32(FACING) * v
    return normals
