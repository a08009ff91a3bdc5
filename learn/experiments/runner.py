"""What all experiments share: the command line, the folder of a run, and its report.

An experiment is a module of one of the packages beside this file, one package per subject. It has

    add_arguments(parser) -> None   its options, besides --out and --report
    measure(arguments) -> dict      the content of report.json; it may keep rows in arguments.out
    tables(report) -> str           a report, as report.json holds it, in Markdown
    figure(report) -> Figure        optional: a chart of the report
    ON_RAY = True                   optional: its rows may be measured on a Ray cluster
                                    (learn.experiments.on_ray)

Its docstring is the description in `--help`. The module is named as the command line names the
experiment, with underscores for hyphens; the other modules of those packages are parts of one or
several experiments. Heavy libraries are imported inside these functions, so that `--help` is quick.

This module runs an experiment: it locks the folder, and writes report.json with the provenance of
the figures, report.md and chart.png. It can also make the last two again from report.json.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
from collections.abc import Callable, Generator, Hashable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, cast

from learn.commands import options
from learn.experiments import on_ray
from manifests import files, lock, outputs
from manifests.provenance import provenance
from manifests.reading import read

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure

REPORT, PAGE, CHART = "report.json", "report.md", "chart.png"
Report = dict[str, Any]  # what JSON can hold; each experiment describes its own keys
Case = TypeVar("Case")


class Experiment(Protocol):
    """The functions that a module has if it is an experiment."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None: ...

    def measure(self, arguments: argparse.Namespace) -> Report: ...

    def tables(self, report: Report) -> str: ...


def find(name: str) -> Experiment:
    """Return the module of the experiment that the command line calls `name`."""
    (path,) = Path(__file__).parent.glob(f"*/{name.replace('-', '_')}.py")
    module = importlib.import_module(f"{__package__}.{path.parent.name}.{path.stem}")
    return cast(Experiment, module)


def register(name: str) -> Callable[[argparse._SubParsersAction], None]:
    """Return the function that adds the parser of the experiment `name` (manifests.cli)."""

    def add(subparsers: argparse._SubParsersAction) -> None:
        experiment = find(name)
        parser = subparsers.add_parser(
            name,
            description=inspect.getdoc(experiment),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        experiment.add_arguments(parser)
        if getattr(experiment, "ON_RAY", False):
            options.add_ray(parser)
        parser.add_argument(
            "--out",
            type=Path,
            required=True,
            metavar="DIR",
            help=f"folder for {REPORT} and {PAGE}",
        )
        parser.add_argument(
            "--report",
            action=_DrawAgain,
            experiment=experiment,
            metavar="FILE",
            help=f"measure nothing, but write {PAGE} again beside this {REPORT}, and print it",
        )
        parser.set_defaults(
            run=lambda arguments: run(experiment, arguments), result_folders=("out",)
        )

    return add


class _DrawAgain(argparse.Action):
    """An option that ends the program, as --help does, so that no other option is required."""

    def __init__(self, experiment: Experiment, **options: Any) -> None:
        super().__init__(**options)
        self.experiment = experiment

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        print(draw(self.experiment, Path(values)), end="")
        parser.exit()


def run(experiment: Experiment, arguments: argparse.Namespace) -> None:
    """Measure an experiment and write its report into arguments.out, which no other run may use.

    The provenance is that of the start: the machine's load is not yet that of the measurement.
    """
    inputs = [value for value in vars(arguments).values() if isinstance(value, Path)]
    outputs.reserve_outputs(arguments.out, (REPORT, PAGE, CHART), overwrite=True, inputs=inputs)
    made_by = provenance()
    with lock.writing(arguments.out, patience=0):
        with on_ray.asked_of_cluster(getattr(arguments, "ray", None), experiment, arguments):
            report = {"made_by": made_by} | experiment.measure(arguments)
        # first, so that a fault in the tables does not cost the measurement
        files.write_json(arguments.out / REPORT, report)
        draw(experiment, arguments.out / REPORT)
    print(f"See {arguments.out / PAGE}")


def draw(experiment: Experiment, path: Path) -> str:
    """Write the page and the chart of a kept report beside it; return the page."""
    report = read(path, dict[str, Any])
    page = page_of(experiment, report)
    with files.transaction():
        files.write_text(path.parent / PAGE, page)
        if figure := getattr(experiment, "figure", None):
            drawn: Figure | None = figure(report)
            if drawn is not None:
                files.write_figure(path.parent / CHART, drawn, dpi=100)
    return page


def page_of(experiment: Experiment, report: Report) -> str:
    """Return the tables of a report, and below them what made it."""
    return f"{experiment.tables(report).rstrip()}\n\n{stamp(report['made_by'])}\n"


def stamp(made_by: dict[str, Any]) -> str:
    """Return one line of Markdown with the command, commit, date, machine and versions."""
    versions = ", ".join(f"{name} {version}" for name, version in made_by["versions"].items())
    return (
        f"`{made_by['command']}`, commit {made_by['commit']}, {made_by['date']};"
        f" {made_by['machine']}; {versions}"
    )


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table in Markdown; cells are written by str."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(map(str, cells))} |" for cells in lines) + "\n"


