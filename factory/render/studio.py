"""A studio: one process, one Blender, shot after shot; shape, light, materials and view are exchanged between shots.

Two scenes share one mesh: `picture` with light and materials, `geometry` with glowing segments, each with a film, a filter and persistent
data of its own, so that neither is ever rebuilt for the other's sake. Camera and light stand still, the object turns by −azimuth
(shaders.frames: the light turns with the camera).

radiance  (height, width, 3) float32, linear Rec.709, black outside the object; row 0 at the top
"""

import platform
from dataclasses import dataclass

import bpy
import numpy as np

from factory.render import body, camera, canary, checks, device, film, light, materials
from factory.render.settings import ALWAYS, GEOMETRY, PICTURE, TIERS, Setting, apply, assign, effective
from shaders import nodes

FACING = 1e-3  # least n·v of a normal: smooth normals lean over the horizon near a coarse mesh's silhouette


@dataclass(frozen=True, eq=False)
class Geometry:
    """What is seen in each pixel's centre, un-antialiased.

    normals   (height, width, 3) float32, camera frame, unit, n·v ≥ 1e-3; 0 outside the mask
    mask      (height, width) bool
    depth     (height, width) float32: distance behind the plane through the object's centre, along the optical axis; 0 outside the mask
    segments  (height, width) uint8: 1, 2, …; 0 outside the mask
    """

    normals: np.ndarray
    mask: np.ndarray
    depth: np.ndarray
    segments: np.ndarray


