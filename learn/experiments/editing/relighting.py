"""Measure relighting, and materials of one picture on another object, under a given light.

Both are shown under a light that is in no input picture, and compared with Cycles' picture of the
same. Relighting: a picture is decomposed, and its predicted normals and material are rendered under
the other, true light. Transfer (Fig. 4 of the paper): the material that is predicted from one
picture is rendered on the normals that are predicted from a picture of another object, which is in
another material under another light. Both are measured on the rungs `direct` and `8-bit` of the
ladder, on a data set of its jobs (`python -m learn evaluate-ladder --jobs DIR` names them).
rows.jsonl keeps a line per result: the same command continues, and a larger --pictures adds to it.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner
from learn.experiments.editing.ladder_scenes import RUNGS, Key, pictures_of, remedy, rungs, scene_of
from learn.experiments.editing.relighting_tables import by_group, by_method, count_values

if TYPE_CHECKING:
    from learn.data.records import Records
    from learn.evaluation.ladder_pictures import Shown
    from learn.networks.prediction import Prediction
    from manifests.schema import Record

ON_RAY = True
TASKS = {
    "relighting": "Relighting: the object under another light",
    "transfer": "Transfer: the material of one picture on another object, under a third light",
}


@dataclass(frozen=True)
class Case:
    """A picture to be made.

    task      one of TASKS
    material  the picture whose material is predicted
    object    the picture whose normals are predicted; in relighting the same
    truth     the object in that material under the light that is given
    """

    task: str
    material: Key
    object: Key
    truth: Key


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, the weights and the number of pictures."""
    options.add_data(parser, "a data set of the ladder's jobs")
    options.add_weights(parser, options.TABLE_WEIGHTS)
    options.add_count(
        parser, "--pictures", 72, "number of input pictures of each task on each rung"
    )
    options.add_seed(parser, "seed by which pictures and lights are drawn")


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows": […], "weights", "seen", "available"}, with rows as of `row_of`.

    Raises InputError for a data set without two shapes in two materials under three lights.
    """
    import numpy as np
    import torch

    from learn.data.records import Records
    from learn.evaluation import ladder, overlap
    from learn.evaluation.methods import make_predictor, training_labels
    from learn.networks import weights as checkpoint
    from manifests import outputs
    from manifests.store_paths import file_hash

    torch.set_num_threads(1)
    weights = arguments.weights
    net, metadata = checkpoint.load_full_network(weights)
    records = Records(arguments.data)
    pictures = pictures_of(records)
    available = sorted(set.intersection(*(set(each) for each in pictures.values())))
    cases = cases_of(available, arguments.pictures, arguments.seed, arguments.data)
    scenes = [scene_of(pictures, case.object, case.truth) for case in cases]
    seen = overlap.report_overlap(
        [weights], ladder.list_tested(records, scenes), arguments.data, True
    )
    about = {
        "data": file_hash(records.store.fetch("materials.json")),
        "weights": file_hash(weights),
        "seed": arguments.seed,
    }
    outputs.pin_settings(arguments.out / "settings.json", about)
    mean = torch.from_numpy(np.mean(training_labels(None, "built-in"), 0)).float()[None]
    bench = Bench(records, pictures, make_predictor(net), metadata["size"], mean)
    todo = [
        ({"task": case.task, "rung": rung, "of": _name(case)}, (case, rung))
        for rung in pictures
        for case in cases
    ]
    rows = runner.resume(arguments.out / "rows.jsonl", todo, lambda c: bench.row(*c), "result")
    return {
        "rows": rows,
        "weights": Path(weights).name,
        "seen": seen,
        "available": len(available),
    }


def cases_of(available: Sequence[Key], count: int, seed: int, where: Path) -> list[Case]:
    """Return up to `count` cases of each task.

    Input pictures take turns by shape. Each gives its material and, in relighting, its object; the
    light, and in transfer the other object, are drawn. A larger count adds to the same cases.

    available  sorted; where: for messages
    Raises     InputError if the pictures allow none of one of TASKS
    """
    import numpy as np

    from manifests.errors import InputError

    known = set(available)
    by_shape: dict[str, list[Key]] = defaultdict(list)
    for index in np.random.default_rng(seed).permutation(len(available)):
        by_shape[available[index].shape].append(available[index])
    turns = [(turn, key) for keys in by_shape.values() for turn, key in enumerate(keys)]
    order = [key for _, key in sorted(turns, key=lambda each: each[0])]
    result: dict[str, list[Case]] = {task: [] for task in TASKS}
    for number, key in enumerate(order):
        possible = {
            "relighting": _objects(known, key, [key]),
            "transfer": _objects(known, key, [each for each in available if each != key]),
        }
        for stream, (task, pairs) in enumerate(possible.items()):
            if pairs and len(result[task]) < count:
                rng = np.random.default_rng(
                    np.random.SeedSequence(seed, spawn_key=(number, stream))
                )
                result[task].append(Case(task, key, *pairs[rng.integers(len(pairs))]))
        if min(map(len, result.values())) >= count:
            break
    for task, cases in result.items():
        if not cases:
            rule = f"pictures for {task}: two shapes, each in two materials under three lights"
            raise InputError(where, rule, "too few", remedy())
    return [case for cases in result.values() for case in cases]


def _objects(
    known: Collection[Key], material: Key, candidates: Sequence[Key]
) -> list[tuple[Key, Key]]:
    """Pairs of an object's picture and the truth of it in the material under a light that is in
    neither input.

    Another object than the material's is in another shape, material and light.
    """
    lights = sorted({key.light for key in known})
    return [
        (each, truth)
        for each in candidates
        if each == material
        or all(
            getattr(each, what) != getattr(material, what) for what in ("shape", *Key._fields[2:])
        )
        for light in lights
        if light not in (each.light, material.light)
        and (truth := Key(each.shape, each.viewpoint, light, material.material)) in known
    ]


def _name(case: Case) -> str:
    """Name a case for rows.jsonl."""
    return " < ".join(
        f"{key.shape} {key.viewpoint} {key.light[0]}+{key.light[1]} {key.material}"
        for key in (case.truth, case.object, case.material)
    )


@dataclass
class Bench:
    """Records and a network, which make and measure pictures.

    pictures  as of `pictures_of`; predict: of learn.evaluation.methods; size of its pictures
    mean      (1, 108) label of the baseline's material
    """

    records: Records
    pictures: Mapping[str, Mapping[Key, Record]]
    predict: Any
    size: int
    mean: Any

    def row(self, case: Case, name: str) -> dict[str, Any]:
        """Return what a result is of, and {"l2", "one_factor": {method: value}}."""
        from learn.metrics.pictures import display_l2, l2_after_alignments

        shown, made = self.results(case, name)
        return {
            "group": scene_of(self.pictures, case.object, case.truth).group,
            "shape": case.object.shape,
            "material_of": case.material.shape,
            "material": case.truth.material,
            "metal": self.records.material(case.truth.material).family == "metal",
            "from_light": _light(case.material.light),
            "to_light": _light(case.truth.light),
            "l2": {key: display_l2(each, shown.target, shown.mask) for key, each in made.items()},
            "one_factor": {
                key: l2_after_alignments(each, shown.target, shown.mask)["l2_one_factor"]
                for key, each in made.items()
            },
        }

    def results(self, case: Case, name: str) -> tuple[Shown, dict[str, Any]]:
        """Return the object with its truth, and {method: radiance (H, W, 3)}."""
        import numpy as np
        import torch

        from learn.data.devices import to_numpy
        from learn.evaluation.methods import render_by_layer
        from learn.networks.prediction import require_part
        from shaders.envmap import roll

        shown, prediction = self.decomposed(case.object, case.truth, name)
        label = require_part(prediction.label)
        if case.material != case.object:
            _, other = self.decomposed(case.material, case.material, name)
            label = require_part(other.label)
        L = roll(self.records.light(case.truth.light[0]), case.truth.light[1])
        light = torch.from_numpy(np.ascontiguousarray(L)).movedim(-1, 0)[None]
        batch, true_label = shown.batch, torch.from_numpy(shown.label)
        facing = torch.zeros_like(batch.n)
        facing[:, 2] = 1.0
        n = require_part(prediction.n)
        parts = {
            "facing": (facing, self.mean),
            "predicted": (n, label),
            "normals": (n, true_label),
            "material": (batch.n, label),
            "true": (batch.n, true_label),
        }
        made = {"unchanged": to_numpy((batch.image * batch.mask)[0].movedim(0, -1))}
        made |= {key: render_by_layer(*each, light, batch) for key, each in parts.items()}
        return shown, made

    def decomposed(self, source: Key, truth: Key, name: str) -> tuple[Shown, Prediction]:
        """Return a picture on a rung beside its truth, and its prediction."""
        from learn.evaluation.ladder_pictures import load_scene

        rung = next(rung for rung in rungs() if rung.name == name)
        picture = load_scene(self.records, scene_of(self.pictures, source, truth), rung, self.size)
        return picture, self.predict(picture.batch)


def _light(light: tuple[str, int]) -> str:
    return light[0] if not light[1] else f"{light[0]} by {light[1]} texels"


def tables(report: runner.Report) -> str:
    """Return a table for each task and rung, with a row for each method."""
    rows = report["rows"]
    result = ["# Relighting, and materials on other objects\n"]
    result += [f"**{sentence}**\n" for sentence in report["seen"]]
    result.append(
        f"Weights {report['weights']}; {report['available']} pictures are there on every rung:"
        f" {count_values(rows, 'shape', 'shapes')}, {count_values(rows, 'material', 'materials')},"
        f" {count_values(rows, 'to_light', 'lights')}. Errors are against Cycles' picture under the"
        " light that is given, which no input shows. *One factor free*: L2 after the factor on the"
        " result's radiance that makes it least. *Ratio*: of means, to the object's picture"
        " unchanged. Intervals draw shapes (in transfer those of both pictures), materials, and"
        " lights of both sides. The layer has neither shadows nor interreflection, which the truth"
        " of the rung 8-bit has: the last row is that error. Predictions are not refined.\n"
    )
    for task, title in TASKS.items():
        for rung in RUNGS:
            chosen = [row for row in rows if (row["task"], row["rung"]) == (task, rung)]
            if chosen:
                result += [f"## {title}; rung {rung}, {len(chosen)} pictures\n", by_method(chosen)]
                result += ["The row *predicted* by group of the object's shape:\n"]
                result += [by_group(chosen)]
    return "\n".join(result)
