"""A fault of a data set: what is wrong, and what has to go so that the same `render` makes it
again.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from manifests.errors import printable

Line = tuple[Path, int]  # file and number, from 1, of a line


@dataclass(frozen=True)
class Fault:
    """What is wrong, in one line, and what `repair` removes for it; nothing where only a person can
    mend it.

    record  id of the record or view that is condemned, None: the fault is of the folder
    line    (file, number from 1) of the line that goes
    file    a damaged or stray file, link or pipe that goes
    stray   whether that file is one that nothing names
    entry   (kind, name) of an entry of dataset.json that goes, kind "shapes", "materials" or
    "lights";
            or of materials.json, kind "labels"
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
    """How many faults are of records and views, how many of stray files, how many of anything
    else.
    """
    counts = Counter("stray" if f.stray else "record" if f.record else "other" for f in faults)
    return counts["record"], counts["stray"], counts["other"]
