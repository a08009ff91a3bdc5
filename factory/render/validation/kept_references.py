"""References that are kept in files, so that a repeated measurement does not render them again.

The first samples are rendered in any case. Only where they equal those of the file, bit by bit,
are its other samples used: so a file of another machine, another Blender, another scene setup or a
mesh that was changed is not used.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from factory.render.estimators.halves import Halves
from factory.render.estimators.renderer import Portion, Shown
from manifests.files import npz_bytes, write_bytes

if TYPE_CHECKING:
    from factory.render.validation.scenes import Scene

FIRST = 4  # samples of each half that say whether a file is of the same scene


class KeptReference(Halves):
    """Halves whose samples are read from a file and written to it whenever they grow.

    path  of a .npz file, which need not exist
    """

    def __init__(self, shown: Shown, path: Path):
        super().__init__(shown)
        self._path = path
        super().grow(FIRST)
        self._first = self.means
        stored = _read(path)
        if stored and all(
            np.array_equal(a, b)
            for half, other in zip(self._first, stored[0], strict=True)
            for a, b in zip(half, other, strict=True)
        ):
            self.resume(*stored[1:])

    def grow(self, count: int) -> None:
        """Render `count` further samples of each half, and write all of them."""
        super().grow(count)
        arrays = {"samples": np.array(self.samples)}
        for key, halves in (("first", self._first), ("mean", self.means)):
            for number, half in enumerate(halves):
                arrays |= {f"{key}_{number}_{name}": a for name, a in half._asdict().items()}
        self._path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(self._path, npz_bytes(arrays))


def path_of(folder: Path, scene: Scene, size: int) -> Path:
    """Return where a scene's reference is kept; the error requested of its pictures is no part."""
    words = {key: value for key, value in asdict(scene).items() if key != "requested"}
    text = json.dumps(words | {"size": size}, sort_keys=True)
    return folder / f"{hashlib.blake2b(text.encode(), digest_size=12).hexdigest()}.npz"


def _read(path: Path) -> tuple[list[Portion], int, list[Portion]] | None:
    """Return a file's first portions, its samples and their means; None if it has no such."""
    try:
        with path.open("rb") as data, np.load(data, allow_pickle=False) as file:
            first, mean = (
                [
                    Portion(*(file[f"{key}_{half}_{name}"] for name in Portion._fields))
                    for half in (0, 1)
                ]
                for key in ("first", "mean")
            )
            return first, int(file["samples"]), mean
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile):
        return None
