"""The geometry of a data set, packed for training: each view of each shape once.

Views may come with pictures (records) or without (views). V views, H, W picture. Beside the data
set's lines stands a cache of two memory-mapped arrays, five bytes per pixel, made on first use and
remade when the lines change; a third one, of two bytes per pixel, where a run needs depth:

packed/normals.npy   (V, H, W, 2) int16, n_x and n_y in units of 1/32767; n_z = √(1 − n_x² − n_y²),
                     for normals face the viewer. Packing turns a normal by .002° where it faces the
                     viewer and by .5° at most, at the rim
packed/segments.npy  (V, H, W) uint8, 1 … S, 0 in the background
packed/depth.npy     (V, H, W) int16, depth in units of 1/16384 radius
packed/skipped.json  hashes of files that were left out, and why
packed/sums.json     CRC-32 of the two arrays' files, which reveals a damaged cache
packed/views.json    the geometry files' hashes, which reveal a stale cache; written last, removed
                     before anything else is changed

A cache that is stale or damaged is made again. Where it cannot be stored (a full disk, a read-only
data set) the arrays stay in memory.
"""

import json
import sys
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from learn.data.records import Records
from manifests.arrays import PACKED_DEPTH, PACKED_NORMALS, PACKED_SEGMENTS, PACKED_TYPES
from manifests.errors import InputError
from manifests.files import replacing, write_text
from manifests.inputs import require_file
from manifests.packed_geometry import pack_depth, pack_normals, unpack_depth, unpack_normals
from manifests.progress import tqdm
from manifests.schema import Camera, Record, View
from shaders.frames import ELEVATION, turned_to_viewer, view_vectors

UNIT_TOLERANCE = 1e-2  # of |n|; files keep it to 1e-4
LARGEST_JSON = 256 << 20  # bytes: 70 per view
ARRAYS = (PACKED_NORMALS, PACKED_SEGMENTS)
LEAST_COVERAGE = 0.02  # a view that shows less of its shape is of no use to training


@dataclass(frozen=True)
class PackedView:
    """One view of one shape: names as in its records, the shape's split.

    hash        of the view's geometry file
    shape_hash  of the shape's mesh
    """

    shape: str
    category: str
    viewpoint: int
    side: str
    hash: str
    shape_hash: str


