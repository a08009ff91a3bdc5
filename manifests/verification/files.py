"""Pictures, geometry and light maps of a data set, checked by their hashes and contents."""

import json
from collections import OrderedDict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from manifests import archives, arrays, light_files, packed_geometry, picture_files
from manifests.errors import InputError
from manifests.inputs import require_file
from manifests.materials import Entry
from manifests.object_store import Unreachable
from manifests.schema import Dataset, Record, View
from manifests.store_paths import image_path, light_path
from manifests.verification import contents
from manifests.verification.faults import Fault
from manifests.verification.strays import kind_of

# of masks in memory, one bit per pixel; the records of one shape are neighbours
MASK_BYTES = 64 << 20
PACKED = (*arrays.PACKED_TYPES, "views.json", "skipped.json")
# earlier caches have no sums, and only runs with shadows need depth
OPTIONAL = ("sums.json", arrays.PACKED_DEPTH)

Reference = Callable[[str, str], tuple[np.ndarray, float] | None]


class _Seen(NamedTuple):
    """What is remembered of a geometry file; texts: what is wrong with it."""

    texts: list[str]
    coverage: float = 0.0
    segments: int = 0


class Files:
    """The files of a data set, read as lines name them.

    labels     {name: Entry} of materials.json
    reference  see Verification; None: no light is known
    copy_here  called with the path of a file, relative to the folder, before it is read
    named      {"images": paths, "geometry": paths, "lights": paths} that lines and dataset.json
               have named so far
    """

    def __init__(
        self,
        folder: Path,
        dataset: Dataset,
        labels: dict[str, Entry],
        reference: Reference | None,
        copy_here: Callable[[str], object] = lambda relative: None,
    ):
        self.folder, self.dataset, self._reference = folder, dataset, reference
        self._copy_here = copy_here
        self.named: dict[str, set[str]] = {"images": set(), "geometry": set(), "lights": set()}
        self._shines: dict[str, bool] = {}
        self._reflects = {name: _reflects(entry) for name, entry in labels.items()}
        self._geometry: dict[tuple[str, str], _Seen] = {}
        self._masks: OrderedDict[str, tuple[np.ndarray, tuple[int, int]]] = OrderedDict()
        self._mask_bytes = 0
        self._folders: dict[str, bool] = {}
        self._packed = _Packed(folder / "packed")

    def light_faults(self) -> Iterator[Fault]:
        """Yield the faults of the light maps."""
        for name, entry in self.dataset.lights.items():
            # entry_faults says so; it may be anybody's file
            if entry.file != light_path(name, entry.hash):
                continue
            self.named["lights"].add(entry.file)
            path = self.folder / entry.file
            try:
                self._require_own(entry.file)
                L = light_files.read_light(path, entry.file_hash)
                scale = light_files.read_scale(path)
            except Unreachable:
                raise
            except (InputError, OSError) as problem:
                yield Fault(_without_folder(entry.file, problem), file=path)
                continue
            known = self._reference(name, entry.hash) if self._reference else None
            for text in contents.light_faults(L, scale, known, entry.scale):
                yield Fault(f"{entry.file}: {text}", file=path, entry=("lights", name))
            self._shines[name] = contents.shines_around(L)

    def name(self, line: Record | View) -> None:
        """Remember the files that a line names, whether or not they are read."""
        self.named["geometry"].add(line.geometry)
        if isinstance(line, Record):
            self.named["images"].add(image_path(line.id))

    def of(self, line: Record | View) -> Iterator[tuple[str, Path | None]]:
        """Yield (what is wrong, the file to remove or None) for the files of one line."""
        seen = self._geometry_of(line)
        where = self.folder / line.geometry
        for text in seen.texts:
            yield text, where
        if seen.texts:
            return
        if abs(seen.coverage - line.coverage) > contents.ROUNDED:
            yield (
                (
                    f"{line.geometry}: expected coverage {line.coverage:.6f}, found"
                    f" {seen.coverage:.6f}"
                ),
                None,
            )
        if seen.segments > line.segments:
            yield (
                f"{line.geometry}: expected segments up to {line.segments}, found {seen.segments}",
                where,
            )
        if isinstance(line, Record):
            for text in self._picture_faults(line):
                yield text, self.folder / line.image

    def _picture_faults(self, record: Record) -> list[str]:
        """Return what is wrong with a record's picture."""
        try:
            self._require_own(record.image)
            radiance = picture_files.read_picture(
                self.folder / record.image, record.camera.size, record.image_hash, exact=True
            )
        except Unreachable:
            raise
        except (InputError, OSError) as problem:
            return [_without_folder(record.image, problem)]
        mask = self._mask(record)
        lit = self._shines.get(record.light, False) and all(
            self._reflects.get(name) for name in record.materials
        )
        texts = [
            *contents.statistics_faults(radiance, mask, record.statistics),
            *contents.support_faults(radiance, mask, record.camera.pixel),
            *contents.black_faults(radiance, mask, lit),
        ]
        return [f"{record.image}: {text}" for text in texts]

    def _geometry_of(self, line: Record | View) -> _Seen:
        """Return what a line's geometry file shows; each file is read once."""
        key = (line.geometry, line.geometry_hash)
        if key not in self._geometry:
            self._geometry[key] = self._read_geometry(line)
        return self._geometry[key]

    def _read_geometry(self, line: Record | View) -> _Seen:
        path = self.folder / line.geometry
        try:
            self._require_own(line.geometry)
            geometry = picture_files.read_geometry(
                path, line.camera.size, line.geometry_hash, exact=True
            )
        except Unreachable:
            raise
        except (InputError, OSError) as problem:
            return _Seen([_without_folder(line.geometry, problem)])
        texts = [
            f"{line.geometry}: {text}" for text in contents.geometry_faults(geometry, line.camera)
        ]
        mask = geometry.mask
        self._keep(line.geometry, mask)
        if not texts:
            self._packed.compare(line.geometry_hash, geometry)
        return _Seen(texts, float(mask.mean()), int(geometry.segments.max(initial=0)))

    def _keep(self, path: str, mask: np.ndarray) -> None:
        """Remember a mask, and forget the least recently used ones."""
        bits, (height, width) = np.packbits(mask), mask.shape
        self._masks[path] = bits, (height, width)
        self._mask_bytes += bits.nbytes
        while self._mask_bytes > MASK_BYTES and len(self._masks) > 1:
            self._mask_bytes -= self._masks.popitem(last=False)[1][0].nbytes

    def _mask(self, record: Record) -> np.ndarray:
        """Return the mask (height, width) bool of a record whose geometry is good."""
        if record.geometry not in self._masks:
            self._copy_here(record.geometry)
            self._keep(
                record.geometry,
                picture_files.read_geometry(self.folder / record.geometry, record.camera.size).mask,
            )
        self._masks.move_to_end(record.geometry)
        bits, (height, width) = self._masks[record.geometry]
        return np.unpackbits(bits, count=height * width).reshape(height, width).astype(bool)

    def _require_own(self, relative: str) -> None:
        """Raise InputError unless an ordinary file lies there, in folders that are no links.

        Raises Unreachable if it cannot be fetched from an object store.
        """
        self._copy_here(relative)
        *parents, _ = relative.split("/")
        for depth in range(1, len(parents) + 1):
            part = "/".join(parents[:depth])
            if part not in self._folders:
                self._folders[part] = kind_of(self.folder / part) == "a folder"
            if not self._folders[part] and (result := kind_of(self.folder / part)):
                raise InputError(
                    self.folder / part, "a folder", result, "verify --repair takes it away"
                )
        if (result := kind_of(self.folder / relative)) not in ("a file", None):
            raise InputError(
                self.folder / relative, "a file of its own", result, "verify --repair takes it away"
            )

    def packed_faults(self) -> Iterator[Fault]:
        """Yield the faults of the cache that training keeps beside the data set."""
        return self._packed.faults()


