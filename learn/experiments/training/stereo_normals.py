"""Measure predicted normals of real photographs whose depth was measured by stereo.

The scenes are described by docs/jobs/stereo-normals/scenes.json, with masks of their objects.
Pictures and disparities come from packages. Copy these files into a folder, which --pictures names:
motorcycle_left.png and motorcycle_disp.npz of scikit-image's folder `data`; aloeL.jpg and
aloeGT.png of Debian's package opencv-doc. Each object is decomposed as by `brdfactory edit`,
without and with refinement. Its normals are compared with those of the disparities, at the
network's size, beside normals that all face the viewer, and for an object of a simple shape, which
the description names, those of `edit --shape`. The report also says how far the normals of
the disparities may be off themselves.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure

    from learn.experiments.training.stereo_scenes import StereoObject

FACING, GIVEN = "facing the viewer", "shape given"
SCENES = Path("docs/jobs/stereo-normals/scenes.json")
BLOCK = 16  # pixels of the squares that intervals draw
SHOWN = 96  # pixels of a picture in the chart
CAUSES = ("noise", "window", "offset")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scenes, the pictures and the weights."""
    parser.add_argument(
        "--scenes",
        type=Path,
        default=SCENES,
        metavar="FILE",
        help=f"description of the scenes (default {SCENES})",
    )
    parser.add_argument(
        "--pictures",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder with their pictures and disparities",
    )
    parser.add_argument(
        "--weights",
        type=options.weights_file,
        action="append",
        metavar="FILE|NAME",
        help=(
            "weights, the chart's first; repeat the option to compare several (default:"
            f" {options.EDITING_WEIGHTS.stem})"
        ),
    )


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows", "weights"}; a row has "object", "weights", "angles", "own" and pictures.

    angles    {"predicted", "refined", FACING, GIVEN if the object has a simple shape: [mean over
              the object in degrees, low, high]}
    overlap   of that shape's outline and the mask, if it has one
    kept      share of the object's pixels that have a measured normal
    pictures  of the first weights: {"picture", "predicted", "measured"}, lists of (SHOWN², 3) 8-bit
    """
    import torch

    from learn.experiments.training.stereo_scenes import objects_of
    from learn.networks import weights as checkpoint

    torch.set_num_threads(1)
    objects = objects_of(arguments.scenes, arguments.pictures)
    rows = []
    weights = arguments.weights or [options.EDITING_WEIGHTS]
    for number, path in enumerate(weights):
        network, metadata = checkpoint.load_full_network(path)
        name = path.stem if path.stem != "weights" else path.parent.name
        for each in objects:
            row = row_of(each, network, metadata["size"], number == 0)
            rows.append({"object": each.name, "weights": name, **row})
    return {"rows": rows, "weights": list(dict.fromkeys(row["weights"] for row in rows))}


def row_of(each: StereoObject, network: Any, size: int, is_shown: bool) -> dict[str, Any]:
    """Return {"angles", "kept", "own"} of an object by a network, and "pictures" if it is shown."""
    import numpy as np

    from learn.data import devices, framing
    from learn.editing import decomposition, photograph
    from learn.experiments.training.stereo_scenes import angle
    from learn.refinement import PHOTOGRAPHS

    photographed = photograph.from_arrays(each.picture, each.mask, name=each.name)
    result = decomposition.decompose(photographed, network, size, PHOTOGRAPHS)
    assert result.refined is not None
    box = result.framed.box
    weight = framing.resize_square(framing.cut_square(each.valid.astype(np.float32), box), size)
    vectors = (each.normals * each.valid[..., None]).astype(np.float32)
    n = framing.resize_square(framing.cut_square(vectors, box), size)
    length = np.linalg.norm(n, axis=-1)
    valid = result.framed.mask & (weight >= 0.5) & (length > 0)
    n = n / np.maximum(length, 1e-6)[..., None]
    predictions = {
        "predicted": devices.to_numpy(
            decomposition.require_parts(result.start).n[0].movedim(0, -1)
        ),
        "refined": devices.to_numpy(result.parts.n[0].movedim(0, -1)),
        FACING: np.broadcast_to(np.array([0.0, 0.0, 1.0]), n.shape),
    }
    overlap = None
    if each.shape is not None:
        given = decomposition.decompose(photographed, network, size, shape=each.shape)
        predictions[GIVEN] = devices.to_numpy(given.parts.n[0].movedim(0, -1))
        overlap = given.shape_overlap
    row: dict[str, Any] = {
        "overlap": overlap,
        "angles": {key: interval(angle(m, n), valid) for key, m in predictions.items()},
        "kept": float(valid.sum() / result.framed.mask.sum()),
        "own": each.own,
    }
    if is_shown:
        # the photographs themselves are left out: their packages state no licence for them
        pictures = {
            "predicted": 127.5 * (predictions["predicted"] + 1) * result.framed.mask[..., None],
            "refined": 127.5 * (predictions["refined"] + 1) * result.framed.mask[..., None],
            "measured": 127.5 * (n + 1) * valid[..., None],
        }
        row["pictures"] = {key: _small(picture) for key, picture in pictures.items()}
    return row


def _small(picture: np.ndarray) -> str:
    """Return display values (H, W, 3) as a JPEG of SHOWN² pixels in base 64."""
    import base64
    import io

    import numpy as np
    from PIL import Image

    image = Image.fromarray(np.clip(np.rint(picture), 0, 255).astype(np.uint8))
    buffer = io.BytesIO()
    image.resize((SHOWN, SHOWN), Image.Resampling.BICUBIC).save(buffer, "JPEG", quality=88)
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def interval(angles: np.ndarray, valid: np.ndarray) -> list[float]:
    """Return [mean, low, high] of angles (H, W) where valid (H, W), over squares of BLOCK pixels.

    Neighbouring pixels err together, so that whole squares are drawn. What it says is how much the
    mean depends on parts of this object; other objects are not drawn.
    """
    import numpy as np

    from learn.metrics import bootstrap

    y, x = np.nonzero(valid)
    _, block = np.unique(y // BLOCK * valid.shape[1] + x // BLOCK, return_inverse=True)
    sums = np.bincount(block, angles[valid])
    counts = np.bincount(block)
    weights = bootstrap.draws([np.arange(len(counts))])
    low, high = np.percentile((weights @ sums) / (weights @ counts), bootstrap.LEVELS)
    return [float(angles[valid].mean()), float(low), float(high)]


def tables(report: runner.Report) -> str:
    """Return each object's angles by all weights, and how far its measured normals may be off."""
    rows = report["rows"]
    names = list(dict.fromkeys(row["object"] for row in rows))
    by = {(row["object"], row["weights"]): row for row in rows}
    first = report["weights"][0]
    head = ["object", FACING]
    head += [f"{name}, {kind}" for name in report["weights"] for kind in ("predicted", "refined")]
    lines = []
    for name in names:
        cells = [
            runner.interval(by[name, weights]["angles"][kind], 1)
            for weights in report["weights"]
            for kind in ("predicted", "refined")
        ]
        lines.append([name, runner.interval(by[name, first]["angles"][FACING], 1), *cells])
    lines.append(["mean of the objects", *_means(by, names, report["weights"])])
    own = [
        [
            name,
            f"{100 * by[name, first]['kept']:.0f} %",
            *(_degrees(by[name, first]["own"].get(cause)) for cause in CAUSES),
        ]
        for name in names
    ]
    return (
        "# Normals of photographs whose depth was measured by stereo\n\n"
        "Mean angles in degrees between predicted normals and those of the disparities. Brackets:"
        f" 95 % intervals over squares of {BLOCK} pixels of each object, at the network's size;"
        f" {len(names)} objects are too few for an interval over objects.\n\n"
        + runner.table(head, lines)
        + _given(rows)
        + "\n![Predicted, refined and measured normals](chart.png)\n"
        + "\n## How far the measured normals may be off\n\n"
        "*Noise*: the fitted surface measured again, with rounded disparities or with noise as"
        " large as the fit's residuals. *Window*: beside planes of a window half as wide, which"
        " have more noise and hide less. *Offset*: if the offset of the disparities is off by what"
        " the description states. Mean angles in degrees.\n\n"
        + runner.table(["object", "pixels with a measured normal", *CAUSES], own)
    )


