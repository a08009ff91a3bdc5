"""The records of a data set as tensors, for training and for rendering by the layer.

H, W picture, S segments; letters as in learn/layer/rendering.py. Everything is float32 on the CPU.

image     (H, W, 3) linear Rec.709 radiance, as Cycles rendered it
n         (H, W, 3) unit normals, camera frame, 0 in the background
segments  (H, W) int64, 1 … S, 0 in the background
label     (S, 108) natural logarithms of κ and γ control values; the layer takes
          material = exp(label)
light     (64, 128, 3) linear radiance of unit mean luminance, light frame of this view: the stored
          map rolled by rotation_texels
view      (H, W, 3) unit vectors to the viewer, camera frame; None for an orthographic camera
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch

from manifests import light_files, picture_files
from manifests.cached_store import open_store
from manifests.errors import InputError
from manifests.facets import Facets
from manifests.materials import Material, material, read_catalogue
from manifests.schema import Record, View
from manifests.store_paths import inside
from manifests.verification.contents import count_turned_away
from manifests.verification.lines import Judge
from shaders.dsbrdf import SIZE
from shaders.envmap import roll
from shaders.frames import camera_from_light, camera_from_upright, view_vectors

T = TypeVar("T")
REPAIR = "python -m factory verify DIR --repair, then render again"


@dataclass(frozen=True)
class Sample:
    """The tensors of one picture, in the shapes and frames that this module states at its top.

    record  the line of the data set that says what the picture shows
    depth   (H, W), 0 in the background
    facets  numpy, camera frame; None where the geometry file holds none
    """

    record: Record
    image: torch.Tensor
    n: torch.Tensor
    depth: torch.Tensor
    segments: torch.Tensor
    label: torch.Tensor
    light: torch.Tensor
    view: torch.Tensor | None
    facets: Facets | None = None

    @property
    def mask(self) -> torch.Tensor:
        """(H, W) bool: the pixels that the object covers."""
        return self.segments > 0

    @property
    def material(self) -> torch.Tensor:
        """(S, 108) κ and γ control values."""
        return self.label.exp()

    @property
    def elevation(self) -> float:
        """The elevation of an upright camera in radians, as the layer takes it.

        Raises  InputError for a rolled camera, which elevation alone does not describe
        """
        require_upright(self.record)
        return float(np.radians(self.record.camera.elevation_deg))

    @property
    def camera_from_light(self) -> np.ndarray:
        """The rotation (3, 3) from the light frame to the camera frame, roll included."""
        camera = self.record.camera
        return camera_from_light(np.radians(camera.elevation_deg), np.radians(camera.roll_deg))

    def upright(self, vectors: torch.Tensor) -> torch.Tensor:
        """Return vectors (…, 3) of the camera frame in the frame of the camera without roll."""
        roll = self.record.camera.roll_deg
        if not roll:
            return vectors
        return vectors @ torch.from_numpy(camera_from_upright(np.radians(roll))).to(vectors)

    def for_layer(self, device: torch.device | str = "cpu") -> dict[str, Any]:
        """Return the arguments of learn.layer.render as a batch of one, on a device.

        Normals and view are those of the camera without roll: its radiance is the same.
        """
        view = None if self.view is None else self.upright(self.view)[None].to(device)
        return {
            "n": self.upright(self.n)[None].to(device),
            "material": self.material[None].to(device),
            "light": self.light[None].to(device),
            "view": view,
            "segments": self.segments[None].to(device),
            "elevation": float(np.radians(self.record.camera.elevation_deg)),
        }


class Records(torch.utils.data.Dataset):
    """The pictures of a data set's folder, as a sequence of samples that torch can load.

    `records[0]` is a Sample: the tensors `image`, `n` (normals), `depth`, `segments`, `label` and
    `light` of one picture, and its `record`, which says what the picture shows.
    Samples are in the order of their record ids, so that an index means the same picture on every
    machine.

    folder  the folder, or the URL of one on an object store, whose files are copied when used
    keep    a function of a record that says whether to use it; None: all are used
    Raises  InputError if the folder holds no data set, or a record that does not match its id
    """

    def __init__(self, folder: str | Path, keep: Callable[[Record], bool] | None = None):
        """Open the folder, as the class says."""
        self.store = open_store(folder)
        self.folder = self.store.folder
        self.dataset = self.store.dataset()
        self.materials = {
            entry.name: entry for entry in read_catalogue(self.folder / "materials.json").materials
        }
        self.records = sorted(
            self._judge_lines("records", self.store.records(keep)), key=lambda record: record.id
        )
        if twice := next((a.id for a, b in pairwise(self.records) if a.id == b.id), None):
            raise InputError(self.folder, "each record once", f"{twice} twice", REPAIR)

    def __len__(self) -> int:
        return len(self.records)

    def __getitem__(self, index: int) -> Sample:
        return self.load(self.records[index])

    def load(self, record: Record) -> Sample:
        """Return the Sample of a record.

        Raises InputError for a file that is missing, damaged or of another size.
        """
        geometry = self._geometry(record)
        fov = None if record.camera.fov_deg is None else np.radians(record.camera.fov_deg)
        height, width = record.camera.size
        view = (
            None
            if fov is None
            else torch.from_numpy(view_vectors(height, width, fov=fov).astype(np.float32))
        )
        light = roll(self.light(record.light), record.rotation_texels)
        label = np.stack([self.label(name) for name in record.materials])
        return Sample(
            record,
            _tensor(self.image(record)),
            _tensor(geometry.normals),
            _tensor(geometry.depth),
            _tensor(geometry.segments.astype(np.int64)),
            _tensor(label),
            _tensor(light),
            view,
            geometry.facets,
        )

    def views(self) -> list[View]:
        """Return every View of geometry alone. Raises InputError as `Records` does."""
        return self._judge_lines("views", self.store.views())

    def _judge_lines(self, kind: str, lines: Iterable[Any]) -> list[Any]:
        """Return the lines, each compared with its id and its entries.

        Training would take an altered line for what it is not. Raises InputError.
        """
        judge, result = Judge(self.dataset, {}, set(), None), []
        faults_of = judge.of_kind(kind)
        for line in lines:
            for fault in faults_of(line, (self.folder, 0)):
                raise InputError(
                    self.folder, f"{kind} that are what their ids mean", fault.text, REPAIR
                )
            result.append(line)
        for fault in judge.verdicts():
            raise InputError(
                self.folder, f"{kind} that are what their ids mean", fault.text, REPAIR
            )
        return result

    def image(self, record: Record) -> np.ndarray:
        """Return radiance (H, W, 3) float32 of a record.

        Raises InputError for a file other than the record's.
        """
        _, radiance = self._read(
            picture_files.read_picture, record.image, record.camera.size, record.image_hash
        )
        return radiance

    def geometry(self, record: Record | View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (normals, depth, segments) of a record or a view.

        normals (H, W, 3) float32, depth (H, W) float32, segments (H, W) int64. Raises InputError.
        """
        geometry = self._geometry(record)
        return geometry.normals, geometry.depth, geometry.segments.astype(np.int64)

    def _geometry(self, record: Record | View) -> picture_files.Geometry:
        """Return the geometry of a record or a view. Raises InputError."""
        path, geometry = self._read(
            picture_files.read_geometry,
            record.geometry,
            record.camera.size,
            record.geometry_hash,
        )
        segments = geometry.segments
        if away := count_turned_away(geometry, record.camera):
            raise InputError(
                path, "normals that face the viewer", f"{away} turned away", "render it again"
            )
        if segments.max(initial=0) > record.segments:
            raise InputError(
                path,
                f"at most {record.segments} segments",
                f"segment {int(segments.max())}",
                "render it again",
            )
        return geometry

    def _read(
        self,
        reader: Callable[[Path, tuple[int, int], str], T],
        relative: str,
        size: tuple[int, int],
        file_hash: str,
    ) -> tuple[Path, T]:
        """Return a file's path and what a reader makes of it. Raises InputError.

        An old copy of what lies on an object store is replaced first.
        """
        path = self.store.fetch(relative)
        try:
            return path, reader(path, size, file_hash)
        except InputError:
            if not self.store.copy_again(relative):
                raise
        return path, reader(path, size, file_hash)

    @cache  # noqa: B019 -- one data set lives as long as its program
    def material(self, name: str) -> Material:
        """Return the material of this name: label, mixture, fit errors. Raises InputError."""
        where, entry = self.folder / "materials.json", self.materials.get(name)
        if entry is None:
            raise InputError(
                where,
                f"an entry for '{name}', which a record names",
                "none",
                "copy the dataset again",
            )
        result, known = material(entry, where), self.dataset.materials.get(name)
        if known is not None and known.hash != result.hash:
            raise InputError(
                f"{where}: '{name}'",
                f"hash {known.hash}, as in dataset.json",
                result.hash,
                "copy the dataset again",
            )
        return result

    def side(self, name: str) -> str:
        """Return the split, "train" or "test", that this data set gives to one of its materials."""
        known = self.dataset.materials.get(name)
        return self.materials[name].split if known is None else known.side

    def label(self, name: str) -> np.ndarray:
        """Return the label (108,) float32 of a material of this data set: natural logarithms."""
        return self.material(name).label.reshape(SIZE).astype(np.float32)

    @cache  # noqa: B019 -- a map takes 100 KB
    def light(self, name: str) -> np.ndarray:
        """Return the stored map (64, 128, 3) float32 of a light, as seen at rotation 0."""
        entry = self.dataset.lights.get(name)
        if entry is None:
            raise InputError(
                self.folder / "dataset.json",
                f"a light '{name}', which a record names",
                "none",
                "copy the dataset again",
            )
        return light_files.read_light(inside(self.folder, entry.file), entry.file_hash)


def require_upright(record: Record | View) -> None:
    """Raise InputError for a rolled camera, of which elevation alone does not give the light."""
    if record.camera.roll_deg:
        raise InputError(
            f"record {record.id}",
            "an upright camera (roll_deg 0)",
            f"a roll of {record.camera.roll_deg:g}°",
            "render with a job without camera_ranges and roll_deg",
        )


def _tensor(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(values))
