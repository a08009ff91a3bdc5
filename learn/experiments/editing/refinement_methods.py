"""Measure whether glossy objects are refined better through the integral than through the sum.

Pictures of objects in materials with lobes that are visible and narrower than a texel are refined
by each method of the layer from the same prediction, in one outer iteration, and the edits into
other materials are compared with Cycles' pictures of them. Predicted lights are smooth; therefore
pictures in direct light are also refined from the prediction with the true light in place of the
predicted one, which then stays. All edits are rendered by the integral. The data set is one of the
ladder's jobs (`python -m learn evaluate-ladder --jobs DIR` names them), or of pictures in direct
light such as docs/jobs/evaluation. The report also says how far the sum is from the integral, of
the true parts and of the predicted ones, in pictures that need not be refined. Seconds are of the
processor, on one thread. rows.jsonl keeps a line per refinement, and pictures.jsonl one per
picture: the same command continues, and larger numbers add to it.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner
from manifests.training_runs import LAYER_METHODS

if TYPE_CHECKING:
    from learn.data.records import Records
    from learn.evaluation.ladder_design import Scene
    from learn.refinement import RefinementSettings

PREDICTED, TRUE_LIGHT = "predicted light", "true light"
METHODS = LAYER_METHODS[::-1]  # the last one, auto, is what the others are compared with


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, the weights and the number of scenes."""
    options.add_data(parser, "a data set with pictures of each scene in several materials")
    options.add_weights(parser, options.TABLE_WEIGHTS)
    options.add_count(
        parser,
        "--scenes",
        24,
        "number of scenes that are refined from the predicted light on each rung, shapes in turn",
    )
    options.add_count(
        parser,
        "--true-light",
        24,
        "number of scenes in direct light that are refined from the true light",
        least=0,
    )
    options.add_count(
        parser,
        "--pictures",
        48,
        "number of scenes on each rung whose sum and integral are compared",
    )
    options.add_seed(parser, "seed by which edits are drawn")


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows", "pictures", "weights", "seen"}.

    rows      as of `row_of`, and scene, rung, start (PREDICTED or TRUE_LIGHT), method
    pictures  as of `compare_with_sum`, and scene, rung
    Raises InputError for a data set without pictures in glossy materials beside others.
    """
    from dataclasses import asdict

    from learn.evaluation import ladder_evaluator
    from learn.experiments.editing import drawn_edits, ladder_scenes

    settings = {rung: asdict(settings_of(rung, METHODS[0])) for rung in ladder_scenes.RUNGS}
    most = {"scenes": max(arguments.scenes, arguments.true_light, arguments.pictures)}
    edits = drawn_edits.opened(
        argparse.Namespace(**vars(arguments) | most), sources=glossy, settings=settings
    )
    counts = {TRUE_LIGHT: arguments.true_light, PREDICTED: arguments.scenes}
    evaluator = ladder_evaluator.LadderEvaluator(edits.records, arguments.weights)
    todo = [
        (
            {"scene": scene.id, "rung": rung, "start": start, "method": method},
            (scene, rung, start, method),
        )
        for start, count in counts.items()
        for scene in edits.scenes[:count]
        for rung in edits.pictures
        # a photograph's light is known up to its exposure at best
        if rung == "direct" or start == PREDICTED
        for method in METHODS
    ]
    compared = [
        ({"scene": scene.id, "rung": rung}, (scene, rung))
        for scene in edits.scenes[: arguments.pictures]
        for rung in edits.pictures
    ]
    pictures = runner.resume(
        arguments.out / "pictures.jsonl",
        compared,
        lambda case: compare_with_sum(evaluator, *case),
        "picture",
    )
    for method in METHODS:  # once without a clock, because kernels are compiled
        _warm_up(evaluator, edits.scenes[0], next(iter(edits.pictures)), method)
    rows = runner.resume(
        arguments.out / "rows.jsonl", todo, lambda case: row_of(evaluator, *case), "refinement"
    )
    return {
        "rows": rows,
        "pictures": pictures,
        "weights": arguments.weights.name,
        "seen": edits.seen,
    }


def glossy(records: Records) -> set[str]:
    """Return the names of materials with lobes that are visible and narrower than texels."""
    import torch

    from learn.layer.display_method import method_for

    return {
        name
        for name in records.materials
        if method_for(torch.from_numpy(records.label(name))) == "quadrature"
    }


def settings_of(rung: str, method: str) -> RefinementSettings:
    """Return how pictures of a rung are refined, in one outer iteration.

    Those of 8 bits are refined as photographs are, others as evaluations are.
    """
    from dataclasses import replace

    from learn.evaluation.ladder_design import RUNGS
    from learn.refinement import PHOTOGRAPHS, RefinementSettings

    (known,) = (each for each in RUNGS if each.name == rung)
    settings = PHOTOGRAPHS if known.eight_bit else RefinementSettings()
    return replace(settings, outer_iterations=1).with_method(method)


def _warm_up(evaluator: Any, scene: Scene, rung: str, method: str) -> None:
    from dataclasses import replace

    from learn.experiments.editing import drawn_edits

    settings = settings_of(rung, method)
    levels = tuple(
        replace(level, iterations=min(level.iterations, 1), joint_iterations=1)
        for level in settings.levels
    )
    settings = replace(settings, levels=levels)
    drawn_edits.refined_row(evaluator, scene, rung, settings)


def row_of(evaluator: Any, scene: Scene, rung: str, start: str, method: str) -> dict[str, Any]:
    """Return a row as of `drawn_edits.refined_row`, and the picture's material.

    evaluator   of learn.evaluation.ladder_evaluator
    """
    from dataclasses import replace

    from learn.experiments.editing import drawn_edits

    settings, is_true = settings_of(rung, method), start == TRUE_LIGHT
    if is_true:
        settings = replace(settings, order=("material", "normals"))
    return drawn_edits.refined_row(evaluator, scene, rung, settings, is_true) | {
        "source": scene.source[rung].materials[0],
        "target_is_glossy": scene.truth[rung].materials[0] in glossy(evaluator.records),
    }


def compare_with_sum(evaluator: Any, scene: Scene, rung: str) -> dict[str, Any]:
    """Return a picture's names, and the display L2 between its renderings by sum and by integral.

    "true" are those of the true parts, "predicted" those of the predicted ones.

    evaluator   of learn.evaluation.ladder_evaluator
    """
    from learn.data.devices import to_numpy
    from learn.editing.decomposition import Parts, require_parts
    from learn.evaluation.ladder_design import RUNGS
    from learn.evaluation.ladder_pictures import load_scene
    from learn.layer import predictions
    from learn.metrics.pictures import display_l2

    (known,) = (each for each in RUNGS if each.name == rung)
    batch = load_scene(evaluator.records, scene, known, evaluator.size).batch
    inside = to_numpy(batch.segments[0] > 0)

    def between_sum_and_integral(parts: Parts) -> float:
        of_parts = (parts.n, parts.label, parts.light, batch.segments, batch.elevation)
        by_sum, by_integral = (
            to_numpy(predictions.picture(*of_parts, policy)[0])
            for policy in (predictions.TEXEL_SUM, predictions.MEASURED)
        )
        return display_l2(by_sum, by_integral, inside)

    return {
        "shape": scene.shape,
        "light": scene.light,
        "source": scene.source[rung].materials[0],
        "true": between_sum_and_integral(Parts(batch.n, batch.label, batch.light)),
        "predicted": between_sum_and_integral(require_parts(evaluator.predict(batch))),
    }


def tables(report: runner.Report) -> str:
    """Return the figures of both methods on each rung, and by light."""
    result = ["# Refinement of glossy objects by the sum and by the integral\n"]
    result += [f"**{sentence}**\n" for sentence in report["seen"]]
    rows = report["rows"]
    sources = sorted({row["source"] for row in rows})
    result.append(
        f"Weights {report['weights']}; number of scenes {_count(rows, 'scene')}, of shapes"
        f" {_count(rows, 'shape')}, of materials with narrow lobes {len(sources)}"
        f" ({', '.join(sources)}), of materials to edit into {_count(rows, 'target')}. *quadrature*"
        " is the integral, *auto* the sum over texels, which is the default. Both begin at the same"
        " prediction. *Difference* and *ratio*"
        " are to auto, scene by scene; intervals are 95 % and draw shapes, target materials and"
        " lights. *One factor free*: L2 after the factor on the edit's radiance that makes it"
        " least.\n"
    )
    for rung in dict.fromkeys(row["rung"] for row in rows):
        result += _of_rung(
            rung,
            [row for row in rows if row["rung"] == rung],
            [picture for picture in report["pictures"] if picture["rung"] == rung],
        )
    return "\n".join(result)


def _count(rows: Sequence[Mapping[str, Any]], key: str) -> int:
    return len({row[key] for row in rows})


def _again(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the re-rendering's means, and what intervals say of the methods' difference."""
    import numpy as np

    from learn.metrics import bootstrap

    by = [[row for row in rows if row["method"] == method] for method in METHODS]
    kinds = ("shape", "source", "light")
    weights = bootstrap.draws_of_rows(by[0], kinds)
    ratios = []
    for key, name in (("image_l2", "the picture's re-rendering"), ("normals_mean_deg", "normals")):
        mine, theirs = (np.array([row["refined"][key] for row in of]) for of in by)
        ratio = runner.ratio_interval(theirs, mine, weights)
        ratios.append(
            f"{name} {mine.mean():.4g} by {METHODS[0]}, {theirs.mean():.4g} by"
            f" {METHODS[1]}, ratio {ratio}"
        )
    return f"Refined, means: {'; '.join(ratios)}. These intervals draw the pictures' materials.\n"


