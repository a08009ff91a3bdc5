"""One worker's work: shots in, records out. It holds a studio, and what the studio shows, so that
nothing is set up twice.

studio    factory.render.studio.Studio, or anything with its methods
geometry  of a shape from a view is rendered once a dataset: it is read back if another worker, or
an earlier run, made it, and
          rendered again in the place of a file that is damaged
light     stored map and rotation; a whole map is averaged to a width that is a multiple of 128, for
rotations are whole texels
"""

import os
import time
from collections import OrderedDict
from contextlib import contextmanager

import msgspec
import numpy as np

from factory.planning.plan import TEXELS, Shot
from factory.planning.shape_names import Source, load_mesh
from factory.render import checks
from manifests.arrays import encode_geometry, encode_picture, read_geometry
from manifests.errors import InputError
from manifests.schema import Job, Record, Statistics, View
from manifests.store import geometry_path, image_path, readable_hash
from manifests.viewpoints import azimuths_deg
from shaders import envmap
from shaders.tone import LUMINANCE

HELD = 48  # geometries whose masks stay in memory: two shapes' 24 views


class ShapeSource(msgspec.Struct, frozen=True, kw_only=True):
    """Where a shape is read from, and what it must turn out to be."""

    source: Source
    hash: str
    category: str


class LightSource(msgspec.Struct, frozen=True, kw_only=True):
    """Where a light is read from, and what it must turn out to be."""

    source: str
    hash: str


class Assignment(msgspec.Struct, frozen=True, kw_only=True):
    """What a worker needs to know besides its shots: the job's common part, and where shapes and
    lights come from.
    """

    job: Job
    shapes: dict[str, ShapeSource]
    lights: dict[str, LightSource]
    library: str | None = None


class BadShot(RuntimeError):
    """A shot whose pixels, normals or light are not what they should be."""


class _Geometry(msgspec.Struct, frozen=True):
    path: str
    hash: str
    mask: np.ndarray
    coverage: float


