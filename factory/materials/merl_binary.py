"""A user's own MERL measurements: a folder of `.binary` files, or one of them.

File     int32 n_h, n_d, n_φ (90, 90, 180), then n_h · n_d · n_φ doubles for each of red, green,
         blue, φ_d fastest, then θ_d, then θ_h
Index    θ_h bin = sqrt(θ_h / (π/2)) n_h, θ_d bin = θ_d / (π/2) n_d, φ_d over [0, π) (f is the same
         at φ_d + π)
Scale    red 1/1500, green 1.15/1500, blue 1.66/1500; negative: not measured

Values are averaged over φ_d as for every source here: a function of (θ_h, θ_d). Cells without any
measurement take the nearest one at the same θ_d. Source: Matusik, Pfister, Brand, McMillan 2003 and
the reader that comes with the data.
"""

import struct
from pathlib import Path

import numpy as np

from manifests.errors import InputError
from manifests.inputs import require_file
from manifests.wording import number_of

SCALE = np.array([1.0, 1.15, 1.66]) / 1500
SUFFIX = ".binary"
HEADER = struct.Struct("<3i")
MAX_SIDE = (
    720  # the database has 90, 90, 180; a finer step than a quarter of a degree is a damaged header
)
MAX_CELLS = 4 * 90 * 90 * 180


class TabulatedBRDF:
    """One material, callable with cos_h, cos_d; f (…, 3) in 1/sr, bilinear between cells."""

    def __init__(self, table: np.ndarray) -> None:
        self.table = table  # (n_h, n_d, 3)

    def __call__(self, cos_h: np.ndarray, cos_d: np.ndarray) -> np.ndarray:
        n_h, n_d = self.table.shape[:2]
        theta_h, theta_d = (
            np.arccos(np.clip(np.asarray(c, float), 0, 1))
            for c in np.broadcast_arrays(cos_h, cos_d)
        )
        i, di = _between(np.sqrt(theta_h * 2 / np.pi) * n_h - 0.5, n_h)
        j, dj = _between(theta_d * 2 / np.pi * n_d - 0.5, n_d)
        di, dj, t = di[..., None], dj[..., None], self.table
        return (t[i, j] * (1 - dj) + t[i, j + 1] * dj) * (1 - di) + (
            t[i + 1, j] * (1 - dj) + t[i + 1, j + 1] * dj
        ) * di


def _between(position, count):
    """Return lower cell and fraction; clamped at the ends."""
    position = np.clip(position, 0, count - 1)
    low = np.minimum(position.astype(int), count - 2)
    return low, position - low


def read(path: Path) -> TabulatedBRDF:
    """Return the TabulatedBRDF of one file.

    Raises  InputError, one line, for any other file; values are read after the size is checked
    """
    require_file(path, "a MERL .binary file")
    size = path.stat().st_size
    with open(path, "rb") as file:
        head = file.read(HEADER.size)
        if len(head) < HEADER.size:
            raise InputError(
                path,
                f"a header of {HEADER.size} bytes",
                number_of(len(head), "byte"),
                "copy the file again",
            )
        sides = HEADER.unpack(head)
        if not all(2 <= n <= MAX_SIDE for n in sides) or sides[0] * sides[1] * sides[2] > MAX_CELLS:
            raise InputError(
                path,
                "a header of three sizes such as 90, 90, 180",
                ", ".join(map(str, sides)),
                "is this a MERL .binary file?",
            )
        expected = HEADER.size + 3 * 8 * sides[0] * sides[1] * sides[2]
        if size != expected:
            raise InputError(
                path,
                f"{expected} bytes after such a header",
                str(size),
                "the file is cut short or not MERL's: copy it again",
            )
        values = np.fromfile(file, "<f8").reshape(3, *sides)
    if not np.isfinite(values).all():
        raise InputError(path, "finite values", "one that is none", "copy the file again")
    measured = values >= 0
    count = measured.sum(-1)
    table = np.where(measured, values, 0).sum(-1) / np.maximum(count, 1)
    if not count.any(axis=1).all():
        raise InputError(
            path,
            "a measurement at every θ_d",
            "a θ_d without any",
            "the file holds too little to fit",
        )
    table = _fill_unknown(table, count > 0)
    return TabulatedBRDF(np.moveaxis(table * SCALE[:, None, None], 0, -1))


def _fill_unknown(table, known):
    """Return (3, n_h, n_d) with unknown cells filled.

    They take the value of the nearest known θ_h of the same channel and θ_d.
    """
    rows = np.arange(table.shape[1])
    filled = table.copy()
    for c, j in zip(*np.nonzero(~known.all(1)), strict=True):
        there = rows[known[c, :, j]]
        filled[c, :, j] = table[c, there[np.argmin(np.abs(rows[:, None] - there), axis=1)], j]
    return filled


def files(path: Path) -> dict[str, Path]:
    """Return {name: path} of a folder's `.binary` files, or of the one file.

    Raises  InputError where there are none
    """
    result = [path] if path.is_file() else sorted(path.glob(f"*{SUFFIX}"))
    if not result:
        raise InputError(path, f"files that end in {SUFFIX}", "none", "give MERL's brdfs folder")
    return {file.stem: file for file in result}
