"""Measure whether refinement needs its last outer iteration: edits and seconds with and without it.

Pictures of the ladder's development side are decomposed on the rungs `direct` and `8-bit` and
refined with each number of outer iterations, from the same prediction. The figures of every number
are compared with those of the last one named, edit by edit. Seconds are of the processor, on one
thread. `python -m learn evaluate-ladder --jobs DIR` names the commands that render the pictures.
rows.jsonl keeps a line per refinement: the same command continues, and a larger --scenes adds to
it.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner
from manifests.option_types import positive

if TYPE_CHECKING:
    from learn.evaluation.ladder_design import Scene

FIGURES = {
    "edit_l2": ("edit, display L2", 0),
    "edit_l2_aligned": ("one factor free", 0),
    "normals_mean_deg": ("normals, °", 2),
    "irradiance": ("irradiance error", 3),
    "seconds": ("processor, s", 1),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, the weights, and the numbers of scenes and of outer iterations."""
    options.add_data(parser, "a data set of the ladder's development side")
    options.add_weights(parser)
    parser.add_argument(
        "--scenes",
        type=positive,
        default=18,
        metavar="N",
        help="number of scenes on each rung, of different shapes (default 18)",
    )
    parser.add_argument(
        "--outer-iterations",
        nargs="+",
        type=positive,
        default=[2, 3],
        metavar="N",
        help="numbers of outer iterations; the last one is compared with (default 2 3)",
    )
    options.add_seed(parser, "seed by which edits are drawn")


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows", "numbers", "weights", "seen"}; rows as of `row_of`, and scene, rung, number.

    Raises InputError for a data set without the ladder's scenes.
    """
    from dataclasses import asdict, replace

    from learn.evaluation import ladder
    from learn.experiments import drawn_edits
    from learn.refinement import RefinementSettings

    settings = replace(RefinementSettings(), outer_iterations=1)
    edits = drawn_edits.opened(arguments, settings=asdict(settings))
    scenes = edits.scenes
    bench = ladder.Bench(edits.records, arguments.weights)
    numbers = list(dict.fromkeys(arguments.outer_iterations))
    todo = [
        ({"scene": scene.id, "rung": rung, "number": number}, (scene, rung, number))
        for scene in scenes
        for rung in edits.pictures
        for number in numbers
    ]
    # once without a clock, because kernels are compiled
    row_of(bench, scenes[0], next(iter(edits.pictures)), 1)
    rows = runner.resume(
        arguments.out / "rows.jsonl", todo, lambda case: row_of(bench, *case), "refinement"
    )
    return {"rows": rows, "numbers": numbers, "weights": arguments.weights.name, "seen": edits.seen}


def row_of(bench: Any, scene: Scene, rung: str, number: int) -> dict[str, Any]:
    """Return a scene's names, and {FIGURES: value} of "predicted" and "refined" on a rung.

    bench   of learn.evaluation.ladder
    number  of outer iterations
    """
    import time
    from dataclasses import replace

    from msgspec import to_builtins

    from learn.editing.decomposition import parts_of
    from learn.evaluation import ladder
    from learn.evaluation.ladder_design import RUNGS as ALL
    from learn.evaluation.ladder_pictures import shown
    from learn.refinement import RefinementSettings

    known = next(each for each in ALL if each.name == rung)
    picture = shown(bench.records, scene, known, bench.size)
    settings = replace(RefinementSettings(), outer_iterations=number)
    began = time.process_time()
    start = bench.predict(picture.batch)
    predicted = time.process_time()
    refined = bench.refine(picture.batch, start, settings).prediction
    seconds = {"predicted": predicted - began, "refined": time.process_time() - predicted}
    target = scene.truth[rung].materials[0]
    return {
        "shape": scene.shape,
        "light": scene.light,
        "target": target,
        "metal": bench.records.material(target).family == "metal",
    } | {
        name: to_builtins(ladder.measured(parts_of(parts), picture, picture.batch))
        | {"seconds": seconds[name]}
        for name, parts in (("predicted", start), ("refined", refined))
    }


def tables(report: runner.Report) -> str:
    """Return the figures of each number on each rung, and their ratios to those of the last."""
    result = ["# Outer iterations of refinement\n"]
    result += [f"**{sentence}**\n" for sentence in report["seen"]]
    rows, last = report["rows"], report["numbers"][-1]
    result.append(
        f"Weights {report['weights']}; {len({row['scene'] for row in rows})} scenes of"
        f" {len({row['shape'] for row in rows})} shapes. All numbers of outer iterations begin at"
        " the same prediction. *Difference* and *ratio* are to"
        f" {last} outer iterations, scene by scene; their intervals are 95 % and draw shapes,"
        " target materials and lights. *One factor free*: L2 after the factor on the edit's"
        " radiance that makes it least.\n"
    )
    for rung in dict.fromkeys(row["rung"] for row in rows):
        chosen = [row for row in rows if row["rung"] == rung]
        result += [f"## Rung {rung}\n", _table(chosen, report["numbers"])]
    return "\n".join(result)


def _table(rows: Sequence[Mapping[str, Any]], numbers: Sequence[int]) -> str:
    """One rung; rows of all numbers, whose scenes are in the same order."""
    import numpy as np

    from learn.metrics import bootstrap

    by_number = [[row for row in rows if row["number"] == number] for number in numbers]
    first, last = by_number[0], by_number[-1]
    kinds = ("shape", "target", "light")
    weights = bootstrap.draws(bootstrap.groups_of(*([row[kind] for row in last] for kind in kinds)))

    def values(of: Sequence[Mapping[str, Any]], part: str, key: str) -> np.ndarray:
        return np.array([row[part][key] for row in of])

    def means(of: Sequence[Mapping[str, Any]], part: str) -> list[str]:
        cells = []
        for key, (_, digits) in FIGURES.items():
            cells.append(f"{values(of, part, key).mean():.{digits}f}")
            if key == "edit_l2":
                cells.append(f"{np.median(values(of, part, key)):.0f}")
        return cells

    def compared(of: Sequence[Mapping[str, Any]]) -> list[str]:
        mine, theirs = (values(each, "refined", "edit_l2") for each in (of, last))
        slow, fast = (values(each, "refined", "seconds") for each in (last, of))
        return [
            runner.interval(bootstrap.interval(mine - theirs, weights), 0),
            runner.interval(bootstrap.relative(theirs, mine, weights), 3),
            f"{(mine < theirs).sum()} of {len(last)}",
            runner.interval(bootstrap.relative(slow, fast, weights), 2),
        ]

    lines = [["none: predicted", *means(first, "predicted"), "", "", "", ""]]
    for number, of in zip(numbers, by_number, strict=True):
        cells = [""] * 4 if of is last else compared(of)
        lines.append([str(number), *means(of, "refined"), *cells])
    edit, *rest = (title for title, _ in FIGURES.values())
    head = ["outer iterations", f"{edit}, mean", "median", *rest]
    head += ["difference of edits", "ratio of edits", "better edits", "ratio of seconds"]
    return runner.table(head, lines)
