"""What a worker does with a shot: render it, check it, write its files and return its record.

The pipeline has a studio and remembers what the studio shows, so that nothing is set up twice.

Geometry (a shape from one view) is rendered once per data set. If another worker or an earlier run
made it, it is read back, or rendered again if its file is damaged.

A light map of full resolution is resized to a width that is a multiple of 128, because a rotation
is a whole number of 128ths of a turn.
"""

from __future__ import annotations

import os
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import msgspec
import numpy as np

from factory.execution.assignment import Assignment, BadShot, ShapeSource, load_light, load_shape
from factory.planning.plan import TEXELS, Shot
from factory.render import checks
from factory.render.estimators import choice
from factory.render.estimators.renderer import Renderer, Shown
from manifests.errors import InputError
from manifests.ids import camera_of
from manifests.picture_files import (
    Geometry,
    SeenGeometry,
    encode_geometry,
    encode_picture,
    read_geometry,
)
from manifests.schema import Accuracy, Camera, Record, Statistics, View
from manifests.store import Store
from manifests.store_paths import geometry_path, image_path, readable_hash
from manifests.viewpoints import azimuths_deg
from shaders import envmap
from shaders.mixture import Mixture
from shaders.tone import LUMINANCE

if TYPE_CHECKING:
    from factory.shapes.mesh import Mesh

MOST_GEOMETRIES = 48  # geometries whose masks stay in memory: 24 views each of two shapes


class Studio(Renderer, Protocol):
    """What the pipeline needs of factory.render.studio.Studio, or of its substitute in tests."""

    settings: Any
    versions: dict[str, str]

    def set_camera(self, lens: Camera) -> None: ...
    def set_shape(self, mesh: Mesh) -> None: ...
    def set_view(self, azimuth: float) -> None: ...
    def set_light(self, L: np.ndarray, rotation_texels: int, light_resolution: str) -> None: ...
    def set_materials(self, mixtures: list[Mixture]) -> None: ...
    def geometry(self) -> SeenGeometry: ...
    def picture(self, samples: int, seed: int, tier: str) -> tuple[np.ndarray, np.ndarray]: ...


class _StoredGeometry(msgspec.Struct, frozen=True):
    """A geometry file that is in its place.

    mask      (height, width) bool
    coverage  share of the frame inside the mask
    """

    path: str
    hash: str
    mask: np.ndarray
    coverage: float