def _of_rung(
    rung: str, rows: Sequence[Mapping[str, Any]], pictures: Sequence[Mapping[str, Any]]
) -> list[str]:
    import numpy as np

    from learn.experiments.editing import drawn_edits

    result = []
    for start in dict.fromkeys(row["start"] for row in rows):
        of = [row for row in rows if row["start"] == start]
        result += [
            f"## Rung {rung}, {start}\n",
            drawn_edits.comparison(of, "method", METHODS, "refined by"),
            _again(of),
        ]
        into = [row for row in of if row["target_is_glossy"]]
        if into and start == PREDICTED:
            result += [
                f"Of these, edits into materials with narrow lobes ({_count(into, 'scene')}):\n",
                drawn_edits.comparison(into, "method", METHODS, "refined by"),
            ]
    lines = []
    for light in ["all", *sorted({picture["light"] for picture in pictures})]:
        of = [picture for picture in pictures if light in ("all", picture["light"])]
        cells = [
            f"{judge([picture[parts] for picture in of]):.2g}"
            for parts in ("true", "predicted")
            for judge in (np.median, np.max)
        ]
        lines.append([light, len(of), _count(of, "source"), *cells])
    result += [
        f"## Rung {rung}, sum and integral\n",
        "How far the picture's re-rendering by the sum is from that by the integral, display L2:\n",
        runner.table(
            [
                "light",
                "pictures",
                "materials",
                "true parts: median",
                "most",
                "predicted parts: median",
                "most",
            ],
            lines,
        ),
    ]
    return result
