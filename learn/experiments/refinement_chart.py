"""The chart of learn.experiments.refinement_ablation: what each weight does."""

from learn.experiments.refinement_ablation import FIGURES, SWEEPS, value_of
from manifests.files import write_figure

LABELS = (
    "re-rendering, display L2",
    "edit, display L2",
    "normals, mean angle (°)",
    "irradiance, relative error",
)


def chart(report, path):
    """Figures after refinement against each weight, beside those before; the default is shaded
    where it was moved too. None moved: none.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    letters = [letter for letter in SWEEPS if any(name.startswith(f"{letter}=") for name in report)]
    if not letters:
        return
    figure, axes = plt.subplots(
        len(FIGURES),
        len(letters),
        figsize=(2.6 * len(letters), 9),
        squeeze=False,
        sharey="row",
        sharex="col",
    )
    for j, letter in enumerate(letters):
        swept = sorted(
            (float(name.partition("=")[2]), name)
            for name in report
            if name.startswith(f"{letter}=")
        )
        values = [value for value, _ in swept]
        for i, (key, label) in enumerate(zip(FIGURES, LABELS, strict=True)):
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
    figure.tight_layout()
    write_figure(path, figure, dpi=100)
    plt.close(figure)
