"""The lines of a ladder's report: by rung and group, and their figures with intervals.

Intervals of 95 % are by bootstrap; whole shapes, target materials and lights are drawn with
replacement.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from learn.evaluation.ladder_design import GROUPS, RUNGS, Rung
from learn.metrics import bootstrap


class Figures:
    """The lines of one rung and group, and their weights in each bootstrap draw."""

    def __init__(self, lines: Sequence[Mapping]):
        self.lines = lines
        names = [[line[key] for line in lines] for key in ("shape", "target", "light")]
        self.weights = bootstrap.draws(bootstrap.groups_of(*names))
        # a single shape, material or light cannot be drawn differently
        self.enough = all(len(set(each)) > 1 for each in names)

    def values(self, get: Callable[[Mapping], float | None]) -> np.ndarray:
        """Return a figure (P,) float64, NaN where a line has none."""
        values = [get(line) for line in self.lines]
        return np.array([np.nan if value is None else value for value in values], np.float64)

    def interval(
        self, get: Callable[[Mapping], float | None], kept: np.ndarray | None = None
    ) -> list[float] | float | None:
        """Return [mean, low, high] over the lines that have the figure; None if none has.

        Of a single shape, material or light the mean alone is returned.

        kept  (P,) bool, the lines that count; None: all
        """
        values = self.values(get)
        present = np.isfinite(values) & (True if kept is None else kept)
        if not present.any():
            return None
        if not self.enough:
            return float(values[present].mean())
        weights = self.weights[:, present]
        return bootstrap.interval(values[present], weights[weights.sum(1) > 0])


def groups(lines: Sequence[Mapping]) -> list[str]:
    """Return those of GROUPS that the lines have."""
    return [group for group in GROUPS if any(line["group"] == group for line in lines)]


def rungs(lines: Sequence[Mapping]) -> list[Rung]:
    """Return those of RUNGS that the lines have; the second test side has two."""
    names = {line["rung"] for line in lines}
    return [rung for rung in RUNGS if rung.name in names]


def select(lines: Sequence[Mapping], rung: str, group: str) -> list[Mapping]:
    """Return the lines of a rung and a group."""
    return [line for line in lines if (line["rung"], line["group"]) == (rung, group)]


def figure_of(kind: str, key: str) -> Callable[[Mapping], float]:
    """Return a function of a line: the figure `key` of its "predicted" or "refined"."""
    return lambda line: line[kind][key]
