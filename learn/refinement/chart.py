"""The chart of learn.refinement.study: what each weight does."""

from learn.refinement.study import FIGURES, SWEEPS, about

LABELS = ("re-rendering, display L2", "edit, display L2", "normals, mean angle (°)", "irradiance, relative error")


def chart(told, path):
    """Median figures after refinement against each weight, over those before; the default's value is marked. No weight moved: no chart."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    letters = [letter for letter in SWEEPS if any(name.startswith(f"{letter}=") for name in told)]
    if not letters:
        return
    figure, axes = plt.subplots(len(FIGURES), len(letters), figsize=(4 * len(letters), 10), squeeze=False, sharey="row")
    for j, letter in enumerate(letters):
        swept = sorted((float(name.partition("=")[2]), name) for name in told if name.startswith(f"{letter}="))
        for i, (key, label) in enumerate(zip(FIGURES, LABELS, strict=True)):
            axis = axes[i][j]
            axis.plot([x for x, _ in swept], [told[name][key][1] for _, name in swept], "o-", label="refined, median")
            axis.plot([x for x, _ in swept], [told[name][key][3] for _, name in swept], "x:", label="refined, mean")
            axis.axhline(told[swept[0][1]][key][0], color="grey", label="predicted, median")
            axis.axvline(getattr(about(letter), letter[-1]), color="grey", linewidth=0.5)
            axis.set_xscale("symlog", linthresh=1e-3)
            axis.set_ylim(bottom=0)
            axis.set_xlabel(letter)
            if j == 0:
                axis.set_ylabel(label)
    axes[0][0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    plt.close(figure)
