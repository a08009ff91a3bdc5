"""The edits of an experiment: pictures of the ladder's rungs, and scenes that are drawn of them."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from learn.experiments import runner

if TYPE_CHECKING:
    from learn.data.records import Records
    from learn.evaluation.ladder_design import Scene
    from learn.experiments.editing.ladder_scenes import Key
    from learn.refinement import RefinementSettings
    from manifests.schema import Record

FIGURES = {
    "edit_l2": ("edit, display L2", 0),
    "edit_l2_aligned": ("one factor free", 0),
    "normals_mean_deg": ("normals, °", 2),
    "irradiance": ("irradiance error", 3),
    "seconds": ("processor, s", 1),
}


class DrawnEdits(NamedTuple):
    """The edits that an experiment measures.

    pictures  as of `ladder_scenes.pictures_of`
    seen      sentences about what the weights saw of the scenes in training
    """

    records: Records
    pictures: Mapping[str, Mapping[Key, Record]]
    scenes: list[Scene]
    seen: list[str]


def opened(
    arguments: argparse.Namespace,
    sources: Callable[[Records], Collection[str]] | None = None,
    **settings: Any,
) -> DrawnEdits:
    """Return the edits of the arguments data, weights, scenes and seed; torch gets one thread.

    What rows.jsonl depends on is pinned in arguments.out, so that no run continues another's rows.

    sources   returns the materials of which one is the input picture's; None: any
    settings  further ones of the experiment that are pinned
    Raises    InputError for a data set without pictures of the rungs, and for an earlier run of
              other settings
    """
    import torch

    from learn.data.records import Records
    from learn.evaluation import ladder, overlap
    from learn.experiments.editing import ladder_scenes
    from manifests import outputs
    from manifests.store_paths import file_hash

    torch.set_num_threads(1)
    records = Records(arguments.data)
    pictures = ladder_scenes.pictures_of(records)
    scenes = ladder_scenes.edits_of(
        pictures,
        arguments.scenes,
        arguments.seed,
        None if sources is None else sources(records),
    )
    is_one = isinstance(arguments.weights, Path)
    weights = [arguments.weights] if is_one else arguments.weights
    seen = overlap.report_overlap(
        weights, ladder.list_tested(records, scenes), arguments.data, True
    )
    hashes = [file_hash(path) for path in weights]
    about = {
        "data": file_hash(arguments.data / "materials.json"),
        "weights": hashes[0] if is_one else hashes,
        "seed": arguments.seed,
    }
    outputs.pin_settings(arguments.out / "settings.json", about | settings)
    return DrawnEdits(records, pictures, scenes, seen)


def refined_row(
    evaluator: Any,
    scene: Scene,
    rung: str,
    settings: RefinementSettings,
    true_light: bool = False,
) -> dict[str, Any]:
    """Return a scene's names, and {FIGURES: value} of "predicted" and "refined" on a rung.

    evaluator       of learn.evaluation.ladder_evaluator
    true_light  whether the true light takes the place of the predicted one; settings say whether it
                may move
    """
    import time

    from msgspec import to_builtins

    from learn.editing.decomposition import require_parts
    from learn.evaluation import ladder_evaluator
    from learn.evaluation.ladder_design import RUNGS
    from learn.evaluation.ladder_pictures import load_scene

    known = next(each for each in RUNGS if each.name == rung)
    picture = load_scene(evaluator.records, scene, known, evaluator.size)
    began = time.process_time()
    start = evaluator.predict(picture.batch)
    if true_light:
        start = start._replace(light=picture.batch.light)
    predicted = time.process_time()
    refined = evaluator.refine(picture.batch, start, settings).prediction
    seconds = {"predicted": predicted - began, "refined": time.process_time() - predicted}
    target = scene.truth[rung].materials[0]
    return {
        "shape": scene.shape,
        "light": scene.light,
        "target": target,
        "metal": evaluator.records.material(target).family == "metal",
    } | {
        name: to_builtins(
            ladder_evaluator.measure_decomposition(require_parts(parts), picture, picture.batch)
        )
        | {
            "seconds": seconds[name],
            "image_l2": ladder_evaluator.error_of_rerendering(parts, picture),
        }
        for name, parts in (("predicted", start), ("refined", refined))
    }


def comparison(
    rows: Sequence[Mapping[str, Any]], key: str, values: Sequence[Any], title: str
) -> str:
    """Return a table of `refined_row`s on one rung, each value of a key against the last of them.

    rows    of all values, whose scenes are in the same order
    title   of the column of values
    """
    import numpy as np

    from learn.metrics import bootstrap

    by_value = [[row for row in rows if row[key] == value] for value in values]
    first, last = by_value[0], by_value[-1]
    kinds = ("shape", "target", "light")
    weights = bootstrap.draws_of_rows(last, kinds)

    def figures(of: Sequence[Mapping[str, Any]], part: str, name: str) -> np.ndarray:
        return np.array([row[part][name] for row in of])

    def means(of: Sequence[Mapping[str, Any]], part: str) -> list[str]:
        cells = []
        for name, (_, digits) in FIGURES.items():
            cells.append(f"{figures(of, part, name).mean():.{digits}f}")
            if name == "edit_l2":
                cells.append(f"{np.median(figures(of, part, name)):.0f}")
        return cells

    def compared(of: Sequence[Mapping[str, Any]]) -> list[str]:
        mine, theirs = (figures(each, "refined", "edit_l2") for each in (of, last))
        slow, fast = (figures(each, "refined", "seconds") for each in (last, of))
        return [
            runner.mean_interval(mine - theirs, weights, 0),
            runner.ratio_interval(theirs, mine, weights, 3),
            f"{(mine < theirs).sum()} of {len(last)}",
            runner.ratio_interval(slow, fast, weights, 2),
        ]

    lines = [["none: predicted", *means(first, "predicted"), "", "", "", ""]]
    for value, of in zip(values, by_value, strict=True):
        cells = [""] * 4 if of is last else compared(of)
        lines.append([str(value), *means(of, "refined"), *cells])
    edit, *rest = (name for name, _ in FIGURES.values())
    head = [title, f"{edit}, mean", "median", *rest]
    head += ["difference of edits", "ratio of edits", "better edits", "ratio of seconds"]
    return runner.table(head, lines)
