"""The text of a card, card.md, from the report that learn.evaluation.model_card measures."""

from collections.abc import Mapping
from typing import Any

Report = Mapping[str, Any]  # card.json

WORDS = {
    "angle_deg": "normals, mean angle (°)",
    "cosine": "normals, mean cosine",
    "irradiance": "irradiance, relative error",
    "constant_irradiance": "the same of a constant light",
    "albedo": "material, log albedo, root mean square error",
    "constant_albedo": "the same of the training materials' mean",
    "image_l2": "I′, display L2 over the mask",
    "target_l2": "O′, display L2 over the mask",
    "plain_angle_deg": "normals without patterns, mean angle (°)",
    "printed_angle_deg": "normals under patterns, mean angle (°)",
    "ratio": "ratio of the two",
    "control_l2": "the same with predicted normals and a constant light",
}
HEAD = ["| | mean | 95 % |", "|---|---|---|"]


def markdown(report: Report) -> str:
    """Return card.md of the content of card.json."""
    run = report["run"]
    lines = [f"# {run['name']}: {run.get('about', '')}", ""]
    for sentence in report.get("seen", ()):
        lines += [f"**{sentence}**", ""]
    lines += [
        *_lines_of_training(report),
        "",
        *_lines_of_relit(report),
        *_lines_of_rendered(report),
        *_lines_of_patterns(report),
        "",
        report["note"],
        "",
        (
            "Rows of sheet.jpg: picture, predicted and true normals, predicted and true light, true"
            " and predicted material, I′, O′, true O."
        ),
    ]
    return "\n".join(lines) + "\n"


def _lines_of_training(report: Report) -> list[str]:
    """The size of the network and of its run, and a table of what each side is drawn from."""
    run, sizes = report["run"], report["sizes"]
    lines = [
        (
            f"{sizes['parameters'] / 1e6:.1f} M parameters, {run['size']} × {run['size']} pixels,"
            f" {_steps(report)} of {run['schedule']['batch']} relit pictures."
        ),
        "",
        "| side | shapes | views | materials | light maps |",
        "|---|---|---|---|---|",
    ]
    for side in ("train", "validation", "test"):
        s = sizes[side]
        lines.append(
            f"| {side} | {s['shapes']} | {s['views']} | {s['materials']} | {s['lights']} |"
        )
    return lines


def _lines_of_relit(report: Report) -> list[str]:
    unseen = "not all of them unseen, as said above" if _overlaps(report) else "never seen"
    return [
        (
            f"On {report['pictures']} pictures of the test side (shapes, materials and lights"
            f" {unseen}; relit by the layer, so without shadows, interreflection or a camera's"
            " faults), mean and 95 % interval over shapes and materials:"
        ),
        "",
        *HEAD,
        *_rows(report["figures"]),
        *_rows_of_seeds(report, "figures_seeds"),
    ]


def _lines_of_rendered(report: Report) -> list[str]:
    if "cycles" not in report:
        return []
    return [
        "",
        (
            f"On {report['cycles_pictures']} pictures that Cycles rendered"
            f" ({report['cycles_about']}), where I and O are Cycles' pictures, O the same"
            " shape, view and light in another material:"
        ),
        "",
        *HEAD,
        *_rows(report["cycles"]),
        *_rows_of_seeds(report, "cycles_seeds"),
    ]


def _lines_of_patterns(report: Report) -> list[str]:
    if "printed" not in report:
        return []
    return [
        "",
        "Normals on the same relit pictures without and with a pattern printed on each object:",
        "",
        *HEAD,
        *_rows(report["printed"]),
    ]


def _overlaps(report: Report) -> bool:
    """Return whether a test picture shows what the weights saw in training."""
    return any(sentence.startswith("Overlap") for sentence in report.get("seen", ()))


def _steps(report: Report) -> str:
    planned = f"{report['run']['schedule']['steps']} steps"
    return f"{report['step']} of {planned}" if report["step"] else f"up to {planned}"


def _words(key: str) -> str:
    """Return a figure's name in words; of one region: "albedo_2" is the second region's albedo."""
    name, _, region = key.rpartition("_")
    return (
        f"{WORDS[name]}, region {region}"
        if region.isdigit() and name in WORDS
        else WORDS.get(key, key)
    )


def _rows(figures: Mapping[str, list[float]]) -> list[str]:
    return [
        f"| {_words(key)} | {mean:.4g} | {low:.4g} – {high:.4g} |"
        for key, (mean, low, high) in figures.items()
    ]


def _rows_of_seeds(report: Report, key: str) -> list[str]:
    """Return a table of several seeds on the same pictures; [] for a single seed."""
    if key not in report:
        return []
    seeds = [f"seed {seed}" + (f", {step} steps" if step else "") for seed, step in report["seeds"]]
    lines = [
        "",
        (
            f"The same of {len(seeds)} seeds: the mean over them with its 95 % interval over shapes"
            " and materials, and each."
        ),
        "",
    ]
    lines += [
        f"| | mean of {len(seeds)} | 95 % | {' | '.join(seeds)} |",
        "|" + "---|" * (3 + len(seeds)),
    ]
    for name, of in report[key].items():
        mean, low, high = of["mean"]
        lines.append(
            f"| {_words(name)} | {mean:.4g} | {low:.4g} – {high:.4g} | "
            + " | ".join(f"{each:.4g}" for each in of["each"])
            + " |"
        )
    return lines
