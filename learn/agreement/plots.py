"""The agreement's charts, drawn by matplotlib into PNG files."""

import io
from collections.abc import Iterable, Mapping, Sequence

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from learn.agreement.measure import Row

INK, ACCENT, PALE = "#1f2933", "#2f6f9f", "#c9d6df"
STYLE: dict = {
    "font.size": 9,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e9ed",
    "axes.axisbelow": True,
    "figure.dpi": 130,
    "savefig.bbox": "tight",
}
NAMES = {
    "noise": "Monte-Carlo noise",
    "node_fit": "node fit",
    "footprint": "pixel footprint",
    "look_up": "light look-up",
    "edges": "edges",
    "rest": "rest",
    "texel_sum": "texel sum (paper's)",
}


def draw(summary: Mapping, rows: Iterable[Row]) -> dict[str, tuple[bytes, str]]:
    """Return {file name: (PNG's bytes, caption)} of the charts that the rows allow."""
    own = [row for row in rows if row.tier == "direct" and row.light_resolution == "64x128"]
    made = {}
    with plt.rc_context(STYLE):
        for name, caption, chart in (
            (
                "causes.png",
                "The direct tier's disagreement by cause: display L2 of each",
                lambda ax: causes(ax, summary["causes"]),
            ),
            (
                "materials.png",
                "By material: layer against Cycles net of noise, beside label against nodes",
                lambda ax: materials(ax, summary),
            ),
            (
                "grazing.png",
                "By angle between normal and view, inside the silhouette, net of noise",
                lambda ax: plot_grazing(ax, summary["grazing"]),
            ),
            (
                "highlight.png",
                "Paper's sum and converged integral, by the highlight's width",
                lambda ax: highlight(ax, own),
            ),
        ):
            fig, ax = plt.subplots(figsize=(5.2, 3.2))
            if chart(ax):
                png = io.BytesIO()
                fig.savefig(png, format="png")
                made[name] = png.getvalue(), caption
            plt.close(fig)
    return made


def bars(
    ax: Axes,
    names: Sequence[str],
    values: Sequence[float],
    color: str | Sequence[str] = ACCENT,
    height: float = 0.8,
    label: str = "",
) -> None:
    """Draw horizontal bars, the first name at the top."""
    positions = np.arange(len(names))[::-1]
    ax.barh(positions, values, height, color=color, label=label)
    ax.set_yticks(positions, names)
    ax.grid(axis="y", visible=False)


def causes(ax: Axes, by_cause: Mapping[str, float | None]) -> bool:
    """Draw the display L2 of each cause. Return whether there was one."""
    known = {name: value for key, name in NAMES.items() if (value := by_cause.get(key)) is not None}
    if not known:
        return False
    bars(
        ax,
        list(known),
        list(known.values()),
        color=[PALE if name == NAMES["texel_sum"] else ACCENT for name in known],
    )
    for position, value in zip(np.arange(len(known))[::-1], known.values(), strict=True):
        ax.text(max(value, 0), position, f" {value:.3g}", va="center", fontsize=8)
    ax.set_xlabel("display L2")
    return True


def materials(ax: Axes, summary: Mapping) -> bool:
    """Draw the agreement of each material beside its node fit. Return whether there was one."""
    table = summary["breakdowns"]["material"]
    shown = [(name, cell) for name, cell in table.items() if cell["net"] is not None][:20]
    if not shown:
        return False
    names = [name if len(name) < 28 else name[:27] + "…" for name, _ in shown]
    positions = np.arange(len(shown))[::-1]
    bars(
        ax,
        names,
        [max(cell["net"], 0) for _, cell in shown],
        height=0.6,
        label="layer − Cycles, net of noise",
    )
    fits = [cell["node_fit"] if cell["node_fit"] is not None else np.nan for _, cell in shown]
    ax.plot(fits, positions, "D", color=INK, markersize=4, label="label − nodes (catalogue)")
    ax.set_xlabel("display L2")
    ax.legend(frameon=False, fontsize=7)
    if isinstance(ax.figure, Figure):
        ax.figure.set_size_inches(5.2, 1.0 + 0.22 * max(len(shown), 6))
    return True


def plot_grazing(ax: Axes, bins: Iterable[Mapping]) -> bool:
    """Draw the error by grazing angle. Return whether there were pixels."""
    seen = [cell for cell in bins if cell["pixels"]]
    if not seen:
        return False
    middles = [(cell["from_deg"] + cell["to_deg"]) / 2 for cell in seen]
    ax.bar(
        middles,
        [cell["l2"] for cell in seen],
        width=[cell["to_deg"] - cell["from_deg"] - 1 for cell in seen],
        color=ACCENT,
    )
    ax.set(xlabel="angle between normal and view, degrees", ylabel="display L2", xlim=(0, 90))
    other = ax.twinx()
    other.plot(
        middles, [100 * cell["signed"] for cell in seen], "o-", color=INK, markersize=3, linewidth=1
    )
    other.set_ylabel("signed error, % of the mean")
    other.grid(visible=False)
    other.spines["right"].set_visible(True)
    return True


def highlight(ax: Axes, rows: Iterable[Row]) -> bool:
    """Draw both sums' errors by the highlight's width. Return whether there were two seeds."""
    seen = [
        (max(row.half_width_deg, 0.05), row.sum_net, row.net)
        for row in rows
        if row.net is not None and row.sum_net is not None
    ]
    if not seen:
        return False
    width, of_sum, of_integral = zip(*seen, strict=True)
    for values, colour, label in (
        (of_sum, "#c2703d", "paper's sum"),
        (of_integral, ACCENT, "converged integral"),
    ):
        ax.loglog(
            width,
            [max(value, 1e-3) for value in values],
            "o",
            color=colour,
            markersize=4,
            alpha=0.7,
            label=label,
        )
    ax.set(
        xlabel="half-width of the highlight, degrees of half angle",
        ylabel="display L2 net of noise",
    )
    ax.legend(frameon=False, fontsize=8)
    return True
