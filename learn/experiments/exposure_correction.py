"""Measure what re-rendering a prediction says of a photograph's exposure.

Held-out shapes in held-out materials are relit under held-out lights, taken by the camera model of
training at any of four stops (learn.data.camera_model) or under automatic exposure, and read back
as photographs. The reader's rule estimates an exposure from the brightness alone, and
learn.editing.exposure corrects it by a share of the ratio between the re-rendering of the
prediction and the picture. The report has the error of the exposure's logarithm for several shares.
rows.jsonl keeps a line per picture: the same command continues.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner
from manifests.option_types import positive

if TYPE_CHECKING:
    from learn.data.photographs import Framed
    from learn.data.relit import RelitDataset

SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
CAMERAS = {"drawn": "exposed by hand, over four stops", "automatic": "automatic exposure"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, the weights and the number of pictures."""
    options.add_data(parser, "a data set with geometry, whose held-out side is used")
    options.add_weights(parser)
    parser.add_argument(
        "--pictures", type=positive, default=200, metavar="N", help="of each kind (default 200)"
    )
    options.add_seed(parser, "seed by which pictures are chosen")


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows": [{"camera", "picture", "shape", "light", "true", "again"}]}.

    true   natural logarithm of the true exposure over the reader's
    again  the same of the re-rendering over the picture
    """
    import numpy as np
    import torch

    from learn.data.relit import RelitDataset
    from learn.data.settings import Data
    from learn.data.sources import data_splits
    from learn.editing.decomposition import predict_framed
    from learn.editing.exposure import brightness_ratio, rendered_again
    from learn.editing.predict import WEIGHTS
    from learn.networks import weights as checkpoint
    from manifests import files
    from manifests.store import file_hash

    torch.set_num_threads(1)
    weights = arguments.weights or WEIGHTS
    network, metadata = checkpoint.load_parts(weights)
    about = {"weights": file_hash(weights), "seed": arguments.seed}
    files.pin_settings(arguments.out / "settings.json", about)
    data = Data(measured_lights=True, materials="built-in")
    split = data_splits(data, arguments.data)["test"]
    source = RelitDataset(split, data, 1, metadata["size"], arguments.seed)

    def row(chosen: tuple[str, int]) -> dict[str, Any]:
        framed, true, names = photographed(source, *chosen)
        batch, prediction = predict_framed(framed, network)
        again = brightness_ratio(framed, rendered_again(batch, prediction))
        return {
            "shape": names.split()[0],
            "true": true,
            "again": float(np.log(again)) if again else 0.0,
        }

    todo = [
        ({"camera": camera, "picture": number}, (camera, number))
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

    from learn.data import camera_model, photographs
    from shaders import tone
    from shaders.tone import LUMINANCE

    batch = source[number]
    radiance = batch.image[0].movedim(0, -1).numpy()
    mask = batch.segments[0].numpy() > 0
    if camera == "automatic":
        exposure = tone.auto_exposure(radiance, mask)
        file = tone.linear_from_srgb(np.rint(tone.display(radiance, exposure)) / 255)
        clipped = photographs.saturated(file)
        seen = (file * photographs.exposure_of(file, mask)).astype(np.float32)
    else:
        rng = np.random.default_rng(np.random.SeedSequence(source.seed, spawn_key=(number,)))
        seen, clipping = camera_model.photographed(rng, radiance, mask)
        clipped = clipping.clipped
    kept = mask & ~clipped.any(-1)
    means = [float((each[kept] @ LUMINANCE).mean()) for each in (radiance, seen)]
    true = float(np.log(means[0] / means[1])) if kept.any() and min(means) > 0 else 0.0
    share = (clipped & mask[..., None]).astype(np.float32)
    framed = photographs.Framed(seen * mask[..., None], mask, (0, 0, len(mask)), 1.0, share)
    return framed, true, batch.names[0]


def tables(report: runner.Report) -> str:
    """Return the error of the exposure's logarithm for each share of the ratio."""
    import numpy as np

    from learn.metrics import bootstrap

    lines = []
    for camera, title in CAMERAS.items():
        rows = [row for row in report["rows"] if row["camera"] == camera]
        true, again = (np.array([row[key] for row in rows]) for key in ("true", "again"))
        weights = bootstrap.draws(bootstrap.groups_of([row["shape"] for row in rows]))
        for share in SHARES:
            error = (true - share * again) / np.log(2)
            lines.append(
                [
                    title,
                    f"{share:g}",
                    f"{error.mean():+.2f}",
                    runner.interval(bootstrap.interval(error**2, weights), 2),
                ]
            )
    head = ["picture", "share of the ratio", "mean error, stops", "mean square, stops²"]
    count = len(report["rows"]) // len(CAMERAS)
    return (
        "# What re-rendering says of a photograph's exposure\n\n"
        f"Weights {report['weights']}, {count} pictures of each kind; intervals are over"
        " shapes.\n\n" + runner.table(head, lines)
    )
