"""The geometry of a data set, packed for training: each view of each shape once.

Views may come with pictures (records) or without (views). They are read from a cache beside the
data set's lines (learn.data.geometry_cache), which is made on first use. Where it cannot be stored
(a full disk, a read-only data set) the arrays stay in memory.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np
import torch

from learn.data.geometry_cache import GeometryCache, Rows
from learn.data.records import Records
from manifests.errors import InputError
from manifests.notices import notice
from manifests.packed_geometry import pack_depth, pack_normals, unpack_depth, unpack_normals
from manifests.progress import tqdm
from manifests.schema import Camera, Record, View
from shaders.frames import ELEVATION, turned_to_viewer, view_vectors

UNIT_TOLERANCE = 1e-2  # of |n|; files keep it to 1e-4
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

    folder               the folder of the data set, as a path
    size                 height and width of the pictures
    has_several_cameras  whether there are several cameras, or one with perspective or roll
    elevation            of the one camera, radians; of several, the preset one, for then the light
                         is given in the frame that lies below the camera by that angle
    views, cameras       [PackedView] and [Camera] of all views, in the same order
    skipped              {hash: what is wrong} of damaged geometry that was left out
    """

    def __init__(
        self,
        folder: str | Path,
        progress: bool = True,
        skip_bad: bool = False,
        depth: bool = False,
    ):
        """Open a data set's geometry, and pack it where this was not done before.

        progress  whether to show a progress bar
        skip_bad  whether damaged geometry is left out; otherwise the first damaged file raises
        depth     whether `depth` is needed too
        Raises    InputError: no data set, nothing rendered, pictures of several sizes; damaged
                  geometry when it is packed
        """
        records = Records(folder)
        chosen = _choose_views(records, folder)
        self.folder, self.size = records.folder, _common_size(chosen, folder)
        cameras = {record.camera for record in chosen}
        self.has_several_cameras = (
            len({(camera.fov_deg, camera.elevation_deg, camera.roll_deg) for camera in cameras}) > 1
            or chosen[0].camera.fov_deg is not None
            or chosen[0].camera.roll_deg != 0
        )
        self.elevation = (
            float(ELEVATION)
            if self.has_several_cameras
            else float(np.radians(chosen[0].camera.elevation_deg))
        )
        shapes = records.dataset.shapes
        missing = sorted({record.shape for record in chosen} - set(shapes))
        if missing:
            raise InputError(
                self.folder / "dataset.json",
                f"a shape '{missing[0]}', which a record names",
                "none",
                "copy the dataset again",
            )
        self.skipped: dict[str, str] = {}
        self._read_or_pack(records, chosen, progress, skip_bad, depth)
        chosen = [record for record in chosen if record.geometry_hash not in self.skipped]
        if not chosen:
            raise InputError(
                folder, "geometry that can be used", "none", next(iter(self.skipped.values()))
            )
        self.views = [
            PackedView(
                record.shape,
                record.category,
                record.viewpoint,
                shapes[record.shape].side,
                record.geometry_hash,
                shapes[record.shape].hash,
            )
            for record in chosen
        ]
        self.cameras = [record.camera for record in chosen]

    def __len__(self) -> int:
        return len(self.views)

    def normals(self, index: int) -> np.ndarray:
        """Return unit normals (H, W, 3) float32; 0 in the background.

        They are in the camera frame, and in perspective in that of each pixel's ray.
        """
        return unpack_normals(self._n[index], self._segments[index] > 0)

    def segments(self, index: int) -> np.ndarray:
        """Return segments (H, W) int64: 1 … S, 0 in the background."""
        return self._segments[index].astype(np.int64)

    def depth(self, index: int) -> np.ndarray:
        """Return depth (H, W) float32 as geometry files have it; 0 in the background.

        Raises  ValueError for geometry that was opened without depth
        """
        if self._depth is None:
            raise ValueError("depth: expected geometry opened with depth=True, found none")
        return unpack_depth(self._depth[index])

    def _read_or_pack(
        self,
        records: Records,
        chosen: Sequence[Record | View],
        progress: bool,
        skip_bad: bool,
        depth: bool,
    ) -> None:
        """Open the arrays of the chosen views; pack them first where the cache is not of them."""
        cache = GeometryCache(self.folder, self.size, depth)
        self.skipped = cache.skipped() if skip_bad else {}
        arrays = cache.read(
            [each.geometry_hash for each in chosen if each.geometry_hash not in self.skipped]
        )
        if arrays is None:
            rows = partial(self._rows, records, chosen, progress, skip_bad, depth)
            arrays = self._pack(cache, rows, len(chosen))
        self._n, self._segments = arrays[:2]
        self._depth = arrays[2] if depth else None

    def _pack(
        self, cache: GeometryCache, rows: Callable[[], Iterator[tuple[str, Rows]]], most: int
    ) -> Rows:
        """Return the arrays of at most `most` views, from the cache that is made of these rows.

        Rows go to the disk as they are read, so that no more than a few views are in memory.
        """
        try:
            hashes = cache.write(rows(), most, self.skipped)
            arrays = cache.read(hashes)
            if arrays is None and hashes:
                raise OSError(f"{self.folder / 'packed'} does not hold what was written")
        except OSError as error:
            notice(f"packed geometry stays in memory, for it cannot be kept: {error}")
            arrays = cache.collect(rows(), most)
        return cache.collect((), 0) if arrays is None else arrays

    def _rows(
        self,
        records: Records,
        chosen: Sequence[Record | View],
        progress: bool,
        skip_bad: bool,
        depth: bool,
    ) -> Iterator[tuple[str, Rows]]:
        """Yield each view's hash and its part of the arrays; remember in `skipped` what is bad."""
        self.skipped.clear()
        for record in tqdm(
            chosen, "packing geometry", unit="view", disable=not progress, leave=False
        ):
            try:
                normals, depths, segments = self._check(records, record)
            except InputError as problem:
                if not skip_bad:
                    raise
                self.skipped[record.geometry_hash] = str(problem)
                continue
            rows = (pack_normals(normals), segments)
            yield record.geometry_hash, (*rows, pack_depth(depths)) if depth else rows

    def _check(
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


def _choose_views(records: Records, folder: str | Path) -> list[Record | View]:
    """Return the first line of each view that shows enough of its shape, in a fixed order.

    Raises InputError where there is none.
    """
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
    return sorted(first.values(), key=lambda r: (r.shape, r.viewpoint, r.geometry_hash))


def _common_size(chosen: Sequence[Record | View], folder: str | Path) -> tuple[int, int]:
    """Return the height and width of all views. Raises InputError where there are several sizes."""
    sizes = sorted({record.camera.size for record in chosen})
    if len(sizes) > 1:
        raise InputError(folder, "pictures of one size", f"{sizes}", "render them with one size")
    return sizes[0]


def subsample(values: np.ndarray, size: int) -> np.ndarray:
    """Return every n-th pixel of values (H, W, …), so that `size` rows are left.

    Pixels are not averaged: a mean of normals is no surface's normal.
    """
    step = len(values) // size
    return np.ascontiguousarray(values[step // 2 :: step, step // 2 :: step])


def fold_segments(segments: torch.Tensor, regions: int) -> torch.Tensor:
    """Return the regions (…) 1 … `regions` of segments (…) 1 … S; 0 in the background.

    Segments beyond `regions` begin again with the first.
    """
    return (segments - 1).clamp(min=0) % regions + (segments > 0)


def view_vectors_of(camera: Camera) -> np.ndarray:
    """Return the unit vector (H, W, 3) from each pixel's surface to the camera, camera frame."""
    fov = None if camera.fov_deg is None else np.radians(camera.fov_deg)
    return view_vectors(*camera.size, fov=fov).astype(np.float32)