class Pipeline:
    """Makes the shots of one assignment and writes their files.

    worker    this worker's name
    append    called with each finished Record or View
    mixtures  {material's name: Mixture}
    shapes    {name: ShapeSource} of the shapes that shots use; the caller sets it
    spent     {kind of work: seconds by the clock} for the last shot
    computed  {kind of work: seconds of processor time, over all threads} for the last shot
    notes     lines for the user about the last shot
    """

    def __init__(
        self,
        studio: Studio,
        assignment: Assignment,
        store: Store,
        worker: str,
        append: Callable[[Record | View], None],
        mixtures: Mapping[str, Mixture],
    ):
        self.studio, self.assignment, self.store, self.worker = studio, assignment, store, worker
        self._append, self._mixtures = append, mixtures
        self.shapes: dict[str, ShapeSource] = {}
        # what the studio shows
        self._shape: str | None = None
        self._view: int | None = None
        self._light: tuple[str, str, int] | None = None
        self._materials: tuple[str, ...] | None = None
        self._segments = 0
        self._light_map: tuple[tuple[str, str], np.ndarray] | None = None
        self._geometries: OrderedDict[str, _StoredGeometry] = OrderedDict()
        self.spent: dict[str, float] = {}
        self.computed: dict[str, float] = {}
        self.notes: list[str] = []
        studio.set_camera(assignment.job.camera)

    def make(self, shot: Shot) -> Record | View:
        """Render, check and write one shot; append its record to the worker's lines and return it.

        A shot of geometry alone has a View in place of a Record.

        Raises  BadShot if a check fails; OSError if a file cannot be written
        """
        start, self.spent, self.computed, self.notes = time.perf_counter(), {}, {}, []
        line = self._make_record(shot, start) if shot.picture else self._make_view(shot, start)
        self._append(line)
        return line

    def _make_view(self, shot: Shot, start: float) -> View:
        """Write the geometry of a shot without a picture; return the shot's View."""
        self._show_shape(shot)
        self._show_view(shot)
        geometry = self._geometry(shot)
        assert shot.split != "mixed"  # without materials, the split is the side of the shape
        return View(
            **self._shared_fields(View, shot, geometry, start),
            segments=self._segments,
            side=shot.split,
            coverage=round(geometry.coverage, 6),
        )

    def _shared_fields(
        self, line: type[Record | View], shot: Shot, geometry: _StoredGeometry, start: float
    ) -> dict[str, Any]:
        """Return the fields {name: value} that a shot's Record and View have in common.

        start  time.perf_counter when the shot was begun
        """
        shape = self.shapes[shot.shape]
        return shot.repeated_in(line) | {
            "shape_hash": shape.hash,
            "category": shape.category,
            "azimuth_deg": azimuths_deg()[shot.viewpoint],
            "camera": self._camera(shot),
            "geometry": geometry.path,
            "geometry_hash": geometry.hash,
            "seconds": round(time.perf_counter() - start, 4),
        }

    def _make_record(self, shot: Shot, start: float) -> Record:
        """Write the picture and the geometry of a shot; return the shot's Record."""
        self._show(shot)
        geometry = self._geometry(shot)
        with self._time_block("picture"):
            radiance, alpha, samples, accuracy = self._picture(shot, geometry)
        if faults := checks.picture_faults(radiance, geometry.coverage, alpha):
            raise BadShot("; ".join(faults))
        image = image_path(shot.id)
        with self._time_block("writing"):
            image_hash = self.store.place(image, encode_picture(radiance), self.worker)
        statistics = _statistics(radiance, geometry)
        return Record(
            **self._shared_fields(Record, shot, geometry, start),
            light_hash=self.assignment.lights[shot.light].hash,
            samples=samples,
            image=image,
            image_hash=image_hash,
            statistics=statistics,
            accuracy=accuracy,
        )

    def _picture(
        self, shot: Shot, geometry: _StoredGeometry
    ) -> tuple[np.ndarray, np.ndarray, int, Accuracy | None]:
        """Render a picture; return radiance, coverage per pixel, samples, and its Accuracy."""
        job, start = self.assignment.job, time.perf_counter()
        if job.error is None:
            return *self.studio.picture(job.samples, shot.seed, shot.tier), job.samples, None
        made = choice.render_within_error(
            Shown(self.studio, shot.seed, shot.tier, geometry.mask), job.error
        )
        accuracy = Accuracy(
            requested=job.error,
            estimator=made.estimator,
            predicted=round(made.predicted, 4),
            estimated=round(max(made.estimated.error, 0.0), 4),
            standard_error=round(made.estimated.standard_error, 4),
            seconds=round(time.perf_counter() - start, 4),
            traced=None if made.traced == shot.tier else made.traced,
        )
        if made.estimated.bound > job.error:
            self.notes.append(
                f"{shot.id}: its error is about {accuracy.estimated:g} ±"
                f" {accuracy.standard_error:.2g} after {made.samples} samples, the largest"
                f" number allowed; the job limits it to {job.error:g}"
            )
        return made.radiance, made.alpha, made.samples, accuracy

    @contextmanager
    def _time_block(self, what: str) -> Iterator[None]:
        """Add the block's seconds to `spent` and `computed`, which forecasts are based on."""
        start, computed = time.perf_counter(), time.process_time()
        yield
        self.spent[what] = self.spent.get(what, 0.0) + time.perf_counter() - start
        self.computed[what] = self.computed.get(what, 0.0) + time.process_time() - computed

    def _show(self, shot: Shot) -> None:
        """Set the studio's shape, light, materials and view, each only if it changes."""
        self._show_shape(shot)
        light = (shot.light, shot.light_resolution, shot.rotation_texels)
        if light != self._light:
            L = self._map(shot.light, shot.light_resolution)
            with self._time_block("light"):
                self.studio.set_light(L, shot.rotation_texels, shot.light_resolution)
            self._light = light
        if shot.materials != self._materials:
            with self._time_block("materials"):
                self.studio.set_materials([self._mixtures[name] for name in shot.materials])
            self._materials = shot.materials
        self._show_view(shot)

    def _show_shape(self, shot: Shot) -> None:
        if shot.shape != self._shape:
            with self._time_block("shape"):
                mesh = load_shape(self.shapes[shot.shape])
                self.studio.set_shape(mesh)
            self._shape, self._segments = shot.shape, mesh.segments
            self._view = self._materials = None

    def _show_view(self, shot: Shot) -> None:
        self.studio.set_camera(self._camera(shot))  # no work where it is the same
        if shot.viewpoint != self._view:
            self.studio.set_view(np.radians(azimuths_deg()[shot.viewpoint]))
            self._view = shot.viewpoint

    def _camera(self, shot: Shot) -> Camera:
        """Return the camera of a shot."""
        shape = self.shapes[shot.shape]
        return camera_of(self.assignment.job, shape.hash, shot.viewpoint)

    def _map(self, name: str, resolution: str) -> np.ndarray:
        """Return the map of a light; the last one stays in memory."""
        if self._light_map is None or self._light_map[0] != (name, resolution):
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

    def _geometry(self, shot: Shot) -> _StoredGeometry:
        """Return the geometry of the shot's shape and view: remembered, read or rendered."""
        if shot.geometry in self._geometries:
            self._geometries.move_to_end(shot.geometry)
            return self._geometries[shot.geometry]
        path = geometry_path(shot.geometry)
        file = self.store.folder / path
        seen: SeenGeometry
        digest: str | None
        if not os.path.lexists(file):
            seen = self._render_geometry()
            digest = self.store.place(path, encode_geometry(seen), self.worker, keep_first=True)
        else:
            digest = readable_hash(file)
            stored, fault = self._read_geometry(file, digest, shot.geometry_hash)
            if stored is None or digest is None or fault:
                seen = self._render_geometry()
                digest = self.store.place_instead(path, encode_geometry(seen), self.worker, digest)
                self.notes += _replacement_notes(path, fault, digest, shot.geometry_hash)
            else:
                seen = stored
        result = _StoredGeometry(path, digest, seen.mask, float(seen.mask.mean()))
        self._geometries[shot.geometry] = result
        if len(self._geometries) > MOST_GEOMETRIES:
            self._geometries.popitem(last=False)
        return result

    def _render_geometry(self) -> SeenGeometry:
        """Render and check the geometry that the studio shows. Raises BadShot if a check fails."""
        with self._time_block("geometry"):
            seen = self.studio.geometry()
        if faults := checks.geometry_faults(seen, self._segments):
            raise BadShot("; ".join(faults))
        return seen

    def _read_geometry(
        self, file: Path, digest: str | None, expected: str | None
    ) -> tuple[Geometry | None, str]:
        """Read a geometry file; return the geometry, and what is wrong with it ("" if nothing is).

        digest    sha256 of the file; None if it cannot be read
        expected  sha256 that records of this geometry name; None if there are none
        """
        if expected is not None and digest != expected:
            return None, "its content is not what its records name"
        try:
            seen = read_geometry(file, self.assignment.job.camera.size)  # ranges leave the size
        except InputError as problem:
            return None, problem.found
        except OSError as error:
            return None, error.strerror or str(error)
        if digest is None:
            return None, "it could not be read"
        return seen, "; ".join(checks.geometry_faults(seen, self._segments))


def _replacement_notes(path: str, fault: str, digest: str, expected: str | None) -> Iterator[str]:
    """Yield what the user should know about a geometry file that was rendered again."""
    yield f"{path} was damaged ({fault}) and has been rendered again"
    if expected not in (None, digest):
        yield (
            f"{path} has another hash than its earlier records name: verify --repair removes those"
            " records, and the same render makes them again"
        )


def _statistics(radiance: np.ndarray, geometry: _StoredGeometry) -> Statistics:
    inside = radiance[geometry.mask]
    return Statistics(
        coverage=round(geometry.coverage, 6),
        mean=round(float(inside.mean(axis=0, dtype=np.float64) @ LUMINANCE), 6),
        max=round(float(inside.max()), 6),
    )
