"""Compare two weights on the edits that both were measured on, from the lines that were kept.

Each folder is one of `learn evaluate`, or of `learn evaluate-ladder`; both must be of the same
command and of the same pictures. Every figure is paired: the ratio of its means is over the edits,
or the pictures, that both folders have, and its interval draws their shapes, their materials and
their lights. Nothing is measured again.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from learn.experiments import runner
from manifests.errors import InputError

METHODS = {"ours": "predicted", "ours, refined": "refined"}
EDIT = "edits, display L2"
ONE_FACTOR = "edits, one factor free"
OF_EDITS = {EDIT: "l2", ONE_FACTOR: "l2_one_factor"}  # of a line of edits.jsonl
OF_PICTURES = {  # of a line of pictures.jsonl: its part, and that part's key
    "normals, °": ("normals", "mean_deg"),
    "material, log error of the BRDF": ("material", "brdf_log"),
    "irradiance error": ("light", "irradiance"),
    "light on three spheres, display L2": ("light", "spheres_l2"),
}
OF_RUNGS = {  # of a line of the ladder
    EDIT: "edit_l2",
    ONE_FACTOR: "edit_l2_aligned",
    "normals, °": "normals_mean_deg",
    "irradiance error": "irradiance",
}
DIGITS = {EDIT: 0, ONE_FACTOR: 0, "normals, °": 1, "light on three spheres, display L2": 0}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the two folders."""
    for name, what in (("before", "the weights that ratios are to"), ("after", "the other ones")):
        parser.add_argument(
            f"--{name}", type=Path, required=True, metavar="DIR", help=f"the results of {what}"
        )


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"before", "after", "rows"}: the folders' names, and a row for each set and figure.

    A row is {"set", "figure", "count", "before", "after", "ratio": [ratio, low, high]}, with means
    in "before" and "after". Raises InputError where the folders share no edit.
    """
    import numpy as np

    from learn.metrics import bootstrap

    before, after = (dict(_figures(folder)) for folder in (arguments.before, arguments.after))
    both = [key for key in before if key in after]
    if not both:
        expected = f"edits that {arguments.before} has as well"
        raise InputError(arguments.after, expected, "none", "measure the same pictures by both")
    rows = []
    sets = list(dict.fromkeys(name for name, _, _ in both))
    pairs = dict.fromkeys((name, figure) for name, figure, _ in both)
    for name, figure in sorted(pairs, key=lambda pair: sets.index(pair[0])):
        of = [before[key] for key in both if key[:2] == (name, figure)]
        with_other = [after[key][0] for key in both if key[:2] == (name, figure)]
        a, b = np.array([each[0] for each in of]), np.array(with_other)
        groups = bootstrap.groups_of(*zip(*(each[1] for each in of), strict=True))
        rows.append(
            {
                "set": name,
                "figure": figure,
                "count": len(of),
                "before": float(a.mean()),
                "after": float(b.mean()),
                "ratio": bootstrap.relative(a, b, bootstrap.draws(groups)),
            }
        )
    first, second = _names(arguments.before, arguments.after)
    return {"before": first, "after": second, "rows": rows}


Key = tuple[str, str, str]  # set, figure, id of the edit or the picture
Value = tuple[float, tuple[str, str, str]]  # the figure; its shape, material and light


def _names(*folders: Path) -> list[str]:
    """Return what a report calls folders: their names, and their parents' where these are equal."""
    paths = [folder.resolve() for folder in folders]
    if len({path.name for path in paths}) == len(paths):
        return [path.name for path in paths]
    return [f"{path.parent.name}/{path.name}" for path in paths]


def _figures(folder: Path) -> Iterator[tuple[Key, Value]]:
    """Yield the figures of a folder. Raises InputError for a folder of neither command."""
    if (folder / "edits.jsonl").is_file():
        yield from _of_evaluation(folder)
    elif (folder / "lines.jsonl").is_file():
        yield from _of_ladder(folder)
    else:
        expected = "edits.jsonl or lines.jsonl in this folder"
        raise InputError(folder, expected, "neither", "name what --out of the evaluation named")


def _of_evaluation(folder: Path) -> Iterator[tuple[Key, Value]]:
    """Yield the figures of `learn evaluate`: all edits, both kinds of them, all pictures."""
    from learn.evaluation.breakdowns import has_metal
    from learn.evaluation.run import rows_of
    from manifests import materials

    known = {
        entry.name: entry.family
        for path in materials.BUILT_IN
        for entry in materials.read_catalogue(path).materials
    }
    for row in rows_of(folder / "edits.jsonl").values():
        kind = "edits into metals" if has_metal(row["wanted"], known) else "edits into others"
        for method, words in METHODS.items():
            for figure, key in OF_EDITS.items():
                for name in (f"all, {words}", f"{kind}, {words}"):
                    value = row["methods"].get(method, {}).get(key)
                    yield from _entry((name, figure), row, "wanted", value)
    for row in rows_of(folder / "pictures.jsonl").values():
        for method, words in METHODS.items():
            for figure, (part, key) in OF_PICTURES.items():
                value = row["methods"].get(method, {}).get(part, {}).get(key)
                yield from _entry((f"all, {words}", figure), row, "materials", value)


def _of_ladder(folder: Path) -> Iterator[tuple[Key, Value]]:
    """Yield the figures of `learn evaluate-ladder`, by group and rung."""
    from manifests import outputs

    for row in outputs.read_lines(folder / "lines.jsonl"):
        if "rung" not in row:
            remedy = "name what --out of evaluate-ladder named"
            raise InputError(folder / "lines.jsonl", "lines of evaluate-ladder", "others", remedy)
        for method in METHODS.values():
            for figure, key in OF_RUNGS.items():
                value = (row[method] or {}).get(key)
                name = f"{row['group']}, {row['rung']}, {method}"
                yield from _entry((name, figure), row, "target", value)


def _entry(
    name: tuple[str, str], row: Mapping[str, Any], material: str, value: float | None
) -> Iterator[tuple[Key, Value]]:
    """Yield a figure of a line, unless it is None; material: the key of the line's material."""
    if value is not None:
        names = row[material]
        joined = names if isinstance(names, str) else "+".join(dict.fromkeys(names))
        yield (*name, row["id"]), (float(value), (row["shape"], joined, row["light"]))


def tables(report: runner.Report) -> str:
    """Return the paired figures as a table."""
    head = ["", "figure", "number", report["before"], report["after"], "ratio"]
    rows = []
    for row in report["rows"]:
        digits = DIGITS.get(row["figure"], 3)
        means = (f"{row[key]:,.{digits}f}" for key in ("before", "after"))
        ratio = runner.interval(row["ratio"], 2)
        rows.append([row["set"], row["figure"], row["count"], *means, ratio])
    return (
        "# Two weights on the same edits\n\n"
        "Means of the edits, or the pictures, that both were measured on, and the ratio of the"
        " means. Brackets: 95 % intervals; whole shapes, materials and lights are drawn with"
        " replacement. The material of an edit is the one that it is edited into.\n\n"
        + runner.table(head, rows)
    )
