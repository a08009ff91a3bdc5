"""The chart of refinement_ablation: figures before and after refinement for each swept value."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from learn.experiments.editing.refinement_sweep import FIGURES, SWEEPS, value_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw(report: dict[str, Any]) -> Figure | None:
    """Return a chart of each swept value, with the default shaded where it was swept too.

    report   {setting: figures} of learn.experiments.editing.refinement_sweep.summary
    Returns  None if no setting of SWEEPS is there
    """
    from matplotlib.figure import Figure

    letters = [letter for letter in SWEEPS if any(name.startswith(f"{letter}=") for name in report)]
    if not letters:
        return None
    drawn = Figure(figsize=(2.6 * len(letters), 9), layout="constrained")
    axes = drawn.subplots(len(FIGURES), len(letters), squeeze=False, sharey="row", sharex="col")
    for j, letter in enumerate(letters):
        swept = sorted(
            (float(name.partition("=")[2]), name)
            for name in report
            if name.startswith(f"{letter}=")
        )
        values = [value for value, _ in swept]
        for i, (key, label) in enumerate(FIGURES.items()):
            axis = axes[i][j]
            before, after, mean_before, mean_after = zip(
                *(report[name][key] for _, name in swept), strict=True
            )
            axis.plot(after, "o-", color="C0", label="refined, median")
            axis.plot(mean_after, "x:", color="C1", label="refined, mean")
            axis.axhline(before[0], color="C0", linewidth=0.8, label="predicted, median")
            axis.axhline(
                mean_before[0], color="C1", linewidth=0.8, linestyle=":", label="predicted, mean"
            )
            if value_of(letter) in values:
                axis.axvspan(
                    *(values.index(value_of(letter)) + side for side in (-0.2, 0.2)),
                    color="0.92",
                    zorder=0,
                )
            axis.set_xticks(range(len(values)), [f"{value:g}" for value in values])
            if j == 0:
                axis.set_ylabel(label)
        axes[-1][j].set_xlabel(letter)
    for row in axes:
        row[0].set_ylim(bottom=0)
    axes[0][0].legend(fontsize=7)
    return drawn
