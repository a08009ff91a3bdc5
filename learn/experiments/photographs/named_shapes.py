"""Measure what it gains to say that an object is a box, a cylinder, a ball or flat.

Views of meshes that a person would call so are relit with held-out materials and lights and taken
by the camera model of training, as in `unseen-shapes`. The report compares the predicted normals
with those of the primitive that is named for each mesh, and with those of the same primitive used
only where its outline is that of the mask. Masks of this camera model have errors, holes and
missing parts. Shapes, materials and lights that the weights saw in training are refused. rows.jsonl
keeps a line per picture: the same command continues.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner

if TYPE_CHECKING:
    from learn.data.data_split import DataSplit
    from learn.data.relit import RelitDataset
    from learn.evaluation.overlap import Tested
    from learn.networks.prediction import Coded

DRAWS = 500
KEPT = 0.95  # overlap from which the last column takes the primitive
COLUMNS = ("predicted", "primitive", "primitive, if it fits", "facing the viewer")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, the names of its meshes, the weights and the number of pictures."""
    parser.add_argument(
        "--data", type=Path, required=True, metavar="DIR", help="a data set with geometry of meshes"
    )
    parser.add_argument(
        "--shapes",
        type=Path,
        required=True,
        metavar="FILE",
        help='a JSON file {"shapes": {mesh: box, cylinder, ball or flat}}; others are left out',
    )
    options.add_weights(parser)
    options.add_count(parser, "--pictures", 160, "of named meshes")
    options.add_allow_overlap(parser)


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows", "all": number of pictures, also of meshes without a name, "seen"}.

    rows  [{"picture", "shape", "named", "material", "overlap", columns: degrees}]
    seen  sentences of learn.evaluation.overlap
    Raises InputError: the weights saw what is measured, and --allow-overlap is not given
    """
    import torch

    from learn.evaluation import overlap
    from learn.experiments.training.unseen_shapes import photographs_of
    from learn.networks import weights as checkpoint
    from manifests import outputs
    from manifests.store_paths import file_hash

    torch.set_num_threads(1)
    shapes = read_shapes(arguments.shapes)
    file = arguments.weights
    network, metadata = checkpoint.load_network(file)
    source = photographs_of(arguments.data, file, [metadata["size"]])[metadata["size"]]
    shown = list_tested(source.data_split, shapes)
    seen = overlap.report_overlap([file], shown, arguments.data, arguments.allow_overlap)
    about = {
        "weights": file_hash(file),
        "data": file_hash(arguments.data / "materials.json"),
        "shapes": file_hash(arguments.shapes),
    }
    outputs.pin_settings(arguments.out / "settings.json", about)
    todo = [({"picture": str(k)}, k) for k in range(arguments.pictures)]

    def row(number: int) -> dict[str, Any]:
        return row_of(source, network, shapes, number)

    rows = runner.resume(arguments.out / "rows.jsonl", todo, row, "picture")
    named = [row for row in rows if row["named"] is not None]
    return {"rows": named, "all": len(rows), "seen": seen}


def list_tested(data_split: DataSplit, shapes: Mapping[str, str]) -> Tested:
    """Return what pictures of the named meshes show, as learn.evaluation.overlap has it."""
    from learn.evaluation import overlap

    shown = overlap.shown_by_split(data_split)
    named = {digits: name for digits, name in shown["shapes"].items() if stem_of(name) in shapes}
    return {**shown, "shapes": named}


def stem_of(shape: str) -> str:
    """Return what a list of shapes calls a mesh file: its name without folder and ending."""
    return Path(shape.split("?")[0]).stem


def read_shapes(path: Path) -> dict[str, str]:
    """Return {mesh: primitive} of a JSON file. Raises InputError for what is none."""
    import json

    from learn.primitives import PRIMITIVES
    from manifests.errors import InputError

    rule = f'{{"shapes": {{mesh: one of {", ".join(PRIMITIVES)}}}}}'
    try:
        shapes = json.loads(path.read_text())["shapes"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(path, rule, str(error), "see docs/jobs/named-shapes") from None
    wrong = [name for name, shape in shapes.items() if shape not in PRIMITIVES]
    if wrong:
        raise InputError(path, rule, f"{wrong[0]}: {shapes[wrong[0]]}", "correct the file")
    return dict(shapes)


def row_of(
    source: RelitDataset, network: Coded, shapes: dict[str, str], number: int
) -> dict[str, Any]:
    """Return the angles of one picture, in degrees; {"named": None} if its mesh has no name."""
    import numpy as np
    import torch

    from learn.data.batch import shape_and_material
    from learn.data.devices import to_numpy
    from learn.primitives.fitting import fit_primitive

    batch = source[number]
    shape, material = shape_and_material(batch.names[0])
    name = stem_of(shape)
    if name not in shapes:
        return {"shape": name, "named": None, "material": material}
    mask = to_numpy(batch.segments[0] > 0)
    with torch.no_grad():
        predicted = network(batch.image, batch.mask, None, ("normals",)).n
    n, truth = (to_numpy(part[0].movedim(0, -1)).astype(float) for part in (predicted, batch.n))
    fitted = fit_primitive(shapes[name], mask.astype(float), np.where(mask[..., None], n, 0))

    def angle(normals: np.ndarray) -> float:
        cosine = (normals * truth)[mask].sum(-1)
        return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())

    own, named = angle(n), angle(fitted.normals)
    return {
        "shape": name,
        "named": shapes[name],
        "material": material,
        "overlap": fitted.overlap,
        "predicted": own,
        "primitive, if it fits": named if fitted.overlap >= KEPT else own,
        "primitive": named,
        "facing the viewer": angle(np.broadcast_to([0.0, 0.0, 1.0], n.shape)),
    }


def tables(report: runner.Report) -> str:
    """Return mean angles of all named meshes, of each primitive, and by overlap."""
    rows = report["rows"]
    head = ["normals, mean angle (°)", "meshes", "pictures", *COLUMNS, "primitive better in"]
    parts = {"all": rows}
    for name in sorted({row["named"] for row in rows}):
        parts[name] = [row for row in rows if row["named"] == name]
    fits = [row for row in rows if row["overlap"] >= KEPT]
    if fits:
        parts[f"overlap of {KEPT:.0%} or more"] = fits
    if len(fits) < len(rows):
        parts["less overlap"] = [row for row in rows if row["overlap"] < KEPT]
    return "\n\n".join(
        [
            "# Normals of objects whose shape is named",
            # the first reports have no such sentences
            *(f"**{sentence}**" for sentence in report.get("seen", ())),
            f"{len(rows)} relit pictures of meshes that are named, taken by the camera model of"
            f" training ({report['all'] - len(rows)} others left out). Intervals are over meshes"
            " and materials.",
            runner.table(head, [_line(title, part) for title, part in parts.items()]),
        ]
    )


def _line(title: str, rows: list[dict[str, Any]]) -> list[str]:
    import numpy as np

    from learn.metrics import bootstrap

    weights = bootstrap.draws_of_rows(rows, ("shape", "material"), DRAWS)
    cells = [
        runner.mean_interval(np.array([row[column] for row in rows]), weights, 1)
        for column in COLUMNS
    ]
    better = np.mean([row["primitive"] < row["predicted"] for row in rows])
    return [
        title,
        str(len({row["shape"] for row in rows})),
        str(len(rows)),
        *cells,
        f"{better:.0%}",
    ]