class Studio:
    """See the module. Set camera, shape, light and materials (and again any of them), then take `geometry()` and `render()`.

    settings  path → {value, reason} of all that alters pixels; tiers, device and threads among them
    versions  of Blender, numpy and Python
    """

    def __init__(self, device_name="auto", threads=None):
        """device_name: one of factory.render.device.NAMES; threads: CPU threads, None: all."""
        bpy.ops.wm.read_factory_settings(use_empty=True)
        film.tap_cycles()
        kind, backend, processors = device.choose(device_name)
        self._always = (
            *ALWAYS,
            Setting("cycles.device", kind, f"asked for: {device_name}"),
            Setting("render.threads_mode", "FIXED" if threads else "AUTO", "asked for"),
            *((Setting("render.threads", threads, "asked for"),) if threads else ()),
        )
        self._picture = _scene("picture", (*self._always, *PICTURE))
        self._geometry = _scene("geometry", (*self._always, *GEOMETRY))
        self._geometry.view_layers[0].use_pass_normal = True
        self._geometry.view_layers[0].use_pass_z = True
        self._lens = self._body = self._objects = self._seen = None
        self._segments, self._tier, self._drawn = 0, None, []
        self.versions = {"blender": bpy.app.version_string, "numpy": np.__version__, "python": platform.python_version()}
        self._device = {"backend": backend, "processors": list(processors)}

    @property
    def settings(self):
        """All that alters pixels, as Blender holds it now."""
        world = light.settings(self._seen.shape[1]) if self._seen is not None else ()
        return {
            "picture": effective(self._picture, (*self._always, *PICTURE, *world)),
            "geometry": effective(self._geometry, (*self._always, *GEOMETRY)),
            "tiers": TIERS,
            "device": self._device,
        }

    def set_camera(self, lens):
        """lens: manifests.schema.Camera."""
        if lens != self._lens:
            for scene in (self._picture, self._geometry):
                camera.place(scene, lens)
            self._lens = lens

    def set_shape(self, mesh):
        """mesh: factory.shapes.mesh.Mesh. Persistent data is dropped in between: with it, memory grows by every mesh ever shown."""
        for scene in (self._picture, self._geometry):
            assign(scene, "render.use_persistent_data", False)
        if self._objects is not None:
            for each in self._objects:
                bpy.data.objects.remove(each)
            bpy.data.meshes.remove(self._body)
        self._segments, self._tier = int(mesh.segment.max()), None
        self._slots(self._segments)
        self._body = body.build(mesh)
        for _ in range(self._segments):
            self._body.materials.append(None)
        self._objects = tuple(
            _put(scene, self._body, made[: self._segments])
            for scene, made in ((self._picture, self._surfaces), (self._geometry, self._glows))
        )
        for scene in (self._picture, self._geometry):
            assign(scene, "render.use_persistent_data", True)

    def _slots(self, count):
        """At least `count` materials for each scene; they are kept and redrawn, never removed."""
        if not self._drawn:
            self._surfaces, self._glows = [], []
        for number in range(len(self._drawn) + 1, count + 1):
            self._surfaces.append(materials.new(f"surface {number}"))
            self._glows.append(materials.glow(number))
            self._drawn.append(None)

    def set_view(self, azimuth):
        """azimuth: radians, counter-clockwise from above, 0 in front of the object."""
        for each in self._objects:
            each.rotation_euler = (0.0, 0.0, -float(azimuth))

    def set_light(self, L, rotation_texels=0, light_resolution="64x128"):
        """A new light, checked to have arrived.

        L                 (height, width, 3) float32, stored layout; (64, 128, 3) for "64x128"
        rotation_texels   columns of the 64×128 map by which the camera sees it rolled
        light_resolution  "64x128": nearest look-up, what the layer sees; "full": bilinear
        Raises            RuntimeError if Cycles shows another light than this
        """
        seen = light.as_seen(np.asarray(L, np.float32), rotation_texels)
        nearest = light_resolution == "64x128"
        if nearest and seen.shape != (64, 128, 3):
            raise ValueError(f"light: shape (64, 128, 3) expected for {light_resolution}, found {seen.shape}; resize it first")
        light.build(self._picture, seen, nearest)
        self._seen = seen
        canary.check(self._picture, seen, nearest)

    def set_materials(self, mixtures):
        """mixtures: one shaders.mixture.Mixture a segment, in the order of their ids."""
        if len(mixtures) != self._segments:
            raise ValueError(f"materials: one a segment, {self._segments}, expected, found {len(mixtures)}; name each segment's material")
        for slot, mixture in enumerate(mixtures):
            if self._drawn[slot] is not mixture:
                materials.draw(self._surfaces[slot], nodes.graph(mixture))
                self._drawn[slot] = mixture

    def geometry(self):
        """The Geometry of shape and view, by one ray through each pixel's centre."""
        passes = film.expose(self._geometry)
        mask = passes["Combined"][..., 3] > 0.5
        world = passes["Normal"].astype(np.float64)
        lengths = np.linalg.norm(world[mask], axis=-1)
        if lengths.size and np.abs(lengths - 1).max() > checks.UNIT_TOLERANCE:
            raise RuntimeError(f"geometry: unit normals expected, found {lengths.min():.3f}–{lengths.max():.3f}; the filter mixes pixels")
        normals = _facing(world @ camera.camera_from_fixed_world(self._lens).T, camera.view_vectors(self._lens))
        depth = passes["Depth"][..., 0] - np.float32(camera.distance(self._lens))
        return Geometry(
            np.where(mask[..., None], normals, 0.0).astype(np.float32),
            mask,
            np.where(mask, depth, np.float32(0)),
            np.where(mask, np.rint(passes["Combined"][..., 0]), 0).astype(np.uint8),
        )

    def render(self, samples, seed, tier="direct"):
        """Radiance (height, width, 3).

        samples  paths a pixel;  seed: any non-negative integer, its lowest 31 bits are used;  tier: a key of TIERS
        """
        return self.picture(samples, seed, tier)[0]

    def picture(self, samples, seed, tier="direct"):
        """Radiance (height, width, 3) and the share (height, width) of each pixel that the object covers; see `render`."""
        self._set_tier(tier)
        assign(self._picture, "cycles.samples", int(samples))
        assign(self._picture, "cycles.seed", int(seed) & 0x7FFFFFFF)
        film_rgba = film.expose(self._picture)["Combined"]
        return np.ascontiguousarray(film_rgba[..., :3]), np.ascontiguousarray(film_rgba[..., 3])

    def _set_tier(self, tier):
        if tier == self._tier:
            return
        bounces = TIERS[tier]["bounces"]
        for name in ("max_bounces", "diffuse_bounces", "glossy_bounces"):
            assign(self._picture, f"cycles.{name}", bounces)
        for ray in ("shadow", "diffuse", "glossy", "transmission"):
            assign(self._objects[0], f"visible_{ray}", not TIERS[tier]["unoccluded"])
        self._tier = tier


def _scene(name, settings):
    """A new scene with a camera."""
    scene = bpy.data.scenes.new(name)
    apply(scene, settings)
    scene.camera = bpy.data.objects.new(f"{name} camera", bpy.data.cameras.new(f"{name} camera"))
    scene.collection.objects.link(scene.camera)
    return scene


def _put(scene, mesh, surfaces):
    """An object of `mesh` in `scene`, its materials its own, so that two scenes may show one mesh differently."""
    each = bpy.data.objects.new(f"{scene.name} object", mesh)
    scene.collection.objects.link(each)
    for slot, surface in zip(each.material_slots, surfaces, strict=True):
        slot.link, slot.material = "OBJECT", surface
    return each


def _facing(normals, view):
    """The nearest unit vectors with n·v ≥ FACING; normals, view (height, width, 3), camera frame."""
    short = np.maximum(FACING - (normals * view).sum(-1, keepdims=True), 0.0)
    bent = normals + short * view
    return np.where(short > 0, bent / np.maximum(np.linalg.norm(bent, axis=-1, keepdims=True), 1e-12), normals)
