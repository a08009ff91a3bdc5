"""Compare weights on Cycles' pictures of glossy objects, with everything predicted.

Each picture shows an object in a material with lobes that are visible and narrower than a texel. It
is decomposed by each of the weights, rendered again, and edited into another material, of which
there is a picture by Cycles too. All renderings are by the integral. Nothing is refined, so that
the figures are those of the networks alone. Each of the weights sees pictures of the size that it
was trained with, or all see those of --size; in direct light smaller ones have every k-th pixel.
The data set is one of the ladder's jobs (`python -m learn evaluate-ladder --jobs DIR` names them),
or of pictures in direct light such as docs/jobs/evaluation. rows.jsonl keeps a line per picture and
weights: the same command continues, and a larger --scenes adds to it.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner
from manifests.option_types import positive

if TYPE_CHECKING:
    from learn.evaluation.ladder_design import Scene
    from learn.evaluation.ladder_pictures import Shown

# of a row: the title of its column and its decimal places
FIGURES = {
    "normals_mean_deg": ("normals, °", 2),
    "albedo": ("material, log albedo error", 3),
    "irradiance": ("light, irradiance error", 3),
    "image_l2": ("re-rendering, display L2", 0),
    "edit_l2": ("edit, display L2", 0),
    "edit_l2_aligned": ("edit, one factor free", 0),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, the weights and the number of scenes."""
    options.add_data(parser, "a data set with pictures of each scene in several materials")
    parser.add_argument(
        "--weights",
        action="append",
        required=True,
        type=named_weights,
        metavar="NAME=FILE",
        help="weights and what the report calls them; repeat the option: the others are compared"
        " with the first ones",
    )
    options.add_count(parser, "--scenes", 48, "number of pictures on each rung, shapes in turn")
    parser.add_argument(
        "--size",
        type=positive,
        metavar="N",
        help="size of pictures for all weights (default: that of each training)",
    )
    options.add_seed(parser, "seed by which edits are drawn")


