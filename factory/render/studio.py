"""A studio: one process, one Blender, shot after shot; shape, light, materials and view are
exchanged between shots.

One scene, shown in two ways: as a picture, with light and materials, and as geometry, where each
segment glows with its own number. (Two scenes would be simpler, but when Blender renders one it
drops what persistent data holds of the other.) Camera and light stand still, the object turns by
−azimuth (shaders.frames: the light turns with the camera).

radiance  (height, width, 3) float32, linear Rec.709, black outside the object; row 0 at the top
"""

import platform
from collections import OrderedDict
from dataclasses import dataclass

import bpy
import numpy as np

from factory.render import (
    body,
    camera,
    canary,
    checks,
    device,
    light,
    materials,
    render_result,
    window,
)
from factory.render.settings import (
    ALWAYS,
    GEOMETRY,
    PIXELS,
    TIERS,
    Setting,
    apply,
    assign,
    effective,
)
from manifests.arrays import LIGHT_SHAPE
from shaders import nodes

HELD = 512  # node groups kept: more than there are materials in a catalogue
# least n·v of a normal: smooth normals lean over the horizon near a coarse mesh's silhouette
FACING = 1e-3


@dataclass(frozen=True, eq=False)
class Geometry:
    """What is seen in each pixel's centre, un-antialiased.

    normals   (height, width, 3) float32, camera frame, unit, n·v ≥ 1e-3; 0 outside the mask
    mask      (height, width) bool
    depth     (height, width) float32: distance behind the plane through the object's centre, along
    the optical axis; 0 outside the mask
    segments  (height, width) uint8: 1, 2, …; 0 outside the mask
    """

    normals: np.ndarray
    mask: np.ndarray
    depth: np.ndarray
    segments: np.ndarray


