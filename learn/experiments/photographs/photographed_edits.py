"""Measure edits as a user gets them: of photographs, in the photograph's own scale.

Rendered pictures are photographed: their light map is the background, a camera exposes the frame,
and 8 bits are kept (photographing). Each photograph is edited into up to three
materials as `edit` does it, and compared with Cycles' picture of the same object in that material
under the same exposure. The report has the brightness of edits beside the truth's, their display
L2, and the line by which a photograph's exposure follows from what can be seen
(learn.editing.exposure), fitted again to these pictures. The data set needs pictures of objects in
several materials, with interreflection and square pixels (docs/jobs/photographed-edits). rows.jsonl
keeps a line per edit: the same command continues, and a larger --photographs adds to it.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from typing import TYPE_CHECKING, Any, NamedTuple

from learn.commands import options
from learn.editing import DETAIL
from learn.experiments import runner
from manifests.option_types import positive, share

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    import numpy as np
    import torch

    from learn.data.records import Records, Sample
    from learn.experiments.photographs.photographing import Photographed
    from learn.refinement import RefinementSettings
    from manifests.schema import Record

ON_RAY = True
TARGETS = 3  # edits of a photograph


class Case(NamedTuple):
    """A photograph to be edited: the record that is shown, and those of its targets."""

    source: Record
    targets: tuple[Record, ...]


def add_arguments(parser: argparse.ArgumentParser, photographs: int = 200) -> None:
    """Add the data, the weights and the number of photographs, whose default may be given."""
    options.add_data(parser, "a data set of objects in several materials")
    options.add_weights(parser)
    parser.add_argument(
        "--photographs",
        type=positive,
        default=photographs,
        metavar="N",
        help="number of photographs (default %(default)s)",
    )
    options.add_seed(parser, "seed by which photographs and target materials are drawn")
    add_detail(parser)


def add_detail(parser: argparse.ArgumentParser) -> None:
    """Add --detail, as `edit` has it."""
    parser.add_argument(
        "--detail",
        type=share,
        default=DETAIL,
        metavar="D",
        help="residual shading that edits keep, 0 to 1, as of `edit` (default %(default)s)",
    )


class Opened(NamedTuple):
    """What edits of photographs are made with.

    records        the data set's
    cases          as of `cases_of`
    network, size  of the weights
    seen           sentences about what the weights saw of it in training
    """

    records: Records
    cases: list[Case]
    network: torch.nn.Module
    size: int
    seen: list[str]


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows", "weights", "seen"}; rows as of `row_of`, and "photograph".

    Raises InputError for a data set without pictures of one scene in two materials.
    """
    from dataclasses import asdict

    from learn.refinement import PHOTOGRAPHS

    records, cases, network, size, seen = opened(arguments, asdict(PHOTOGRAPHS))
    todo = [({"photograph": case.source.id}, case) for case in cases]
    rows = runner.resume(
        arguments.out / "rows.jsonl",
        todo,
        lambda case: row_of(records, network, size, case, PHOTOGRAPHS, detail=arguments.detail),
        "photograph",
    )
    return {"rows": rows, "weights": arguments.weights.name, "seen": seen}


def opened(arguments: argparse.Namespace, refinement: Any) -> Opened:
    """Return what the options name, and pin it with the settings of refinement in --out.

    Raises InputError: no picture of one scene in two materials, or --out has results of others
    """
    import torch

    from learn.data.records import Records
    from learn.evaluation import ladder, overlap
    from learn.evaluation.ladder_design import Scene
    from learn.networks import weights as checkpoint
    from manifests import outputs
    from manifests.store_paths import file_hash

    torch.set_num_threads(1)
    records = Records(arguments.data)
    cases = cases_of(records, arguments.photographs, arguments.seed)
    scenes = [
        Scene("", "", "", "", {"photograph": case.source}, {"photograph": target})
        for case in cases
        for target in case.targets
    ]
    seen = overlap.report_overlap(
        [arguments.weights], ladder.list_tested(records, scenes), arguments.data, True
    )
    about = {
        "data": file_hash(arguments.data / "materials.json"),
        "weights": file_hash(arguments.weights),
        "seed": arguments.seed,
        "refinement": refinement,
        "detail": arguments.detail,
    }
    outputs.pin_settings(arguments.out / "settings.json", about)
    network, metadata = checkpoint.load_full_network(arguments.weights)
    return Opened(records, cases, network, metadata["size"], seen)


