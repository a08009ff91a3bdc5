"""Chart what training runs reached against the processor time that they took.

Reads the logs of runs that `learn train` has made (log.jsonl and run.json) and draws the
figures of their validations. Runs that begin with the weights of an earlier one are named together,
in order, with commas between them, and their times add up. Example:
python -m learn.experiments training-runs paper=run-1,run-2 compact=run-3 --out chart
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn.experiments import runner
from manifests.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURES = {  # of learn.training.validation: (caption, digits, what a constant guess is called)
    "angle_deg": ("normals, °", 1, None),
    "albedo": ("log albedo", 2, "constant_albedo"),
    "irradiance": ("irradiance error", 2, "constant_irradiance"),
    "target_l2": ("O′, display L2", 0, "control_l2"),
}
HOUR = 3600


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the runs."""
    parser.add_argument(
        "runs",
        nargs="+",
        type=runs_of,
        metavar="NAME=DIR[,DIR...]",
        help="folders of runs, those that continue one another with commas between them",
    )


def runs_of(text: str) -> tuple[str, list[Path]]:
    """Return the name and the folders of "NAME=DIR,DIR"."""
    name, equals, folders = text.partition("=")
    if not equals or not name or not all(folders.split(",")):
        raise argparse.ArgumentTypeError(f"expected NAME=DIR or NAME=DIR,DIR, found {text}")
    return name, [Path(folder) for folder in folders.split(",")]


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"runs": {name: [{"run", "steps", "hours", "validations"}]}}.

    validations  [{"step", "hours": of all runs of this name so far, figure: value}]
    Raises       InputError for a folder without a log, and for a name that is there twice
    """
    names = [name for name, _ in arguments.runs]
    for name in names:
        if names.count(name) > 1:
            rule = "a name of its own for each line of the chart"
            raise InputError(name, rule, "it twice", "name the lines differently")
    result: dict[str, list[dict[str, Any]]] = {}
    for name, folders in arguments.runs:
        result[name], before = [], 0.0
        for folder in folders:
            each = log_of(folder, before)
            result[name].append(each)
            before += each["hours"]
    return {"runs": result}


def log_of(folder: Path, before: float) -> dict[str, Any]:
    """Return one run's entry as `measure` has it; before: hours of the runs that it continues.

    Raises InputError if the folder has no log, or one without validations.
    """
    run, log = folder / "run.json", folder / "log.jsonl"
    for path in (run, log):
        if not path.is_file():
            remedy = "name a folder that `learn train` has written"
            raise InputError(folder, f"the file {path.name}", "none", remedy)
    lines = list(_lines(log))
    validations = [
        {"step": line["step"], "hours": before + line["cpu_seconds"] / HOUR}
        | with_mean_albedo(line["validation"])
        for line in lines
        if "validation" in line
    ]
    if not validations:
        remedy = "train with a smaller --sheet-every"
        raise InputError(log, "the figures of a validation", "none", remedy)
    return {
        "run": json.loads(run.read_text())["name"],
        "steps": lines[-1]["step"] + 1,
        "hours": lines[-1]["cpu_seconds"] / HOUR,
        "validations": validations,
    }


def with_mean_albedo(validation: Mapping[str, float]) -> dict[str, float]:
    """Return a validation's figures; several regions' albedos have their mean beside them."""
    result = dict(validation)
    for key in ("albedo", "constant_albedo"):
        regions = [value for name, value in validation.items() if name.startswith(f"{key}_")]
        if regions:
            result.setdefault(key, sum(regions) / len(regions))
    return result


def _lines(path: Path) -> Iterator[dict[str, Any]]:
    for number, text in enumerate(path.read_text().splitlines(), 1):
        try:
            line = json.loads(text)
            if {"step", "cpu_seconds"} <= line.keys():
                yield line
        except (ValueError, AttributeError):
            remedy = "train in another folder; a killed run's last line mends when it continues"
            raise InputError(f"{path}:{number}", "an object in JSON", text[:40], remedy) from None


def tables(report: runner.Report) -> str:
    """Return what each run took, and the figures of its last validation."""
    captions = [caption for caption, _, _ in FIGURES.values()]
    rows = [
        [
            name,
            each["run"],
            each["steps"],
            f"{each['validations'][-1]['hours']:.2f}",
            *(_cell(each["validations"][-1], key) for key in FIGURES),
        ]
        for name, runs in report["runs"].items()
        for each in runs
    ]
    return "\n".join(
        [
            "# Training runs\n",
            "The figures of each run's last validation; in parentheses those of a constant"
            " guess, and for O′, the picture in another material, those of a constant light. A"
            " validation has held-out shapes and lights of the run's own data, so that runs on"
            " different data cannot be compared. Hours are of the processor, together with those"
            " of the runs that a run continues.\n",
            "![Figures of validations against processor hours](chart.png)\n",
            runner.table(["line", "run", "steps", "hours", *captions], rows),
        ]
    )


def _cell(validation: Mapping[str, float], key: str) -> str:
    _, digits, constant = FIGURES[key]
    if key not in validation:
        return "–"
    result = f"{validation[key]:.{digits}f}"
    if constant is not None and constant in validation:
        result += f" ({validation[constant]:.{digits}f})"
    return result


def figure(report: runner.Report) -> Figure:
    """Return one chart for each figure, against hours, with a line for each name."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(10, 7), layout="constrained")
    for axis, (key, (caption, _, constant)) in zip(
        drawn.subplots(2, 2).flat, FIGURES.items(), strict=True
    ):
        for k, (name, runs) in enumerate(report["runs"].items()):
            for number, each in enumerate(runs):
                _draw(axis, each["validations"], key, f"C{k}", None if number else name)
                if constant:
                    _draw(axis, each["validations"], constant, f"C{k}", None, ":")
        axis.set(xlabel="processor hours", ylabel=caption, ylim=(0, None))
    drawn.axes[0].legend()
    drawn.axes[1].plot([], [], "k:", label="constant guess")
    drawn.axes[1].legend()
    return drawn


def _draw(
    axis: Any,
    validations: Sequence[Mapping[str, float]],
    key: str,
    colour: str,
    label: str | None,
    style: str = "o-",
) -> None:
    points = [(each["hours"], each[key]) for each in validations if key in each]
    axis.plot(*zip(*points, strict=True) if points else ((), ()), style, color=colour, label=label)
