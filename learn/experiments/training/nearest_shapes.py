"""Measure normals by how far a shape is from the nearest that the weights were trained on.

Pictures are those of the data sets that Cycles rendered with direct light from the elevation of
training. The distance is that of learn.evaluation.distances: the mean angle between the normals of
a shape's views and the nearest views of one training shape, turns about the vertical left free as
far as the training showed them. --geometry names a data set with the geometry of the training
shapes, of which those count that the weights say they saw.

The report has normals of each data set, of thirds of all shapes by distance, and the rank
correlation of a shape's error with its distance. rows.jsonl keeps a line per picture: the same
command continues.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure

    from learn.data.records import Records
    from learn.networks.prediction import Coded
    from manifests.schema import Record

DRAWS = 2000
KINDS = ("light", "shape", "material")  # what the bootstrap draws; keys of a row
GROUPS = ("nearest third", "middle third", "farthest third")
FEWEST = 4  # shapes, of which a rank correlation is given


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data sets, the training's geometry, the weights and the number of pictures."""
    parser.add_argument(
        "--data",
        type=Path,
        required=True,
        action="append",
        metavar="DIR",
        help="a data set with pictures under direct light; repeat the option",
    )
    parser.add_argument(
        "--geometry",
        type=Path,
        required=True,
        metavar="DIR",
        help="a data set with geometry of the shapes that the weights were trained on",
    )
    options.add_weights(parser, options.TABLE_WEIGHTS)
    options.add_count(parser, "--pictures", 400, "of each data set at most")


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows", "distances", "seen", "weights"}.

    rows       [{"picture", "data", "shape", "material", "light", "angle", "facing"}]: mean angles
               over the mask in degrees, predicted and of normals that all face the viewer
    distances  {data: {shape: degrees}}
    Raises     InputError for a data set without such pictures
    """
    import torch

    from learn.data.records import Records
    from learn.data.seen import DIGITS
    from learn.evaluation import distances
    from learn.networks import weights as checkpoint
    from manifests import outputs
    from manifests.store_paths import file_hash

    torch.set_num_threads(1)
    network, metadata = checkpoint.load_full_network(arguments.weights)
    seen = checkpoint.seen_by(arguments.weights)
    known = set(seen.shapes) if seen is not None else set()
    about = {
        "weights": file_hash(arguments.weights),
        "data": {path.name: file_hash(path / "materials.json") for path in arguments.data},
    }
    outputs.pin_settings(arguments.out / "settings.json", about)
    training = distances.training_shapes(arguments.geometry, seen)
    todo, degrees, sentences = [], {}, []
    for folder in arguments.data:
        records = Records(folder)
        shown = pictures_of(records, metadata["size"], arguments.pictures)
        sentences += _what_weights_saw(arguments.weights, records, shown)
        same = {record.shape for record in shown if record.shape_hash[:DIGITS] in known}
        degrees[folder.name] = distances.shape_distances(
            distances.rasters(records, shown), training, same
        )
        todo += [
            ({"picture": f"{folder.name} {record.id}", "data": folder.name}, (records, record))
            for record in shown
        ]

    def row(case: tuple[Records, Record]) -> dict[str, Any]:
        return row_of(network, *case)

    rows = runner.resume(arguments.out / "rows.jsonl", todo, row, "picture")
    name = arguments.weights.name
    return {"rows": rows, "distances": degrees, "seen": sorted(set(sentences)), "weights": name}


def pictures_of(records: Records, size: int, most: int) -> list[Record]:
    """Return at most `most` pictures under direct light, of all shapes in turns.

    size    of pictures of the weights
    Raises  InputError where there is none
    """
    from manifests.errors import InputError

    by_shape: dict[str, list[Record]] = {}
    for record in sorted(records.records, key=lambda each: each.id):
        camera = record.camera
        if (
            record.tier == "direct"
            and camera.size == (size, size)
            and camera.fov_deg is None
            and not camera.roll_deg
            and len(set(record.materials)) == 1
        ):
            by_shape.setdefault(record.shape, []).append(record)
    turns = [(turn, each.id, each) for own in by_shape.values() for turn, each in enumerate(own)]
    if not turns:
        rule = f"pictures of {size}² under direct light by an upright orthographic camera"
        remedy = 'render some: "tiers": ["direct"] in the job, without camera_ranges'
        raise InputError(records.folder, rule, f"none in {len(records)} records", remedy)
    return [each for _, _, each in sorted(turns, key=lambda turn: turn[:2])[:most]]


def _what_weights_saw(weights: Path, records: Records, shown: Sequence[Record]) -> list[str]:
    """Return what the report says at its top of what the weights saw of these pictures."""
    from learn.data.seen import DIGITS, map_hash
    from learn.evaluation import overlap

    tested = {
        "shapes": {record.shape_hash[:DIGITS]: record.shape for record in shown},
        "materials": {},
        "lights": {
            map_hash(records.light(name)): name for name in {record.light for record in shown}
        },
    }
    return overlap.report_overlap([weights], tested, records.folder, True)


def row_of(network: Coded, records: Records, record: Record) -> dict[str, Any]:
    """Return the errors of predicted normals, and of normals facing the viewer, on a picture."""
    import torch

    from learn.data.pairs import make_batch

    batch = make_batch(records, record)
    inside = batch.segments > 0
    with torch.no_grad():
        n = network(batch.image, batch.mask, None, ("normals",)).n
    angle = (n * batch.n).sum(1).clamp(-1, 1).arccos().rad2deg()[inside].mean()
    facing = batch.n[:, 2].clamp(-1, 1).arccos().rad2deg()[inside].mean()
    return {
        "shape": record.shape,
        "material": record.materials[0],
        "light": record.light,
        "angle": float(angle),
        "facing": float(facing),
    }


def tables(report: runner.Report) -> str:
    """Return normals of each data set and of thirds by distance, and the rank correlations."""
    known = report["distances"]
    rows = [row | {"distance": known[row["data"]][row["shape"]]} for row in report["rows"]]
    head = ["", "shapes", "pictures", "mean distance, °", "normals, mean °", "facing the viewer, °"]
    by_set: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        by_set.setdefault(row["data"], []).append(row)
    thirds = thirds_of(rows)
    lines = [_line(title, of_title) for title, of_title in (by_set | thirds).items() if of_title]
    correlated = [
        [title, str(len(shapes_of(each))), _correlation(each)]
        for title, each in ({"all shapes": rows} | by_set).items()
    ]
    return "\n\n".join(
        [
            "# Normals by distance to the nearest training shape",
            *report["seen"],
            f"Normals that `{report['weights']}` predicts from pictures under direct light. The"
            " distance is the mean angle between the normals of a shape's views and the nearest"
            " views of one training shape, 90° where only one of the two is. Intervals are over"
            " shapes, materials and lights.",
            runner.table(head, lines),
            "Rank correlation (Spearman) of a shape's mean error with its distance, and its"
            " interval over shapes:",
            runner.table(["", "shapes", "rank correlation"], correlated),
        ]
    )


def shapes_of(rows: Sequence[Mapping[str, Any]]) -> list[tuple[float, float]]:
    """Return (distance, mean error) of each shape."""
    import numpy as np

    by_shape: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        by_shape.setdefault((row["data"], row["shape"]), []).append(row)
    return [
        (own[0]["distance"], float(np.mean([row["angle"] for row in own])))
        for own in by_shape.values()
    ]


def thirds_of(rows: Sequence[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Return {words: rows} of three groups of equally many shapes, by distance."""
    import numpy as np

    names = sorted({(row["distance"], row["data"], row["shape"]) for row in rows})
    parts = np.array_split(np.arange(len(names)), len(GROUPS))
    group = {names[i][1:]: words for words, part in zip(GROUPS, parts, strict=True) for i in part}
    return {
        words: [row for row in rows if group[row["data"], row["shape"]] == words]
        for words in GROUPS
    }