def cases_of(records: Records, count: int, seed: int) -> list[Case]:
    """Return up to `count` photographs; shapes take turns, and the rest is drawn.

    A larger count adds to the same ones.
    """
    import numpy as np

    from manifests.errors import InputError

    scenes: dict[tuple[Any, ...], dict[str, Record]] = defaultdict(dict)
    for record in sorted(records.records, key=lambda record: record.id):
        one = len(set(record.materials)) == 1 and record.camera.fov_deg is None
        if one and record.tier == "full" and record.camera.pixel == "square":
            key = (record.shape, record.viewpoint, record.light, record.rotation_texels)
            scenes[key].setdefault(record.materials[0], record)
    several = [of for _, of in sorted(scenes.items()) if len(of) > 1]
    if not several:
        raise InputError(
            records.folder,
            "pictures of objects in two materials, with interreflection and square pixels",
            "none",
            "render docs/jobs/photographed-edits",
        )
    drawn = []
    for number, of in enumerate(several):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
        names = [str(name) for name in rng.permutation(sorted(of))]
        for turn, name in enumerate(names):
            others = (names[turn + 1 :] + names[:turn])[:TARGETS]
            case = Case(of[name], tuple(of[other] for other in others))
            drawn.append((turn, float(rng.random()), case))
    order = [case for _, _, case in sorted(drawn, key=lambda each: each[:2])]
    by_shape: dict[str, int] = defaultdict(int)
    turns = []
    for case in order:
        by_shape[case.source.shape] += 1
        turns.append(by_shape[case.source.shape])
    return [order[k] for k in np.argsort(turns, kind="stable")[:count]]


def row_of(
    records: Records,
    network: torch.nn.Module,
    size: int,
    case: Case,
    settings: RefinementSettings | None,
    paint: Callable[[Sample], np.ndarray] | None = None,
    detail: float = DETAIL,
) -> dict[str, Any]:
    """Return what a photograph shows, its cues, and the figures of its edits.

    settings  of refinement; None: none
    paint     from the picture to the radiance (H, H, 3) that is photographed; None: its own
    detail    of edits, as learn.editing.compositor takes it

    {"shape", "group", "light", "source"} with the figures of `figures_of`.
    """
    import numpy as np

    from learn.evaluation.ladder_design import group_of
    from learn.experiments.photographs.photographing import photographed, placed

    record = case.source
    sample = records.load(record)
    photo = photographed(
        sample.image.numpy() if paint is None else paint(sample),
        sample.mask.numpy(),
        sample.light.numpy(),
        np.radians(record.camera.elevation_deg),
        record.id,
    )

    def truth(target: Record) -> Truth:
        (name,) = set(target.materials)
        frame = placed(records.image(target), np.zeros((*photo.mask.shape, 3), np.float32))
        return Truth(name, records.material(name).family, records.label(name), frame)

    about = {
        "shape": record.shape,
        "group": group_of(record.shape, record.category)[0],
        "light": record.light,
        "source": record.materials[0],
    }
    targets = map(truth, case.targets)
    return about | figures_of(photo, record.id, targets, network, size, settings, detail=detail)


class Truth(NamedTuple):
    """What an edit should show.

    material, family, label  the target's, as its Material has them
    frame  (N, N, 3) radiance of the photograph's frame with the object in the target, under light
           of unit mean
    """

    material: str
    family: str
    label: np.ndarray
    frame: np.ndarray