def _given(rows: Sequence[dict[str, Any]]) -> str:
    """The table of objects whose shape is given, "" without any."""
    lines = [
        [
            row["object"],
            row["weights"],
            *(runner.interval(row["angles"][kind], 1) for kind in ("predicted", GIVEN)),
            f"{row['overlap']:.2f}",
        ]
        for row in rows
        if GIVEN in row["angles"]
    ]
    if not lines:
        return ""
    head = ["object", "weights", "predicted", GIVEN, "overlap of its outline and the mask"]
    return "\n## Objects whose shape is given\n\n" + runner.table(head, lines)


def _means(by: dict, names: Sequence[str], weights: Sequence[str]) -> list[str]:
    """The last line of the table: means over objects."""
    keys = [(weights[0], FACING)]
    keys += [(name, kind) for name in weights for kind in ("predicted", "refined")]
    return [
        f"{sum(by[name, each]['angles'][kind][0] for name in names) / len(names):.1f}"
        for each, kind in keys
    ]


def _degrees(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"


def figure(report: runner.Report) -> Figure:
    """Return a chart: each object's predicted, refined and measured normals."""
    import base64
    import io

    from matplotlib.figure import Figure as Drawing
    from PIL import Image

    shown = [row for row in report["rows"] if "pictures" in row]
    kinds = list(shown[0]["pictures"])
    drawing = Drawing(figsize=(1.7 * len(kinds), 1.85 * len(shown)), layout="constrained")
    places = drawing.subplots(len(shown), len(kinds), squeeze=False)
    for line, row in zip(places, shown, strict=True):
        for place, kind in zip(line, kinds, strict=True):
            buffer = io.BytesIO(base64.b64decode(row["pictures"][kind]))
            place.imshow(Image.open(buffer))
            place.set_xticks([])
            place.set_yticks([])
            angles = row["angles"].get(kind)
            title = kind if angles is None else f"{kind}, {angles[0]:.1f}°"
            place.set_title(title, fontsize=8)
        line[0].set_ylabel(row["object"], fontsize=8)
    return drawing
