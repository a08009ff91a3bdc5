"""Measure whether glossy objects are refined better through the integral than through the sum.

Pictures of objects in materials with lobes that are visible and narrower than a texel are refined
by each method of the layer from the same prediction, and the edits into other materials are
compared with Cycles' pictures of them. Pictures in direct light are refined as evaluations are, and
8-bit pictures as photographs are. All edits are rendered by the integral. The data set is one of
the ladder's jobs (`python -m learn evaluate-ladder --jobs DIR` names them), or of pictures in
direct light such as docs/jobs/evaluation. The report also says how far the sum is from the
integral, of the true parts and of the predicted ones. Seconds are of the processor, on one thread.
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
from manifests.training_runs import LAYER_METHODS

if TYPE_CHECKING:
    from learn.data.records import Records
    from learn.evaluation.ladder_design import Scene
    from learn.refinement import RefinementSettings

METHODS = LAYER_METHODS[::-1]  # the last one, auto, is what the others are compared with


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, the weights and the number of scenes."""
    options.add_data(parser, "a data set with pictures of each scene in several materials")
    options.add_weights(parser, options.TABLE_WEIGHTS)
    parser.add_argument(
        "--scenes",
        type=positive,
        default=24,
        metavar="N",
        help="number of scenes on each rung, shapes in turn (default 24)",
    )
    options.add_seed(parser, "seed by which edits are drawn")


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows", "weights", "seen"}; rows as of `row_of`, and scene, rung, method.

    Raises InputError for a data set without pictures in glossy materials beside others.
    """
    from dataclasses import asdict

    from learn.evaluation import ladder
    from learn.experiments import drawn_edits, relighting

    settings = {rung: asdict(settings_of(rung, METHODS[0])) for rung in relighting.RUNGS}
    edits = drawn_edits.opened(arguments, sources=glossy, settings=settings)
    bench = ladder.Bench(edits.records, arguments.weights)
    todo = [
        ({"scene": scene.id, "rung": rung, "method": method}, (scene, rung, method))
        for scene in edits.scenes
        for rung in edits.pictures
        for method in METHODS
    ]
    for method in METHODS:  # once without a clock, because kernels are compiled
        _warm_up(bench, edits.scenes[0], next(iter(edits.pictures)), method)
    rows = runner.resume(
        arguments.out / "rows.jsonl", todo, lambda case: row_of(bench, *case), "refinement"
    )
    return {"rows": rows, "weights": arguments.weights.name, "seen": edits.seen}


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
    """Return how pictures of a rung are refined: as evaluations are, or as photographs are."""
    from learn.evaluation.ladder_design import RUNGS
    from learn.refinement import PHOTOGRAPHS, RefinementSettings

    (known,) = (each for each in RUNGS if each.name == rung)
    return (PHOTOGRAPHS if known.eight_bit else RefinementSettings()).rendered_by(method)


def _warm_up(bench: Any, scene: Scene, rung: str, method: str) -> None:
    from dataclasses import replace

    from learn.experiments import drawn_edits

    settings = settings_of(rung, method)
    levels = tuple(
        replace(level, iterations=min(level.iterations, 1), joint_iterations=1)
        for level in settings.levels
    )
    settings = replace(settings, outer_iterations=1, levels=levels)
    drawn_edits.refined_row(bench, scene, rung, settings)


def row_of(bench: Any, scene: Scene, rung: str, method: str) -> dict[str, Any]:
    """Return a row as of `drawn_edits.refined_row`, the picture's material, and {"apart"}.

    "apart" is the display L2 between the picture's re-rendering by the sum and by the integral, of
    "true" parts and of those "predicted".

    bench   of learn.evaluation.ladder
    """
    from learn.evaluation.ladder_design import RUNGS
    from learn.evaluation.ladder_pictures import shown
    from learn.experiments import drawn_edits
    from learn.networks.prediction import Prediction

    row = drawn_edits.refined_row(bench, scene, rung, settings_of(rung, method))
    (known,) = (each for each in RUNGS if each.name == rung)
    batch = shown(bench.records, scene, known, bench.size).batch
    source = scene.source[rung].materials[0]
    narrow = scene.truth[rung].materials[0] in glossy(bench.records)
    parts = {
        "true": Prediction(batch.n, None, batch.label, None, batch.light),
        "predicted": bench.predict(batch),
    }
    return row | {
        "source": source,
        "target_is_glossy": narrow,
        "apart": {name: _apart(each, batch) for name, each in parts.items()},
    }


def _apart(parts: Any, batch: Any) -> float:
    """Return the display L2 between both renderings of parts, over the object."""
    from learn.data.devices import array
    from learn.layer import predictions
    from learn.metrics.pictures import display_l2

    def rendered(policy: predictions.Policy) -> Any:
        args = (parts.n, parts.label, parts.light, batch.segments, batch.elevation, policy)
        return array(predictions.picture(*args)[0])

    inside = array(batch.segments[0] > 0)
    return display_l2(rendered(predictions.TEXEL_SUM), rendered(predictions.MEASURED), inside)


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
        result += _of_rung(rung, [row for row in rows if row["rung"] == rung])
    return "\n".join(result)


def _count(rows: Sequence[Mapping[str, Any]], key: str) -> int:
    return len({row[key] for row in rows})


def _of_rung(rung: str, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    import numpy as np

    from learn.experiments import drawn_edits

    result = [
        f"## Rung {rung}\n",
        drawn_edits.comparison(rows, "method", METHODS, "refined by"),
    ]
    into = [row for row in rows if row["target_is_glossy"]]
    if into:
        result += [
            f"Of these, edits into materials with narrow lobes ({_count(into, 'scene')}):\n",
            drawn_edits.comparison(into, "method", METHODS, "refined by"),
        ]
    each = [row for row in rows if row["method"] == METHODS[0]]
    apart = {name: np.array([row["apart"][name] for row in each]) for name in ("true", "predicted")}
    middle, most = ({k: f(v) for k, v in apart.items()} for f in (np.median, np.max))
    result.append(
        "Display L2 between the picture's re-rendering by the sum and by the integral: of the true"
        f" parts {middle['true']:.2g} in the median and {most['true']:.3g} at most, of the predicted"
        f" parts {middle['predicted']:.2g} and {most['predicted']:.3g}.\n"
    )
    lines = []
    for light in sorted({row["light"] for row in rows}):
        of = [row for row in rows if row["light"] == light]
        means = [
            np.mean([row["refined"]["edit_l2"] for row in of if row["method"] == method])
            for method in METHODS
        ]
        true = np.mean([row["apart"]["true"] for row in of])
        lines.append([light, _count(of, "scene"), *(f"{mean:.0f}" for mean in means), f"{true:.2g}"])
    head = ["light", "scenes", *(f"edit, {method}" for method in METHODS)]
    result.append(runner.table([*head, "sum and integral apart, true parts"], lines))
    return result
