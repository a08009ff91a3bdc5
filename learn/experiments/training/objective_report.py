"""What objective_ablation reports: figures of each variant, their ratios to all terms, a chart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from learn.experiments import runner
from learn.experiments.training import ratio_chart

if TYPE_CHECKING:
    from matplotlib.figure import Figure


REFERENCE, AGAIN = "all terms", "all terms again"
FROM_WEIGHTS = "weights"
GLOSSY = (
    " Training and test draw from materials with narrow lobes alone, and the test's pictures are"
    " rendered by the integral (`quadrature`)."
)
FIGURES = {
    "angle_deg": "normals, mean angle (°)",
    "albedo": "material, log albedo error",
    "irradiance": "light, relative irradiance error",
    "image_l2": "I′, display L2",
    "target_l2": "edit O′, display L2",
}
DIGITS = {"angle_deg": 2, "albedo": 3, "irradiance": 3, "image_l2": 0, "target_l2": 0}


def summary(results: Mapping[str, Mapping[str, list]], about: Mapping[str, Any]) -> runner.Report:
    """Return each variant's figures, and their ratios to all terms, with 95 % intervals.

    results  {start: {variant: [result of variants.train_and_measure]}}
    """
    from learn.experiments.training import variants

    initialisations: dict[str, Any] = {}
    for start, of_start in results.items():
        reference = of_start[REFERENCE]
        initialisations[start] = {
            name: {
                "figures": variants.figures(result),
                "ratios": {key: variants.ratio(reference, result, key) for key in FIGURES},
                "steps": result[0]["steps"],
                "milliseconds": 1e3 * result[0]["seconds"] / max(result[0]["steps"], 1),
            }
            for name, result in of_start.items()
        }
    pictures = len(next(iter(results.values()))[REFERENCE][0]["rows"])
    return {"initialisations": initialisations, "about": {**about, "pictures": pictures}}


def tables(report: runner.Report) -> str:
    """Return each variant's figures and its ratios to all terms, from nothing and from weights."""
    about = report["about"]
    train, test = about["train"], about["test"]
    is_again = any(AGAIN in of_start for of_start in report["initialisations"].values())
    parts = [
        "# What the rendered pictures and the reflectance map bring to training (Section 4.3)",
        *report["seen"],
        f"{about['steps']} steps of {about['batch']} pictures of {about['size']}² pixels of the run"
        f" `{about['run']}`, one training of each variant. Training drew from {train['shapes']:,}"
        f" shapes and {train['lights']} light maps. Measured on {about['pictures']} pictures of"
        f" {test['shapes']} shapes, {test['materials']} materials and {test['lights']} light maps"
        " that are never seen, with everything predicted. Means with 95 % intervals over shapes"
        " and materials, which do not cover another training of the same variant"
        + (f": `{AGAIN}` shows what other random numbers do." if is_again else ".")
        + GLOSSY * about.get("glossy", False),
    ]
    for start, of_start in report["initialisations"].items():
        begins = f"the weights {about['start']}" if start == FROM_WEIGHTS else "nothing"
        learning_rate = about["learning_rates"][start]
        head = ["variant", *FIGURES.values(), "steps", "processor time of a step"]
        rows = [
            [
                name,
                *(runner.interval(row["figures"][key], DIGITS[key]) for key in FIGURES),
                row["steps"],
                f"{row['milliseconds']:.0f} ms" if row["steps"] else "–",
            ]
            for name, row in of_start.items()
        ]
        ratios = [
            [name, *(runner.interval(row["ratios"][key]) for key in FIGURES)]
            for name, row in of_start.items()
            if name != REFERENCE
        ]
        parts += [
            f"## From {begins}, learning rate {learning_rate:g}",
            runner.table(head, rows),
            f"Ratios to `{REFERENCE}` on the same pictures; below 1 is better:",
            runner.table(["variant", *FIGURES.values()], ratios),
        ]
    parts += [f"Left out: {name}. {reason}" for name, reason in report["left_out"].items()]
    return "\n\n".join(part.rstrip() for part in parts) + "\n"


def figure(report: runner.Report) -> Figure:
    """Return a chart of each variant's ratios to all terms, with their intervals."""
    from matplotlib.figure import Figure

    of_starts = report["initialisations"]
    longest = max(len(of_start) for of_start in of_starts.values())
    drawn = Figure(
        figsize=(2.4 * len(FIGURES) + 2, len(of_starts) * (0.3 * longest + 0.8)),
        layout="constrained",
    )
    axes = drawn.subplots(len(of_starts), len(FIGURES), squeeze=False, sharey="row")
    for line, (start, of_start) in zip(axes, of_starts.items(), strict=True):
        names = [name for name in of_start if name != REFERENCE]
        for axis, (key, label) in zip(line, FIGURES.items(), strict=True):
            ratio_chart.draw_ratios(
                axis, label, {name: of_start[name]["ratios"][key] for name in names}
            )
        line[0].set_ylabel(f"from {start}", fontsize=9)
        line[0].invert_yaxis()
    drawn.suptitle(f"ratio to {REFERENCE}, with 95 % intervals", fontsize=10)
    return drawn
