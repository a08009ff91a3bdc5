"""The samples of a data set: each line with its picture, geometry and labels, checked and bounded.

Ids are hashes, so samples in the order of their ids are shuffled, and in the same way everywhere.
"""

import hashlib
import io
from typing import Any, NamedTuple

import msgspec
import numpy as np

from manifests.errors import InputError
from manifests.exporting.counts import Counts, split_of_line
from manifests.line_files import encode
from manifests.materials import load_catalogue
from manifests.picture_files import Geometry, read_geometry, read_picture
from manifests.placed_lines import PlacedLines
from manifests.schema import Dataset, Record, View
from manifests.store import Store
from manifests.store_paths import inside
from shaders import tone


class Sample(NamedTuple):
    """One line of a data set with the arrays that it names.

    line      a Record, or a View where there is no picture
    radiance  (height, width, 3) float32, linear Rec.709; None without a picture
    display   (height, width, 3) uint8, sRGB of radiance × exposure; None without a picture
    exposure  the factor that brings the 99th percentile of the object's luminance to 1
    geometry  normals, depth and segments
    labels    (segments, L) float32 labels of the materials; None without a picture
    """

    line: Record | View
    radiance: np.ndarray | None
    display: np.ndarray | None
    exposure: float | None
    geometry: Geometry
    labels: np.ndarray | None

    @property
    def split(self) -> str:
        """train, test or mixed; of a view, the side of its shape."""
        return split_of_line(self.line)

    def metadata(self) -> dict[str, Any]:
        """Return the line as plain values, and the exposure of its display values."""
        return {
            **msgspec.json.decode(encode(self.line)),
            **({} if self.exposure is None else {"exposure": self.exposure}),
        }

    def arrays(self) -> dict[str, np.ndarray]:
        """Return {name: array} of everything but the display values; radiance is float16."""
        result = {
            "normals": self.geometry.normals,
            "depth": self.geometry.depth,
            "segments": self.geometry.segments,
        }
        if self.radiance is not None and self.labels is not None:
            result |= {"radiance": self.radiance.astype(np.float16), "labels": self.labels}
        return result


class Samples:
    """The lines of a data set or of one split of it, in the order of their ids, and their files.

    Records are exported where there are any, otherwise the views of a data set without pictures.

    lines     PlacedLines: each is read when it is asked for
    counts    what the data card says of them
    left_out  number of views that are not exported because there are records

    Raises  InputError if the data set or the split is empty, or has a line twice
    """

    def __init__(self, store: Store, split: str | None = None):
        self.store, self.dataset = store, store.dataset()
        self.counts = Counts()
        keep = _chooser(split)
        self.lines = PlacedLines(store, "records", keep, self.counts.add)
        if not self.lines and not store.record_files():
            self.lines = PlacedLines(store, "views", keep, self.counts.add)
        if not self.lines:
            raise InputError(
                store.folder, "records to export", "none", "render some, or choose another --split"
            )
        self.lines.require_each_once()  # two samples of one name are an error to `webdataset`
        self.pictures = isinstance(self.lines[0], Record)
        views = store.views(keep) if self.pictures else ()
        self.left_out = sum(1 for _ in views)
        self._labels = (
            {
                name: np.asarray(material.label, np.float32).reshape(-1)
                for name, material in load_catalogue(store.folder / "materials.json").items()
            }
            if self.pictures
            else {}
        )

    def digest(self) -> str:
        """Return a hash of all lines: another one means that the data set has changed."""
        result = hashlib.sha256()
        for line in self.lines:
            result.update(encode(line))
        return result.hexdigest()

    def of_split(self, split: str) -> PlacedLines:
        """Return the lines of a split: train, test or mixed."""
        there = (split_of_line(line) == split for line in self.lines)
        return self.lines.select(np.fromiter(there, bool, len(self.lines)))

    def read(self, line: Record | View) -> Sample:
        """Return a line's Sample. Raises InputError for files that are missing or altered."""
        geometry = read_geometry(
            inside(self.store.folder, line.geometry), line.camera.size, line.geometry_hash
        )
        if isinstance(line, View):
            return Sample(line, None, None, None, geometry, None)
        radiance = read_picture(
            inside(self.store.folder, line.image), line.camera.size, line.image_hash
        )
        if unknown := [name for name in line.materials if name not in self._labels]:
            raise InputError(
                self.store.folder / "materials.json",
                f"the material '{unknown[0]}' of record {line.id}",
                "none of that name",
                "python -m factory verify DIR names all faults",
            )
        exposure = tone.auto_exposure(radiance, geometry.mask)
        display = np.rint(tone.display(radiance, exposure)).astype(np.uint8)
        labels = np.stack([self._labels[name] for name in line.materials])
        return Sample(line, radiance, display, exposure, geometry, labels)


def _chooser(split: str | None) -> Any:
    """Return what keeps the lines of a split, None for all."""
    return None if split is None else lambda line: split_of_line(line) == split


def png_bytes(pixels: np.ndarray) -> bytes:
    """Return display values (height, width, 3) uint8 as the bytes of a PNG file."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG")
    return buffer.getvalue()


def npy_bytes(array: np.ndarray) -> bytes:
    """Return an array as the bytes of an .npy file, which holds no pickle."""
    buffer = io.BytesIO()
    np.save(buffer, np.ascontiguousarray(array), allow_pickle=False)
    return buffer.getvalue()


def licences(dataset: Dataset) -> dict[str, dict[str, int]]:
    """Return {kind of asset: {licence: number of assets}} of a data set."""
    result: dict[str, dict[str, int]] = {}
    for kind in ("shapes", "materials", "lights"):
        counts: dict[str, int] = {}
        for entry in getattr(dataset, kind).values():
            counts[entry.licence] = counts.get(entry.licence, 0) + 1
        result[kind] = dict(sorted(counts.items()))
    return result
