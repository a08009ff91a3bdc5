"""A table of the evaluation as plain JSON, and the rows of figures that it is made from."""

from collections.abc import Iterable, Sequence
from typing import TypedDict

import numpy as np

from learn.metrics import bootstrap

# [mean, low, high], a number, a word, or None where a method has no such figure
Cell = list[float] | float | str | None


class Column(TypedDict):
    """A column: key of its cells, label with an arrow towards better, digits after the point."""

    key: str
    label: str
    digits: int
    interval: bool


class TableRow(TypedDict):
    """A row of a table."""

    name: str
    cells: dict[str, Cell]


class Table(TypedDict):
    """A table as it is in report.json."""

    title: str
    note: str
    columns: list[Column]
    rows: list[TableRow]


def column(key: str, label: str, digits: int = 3, interval: bool = False) -> Column:
    """Return a column; interval: whether intervals are shown."""
    return {"key": key, "label": label, "digits": digits, "interval": interval}


class Rows:
    """Figures of many pictures or edits, and their weights in each bootstrap draw.

    material  the key of a row's material names
    """

    def __init__(self, rows: Sequence[dict], material: str):
        self.rows = rows
        names = [
            ["+".join(dict.fromkeys(row[material])) for row in rows],
            [row["shape"] for row in rows],
            [row["light"] for row in rows],
        ]
        self.weights = (
            bootstrap.draws(bootstrap.groups_of(*reversed(names))) if rows else np.zeros((0, 0))
        )
        # a single shape or material cannot be drawn differently; with a single light the interval
        # holds for this light
        self.enough = all(len(set(each)) > 1 for each in names[:2])

    def values(self, method: str, path: Sequence[str]) -> np.ndarray:
        """Return one figure (P,) float64, NaN where a row has none; path: keys below the method."""
        result = np.full(len(self.rows), np.nan)
        for i, row in enumerate(self.rows):
            value = row["methods"].get(method, {})
            for key in path:
                value = value.get(key) if isinstance(value, dict) else None
            if value is not None:
                result[i] = value
        return result

    def cell(self, method: str, path: Sequence[str]) -> list[float] | None:
        """Return [mean, low, high] over the rows that have the figure; None if none has."""
        return self.interval(self.values(method, path))

    def interval(self, values: np.ndarray) -> list[float] | None:
        """Return [mean, low, high] of values (P,), those that are NaN left out."""
        present = np.isfinite(values)
        return bootstrap.interval(values[present], self.draws(present)) if present.any() else None

    def draws(self, present: np.ndarray) -> np.ndarray:
        """Return the weights (D, Q) of the Q rows that are present (P,) bool."""
        if present.all():
            return self.weights
        weights = self.weights[:, present]
        return weights[weights.sum(1) > 0]

    def methods(self) -> list[str]:
        """Return the methods' names in order of their first row."""
        return list(dict.fromkeys(name for row in self.rows for name in row["methods"]))


def table(title: str, note: str, columns: Iterable[Column], rows: list[TableRow]) -> Table | None:
    """Return a table without the columns that no row fills; None without rows."""
    filled = [c for c in columns if any(row["cells"].get(c["key"]) is not None for row in rows)]
    if not rows or not filled:
        return None
    return {"title": title, "note": note, "columns": filled, "rows": rows}