def rank_correlation(pairs: np.ndarray) -> tuple[float, float, float] | None:
    """Return (Spearman's rank correlation, low, high) of pairs (S, 2), bootstrapped over rows.

    None for fewer than FEWEST rows, or where one column is constant
    """
    import numpy as np
    from scipy.stats import rankdata

    from learn.metrics import bootstrap

    if len(pairs) < FEWEST or (np.ptp(pairs, 0) == 0).any():
        return None

    def of(some: np.ndarray) -> float:
        a, b = rankdata(some, axis=0).T
        spread = a.std() * b.std()
        return float(((a - a.mean()) * (b - b.mean())).mean() / spread) if spread else np.nan

    rng = np.random.default_rng(0)
    drawn = [of(pairs[rng.integers(len(pairs), size=len(pairs))]) for _ in range(DRAWS)]
    low, high = np.nanpercentile(drawn, bootstrap.LEVELS)
    return of(pairs), float(low), float(high)


def _correlation(rows: Sequence[Mapping[str, Any]]) -> str:
    import numpy as np

    result = rank_correlation(np.array(shapes_of(rows)))
    return "too few shapes" if result is None else runner.interval(result, 2)


def _line(title: str, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a line of the first table."""
    import numpy as np

    from learn.metrics import bootstrap

    weights = bootstrap.draws_of_rows(rows, KINDS, DRAWS)
    columns = [np.array([row[key] for row in rows]) for key in ("angle", "facing")]
    cells = [runner.mean_interval(values, weights, 1) for values in columns]
    shapes = shapes_of(rows)
    distance = f"{np.mean([each[0] for each in shapes]):.1f}"
    return [title, str(len(shapes)), str(len(rows)), distance, *cells]


def figure(report: runner.Report) -> Figure:
    """Return a chart of each shape's mean error over its distance, by data set."""
    from matplotlib.figure import Figure

    result = Figure(figsize=(7, 5), layout="constrained")
    axes = result.subplots()
    for name, known in report["distances"].items():
        rows = [
            row | {"distance": known[row["shape"]]} for row in report["rows"] if row["data"] == name
        ]
        axes.plot(*zip(*shapes_of(rows), strict=True), "o", label=name, alpha=0.7)
    axes.set_xlabel("distance to the nearest training shape (°)")
    axes.set_ylabel("error of predicted normals, mean over the shape's pictures (°)")
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    axes.legend(loc="upper left")
    axes.grid(alpha=0.3)
    return result