class Studio:
    """See the module. Set camera, shape, light and materials (and again any of them), then take
    `geometry()` and `render()`.

    settings  path → {value, reason} of all that alters pixels; tiers, device and threads among them
    versions  of Blender, numpy and Python
    """

    def __init__(self, device_name="auto", threads=None):
        """device_name: one of factory.render.device.NAMES; threads: CPU threads, None: all."""
        bpy.ops.wm.read_factory_settings(use_empty=True)
        render_result.hook_cycles()
        kind, backend, processors = device.choose(device_name)
        self._always = (
            *ALWAYS,
            Setting("cycles.device", kind, f"asked for: {device_name}"),
            Setting("render.threads_mode", "FIXED" if threads else "AUTO", "asked for"),
            *((Setting("render.threads", threads, "asked for"),) if threads else ()),
        )
        self._scene = _scene(self._always)
        self._lens = self._body = self._object = self._twin = self._shown = self._seen = (
            self._vertices
        ) = None
        self._azimuth = 0.0
        self._segments, self._tier = 0, None
        self._surfaces, self._glows, self._worn, self._groups = [], [], [], OrderedDict()
        self.versions = {
            "blender": bpy.app.version_string,
            "numpy": np.__version__,
            "python": platform.python_version(),
        }
        self._device = {"backend": backend, "processors": list(processors)}

    @property
    def settings(self):
        """All that alters pixels, as Blender holds it now."""
        world = light.settings(self._seen.shape[1]) if self._seen is not None else ()
        held = {}
        for purpose in ("picture", "geometry"):
            self._show(purpose)
            held[purpose] = effective(
                self._scene,
                (*self._always, *self._own(purpose), *(world if purpose == "picture" else ())),
            )
        return {**held, "tiers": TIERS, "device": self._device}

    def set_camera(self, lens):
        """lens: manifests.schema.Camera."""
        if lens != self._lens:
            camera.place(self._scene, lens)
            self._lens, self._shown = lens, None  # another lens may have other pixels

    def set_shape(self, mesh):
        """mesh: factory.shapes.mesh.Mesh. Persistent data is dropped in between: with it, memory
        grows by every mesh ever shown.
        """
        assign(self._scene, "render.use_persistent_data", False)
        if self._object is not None:
            for each in (self._object, self._twin):
                bpy.data.objects.remove(each)
            bpy.data.meshes.remove(self._body)
        self._segments, self._tier, self._worn = int(mesh.segment.max()), None, []
        self._slots(self._segments)
        self._vertices = mesh.vertices.astype(np.float32)
        self._body = body.build(mesh)
        for surface in self._surfaces[: self._segments]:
            self._body.materials.append(surface)
        self._object = _put(self._scene, self._body)
        self._twin = _twin(self._scene, self._body)
        assign(self._scene, "render.use_persistent_data", True)

    def _slots(self, count):
        """At least `count` materials, and as many glowing groups; they are kept, never removed."""
        for number in range(len(self._surfaces) + 1, count + 1):
            self._surfaces.append(materials.new(f"surface {number}"))
            self._glows.append(materials.emit_id(number))

    def _show(self, purpose):
        """Shows the scene as "picture" or as "geometry"."""
        if purpose != self._shown:
            apply(self._scene, self._own(purpose))
            for each in ("use_pass_normal", "use_pass_z"):
                assign(self._scene.view_layers[0], each, purpose == "geometry")
            self._shown = purpose
        for surface, group in zip(
            self._surfaces, self._glows if purpose == "geometry" else self._worn, strict=False
        ):
            materials.show(surface, group)

    def _own(self, purpose):
        """The settings that a way of showing the scene has for itself."""
        return (
            GEOMETRY
            if purpose == "geometry"
            else PIXELS[self._lens.pixel if self._lens else "square"]
        )

    def set_view(self, azimuth):
        """azimuth: radians, counter-clockwise from above, 0 in front of the object."""
        self._azimuth = float(azimuth)

    def set_light(self, L, rotation_texels=0, light_resolution="64x128"):
        """A new light, checked to have arrived.

        L                 (height, width, 3) float32, stored layout; (64, 128, 3) for "64x128"
        rotation_texels   columns of the 64×128 map by which the camera sees it rolled
        light_resolution  "64x128": nearest look-up, what the layer sees; "full": bilinear
        Raises            RuntimeError if Cycles shows another light than this
        """
        seen = light.as_seen(np.asarray(L, np.float32), rotation_texels)
        nearest = light_resolution == "64x128"
        if nearest and seen.shape != LIGHT_SHAPE:
            raise ValueError(
                f"light: expected shape {LIGHT_SHAPE} for {light_resolution}, found {seen.shape}"
                " (resize it first)"
            )
        light.build(self._scene, seen, nearest)
        self._seen = seen
        self._show("picture")
        canary.check(self._scene, seen, nearest)

    def set_materials(self, mixtures):
        """mixtures: one shaders.mixture.Mixture a segment, in the order of their ids."""
        if len(mixtures) != self._segments:
            raise ValueError(
                f"materials: expected one a segment, {self._segments}, found {len(mixtures)} (name"
                " each segment's material)"
            )
        self._worn = [self._group(mixture) for mixture in mixtures]

    def _group(self, mixture):
        """The node group of a mixture, built when it is first asked for; the one longest unused
        makes room.
        """
        arrays = (mixture.stops, mixture.log_alpha, mixture.tilt, mixture.weights)
        key = mixture.kinds, *(array.tobytes() for array in arrays)
        if key not in self._groups:
            self._groups[key] = materials.build(nodes.graph(mixture))
        self._groups.move_to_end(key)
        if len(self._groups) > HELD:
            bpy.data.node_groups.remove(self._groups.popitem(last=False)[1])
        return self._groups[key]

    def geometry(self):
        """The Geometry of shape and view, by one ray through each pixel's centre."""
        self._show("geometry")
        opening, passes = self._render_passes()
        size = self._lens.size
        mask = window.paste(passes["Combined"][..., 3] > 0.5, opening, size)
        inside = mask[opening[0] : opening[1], opening[2] : opening[3]]
        world = passes["Normal"][inside]
        squares = np.einsum("pi,pi->p", world, world)
        if squares.size and np.abs(squares - 1).max() > 2 * checks.UNIT_TOLERANCE:
            raise RuntimeError(
                "geometry: expected unit normals, found n·n"
                f" {squares.min():.3f}–{squares.max():.3f} (the filter mixes pixels)"
            )
        view = (
            None
            if self._lens.fov_deg is None
            else camera.view_vectors(self._lens)[mask].astype(np.float32)
        )
        shot = Geometry(
            np.zeros((*size, 3), np.float32),
            mask,
            np.zeros(size, np.float32),
            np.zeros(size, np.uint8),
        )
        shot.normals[mask] = _facing(
            world @ camera.camera_from_fixed_world(self._lens).T.astype(np.float32), view
        )
        shot.depth[mask] = passes["Depth"][inside][:, 0] - np.float32(camera.distance(self._lens))
        shot.segments[mask] = np.rint(passes["Combined"][inside][:, 0])
        return shot

    def render(self, samples, seed, tier="direct"):
        """Radiance (height, width, 3).

        samples  paths a pixel;  seed: any non-negative integer, its lowest 31 bits are used;  tier:
        a key of TIERS
        """
        return self.picture(samples, seed, tier)[0]

    def picture(self, samples, seed, tier="direct"):
        """Radiance (height, width, 3) and the share (height, width) of each pixel that the object
        covers; see `render`.
        """
        self._show("picture")
        self._set_tier(tier)
        assign(self._scene, "cycles.samples", int(samples))
        assign(self._scene, "cycles.seed", int(seed) & 0x7FFFFFFF)
        opening, passes = self._render_passes()
        rgba = window.paste(passes["Combined"], opening, self._lens.size)
        return np.ascontiguousarray(rgba[..., :3]), np.ascontiguousarray(rgba[..., 3])

    def _render_passes(self):
        """The window on the object as it stands now, and the scene's passes in it."""
        self._object.rotation_euler = (0.0, 0.0, -self._azimuth)
        opening = window.around(self._vertices, self._azimuth, self._lens)
        window.open_on(self._scene, opening)
        return opening, render_result.render_passes(self._scene)

    def _set_tier(self, tier):
        if tier == self._tier:
            return
        bounces = TIERS[tier]["bounces"]
        for name in ("max_bounces", "diffuse_bounces", "glossy_bounces"):
            assign(self._scene, f"cycles.{name}", bounces)
        for ray in ("shadow", "diffuse", "glossy", "transmission"):
            assign(self._object, f"visible_{ray}", not TIERS[tier]["unoccluded"])
        self._tier = tier