class Pipeline:
    """Makes shots of one assignment and puts them in place.

    store, worker  manifests.store.Store and this worker's name
    append         called with each finished Record or View
    mixtures       material name → shaders.mixture.Mixture
    """

    def __init__(self, studio, assignment, store, worker, append, mixtures):
        self.studio, self.assignment, self.store, self.worker = studio, assignment, store, worker
        self._append, self._mixtures = append, mixtures
        self._shape = self._view = self._light = self._materials = None
        self._light_map = (None, None)
        self._segments = 0
        self._geometries = OrderedDict()
        self.spent, self.notes = {}, []
        studio.set_camera(assignment.job.camera)

    def make(self, shot: Shot):
        """Render one shot, check it, write it, append its record, return the record (of a shot
        without a picture: its View).

        `spent` then holds the seconds by kind of work, `notes` what the user should know.

        Raises  BadShot; OSError if it cannot be written
        """
        start, self.spent, self.notes = time.perf_counter(), {}, []
        record = self._pictured(shot, start) if shot.picture else self._viewed(shot, start)
        self._append(record)
        return record

    def _viewed(self, shot, start):
        """The View of a shot without a picture, its geometry in place."""
        self._show_shape(shot)
        self._show_view(shot)
        geometry = self._geometry(shot)
        return View(
            **self._shared(View, shot, geometry, start),
            segments=self._segments,
            side=shot.split,
            coverage=round(geometry.coverage, 6),
        )

    def _shared(self, line, shot, geometry, start):
        """{field: value} that a Record and a View of a shot have alike.

        line   Record or View; start: when the shot was begun, by time.perf_counter
        """
        shape = self.assignment.shapes[shot.shape]
        return shot.repeated_in(line) | {
            "shape_hash": shape.hash,
            "category": shape.category,
            "azimuth_deg": azimuths_deg()[shot.viewpoint],
            "camera": self.assignment.job.camera,
            "geometry": geometry.path,
            "geometry_hash": geometry.hash,
            "seconds": round(time.perf_counter() - start, 4),
        }

    def _pictured(self, shot, start):
        """The Record of a shot, its picture and geometry in place."""
        self._show(shot)
        geometry = self._geometry(shot)
        with self._timed("picture"):
            radiance, alpha = self.studio.picture(self.assignment.job.samples, shot.seed, shot.tier)
        if faults := checks.picture(radiance, geometry.coverage, alpha):
            raise BadShot("; ".join(faults))
        image = image_path(shot.id)
        with self._timed("writing"):
            image_hash = self.store.place(image, encode_picture(radiance), self.worker)
        statistics = _statistics(radiance, geometry)
        return Record(
            **self._shared(Record, shot, geometry, start),
            light_hash=self.assignment.lights[shot.light].hash,
            samples=self.assignment.job.samples,
            image=image,
            image_hash=image_hash,
            statistics=statistics,
        )

    @contextmanager
    def _timed(self, what):
        """Add the block's seconds to `spent`: what a forecast is made of."""
        start = time.perf_counter()
        yield
        self.spent[what] = self.spent.get(what, 0.0) + time.perf_counter() - start

    def _show(self, shot):
        """Give the studio shape, light, materials and view, each only if it is another."""
        self._show_shape(shot)
        light = (shot.light, shot.light_resolution, shot.rotation_texels)
        if light != self._light:
            L = self._map(shot.light, shot.light_resolution)
            with self._timed("light"):
                self.studio.set_light(L, shot.rotation_texels, shot.light_resolution)
            self._light = light
        if shot.materials != self._materials:
            with self._timed("materials"):
                self.studio.set_materials([self._mixtures[name] for name in shot.materials])
            self._materials = shot.materials
        self._show_view(shot)

    def _show_shape(self, shot):
        if shot.shape != self._shape:
            with self._timed("shape"):
                mesh = load_shape(self.assignment.shapes[shot.shape])
                self.studio.set_shape(mesh)
            self._shape, self._segments = shot.shape, mesh.segments
            self._view = self._materials = None

    def _show_view(self, shot):
        if shot.viewpoint != self._view:
            self.studio.set_view(np.radians(azimuths_deg()[shot.viewpoint]))
            self._view = shot.viewpoint

    def _map(self, name, resolution):
        """The stored map of a light, kept until another is asked for."""
        if self._light_map[0] != (name, resolution):
            entry = self.assignment.lights[name]
            light = load_light(entry, self.assignment.library)
            L = light.L64
            if resolution == "full":
                L = light.L_full
                height, width = max(L.shape[0], TEXELS // 2), -(-L.shape[1] // TEXELS) * TEXELS
                if L.shape[:2] != (height, width):
                    L = envmap.resize(L, height, width, np.float32)
            self._light_map = ((name, resolution), L)
        return self._light_map[1]

    def _geometry(self, shot):
        """Geometry of the shot's shape and view: from memory, from the folder, or rendered."""
        if shot.geometry in self._geometries:
            self._geometries.move_to_end(shot.geometry)
            return self._geometries[shot.geometry]
        path = geometry_path(shot.geometry)
        file = self.store.folder / path
        if not os.path.lexists(file):
            seen = self._rendered_geometry()
            digest = self.store.place(path, encode_geometry(seen), self.worker, keep_first=True)
        else:
            digest = readable_hash(file)
            seen, fault = self._whole_geometry(file, digest, shot.geometry_hash)
            if fault:
                seen = self._rendered_geometry()
                digest = self.store.place_instead(path, encode_geometry(seen), self.worker, digest)
                self.notes += _replaced(path, fault, digest, shot.geometry_hash)
        held = _Geometry(path, digest, seen.mask, float(seen.mask.mean()))
        self._geometries[shot.geometry] = held
        if len(self._geometries) > HELD:
            self._geometries.popitem(last=False)
        return held

    def _rendered_geometry(self):
        """What the studio shows, checked. Raises BadShot."""
        with self._timed("geometry"):
            seen = self.studio.geometry()
        if faults := checks.geometry(seen, self._segments):
            raise BadShot("; ".join(faults))
        return seen

    def _whole_geometry(self, file, digest, expected):
        """(Geometry, "") of a file that is there; (None, what is wrong with it) if it is not what
        was rendered.

        digest, expected  its sha256, and the one that records name or None
        """
        if expected is not None and digest != expected:
            return None, "another content than its records name"
        try:
            seen = read_geometry(file, tuple(self.assignment.job.camera.size))
        except InputError as problem:
            return None, problem.found
        except OSError as error:
            return None, error.strerror or str(error)
        return seen, "; ".join(checks.geometry(seen, self._segments))


def _replaced(path, fault, digest, expected):
    """What the user should know of a geometry file that was rendered again."""
    yield f"{path} was damaged ({fault}) and has been rendered again"
    if expected not in (None, digest):
        yield (
            f"{path} has other bits than its earlier records name: verify --repair takes those"
            " away, the same render makes them again"
        )


def load_shape(entry):
    """The Mesh of an assignment's shape. Raises BadShot if the file has changed since the plan was
    made.
    """
    mesh = load_mesh(entry.source)
    if mesh.hash != entry.hash:
        raise BadShot(
            f"{entry.source.place}: expected the mesh with hash {entry.hash[:12]}, found"
            f" {mesh.hash[:12]}: it changed meanwhile"
        )
    return mesh


def load_light(entry, library):
    """The Light of an assignment's light. Raises BadShot if the file has changed since the plan was
    made.
    """
    from factory.lights import load

    light = load(entry.source, library)
    if light.hash != entry.hash:
        raise BadShot(
            f"{entry.source}: expected the map with hash {entry.hash[:12]}, found"
            f" {light.hash[:12]}: it changed meanwhile"
        )
    return light


def _statistics(radiance, geometry):
    inside = radiance[geometry.mask]
    return Statistics(
        coverage=round(geometry.coverage, 6),
        mean=round(float(inside.mean(axis=0, dtype=np.float64) @ LUMINANCE), 6),
        max=round(float(inside.max()), 6),
    )