def _without_folder(relative: str, error: InputError | OSError) -> str:
    """Return an error about a file, without the folder's own path."""
    if isinstance(error, InputError):
        return f"{relative}: expected {error.expected}, found {error.found}"
    return f"{relative}: expected a file that can be read, found {error.strerror or error}"


def _reflects(entry: Entry) -> bool:
    """Return whether the mixture of a material reflects any light."""
    return any(value > 0 for closure in entry.mixture.weights for stop in closure for value in stop)


class _Packed:
    """The cache of packed geometry (learn.data.geometry).

    Each row is compared with the file from which it was made.
    """

    def __init__(self, folder: Path):
        self.folder, self._rows, self._left_out, self._texts = folder, {}, set(), []
        if kind_of(folder) != "a folder" or kind_of(folder / "views.json") is None:
            return
        try:
            for name in (*PACKED, "sums.json"):
                if name not in OPTIONAL or kind_of(folder / name) is not None:
                    require_file(folder / name, "a cache's file")
            hashes, left_out = (
                json.loads((folder / name).read_text("utf-8"))
                for name in ("views.json", "skipped.json")
            )
            self._normals, self._segments = (
                np.load(folder / name, mmap_mode="r", allow_pickle=False)
                for name in (arrays.PACKED_NORMALS, arrays.PACKED_SEGMENTS)
            )
            if not len(hashes) == len(self._normals) == len(self._segments):
                raise ValueError(
                    f"{len(hashes)} views, {len(self._normals)} and {len(self._segments)} rows"
                )
            self._rows, self._left_out = (
                {hash_: row for row, hash_ in enumerate(hashes)},
                set(left_out),
            )
        except (OSError, ValueError, EOFError, *archives.NO_HEADER) as error:
            self._texts.append(
                f"expected a whole cache of geometry, found {error or type(error).__name__}"
            )

    def compare(self, hash_: str, geometry: picture_files.Geometry) -> None:
        """Compare a good geometry file with its row, if it has one."""
        if hash_ in self._left_out:
            self._texts.append(
                f"expected good geometry, as that with hash {hash_[:12]}, found it left out"
            )
        row = self._rows.pop(hash_, None)
        if row is None:
            return
        same = np.array_equal(self._normals[row], packed_geometry.pack_normals(geometry.normals))
        if not (same and np.array_equal(self._segments[row], geometry.segments)):
            self._texts.append(
                f"expected the geometry with hash {hash_[:12]} in row {row}, found other normals or"
                " segments"
            )

    def faults(self) -> Iterator[Fault]:
        """Yield what is wrong; the whole cache is removed then, since training makes it again."""
        for text in self._texts:
            yield Fault(f"packed: {text}", file=self.folder)
