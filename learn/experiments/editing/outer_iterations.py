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
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner
from manifests.option_types import positive

if TYPE_CHECKING:
    from learn.evaluation.ladder_design import Scene


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, the weights, and the numbers of scenes and of outer iterations."""
    options.add_data(parser, "a data set of the ladder's development side")
    options.add_weights(parser)
    options.add_count(parser, "--scenes", 18, "number of scenes on each rung, of different shapes")
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

    from learn.evaluation import ladder_evaluator
    from learn.experiments.editing import drawn_edits
    from learn.refinement import RefinementSettings

    settings = replace(RefinementSettings(), outer_iterations=1)
    edits = drawn_edits.opened(arguments, settings=asdict(settings))
    scenes = edits.scenes
    evaluator = ladder_evaluator.LadderEvaluator(edits.records, arguments.weights)
    numbers = list(dict.fromkeys(arguments.outer_iterations))
    todo = [
        ({"scene": scene.id, "rung": rung, "number": number}, (scene, rung, number))
        for scene in scenes
        for rung in edits.pictures
        for number in numbers
    ]
    # once without a clock, because kernels are compiled
    row_of(evaluator, scenes[0], next(iter(edits.pictures)), 1)
    rows = runner.resume(
        arguments.out / "rows.jsonl", todo, lambda case: row_of(evaluator, *case), "refinement"
    )
    return {"rows": rows, "numbers": numbers, "weights": arguments.weights.name, "seen": edits.seen}


def row_of(evaluator: Any, scene: Scene, rung: str, number: int) -> dict[str, Any]:
    """Return the row of a scene on a rung, as of `drawn_edits.refined_row`.

    evaluator   of learn.evaluation.ladder_evaluator
    number  of outer iterations
    """
    from dataclasses import replace

    from learn.experiments.editing import drawn_edits
    from learn.refinement import RefinementSettings

    settings = replace(RefinementSettings(), outer_iterations=number)
    return drawn_edits.refined_row(evaluator, scene, rung, settings)


def tables(report: runner.Report) -> str:
    """Return the figures of each number on each rung, and their ratios to those of the last."""
    from learn.experiments.editing import drawn_edits

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
        table = drawn_edits.comparison(chosen, "number", report["numbers"], "outer iterations")
        result += [f"## Rung {rung}\n", table]
    return "\n".join(result)
