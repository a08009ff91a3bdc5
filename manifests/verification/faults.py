"""Faults of a data set: what is wrong, and what `repair` removes for it."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from manifests.errors import printable

Line = tuple[Path, int]  # file and number, from 1, of a line


@dataclass(frozen=True)
class Fault:
    """What is wrong, in one line, and what `repair` removes for it.

    A fault for which nothing is removed can be mended by a person alone.

    record  id of the record or view that is at fault, None: the fault is of the folder
    line    (file, number from 1) of the line to remove
    file    a damaged or stray file, link or pipe to remove
    stray   whether that file is one that nothing names
    entry   (kind, name) of an entry of dataset.json to remove, kind "shapes", "materials" or
            "lights"; or of materials.json, kind "labels"
    """

    text: str
    record: str | None = None
    line: Line | None = None
    file: Path | None = None
    stray: bool = False
    entry: tuple[str, str] | None = None

    def __post_init__(self):
        object.__setattr__(self, "text", printable(self.text))  # names come from outside

    @property
    def mendable(self) -> bool:
        """Whether `repair` removes something for it."""
        return not (self.line is None and self.file is None and self.entry is None)


def summary(faults: Iterable[Fault]) -> tuple[int, int, int]:
    """Return the numbers of faults of records and views, of stray files, and of anything else."""
    counts = Counter("stray" if f.stray else "record" if f.record else "other" for f in faults)
    return counts["record"], counts["stray"], counts["other"]