def figures_of(
    photo: Photographed,
    name: str,
    targets: Iterable[Truth],
    network: torch.nn.Module,
    size: int,
    settings: RefinementSettings | None,
    shape: str | None = None,
    detail: float = DETAIL,
) -> dict[str, Any]:
    """Return what a photograph's cues and its edits are worth.

    name      for messages
    settings  of refinement; None: none
    shape     of the object, as `learn.editing.decomposition.decompose` takes it
    detail    of edits, as learn.editing.compositor takes it

    {"exposure": {"true", "used"} in stops, "light_green": of the light that was read, before it was
    taken back, "cues": of learn.editing.exposure, "edits": [{"target", "family", "narrow": share of
    its albedo in narrow lobes, "darkened": stops by which it was rendered darker for that, "stops":
    of brightness above the truth's, "green" and "red_blue": of colour beyond the truth's, "l2":
    if brighter by each of SCALES (photographed_fit), "l2_coloured": the same if the edit's mean had
    the colour of the truth's, "unchanged": L2 of the photograph as it was}]}; {"refused", "edits":
    []} for a photograph that cannot be edited
    """
    from dataclasses import asdict

    import numpy as np

    from learn.data.devices import to_numpy
    from learn.editing import decomposition, light_colour, photograph
    from learn.editing.compositor import Compositor
    from manifests.errors import InputError
    from shaders.envmap import mean_radiance

    try:
        read = photograph.from_arrays(photo.pixels, photo.mask, name=name)
        parts = decomposition.decompose(read, network, size, settings, shape=shape)
    except InputError as error:  # an object that is black or white in the photograph
        return {"refused": str(error), "edits": []}
    if parts.cues is None:
        raise ValueError("decomposition: expected an exposure that was estimated")
    light = decomposition.require_parts(
        parts.refined.prediction if parts.refined else parts.start
    ).light
    compositor = Compositor(parts, detail=detail)
    return {
        "exposure": {
            "true": -float(np.log2(photo.exposure)),
            "used": float(np.log2(parts.framed.exposure)),
        },
        "light_green": light_colour.green_of(mean_radiance(to_numpy(light[0].movedim(0, -1)))),
        "cues": asdict(parts.cues),
        "edits": [edit_of(compositor, photo, target) for target in targets],
    }


def edit_of(compositor: Any, photo: Photographed, target: Truth) -> dict[str, Any]:
    """Return a row of "edits" of `figures_of`. Brightness is the mean luminance over the object."""
    import numpy as np

    from learn.editing import light_colour
    from learn.editing.photograph import CLEAR
    from learn.experiments.photographs.photographed_fit import SCALES
    from learn.layer.albedo import narrow_share
    from shaders import tone
    from shaders.tone import LUMINANCE

    edited = compositor.edit([target.label])
    before = compositor.decomposition.photograph
    inside = photo.mask & (before.coverage > 1 - CLEAR)
    truth = photo.of(target.frame)
    colours = [np.maximum(each[inside].mean(0), 1e-6) for each in (edited, truth)]
    mine, its = (float(colour @ LUMINANCE) for colour in colours)
    red_blue = [float(np.log2(colour[0] / colour[2])) for colour in colours]
    coloured = edited * (colours[1] / colours[0] * (mine / its)).astype(np.float32)

    def l2_by_scale(picture: np.ndarray) -> list[float]:
        each = (tone.display_l2(picture * 2**s, truth, 1.0, inside) for s in SCALES)
        return [round(float(l2), 1) for l2 in each]

    return {
        "target": target.material,
        "family": target.family,
        "narrow": narrow_share(target.label),
        "darkened": -float(np.log2(compositor.mirror_correction(target.label))),
        "stops": float(np.log2(mine / its)),
        "green": light_colour.green_of(colours[0]) - light_colour.green_of(colours[1]),
        "red_blue": red_blue[0] - red_blue[1],
        "l2": l2_by_scale(edited),
        "l2_coloured": l2_by_scale(coloured),
        "unchanged": round(float(tone.display_l2(before.radiance, truth, 1.0, inside)), 1),
    }


def tables(report: runner.Report) -> str:
    """Return the edits by way of exposing them, in groups, and the line that is fitted to them."""
    from learn.experiments.photographs import photographed_fit

    return photographed_fit.page(report)
