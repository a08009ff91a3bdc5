"""Measure how bright edits are beside their truth, and what one factor on all of them would change.

Pictures of the ladder's rungs `direct` and `8-bit` are decomposed, refined and rendered in another
material, and compared with Cycles' picture of it. Edits into metals and into other materials are
reported apart. The common factor of a group is the one that makes its mean error least on the other
shapes. `python -m learn evaluate-ladder --jobs DIR` names the commands that render the pictures.
rows.jsonl keeps a line per edit: the same command continues, and a larger --scenes adds to it.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner

if TYPE_CHECKING:
    import numpy as np

    from learn.editing.decomposition import Parts
    from learn.evaluation.ladder_design import Scene
    from learn.evaluation.ladder_evaluator import LadderEvaluator
    from learn.evaluation.ladder_pictures import Shown

ON_RAY = True
FACTORS = tuple(2 ** (k / 4) for k in range(-8, 5))  # on radiance: two stops darker to one brighter
UNCHANGED = FACTORS.index(1.0)
METHODS = ("predicted", "refined")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, the weights and the number of scenes."""
    options.add_data(parser, "a data set with pictures of the ladder's cameras")
    options.add_weights(parser)
    options.add_count(
        parser, "--scenes", 48, "number of edits on each rung, of different shapes and lights"
    )
    options.add_seed(parser, "seed by which edits are drawn")


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows", "weights", "seen"}; rows as of `row_of`, and scene and rung.

    Raises InputError for a data set without pictures of the rungs.
    """
    from learn.evaluation.ladder_evaluator import LadderEvaluator
    from learn.experiments.editing import drawn_edits

    edits = drawn_edits.opened(arguments)
    evaluator = LadderEvaluator(edits.records, arguments.weights)
    todo = [
        ({"scene": f"{of.source[rung].id}-{of.truth[rung].id}", "rung": rung}, (of, rung))
        for of in edits.scenes
        for rung in edits.pictures
    ]
    rows = runner.resume(
        arguments.out / "rows.jsonl", todo, lambda case: row_of(evaluator, *case), "edit"
    )
    return {"rows": rows, "weights": arguments.weights.name, "seen": edits.seen}


def row_of(evaluator: LadderEvaluator, scene: Scene, rung: str) -> dict[str, Any]:
    """Return a scene's names, and the figures of its edit.

    {"shape", "group", "light", "source", "target", "metal", method: {"stops": of brightness above
    the truth's, "l2": with each of FACTORS, "l2_one_factor": with its own best one}}
    """
    from learn.editing.decomposition import require_parts
    from learn.evaluation.ladder_design import RUNGS
    from learn.evaluation.ladder_pictures import load_scene

    known = next(each for each in RUNGS if each.name == rung)
    picture = load_scene(evaluator.records, scene, known, evaluator.size)
    predicted = evaluator.predict(picture.batch)
    refined = evaluator.refine(picture.batch, predicted).prediction
    target = scene.truth[rung].materials[0]
    return {
        "shape": scene.shape,
        "group": scene.group,
        "light": scene.light,
        "source": scene.source[rung].materials[0],
        "target": target,
        "metal": evaluator.records.material(target).family == "metal",
    } | {
        name: figures(require_parts(parts), picture)
        for name, parts in zip(METHODS, (predicted, refined), strict=True)
    }


def figures(parts: Parts, picture: Shown) -> dict[str, Any]:
    """Return a method's figures of `row_of`. Brightness is the mean luminance over the object."""
    import numpy as np
    import torch

    from learn.evaluation.methods import render_by_layer
    from learn.metrics.pictures import display_l2, l2_after_alignments
    from shaders.tone import LUMINANCE

    edited = render_by_layer(parts.n, torch.from_numpy(picture.label), parts.light, picture.batch)
    mine, its = (
        float((each[picture.mask] @ np.asarray(LUMINANCE)).mean())
        for each in (edited, picture.target)
    )
    return {
        "stops": float(np.log2(mine / its)),
        "l2": [display_l2(edited * factor, picture.target, picture.mask) for factor in FACTORS],
        "l2_one_factor": l2_after_alignments(edited, picture.target, picture.mask)["l2_one_factor"],
    }


def by_other_shapes(l2: np.ndarray, shapes: Sequence[str]) -> np.ndarray:
    """Return (rows,) the error with the factor that is best on average for the other shapes.

    l2 (rows, factors); the rows of a single shape keep their own brightness
    """
    import numpy as np

    result = l2[:, UNCHANGED].copy()
    for shape in set(shapes):
        own = np.array([each == shape for each in shapes])
        if not own.all():
            result[own] = l2[own, l2[~own].mean(0).argmin()]
    return result


def summary(rows: Sequence[Mapping[str, Any]], method: str) -> dict[str, Any]:
    """Return {"stops", "l2", "common", "ratio", "own"}: [mean, low, high] each, and "factor".

    common  error with the factor of the other shapes; ratio: common over l2; own: each edit's best
    """
    import numpy as np

    from learn.metrics import bootstrap

    weights = _weights(rows)
    l2 = np.array([row[method]["l2"] for row in rows])
    common = by_other_shapes(l2, [row["shape"] for row in rows])
    stops, own = (
        np.array([row[method][key] for row in rows]) for key in ("stops", "l2_one_factor")
    )
    return {
        "stops": bootstrap.interval(stops, weights),
        "l2": bootstrap.interval(l2[:, UNCHANGED], weights),
        "common": bootstrap.interval(common, weights),
        "ratio": bootstrap.relative(l2[:, UNCHANGED], common, weights),
        "own": bootstrap.interval(own, weights),
        "factor": FACTORS[int(l2.mean(0).argmin())],
    }


def _weights(rows: Sequence[Mapping[str, Any]]) -> np.ndarray:
    from learn.metrics import bootstrap

    return bootstrap.draws_of_rows(rows, ("shape", "target", "light"))


def tables(report: runner.Report) -> str:
    """Return a table per rung: metals and others, predicted and refined."""
    result = ["# Brightness of edits\n"]
    result += [f"**{sentence}**\n" for sentence in report["seen"]]
    rows = report["rows"]
    result.append(
        f"Weights {report['weights']}; edits of {len({row['shape'] for row in rows})} shapes under"
        f" {len({row['light'] for row in rows})} lights. *Brightness*: mean luminance over the"
        " object, in stops above the truth's. *Common factor*: L2 with the factor on radiance that"
        " is best for the other shapes, and the one that is best for all. *Own factor*: with each"
        " edit's best factor. Brackets are 95 % intervals that draw shapes, target materials and"
        " lights.\n"
    )
    head = [
        "edits into",
        "",
        "edits",
        "brightness, stops",
        "L2",
        "common factor",
        "ratio",
        "factor",
        "own factor",
    ]
    for rung in dict.fromkeys(row["rung"] for row in rows):
        lines = []
        for metal, caption in ((True, "metals"), (False, "others")):
            of = [row for row in rows if row["rung"] == rung and row["metal"] == metal]
            for method in METHODS if of else ():
                values = summary(of, method)
                lines.append(
                    [
                        caption,
                        method,
                        len(of),
                        runner.interval(values["stops"], 2),
                        runner.interval(values["l2"], 0),
                        runner.interval(values["common"], 0),
                        runner.interval(values["ratio"], 2),
                        f"{values['factor']:.2f}",
                        runner.interval(values["own"], 0),
                    ]
                )
        result += [f"## Rung {rung}\n", runner.table(head, lines)]
    result.append(
        "## One factor for all edits into metals\n\n"
        "Refined edits. *Ratio*: L2 with the factor over L2 without it.\n"
    )
    for rung in dict.fromkeys(row["rung"] for row in rows):
        of = [row for row in rows if row["rung"] == rung and row["metal"]]
        if of:
            result += [f"### On the rung {rung}\n", table_by_factor(of)]
    return "\n".join(result)


def table_by_factor(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return L2 of refined edits with each of FACTORS, and how many edits are better by it."""
    import numpy as np

    weights = _weights(rows)
    l2 = np.array([row["refined"]["l2"] for row in rows])
    lines = [
        [
            f"{factor:.2f}",
            runner.mean_interval(l2[:, k], weights, 0),
            runner.ratio_interval(l2[:, UNCHANGED], l2[:, k], weights, 2),
            f"{(l2[:, k] < l2[:, UNCHANGED]).sum()} of {len(rows)}",
        ]
        for k, factor in enumerate(FACTORS)
    ]
    return runner.table(["factor", "L2", "ratio", "better in"], lines)