class Geometry:
    """The views of a data set, rendered by one orthographic camera or by several cameras.

    Networks and layer assume a distant viewer. Normals of a view in perspective are therefore
    turned, at each pixel, by the smallest rotation that takes the direction to the viewer to +z.

    elevation       of the one camera, radians; of several, the preset one, for then the light is
                    given in the frame that lies below the camera by that angle
    several         whether there are several cameras, or one with perspective or roll
    skip_bad  whether damaged geometry is left out and listed in `skipped`, {hash: what is wrong};
              otherwise the first damaged file raises
    depth     whether `depth` is needed too
    Raises    InputError: no data set, nothing rendered, pictures of several sizes; damaged geometry
              when it is packed
    """

    def __init__(
        self,
        folder: str | Path,
        progress: bool = True,
        skip_bad: bool = False,
        depth: bool = False,
    ):
        records = Records(folder)
        first: dict[str, Record | View] = {}
        for record in chain(records.views(), records.records):
            if record.coverage >= LEAST_COVERAGE:
                first.setdefault(record.geometry_hash, record)
        if not first:
            raise InputError(
                folder,
                "views or records",
                "none",
                f"render some: python -m factory render geometry --out {folder}",
            )
        chosen = sorted(first.values(), key=lambda r: (r.shape, r.viewpoint, r.geometry_hash))
        cameras = {r.camera for r in chosen}
        sizes = sorted({camera.size for camera in cameras})
        if len(sizes) > 1:
            raise InputError(
                folder,
                "pictures of one size",
                f"{sizes}",
                "render them with one size",
            )
        first_camera = chosen[0].camera
        self.several = (
            len({(camera.fov_deg, camera.elevation_deg, camera.roll_deg) for camera in cameras}) > 1
            or first_camera.fov_deg is not None
            or first_camera.roll_deg != 0
        )
        self.folder, self.size = records.folder, first_camera.size
        elevation_deg = np.degrees(ELEVATION) if self.several else first_camera.elevation_deg
        self.elevation = float(np.radians(elevation_deg))
        shapes = records.dataset.shapes
        missing = sorted({r.shape for r in chosen} - set(shapes))
        if missing:
            raise InputError(
                self.folder / "dataset.json",
                f"a shape '{missing[0]}', which a record names",
                "none",
                "copy the dataset again",
            )
        self.skipped = self._known_as_bad() if skip_bad else {}
        self._n: np.ndarray | None = None
        self._segments: np.ndarray | None = None
        self._depth: np.ndarray | None = None
        self._names = (*ARRAYS, PACKED_DEPTH) if depth else ARRAYS
        hashes = [r.geometry_hash for r in chosen if r.geometry_hash not in self.skipped]
        if self._is_fresh(hashes):
            self._map(len(hashes))
        if self._n is None:
            self._pack(records, chosen, progress, skip_bad)
        chosen = [r for r in chosen if r.geometry_hash not in self.skipped]
        if not chosen:
            raise InputError(
                folder, "geometry that can be used", "none", next(iter(self.skipped.values()))
            )
        self.views = [
            PackedView(
                r.shape,
                r.category,
                r.viewpoint,
                shapes[r.shape].side,
                r.geometry_hash,
                shapes[r.shape].hash,
            )
            for r in chosen
        ]
        self.cameras = [r.camera for r in chosen]

    def __len__(self) -> int:
        return len(self.views)

    def normals(self, index: int) -> np.ndarray:
        """Return unit normals (H, W, 3) float32; 0 in the background.

        They are in the camera frame, and in perspective in that of each pixel's ray.
        """
        n, segments = self._arrays()[:2]
        return unpack_normals(n[index], segments[index] > 0)

    def segments(self, index: int) -> np.ndarray:
        """Return segments (H, W) int64: 1 … S, 0 in the background."""
        return self._arrays()[1][index].astype(np.int64)

    def depth(self, index: int) -> np.ndarray:
        """Return depth (H, W) float32 as geometry files have it; 0 in the background.

        Raises  ValueError for geometry that was opened without depth
        """
        if self._depth is None:
            raise ValueError("depth: expected geometry opened with depth=True, found none")
        return unpack_depth(self._depth[index])

    def _arrays(self) -> tuple[np.ndarray, ...]:
        assert self._n is not None and self._segments is not None  # packed when it was made
        kept = (self._n, self._segments)
        return kept if self._depth is None else (*kept, self._depth)

    def _set(self, arrays: Sequence[np.ndarray]) -> None:
        self._n, self._segments = arrays[:2]
        self._depth = arrays[2] if len(arrays) > 2 else None

    def _at(self, name: str) -> Path:
        return self.folder / "packed" / name

    def _known_as_bad(self) -> dict[str, str]:
        """Return {hash: what is wrong} of files that were left out when the cache was made."""
        known = self._remembered("skipped.json")
        return (
            known
            if isinstance(known, dict) and all(isinstance(text, str) for text in known.values())
            else {}
        )

    def _is_fresh(self, hashes: list[str]) -> bool:
        """Return whether the cache was made of these files."""
        return self._remembered("views.json") == hashes

    def _remembered(self, name: str) -> Any:
        """Return the content of a small file of the cache; None if it is missing or damaged."""
        try:
            require_file(self._at(name), "a part of the cache", maximum_bytes=LARGEST_JSON)
            return json.loads(self._at(name).read_text())
        except (OSError, ValueError, RecursionError):
            return None

    def _map(self, count: int) -> None:
        """Map the arrays of `count` views into memory if their checksums are right."""
        sums, (height, width) = self._remembered("sums.json"), self.size
        try:
            if not isinstance(sums, dict) or any(
                _sum(self._at(name)) != sums.get(name) for name in self._names
            ):
                return
            arrays = [
                np.load(self._at(name), mmap_mode="r", allow_pickle=False) for name in self._names
            ]
        except (OSError, ValueError, EOFError):
            return
        frame = (count, height, width)
        if [array.shape for array in arrays] == [(*frame, 2), frame, frame][: len(arrays)]:
            self._set(arrays)

    def _pack(
        self,
        records: Records,
        chosen: Sequence[Record | View],
        progress: bool,
        skip_bad: bool,
    ) -> None:
        hashes: list[str] = []
        self.skipped = {}
        frame = (len(chosen), *self.size)
        arrays = [
            np.zeros(shape, PACKED_TYPES[name])
            for shape, name in zip(((*frame, 2), frame, frame), self._names, strict=False)
        ]
        for record in tqdm(
            chosen, "packing geometry", unit="view", disable=not progress, leave=False
        ):
            try:
                normals, depth, covered = self._checked(records, record)
            except InputError as problem:
                if not skip_bad:
                    raise
                self.skipped[record.geometry_hash] = str(problem)
                continue
            packed = (pack_normals(normals), covered, pack_depth(depth))
            for stored, values in zip(arrays, packed, strict=False):
                stored[len(hashes)] = values
            hashes.append(record.geometry_hash)
        self._set([stored[: len(hashes)] for stored in arrays])
        try:
            self._keep(hashes)
        except OSError as error:
            print(
                f"learn: packed geometry stays in memory, for it cannot be kept: {error}",
                file=sys.stderr,
            )
            return
        self._map(len(hashes))

    def _keep(self, hashes: list[str]) -> None:
        """Write the cache."""
        self.folder.joinpath("packed").mkdir(exist_ok=True)
        self._at("views.json").unlink(missing_ok=True)
        for name, array in zip(self._names, self._arrays(), strict=True):
            with replacing(self._at(name)) as file:
                np.save(file, array, allow_pickle=False)
        write_text(
            self._at("sums.json"), json.dumps({name: _sum(self._at(name)) for name in self._names})
        )
        write_text(self._at("skipped.json"), json.dumps(self.skipped))
        write_text(self._at("views.json"), json.dumps(hashes))

    def _checked(
        self, records: Records, record: Record | View
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return normals (H, W, 3), depth (H, W) and segments (H, W) of a record or a view.

        Raises InputError for geometry that training cannot use.
        """
        normals, depth, segments = records.geometry(record)
        where, remedy = (
            self.folder / record.geometry,
            "python -m factory verify DIR --repair, then render again; or --skip-bad",
        )
        if not segments.any():
            raise InputError(where, "a shape in the frame", "an empty mask", remedy)
        lengths = np.linalg.norm(normals[segments > 0], axis=-1)
        if not np.abs(lengths - 1).max() < UNIT_TOLERANCE:  # in this form NaN is refused too
            raise InputError(
                where, "unit normals", f"lengths {lengths.min():.4f}–{lengths.max():.4f}", remedy
            )
        if record.camera.fov_deg is not None:
            normals = turned_to_viewer(normals, view_vectors_of(record.camera))
        return normals, depth, segments


def view_vectors_of(camera: Camera) -> np.ndarray:
    """Return the unit vector (H, W, 3) from each pixel's surface to the camera, camera frame."""
    fov = None if camera.fov_deg is None else np.radians(camera.fov_deg)
    return view_vectors(*camera.size, fov=fov).astype(np.float32)


def _sum(path: Path) -> int:
    """Return the CRC-32 of a file's bytes, at 2 GB per second."""
    result = 0
    require_file(path, "a part of the cache")
    with open(path, "rb") as file:
        while data := file.read(1 << 22):
            result = zlib.crc32(data, result)
    return result
