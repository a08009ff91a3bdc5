"""The ladder's chart: normals, light and edits over the rungs."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from learn.evaluation.ladder_design import OUTSIDE_GROUP
from learn.evaluation.ladder_lines import Figures, groups, rungs, select

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {
    "own families": "#2f6f9f",
    "general families of training": "#8a6fb0",
    "held-out families": "#b3402a",
    "outside meshes": "#2e7d4f",
}
FIGURES: tuple[tuple[str, str, Callable[[Mapping], float]], ...] = (
    ("normals", "normals, mean angle (°)", lambda line: line["predicted"]["normals_mean_deg"]),
    ("irradiance", "light, irradiance error", lambda line: line["predicted"]["irradiance"]),
    ("edit", "edits, display L2", lambda line: line["predicted"]["edit_l2"]),
)


def chart(lines: Sequence[Mapping], side: str) -> "Figure":
    """Return the figure: normals, light and edits over the rungs, one line per group."""
    from matplotlib.figure import Figure as Drawing

    figure = Drawing(figsize=(13, 4.4), layout="constrained", dpi=110)
    shown, steps = groups(lines), rungs(lines)
    axes = figure.subplots(1, len(FIGURES))
    for place, (_, title, get) in zip(axes, FIGURES, strict=True):
        for number, group in enumerate(shown):
            _draw(place, lines, group, get, (number - (len(shown) - 1) / 2) * 0.08)
        place.set_title(title, fontsize=11)
        place.set_xticks(range(len(steps)), [rung.name for rung in steps])
        place.axvspan(-0.4, 0.4, color="0.94", zorder=0)
        place.set_xlim(-0.4, len(steps) - 0.6)
        place.set_ylim(0, 1.1 * place.get_ylim()[1])
        place.grid(axis="y", alpha=0.3)
        for edge in ("top", "right"):
            place.spines[edge].set_visible(False)
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    figure.suptitle(
        f"Predictions on the {side} side; each rung adds one thing (bars: 95 % intervals; grey:"
        " the picture the layer itself can compute)",
        fontsize=10,
    )
    return figure


def _draw(
    place: "Axes",
    lines: Sequence[Mapping],
    group: str,
    get: Callable[[Mapping], float],
    shift: float,
) -> None:
    points = [
        (number + shift, *(interval if isinstance(interval, list) else [interval] * 3))
        for number, rung in enumerate(rungs(lines))
        if (here := select(lines, rung.name, group))
        and (interval := Figures(here).interval(get)) is not None
    ]
    x, mean, low, high = np.array(points).T
    marker = "s--" if group == OUTSIDE_GROUP else "o-"
    place.errorbar(
        x,
        mean,
        [np.maximum(mean - low, 0), np.maximum(high - mean, 0)],
        fmt=marker,
        color=COLOURS[group],
        capsize=3,
        lw=1.6,
        ms=5,
        label=group,
    )