def _scene(settings):
    """A new scene with a camera."""
    scene = bpy.data.scenes.new("studio")
    apply(scene, settings)
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    return scene


def _put(scene, mesh):
    """An object of `mesh` in `scene`."""
    each = bpy.data.objects.new("object", mesh)
    scene.collection.objects.link(each)
    return each


def _twin(scene, mesh):
    """A second object of the same mesh that no ray sees.

    Of a mesh with one object Cycles bakes the object's place into the vertices: each turn would
    send it all again and rebuild its tree (33 ms of work for 80,000 triangles). Of a mesh with two
    it moves a matrix, unless materials belong to the objects, not the mesh.
    """
    twin = _put(scene, mesh)
    twin.location = (0.0, 0.0, -10.0)
    for ray in ("camera", "shadow", "diffuse", "glossy", "transmission"):
        # volume scatter stays, of which there is none: Cycles drops an object seen by no ray at all
        assign(twin, f"visible_{ray}", False)
    return twin


def _facing(normals, view):
    """Normals (P, 3), camera frame, those with n·v < FACING moved to the nearest unit vector that
    has it; view (P, 3), None: (0, 0, 1).
    """
    cosine = normals[:, 2] if view is None else np.einsum("pi,pi->p", normals, view)
    (away,) = np.nonzero(cosine < FACING)
    v = np.array([0.0, 0.0, 1.0], np.float32) if view is None else view[away]
    flat = normals[away] - cosine[away, None] * v  # the part across the view
    flat /= np.maximum(np.linalg.norm(flat, axis=-1, keepdims=True), np.float32(1e-12))
    normals[away] = np.float32(np.sqrt(1 - FACING**2)) * flat + np.float32(FACING) * v
    return normals