def named_weights(text: str) -> tuple[str, Path]:
    """Return (name, path) of NAME=FILE, or of NAME=NAME of the program's own weights."""
    name, _, path = text.partition("=")
    if not name or not path:
        raise argparse.ArgumentTypeError(f"expected NAME=FILE, found {text!r}")
    return name, options.weights_file(path)


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows", "weights": [name], "sizes": {name: pixels}, "seen"}; rows as of `row_of`.

    Raises InputError for a data set without pictures in glossy materials beside others, and for two
    weights of one name.
    """
    from learn.evaluation import ladder_evaluator
    from learn.experiments.editing import drawn_edits
    from learn.experiments.editing.refinement_methods import glossy
    from manifests.errors import InputError

    named = dict(arguments.weights)
    if len(named) < len(arguments.weights):
        names = ", ".join(name for name, _ in arguments.weights)
        raise InputError("--weights", "a name of its own for each", names, "rename one")
    edits = drawn_edits.opened(
        argparse.Namespace(**vars(arguments) | {"weights": list(named.values())}),
        sources=glossy,
        names=list(named),
        size=arguments.size,
    )
    evaluators = {
        name: ladder_evaluator.LadderEvaluator(edits.records, path) for name, path in named.items()
    }
    for evaluator in evaluators.values():
        evaluator.size = arguments.size or evaluator.size
    todo = [
        ({"scene": scene.id, "rung": rung, "weights": name}, (scene, rung, name))
        for scene in edits.scenes
        for rung in edits.pictures
        for name in named
    ]
    rows = runner.resume(
        arguments.out / "rows.jsonl",
        todo,
        lambda case: row_of(evaluators[case[2]], *case[:2]),
        "picture",
    )
    return {
        "rows": rows,
        "weights": list(named),
        "sizes": {name: evaluator.size for name, evaluator in evaluators.items()},
        "seen": list(dict.fromkeys(edits.seen)),
    }


def row_of(evaluator: Any, scene: Scene, rung: str) -> dict[str, Any]:
    """Return a picture's names and {FIGURES: value}.

    evaluator  of learn.evaluation.ladder_evaluator
    """
    from learn.editing.decomposition import require_parts
    from learn.evaluation import ladder_evaluator
    from learn.evaluation.ladder_design import RUNGS
    from learn.evaluation.ladder_pictures import load_scene
    from learn.training.validation import albedo_errors

    (known,) = (each for each in RUNGS if each.name == rung)
    picture = of_size(load_scene(evaluator.records, scene, known, evaluator.size), evaluator.size)
    prediction = evaluator.predict(picture.batch)
    parts = require_parts(prediction)
    of_parts = ladder_evaluator.measure_decomposition(parts, picture, picture.batch)
    return {
        "shape": scene.shape,
        "light": scene.light,
        "source": scene.source[rung].materials[0],
        "target": scene.truth[rung].materials[0],
        "normals_mean_deg": of_parts.normals_mean_deg,
        "albedo": float(albedo_errors(parts.label, picture.batch)["albedo"][0]),
        "irradiance": of_parts.irradiance,
        "image_l2": ladder_evaluator.error_of_rerendering(prediction, picture),
        "edit_l2": of_parts.edit_l2,
        "edit_l2_aligned": of_parts.edit_l2_aligned,
    }


def of_size(picture: Shown, size: int) -> Shown:
    """Return every k-th pixel of a picture that has k times as many rows and columns as `size`.

    Others are returned as they are. Each pixel keeps its value, as in training pictures, which take
    the same pixels of larger geometry.
    """
    rows, columns = picture.mask.shape
    step = rows // size
    if step < 2 or rows != columns or rows % size:
        return picture
    every = slice(step // 2, None, step)
    batch = picture.batch
    return replace(
        picture,
        target=picture.target[every, every],
        mask=picture.mask[every, every],
        batch=replace(
            batch,
            **{
                name: getattr(batch, name)[..., every, every].contiguous()
                for name in ("image", "mask", "n", "segments")
            },
        ),
    )


def tables(report: runner.Report) -> str:
    """Return the figures of all weights on each rung, and their ratios to those of the first."""
    rows, names = report["rows"], report["weights"]
    sizes = ", ".join(f"{name} {size}²" for name, size in report["sizes"].items())
    parts = ["# Weights on Cycles' pictures of glossy objects"]
    parts += [f"**{sentence}**" for sentence in report["seen"]]
    parts.append(
        "Everything is predicted and nothing refined. Renderings are by the integral. Size of"
        f" pictures: {sizes}. Intervals are 95 % and draw shapes, the pictures' materials and"
        " lights; those of ratios are of pairs, picture by picture, and below 1 is better."
    )
    for rung in dict.fromkeys(row["rung"] for row in rows):
        parts += _of_rung(rung, [row for row in rows if row["rung"] == rung], names)
    return "\n\n".join(part.rstrip() for part in parts) + "\n"


def _of_rung(rung: str, rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> list[str]:
    import numpy as np

    from learn.metrics import bootstrap

    by = {name: [row for row in rows if row["weights"] == name] for name in names}
    first = by[names[0]]
    weights = bootstrap.draws_of_rows(first, ("shape", "source", "light"))

    def values(name: str, key: str) -> np.ndarray:
        return np.array([row[key] for row in by[name]])

    counts = {kind: len({row[kind] for row in first}) for kind in ("shape", "source", "light")}
    head = ["weights", *(title for title, _ in FIGURES.values())]
    means = [
        [
            name,
            *(
                runner.mean_interval(values(name, key), weights, digits)
                for key, (_, digits) in FIGURES.items()
            ),
        ]
        for name in names
    ]
    ratios = [
        [
            name,
            *(
                runner.ratio_interval(values(names[0], key), values(name, key), weights)
                for key in FIGURES
            ),
        ]
        for name in names[1:]
    ]
    result = [
        f"## Rung {rung}",
        f"{len(first)} pictures of {counts['shape']} shapes, {counts['source']} materials with"
        f" narrow lobes and {counts['light']} lights, means:",
        runner.table(head, means),
    ]
    if ratios:
        result += [f"Ratios to `{names[0]}`:", runner.table(head, ratios)]
    return result
