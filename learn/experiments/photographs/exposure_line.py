"""Fit the line by which photographs are exposed to several sets of photographs at once.

Reports of photographed-edits and room-photographs know every edit at many exposures, so that any
line can be judged by them without editing anything again. The line (learn.editing.exposure) is
fitted to the reports of --fit, each of which counts as much as any other however many edits it has,
and also to each of them alone. All lines are then judged by these and by the reports of --judge, to
which nothing is fitted.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn.experiments import runner

if TYPE_CHECKING:
    import numpy as np

    from learn.experiments.photographs.photographed_fit import Edits

LINES = ("with background", "cut out")
ALL, INTERVALS, IN_USE, TRUE = "all", "intervals", "in use", "the true exposure"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the reports that the line is fitted to, and those that it is judged by."""
    parser.add_argument(
        "--fit",
        type=_named,
        nargs="+",
        required=True,
        metavar="NAME=FILE",
        help="report.json of photographed-edits or room-photographs, fitted to",
    )
    parser.add_argument(
        "--judge",
        type=_named,
        nargs="*",
        default=[],
        metavar="NAME=FILE",
        help="further ones, which the line is not fitted to",
    )


def _named(word: str) -> tuple[str, Path]:
    name, equals, path = word.partition("=")
    if not (name and equals and path):
        raise argparse.ArgumentTypeError(f"expected NAME=FILE, found '{word}'")
    return name, Path(path)


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"fitted": {line: {rule: slopes}}, "sets": [set]}.

    rule   "all", or the name of a set of --fit, to which alone it is fitted
    slopes {"constant", "again", "background"}; "intervals" of those of all: [mean, low, high]
    set    {"name", "judged": whether nothing was fitted to it, "edits", "photographs",
           "unchanged": L2, line: {rule: {"brightness", "off", "l2": [mean, low, high]}}}
    Raises InputError for a report of another command, and for sets that are named like each other
    or like a rule
    """
    import numpy as np

    from learn.experiments.photographs import photographed_fit
    from learn.metrics import bootstrap

    _require_names([name for name, _ in (*arguments.fit, *arguments.judge)])
    fit = {name: read_edits(path) for name, path in arguments.fit}
    judge = {name: read_edits(path) for name, path in arguments.judge}
    report: runner.Report = {"fitted": {}, "sets": []}
    stops: dict[str, dict[str, Any]] = {}
    for line in LINES:
        of = {ALL: _fitted(line, list(fit.values()))}
        of |= {name: _fitted(line, [edits]) for name, edits in fit.items()}
        report["fitted"][line] = {rule: _as_json(slopes) for rule, slopes in of.items()}
        stops[line] = of
    drawn = [photographed_fit.weights_of(edits)[:300] for edits in fit.values()]
    for line in LINES:
        several = [
            _fitted(line, list(fit.values()), [of[k] for of in drawn])
            for k in range(min(map(len, drawn)))
        ]
        low, high = np.percentile(several, bootstrap.LEVELS, axis=0)
        intervals = zip(stops[line][ALL], low, high, strict=True)
        report["fitted"][line][INTERVALS] = {
            term: [float(x) for x in of]
            for term, of in zip(photographed_fit.TERMS, intervals, strict=True)
        }
    for name, edits in (fit | judge).items():
        report["sets"].append(_judged(name, edits, name in judge, stops))
    return report


def _require_names(names: Sequence[str]) -> None:
    from manifests.errors import InputError

    reserved = {ALL, INTERVALS, IN_USE, TRUE}
    wrong = [name for k, name in enumerate(names) if name in reserved or name in names[:k]]
    if wrong:
        rule = f"sets of different names, none of them {', '.join(sorted(reserved))}"
        raise InputError("--fit and --judge", rule, wrong[0], "name it otherwise")


def read_edits(path: Path) -> Edits:
    """Return the Edits of a report.json. Raises InputError for a report of another command."""
    from learn.experiments.photographs import photographed_fit
    from manifests.errors import InputError
    from manifests.reading import read

    report = read(path, dict[str, Any], maximum_bytes=1 << 28)
    try:
        edits = photographed_fit.edits_of(report)
    except (KeyError, TypeError):
        remedy = "name the report.json of photographed-edits or room-photographs"
        raise InputError(path, "rows of photographs with edits", "another report", remedy) from None
    if not edits.rows:
        raise InputError(path, "edits of photographs", "none", "measure more photographs")
    return edits


def _fitted(
    line: str, sets: Sequence[Edits], weights: Sequence[np.ndarray] | None = None
) -> np.ndarray:
    """Return slopes (5,) of photographed_fit.TERMS, fitted to sets that count alike.

    weights  (E,) of each set's edits
    """
    import numpy as np

    from learn.editing import mirror_correction
    from learn.experiments.photographs import photographed_fit as fit

    columns = [fit.TERMS.index(term) for term in _terms(line)]
    each = [np.ones(len(edits.rows)) for edits in sets] if weights is None else weights
    alike = np.concatenate([of / max(of.sum(), 1e-9) for of in each])
    cues = np.concatenate([edits.cues[:, columns] for edits in sets])
    # mirror-like targets are darkened as the program does it
    rest = np.concatenate(
        [edits.right - mirror_correction.STOPS * edits.cues[:, 4] for edits in sets]
    )
    slopes = np.zeros(len(fit.TERMS))
    slopes[columns] = fit.least_squares(cues, rest, alike)
    slopes[4] = mirror_correction.STOPS
    return slopes


def _terms(line: str) -> tuple[str, ...]:
    return ("constant", "again", "background") if line == LINES[0] else ("constant", "again")


def _as_json(slopes: np.ndarray) -> dict[str, float]:
    return {
        name: float(slopes[k]) for k, name in ((0, "constant"), (2, "again"), (3, "background"))
    }


def _judged(
    name: str, edits: Edits, judged: bool, stops: dict[str, dict[str, Any]]
) -> dict[str, Any]:
    import numpy as np

    from learn.editing import mirror_correction
    from learn.experiments.photographs import photographed_fit
    from learn.metrics import bootstrap

    weights = photographed_fit.weights_of(edits)
    darker = mirror_correction.STOPS * edits.cues[:, 4]
    result: dict[str, Any] = {
        "name": name,
        "judged": judged,
        "edits": len(edits.rows),
        "photographs": len({row["photograph"] for row in edits.rows}),
        "unchanged": bootstrap.interval(edits.unchanged, weights),
    }
    for line in LINES:
        rules = {rule: edits.cues @ slopes for rule, slopes in stops[line].items()}
        rules |= {
            IN_USE: photographed_fit.in_use(edits, cut_out=line != LINES[0]),
            TRUE: edits.true + darker,
        }
        result[line] = {
            rule: {
                "brightness": float(edits.brightness(exposed).mean()),
                "off": float(np.sqrt((edits.brightness(exposed) ** 2).mean())),
                "l2": bootstrap.interval(edits.error(exposed), weights),
            }
            for rule, exposed in rules.items()
        }
    return result


def tables(report: runner.Report) -> str:
    """Return the slopes, and what each line is worth on each set."""
    sets = report["sets"]
    fitted = [each["name"] for each in sets if not each["judged"]]
    result = ["# A line for the exposure of photographs\n"]
    result.append(
        f"Fitted to {', '.join(fitted)}, each of which counts as much as any other. Brightness: of"
        " edits above their truth's, in stops, mean and root mean square. L2 is that of display"
        " values, in the photograph's own exposure. Brackets are 95 % intervals that draw shapes,"
        " target materials and lights.\n"
    )
    for line in LINES:
        of = report["fitted"][line]
        result.append(f"## {line.capitalize()}\n")
        lines: list[list[object]] = []
        for rule in (ALL, *fitted):
            lines.append([rule, *(f"{of[rule][key]:+.2f}" for key in of[rule])])
        within = [of[INTERVALS][key] for key in of[ALL]]
        lines.append(["all, intervals", *(runner.interval(each, 2) for each in within)])
        result.append(runner.table(["fitted to", *of[ALL]], lines))
        head = ["set", "edits", "exposed by", "brightness", "off by", "L2"]
        lines = []
        for each in sets:
            name = each["name"] + (", not fitted to" if each["judged"] else "")
            lines.append(
                [name, each["edits"], "not edited", "", "", runner.interval(each["unchanged"], 0)]
            )
            for rule, value in each[line].items():
                shown = rule if rule in (IN_USE, TRUE) else f"the line of {rule}"
                cells = [f"{value['brightness']:+.2f}", f"{value['off']:.2f}"]
                lines.append(["", "", shown, *cells, runner.interval(value["l2"], 0)])
        result.append(runner.table(head, lines))
    return "\n".join(result)
