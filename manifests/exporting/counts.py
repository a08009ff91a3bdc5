"""What a data card counts, gathered line after line, so that no line needs to stay in memory."""

from collections import Counter

from manifests.exporting.card_errors import Errors
from manifests.schema import Record, View


class Counts:
    """How many lines there are of each kind.

    splits            {train, test or mixed: number of lines}
    sizes             {(height, width): number of lines}
    tiers             {tier: number of pictures}
    shapes, materials, lights   names that lines have
    errors            estimated errors of the pictures
    """

    def __init__(self) -> None:
        self.splits: Counter[str] = Counter()
        self.sizes: Counter[tuple[int, int]] = Counter()
        self.tiers: Counter[str] = Counter()
        self.shapes: set[str] = set()
        self.materials: set[str] = set()
        self.lights: set[str] = set()
        self.errors = Errors()

    def add(self, line: Record | View) -> None:
        """Count a line."""
        self.splits[split_of_line(line)] += 1
        self.sizes[line.camera.size] += 1
        self.shapes.add(line.shape)
        if isinstance(line, Record):
            self.tiers[line.tier] += 1
            self.materials.update(line.materials)
            self.lights.add(line.light)
            self.errors.add(line)


def split_of_line(line: Record | View) -> str:
    """Return train, test or mixed; of a view, the side of its shape."""
    return line.split if isinstance(line, Record) else line.side
