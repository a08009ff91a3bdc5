"""Measure the normals of weights on many shapes, in pictures made as photographs.

Every view of each data set's geometry is relit with materials and lights that the weights' run
held out, with shadows, and taken by the camera model of training at an unknown exposure
(learn.data.camera_model). Pictures are made without Cycles, so that hundreds of shapes take
minutes; the ladder (`python -m learn evaluate-ladder`) shows fewer shapes in Cycles' pictures. All
weights see the same views, materials and lights, each in pictures of the size that it was trained
on; the geometry must be a whole number of times larger. The report has mean angles of each data set
and of each family, with intervals over shapes and materials, beside normals that all face the
viewer. rows.jsonl keeps a line per picture: the same command continues.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner

if TYPE_CHECKING:
    from learn.data.relit import RelitDataset
    from learn.networks.prediction import Coded

ON_RAY = True
FACING = "facing the viewer"
DRAWS = 500
MOST_FAMILIES = 40  # of a report: further ones have no row of their own


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data sets, the weights and the number of pictures."""
    parser.add_argument(
        "--data",
        type=Path,
        required=True,
        action="append",
        metavar="DIR",
        help="a data set with geometry of shapes that no training saw; repeat the option",
    )
    parser.add_argument(
        "--weights",
        type=Path,
        required=True,
        action="append",
        metavar="FILE",
        help="a weights.safetensors; repeat the option to compare several",
    )
    options.add_count(parser, "--pictures", 400, "of each data set")
    parser.add_argument(
        "--allow-overlap",
        action="store_true",
        help="measure shapes that the weights saw too, and say so",
    )


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows": [{"picture", "data", "shape", "family", "material", angles}]}.

    angles  {name of the weights, or FACING: mean angle over the mask, degrees}
    """
    import torch

    from learn.evaluation import overlap
    from learn.networks import weights as checkpoint
    from manifests import outputs
    from manifests.store_paths import file_hash

    torch.set_num_threads(1)
    about = {
        "weights": {_name(path): file_hash(path) for path in arguments.weights},
        "data": {path.name: file_hash(path / "materials.json") for path in arguments.data},
    }
    outputs.pin_settings(arguments.out / "settings.json", about)
    networks: dict[int, dict[str, Coded]] = {}  # {size of pictures: {name: network}}
    for path in arguments.weights:
        network, metadata = checkpoint.load_network(path)
        networks.setdefault(metadata["size"], {})[_name(path)] = network
    todo, sentences = [], []
    for folder in arguments.data:
        sources = photographs_of(folder, arguments.weights[0], list(networks))
        shown = overlap.shown_by_split(next(iter(sources.values())).data_split)
        sentences += overlap.report_overlap(
            arguments.weights, shown, folder, arguments.allow_overlap
        )
        todo += [
            ({"picture": f"{folder.name} {k}", "data": folder.name}, (sources, k))
            for k in range(arguments.pictures)
        ]

    def row(case: tuple[dict[int, RelitDataset], int]) -> dict[str, Any]:
        return row_of(case[0], networks, case[1])

    rows = runner.resume(arguments.out / "rows.jsonl", todo, row, "picture")
    names = [_name(path) for path in arguments.weights]
    return {"rows": rows, "seen": sorted(set(sentences)), "weights": names}


def _name(path: Path) -> str:
    return path.stem if path.stem != "weights" else path.parent.name


def photographs_of(folder: Path, weights: Path, sizes: Sequence[int]) -> dict[int, RelitDataset]:
    """Return pictures of all of a data set's views, as training would photograph them, by size.

    The k-th picture has the same view, material and light at all sizes. Materials are the built-in
    ones for testing, lights the measured ones that the run of the weights held out for testing; all
    measured ones where it names none.
    """
    import json

    import numpy as np

    from learn.data.data_split import DataSplit
    from learn.data.geometry import Geometry
    from learn.data.relit import RelitDataset
    from learn.data.settings import Data, decode_run
    from learn.data.sources import split_materials
    from learn.networks import weights as checkpoint
    from manifests import measured_lights

    metadata = checkpoint.load_network(weights)[1]
    run = decode_run(json.dumps(metadata["run"]).encode(), weights)
    data = Data(
        materials="built-in",
        real_lights=1.0,
        camera_model=1.0,
        unknown_camera=True,
        shadows=1.0,
        sharing=1,
    )
    maps = measured_lights.load_all()
    lights = sorted(set(run.data.test_lights) & set(maps)) or sorted(maps)
    geometry = Geometry(folder, depth=True)
    # pictures of the side "train" are photographed; the parts are those for testing
    everything = DataSplit(
        geometry,
        np.arange(len(geometry)),
        {
            m.name: m.label.reshape(-1).astype(np.float32)
            for m in split_materials(data, None)[0]["test"]
        },
        [maps[name] for name in lights],
        "train",
        map_names=tuple(lights),
    )
    return {size: RelitDataset(everything, data, 1, size, seed=5) for size in sizes}


def row_of(
    sources: Mapping[int, RelitDataset],
    networks: Mapping[int, Mapping[str, Coded]],
    number: int,
) -> dict[str, Any]:
    """Return the angles of all weights, and of normals facing the viewer, on one picture.

    sources, networks  by the size of pictures; normals facing the viewer are those of the first
    """
    import torch

    from learn.data.batch import shape_and_material
    from learn.training.validation import masked_means

    angles: dict[str, float] = {}
    for size, source in sources.items():
        batch = source[number]
        mask = batch.segments > 0
        shape, material = shape_and_material(batch.names[0])
        facing = batch.n[:, 2].clamp(-1, 1).arccos().rad2deg()
        angles.setdefault(FACING, float(masked_means(facing, mask)[0]))
        for name, network in networks[size].items():
            with torch.no_grad():
                n = network(batch.image, batch.mask, None, ("normals",)).n
            angle = (n * batch.n).sum(1).clamp(-1, 1).arccos().rad2deg()
            angles[name] = float(masked_means(angle, mask)[0])
    return {"shape": shape, "family": family_of(shape), "material": material} | angles


def family_of(shape: str) -> str:
    """Return "vessel" of "vessel:3", and of a mesh file the package that it is from."""
    name = Path(shape.split("?")[0]).stem
    return shape.split(":")[0] if ":" in shape else name.split("-")[0]


def tables(report: runner.Report) -> str:
    """Return mean angles of each data set, then of its families."""
    rows, columns = report["rows"], [*report["weights"], FACING]
    head = ["normals, mean angle (°)", "shapes", "pictures", *columns]
    by_set: dict[str, list[dict[str, Any]]] = {}
    by_family: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        by_set.setdefault(row["data"], []).append(row)
        by_family.setdefault(f"{row['data']}: {row['family']}", []).append(row)
    families = list(by_family.items())[:MOST_FAMILIES]
    return "\n\n".join(
        [
            "# Normals of unseen shapes",
            *report["seen"],
            "Relit pictures, taken by the camera model of training. Intervals are over shapes and"
            " materials.",
            runner.table(head, [_line(*each, columns) for each in by_set.items()]),
            runner.table(head, [_line(*each, columns) for each in families]),
        ]
    )


def _line(title: str, rows: Sequence[dict[str, Any]], columns: Sequence[str]) -> list[str]:
    """Return a line of a table: means with intervals."""
    import numpy as np

    from learn.metrics import bootstrap

    weights = bootstrap.draws_of_rows(rows, ("shape", "material"), DRAWS)
    cells = [
        runner.mean_interval(np.array([row[column] for row in rows]), weights, 1)
        for column in columns
    ]
    return [title, str(len({row["shape"] for row in rows})), str(len(rows)), *cells]