def interval(values: Sequence[float], digits: int = 3) -> str:
    """Return "mean [low, high]" with so many decimal places."""
    mean, low, high = (f"{value:.{digits}f}" for value in values)
    return f"{mean} [{low}, {high}]"


def mean_interval(values: np.ndarray, weights: np.ndarray, digits: int = 3) -> str:
    """Return the mean of values (P,) as `interval` writes it; weights (D, P) of bootstrap."""
    from learn.metrics import bootstrap

    return interval(bootstrap.interval(values, weights), digits)


def ratio_interval(
    before: np.ndarray, after: np.ndarray, weights: np.ndarray, digits: int = 3
) -> str:
    """Return mean after / mean before as `interval` writes it, of values (P,) of the same rows."""
    from learn.metrics import bootstrap

    return interval(bootstrap.relative(before, after, weights), digits)


def resume(
    path: Path,
    cases: Sequence[tuple[dict[str, Any], Case]],
    measure: Callable[[Case], dict[str, Any]],
    unit: str,
    current: Callable[[dict[str, Any]], dict[str, Any]] = lambda row: row,
    group: Callable[[Case], Hashable] = id,
) -> list[dict[str, Any]]:
    """Return a row for each case; rows that the file at `path` has are read, not measured again.

    cases    pairs of what identifies a row, as {key: value}, and what `measure` receives
    measure  returns the rest of the row; the whole row is then appended to the file as one line
    unit     what the progress bar counts
    current  brings a row that an earlier version wrote up to date
    group    returns a key: on a cluster, one worker measures the cases of a key
    """
    import contextlib

    from manifests.line_files import Lines
    from manifests.progress import tqdm

    keys = list(cases[0][0]) if cases else []
    kept = [current(row) for row in outputs.read_lines(path)]
    done = {tuple(row[key] for key in keys): row for row in kept}
    missing = [(each, case) for each, case in cases if tuple(each.values()) not in done]
    on_ray.end_where_rows_are_requested(path, cases, measure, len(missing))
    with (
        contextlib.closing(Lines(path)) as lines,
        contextlib.closing(_rest_of_rows(path, missing, measure, group)) as measured,
        tqdm(total=len(missing), unit=unit) as bar,
    ):
        for identity, rest in measured:
            row = identity | rest
            lines.append(row)
            done[tuple(identity.values())] = row
            bar.update()
    return [done[tuple(identity.values())] for identity, _ in cases]


def _rest_of_rows(
    path: Path,
    missing: Sequence[tuple[dict[str, Any], Case]],
    measure: Callable[[Case], dict[str, Any]],
    group: Callable[[Case], Hashable],
) -> Generator[tuple[dict[str, Any], dict[str, Any]], None, None]:
    """Yield (what identifies a row, the rest of it), measured here or on a cluster."""
    if not on_ray.is_asking():
        for identity, case in missing:
            yield identity, measure(case)
        return
    pieces: dict[Hashable, list[dict[str, Any]]] = {}
    for identity, case in missing:
        pieces.setdefault(group(case), []).append(identity)
    yield from on_ray.measure_on_cluster(path, list(pieces.values()))
