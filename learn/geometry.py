"""A dataset's geometry, packed for training: each view of each shape once, with pictures (records) or without (views).

V views, H, W picture. Beside a dataset's lines stands a cache of two memory-mapped arrays, five bytes a pixel, made on first use and
again when they change:

packed/normals.npy   (V, H, W, 2) int16, n_x and n_y in units of 1/32767; n_z = √(1 − n_x² − n_y²), for normals face the viewer;
                     a normal is turned by .002° where it faces the viewer and by .5° at most, at the rim
packed/segments.npy  (V, H, W) uint8, 1 … S, 0 in the background
packed/views.json    the geometry files' hashes, by which a stale cache is known
"""

import json
import os
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
from tqdm import tqdm

from learn.dataset import Records
from manifests.problems import Problem

UNIT = 32767
UNIT_TOLERANCE = 1e-2  # of |n|; files keep it to 1e-4
LEAST_COVERAGE = 0.02  # a view that shows less of its shape teaches nothing


@dataclass(frozen=True)
class View:
    """One view of one shape: names as in its records, the geometry file's hash, the shape's side of the split."""

    shape: str
    category: str
    viewpoint: int
    side: str
    hash: str


class Geometry:
    """The views of a dataset rendered with one orthographic camera.

    Raises  Problem: no dataset, nothing rendered, cameras of several sizes or with perspective; damaged geometry when it is packed
    """

    def __init__(self, folder, progress=True):
        records = Records(folder)
        first = {}
        for record in chain(records.store.views(), records.records):
            if record.coverage >= LEAST_COVERAGE:
                first.setdefault(record.geometry_hash, record)
        if not first:
            raise Problem(folder, "views or records", "none", f"render some: python -m factory render geometry --out {folder}")
        chosen = sorted(first.values(), key=lambda r: (r.shape, r.viewpoint, r.geometry_hash))
        cameras = {(r.camera.size, r.camera.fov_deg, r.camera.elevation_deg) for r in chosen}
        if len(cameras) > 1 or chosen[0].camera.fov_deg is not None:
            raise Problem(folder, "one orthographic camera everywhere", f"{sorted(map(str, cameras))}", "render them with one job")
        self.folder, self.size = Path(folder), chosen[0].camera.size
        self.elevation = float(np.radians(chosen[0].camera.elevation_deg))
        sides = {name: entry.side for name, entry in records.dataset.shapes.items()}
        self.views = [View(r.shape, r.category, r.viewpoint, sides[r.shape], r.geometry_hash) for r in chosen]
        if not self._is_fresh():
            self._pack(records, chosen, progress)
        self._n = np.load(self._at("normals.npy"), mmap_mode="r", allow_pickle=False)
        self._segments = np.load(self._at("segments.npy"), mmap_mode="r", allow_pickle=False)

    def __len__(self):
        return len(self.views)

    def normals(self, index):
        """(H, W, 3) float32 unit normals, camera frame; 0 in the background."""
        xy = self._n[index].astype(np.float32) / UNIT
        z = np.sqrt(np.clip(1.0 - (xy * xy).sum(-1, keepdims=True), 0.0, 1.0))
        return np.concatenate([xy, z], -1) * (self._segments[index] > 0)[..., None]

    def segments(self, index):
        """(H, W) int64: 1 … S, 0 in the background."""
        return self._segments[index].astype(np.int64)

    def _at(self, name):
        return self.folder / "packed" / name

    def _is_fresh(self):
        try:
            hashes = json.loads(self._at("views.json").read_text())
        except (OSError, ValueError):
            return False
        return hashes == [view.hash for view in self.views]

    def _pack(self, records, chosen, progress):
        self.folder.joinpath("packed").mkdir(exist_ok=True)
        n = np.zeros((len(chosen), *self.size, 2), np.int16)
        segments = np.zeros((len(chosen), *self.size), np.uint8)
        for i, record in enumerate(tqdm(chosen, "packing geometry", unit="view", disable=not progress, leave=False)):
            normals, _, segments[i] = records.geometry(record)
            lengths = np.linalg.norm(normals[segments[i] > 0], axis=-1)
            if not np.abs(lengths - 1).max(initial=0.0) < UNIT_TOLERANCE:  # so asked, NaN is refused too
                remedy = "python -m factory verify DIR --repair, then render again"
                raise Problem(self.folder / record.geometry, "unit normals", f"lengths {lengths.min():.4f}–{lengths.max():.4f}", remedy)
            n[i] = np.rint(normals[..., :2] * UNIT)
        for name, array in (("normals.npy", n), ("segments.npy", segments)):
            _replace(self._at(name), lambda file, array=array: np.save(file, array, allow_pickle=False))
        _replace(self._at("views.json"), lambda file: file.write(json.dumps([v.hash for v in self.views]).encode()))


def _replace(path, write):
    """Write a file under another name, then give it its own: a reader sees all of it or nothing."""
    temporary = path.with_name(f"{path.name}.{os.getpid()}")
    with open(temporary, "wb") as file:
        write(file)
    temporary.replace(path)
