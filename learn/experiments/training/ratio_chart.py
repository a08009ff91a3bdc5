"""One panel of a chart of ratios, as the ablations draw it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_ratios(
    axis: Axes, title: str, ratios: Mapping[str, Sequence[float]], size: float = 8
) -> None:
    """Draw ratios {name: [mean, low, high]} with their intervals below each other, beside 1.

    size  of the letters, in points
    """
    for i, (mean, low, high) in enumerate(ratios.values()):
        axis.plot([low, high], [i, i], color="#345", lw=2)
        axis.plot(mean, i, "o", color="#345")
    axis.axvline(1, color="#999", lw=1)
    axis.set_title(title, fontsize=size)
    axis.set_yticks(range(len(ratios)), ratios, fontsize=size)
    axis.tick_params(axis="x", labelsize=size)
