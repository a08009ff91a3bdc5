"""Measure what re-rendering a prediction says of a photograph's exposure.

Shapes, materials and lights that the weights' run held out are relit, taken by the camera model of
training at any of four stops (learn.data.camera_model) or under automatic exposure, and read back
as photographs. The reader's rule estimates an exposure from the brightness alone, and
learn.editing.exposure corrects it by a share of the ratio between the re-rendering of the
prediction and the picture. The report has the error of the exposure's logarithm for several shares:
the validation side is there to choose one, the test side to confirm it. rows.jsonl keeps a line per
picture: the same command continues.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner
from manifests.option_types import positive

if TYPE_CHECKING:
    from learn.data.framing import Framed
    from learn.data.relit import RelitDataset

ON_RAY = True
SIDES = ("validation", "test")
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
CAMERAS = {"drawn": "exposed by hand, over four stops", "automatic": "automatic exposure"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, the weights and the number of pictures."""
    options.add_data(parser, "a data set with geometry, whose held-out sides are used")
    options.add_weights(parser)
    parser.add_argument(
        "--pictures", type=positive, default=100, metavar="N", help="of each kind (default 100)"
    )
    options.add_seed(parser, "seed by which pictures are chosen")


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows": [{"side", "camera", "picture", "shape", "material", "metal", "true",
    "again"}]}.

    true   natural logarithm of the true exposure over the reader's
    again  the same of the re-rendering over the picture
    """
    import json

    import msgspec
    import numpy as np
    import torch

    from learn.data.records import Records
    from learn.data.relit import RelitDataset
    from learn.data.settings import decode_run
    from learn.data.sources import data_splits, materials_of
    from learn.editing.decomposition import predict_framed
    from learn.editing.exposure import brightness_ratio, rendered_again
    from learn.networks import weights as checkpoint
    from manifests import files
    from manifests.store import file_hash

    torch.set_num_threads(1)
    weights = arguments.weights
    network, metadata = checkpoint.load_parts(weights)
    about = {
        "weights": file_hash(weights),
        "data": file_hash(arguments.data / "materials.json"),
        "seed": arguments.seed,
    }
    files.pin_settings(arguments.out / "settings.json", about)
    run = decode_run(json.dumps(metadata["run"]).encode(), weights)
    data = msgspec.structs.replace(run.data, measured_lights=True, shadows=0)  # needs no depth
    splits = data_splits(data, arguments.data)
    materials, _ = materials_of(data, Records(arguments.data))
    family = {m.name: m.family for of_side in materials.values() for m in of_side}
    sources = {
        side: RelitDataset(splits[side], data, 1, run.size, arguments.seed) for side in SIDES
    }

    def row(chosen: tuple[str, str, int]) -> dict[str, Any]:
        side, camera, number = chosen
        framed, true, names = photographed(sources[side], camera, number)
        batch, prediction = predict_framed(framed, network)
        again = brightness_ratio(framed, rendered_again(batch, prediction))
        return {
            "shape": names.split()[0],
            "material": names.split()[-1],
            "metal": family[names.split()[-1]] == "metal",
            "true": true,
            "again": float(np.log(again)) if again else 0.0,
        }

    todo = [
        ({"side": side, "camera": camera, "picture": number}, (side, camera, number))
        for side in SIDES
        for camera in CAMERAS
        for number in range(arguments.pictures)
    ]
    rows = runner.resume(arguments.out / "rows.jsonl", todo, row, "picture")
    return {"rows": rows, "weights": Path(weights).name}


def photographed(source: RelitDataset, camera: str, number: int) -> tuple[Framed, float, str]:
    """Return a picture as a network sees it, the logarithm of what its exposure lacks, its names.

    The picture is a function of its number and the source's seed.
    """
    import numpy as np

    from learn.data import camera_model, framing, photographs
    from shaders import tone
    from shaders.tone import LUMINANCE

    batch = source[number]
    radiance = batch.image[0].movedim(0, -1).numpy()
    mask = batch.segments[0].numpy() > 0
    if camera == "automatic":
        exposure = tone.auto_exposure(radiance, mask)
        file = tone.linear_from_srgb(np.rint(tone.display(radiance, exposure)) / 255)
        clipped = photographs.saturated(file)
        seen = (file * framing.exposure_of(file, mask)).astype(np.float32)
    else:
        rng = np.random.default_rng(np.random.SeedSequence(source.seed, spawn_key=(number,)))
        seen, clipping = camera_model.photographed(rng, radiance, mask)
        clipped = clipping.clipped
    kept = mask & ~clipped.any(-1)
    means = [float((each[kept] @ LUMINANCE).mean()) for each in (radiance, seen)]
    true = float(np.log(means[0] / means[1])) if kept.any() and min(means) > 0 else 0.0
    share = (clipped & mask[..., None]).astype(np.float32)
    framed = framing.Framed(seen * mask[..., None], mask, (0, 0, len(mask)), 1.0, share)
    return framed, true, batch.names[0]


def tables(report: runner.Report) -> str:
    """Return the error of the exposure's logarithm for each share of the ratio."""
    import numpy as np

    from learn.metrics import bootstrap

    lines = []
    for side, (camera, title) in itertools.product(SIDES, CAMERAS.items()):
        rows = [row for row in report["rows"] if (row["side"], row["camera"]) == (side, camera)]
        true, again = (np.array([row[key] for row in rows]) for key in ("true", "again"))
        groups = bootstrap.groups_of(*([row[key] for row in rows] for key in ("shape", "material")))
        weights = bootstrap.draws(groups)
        for share in SHARES:
            error = (true - share * again) / np.log(2)
            lines.append(
                [
                    side,
                    title,
                    f"{share:g}",
                    f"{error.mean():+.2f}",
                    runner.interval(bootstrap.interval(error**2, weights), 2),
                ]
            )
    brightness = []
    for title, is_metal in (("metals", True), ("other materials", False)):
        rows = [r for r in report["rows"] if r["side"] == "test" and r["metal"] == is_metal]
        if rows:
            stops = np.array([row["again"] - row["true"] for row in rows]) / np.log(2)
            groups = bootstrap.groups_of(
                *([row[key] for row in rows] for key in ("shape", "material"))
            )
            mean = bootstrap.interval(stops, bootstrap.draws(groups))
            brightness.append([title, str(len(rows)), runner.interval(mean, 2)])
    head = ["side", "picture", "share of the ratio", "mean error, stops", "mean square, stops²"]
    count = len(report["rows"]) // len(SIDES) // len(CAMERAS)
    return (
        "# What re-rendering says of a photograph's exposure\n\n"
        f"Weights {report['weights']}, {count} pictures of each kind; intervals are over"
        " shapes and materials.\n\n" + runner.table(head, lines) + "\n"
        "How much brighter the re-rendering is than the true radiance, test side:\n\n"
        + runner.table(["source material", "pictures", "stops"], brightness)
    )
