"""Measure edits of photographs of objects that stand in rooms and under open skies.

In the photographs of `photographed-edits` the light is far away, and it is also what lies behind
the object. Here an object stands on a table, light comes from near, and walls, furniture and ground
are behind it (`python -m factory.render.validation.objects_in_rooms` renders them). A camera
exposes the frame, balances its white if asked to, and keeps 8 bits. Each photograph is edited into
the other materials of its scene as `edit` does it, and compared with Cycles' picture of the same
object in that material, in the same place and as the same camera takes it. rows.jsonl keeps a line
per photograph: the same command continues, and more --scenes add to it. sheet.jpg shows some of the
edits beside their truth.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.editing import DETAIL
from learn.experiments import runner
from learn.experiments.photographs import exposure_line, photographed_edits, room_cases

if TYPE_CHECKING:
    from collections.abc import Sequence

    import torch

    from learn.experiments.photographs.room_cases import Case
    from learn.refinement import RefinementSettings

ON_RAY = True
SHOWN = 8  # edits of the sheet, of as many scenes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scenes, the weights and how many scenes are photographed."""
    options.add_data(parser, "a folder of factory.render.validation.objects_in_rooms")
    options.add_weights(parser)
    options.add_scenes(parser)
    parser.add_argument(
        "--white-balance",
        action="store_true",
        help="photograph with a camera that balances white, as most do",
    )
    parser.add_argument(
        "--shapes",
        type=Path,
        metavar="FILE",
        help=(
            'photograph only objects that this JSON file names: {"shapes": {mesh: box, cylinder,'
            " ball or flat}}"
        ),
    )
    parser.add_argument(
        "--use-shapes",
        action="store_true",
        help="edit them as the shapes that the file names, instead of guessing",
    )
    parser.add_argument(
        "--no-refine",
        action="store_true",
        help="edit what the network predicts, without refinement",
    )
    photographed_edits.add_detail(parser)
    parser.add_argument(
        "--beside",
        type=Path,
        metavar="FILE",
        help="report.json of the same photographs edited otherwise, with whose errors to compare",
    )


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows", "weights", "seen"}; rows as of `photographed_edits.row_of`.

    With --beside also {"beside": {"name": its folder's, "edits": number, rule: its L2 by which ours
    is divided, [mean, low, high]}}. Raises InputError: no scenes, or a report of other photographs
    """
    from dataclasses import asdict

    import torch

    from learn.evaluation import overlap
    from learn.networks import weights as checkpoint
    from learn.refinement import PHOTOGRAPHS
    from manifests import outputs
    from manifests.errors import InputError
    from manifests.store_paths import file_hash

    torch.set_num_threads(1)
    cases = room_cases.cases_of(
        arguments.data, arguments.scenes, arguments.after, arguments.white_balance
    )
    if arguments.shapes:
        cases = room_cases.named_cases(cases, arguments.shapes, arguments.use_shapes)
    elif arguments.use_shapes:
        raise InputError("--use-shapes", "--shapes FILE", "none", "name the objects' shapes")
    settings = None if arguments.no_refine else PHOTOGRAPHS
    seen = overlap.report_overlap(
        [arguments.weights], room_cases.list_tested(cases), arguments.data, True
    )
    about = {
        # a larger --scenes keeps the first one
        "data": file_hash(cases[0].folder / "scene.json"),
        "weights": file_hash(arguments.weights),
        "refinement": None if settings is None else asdict(settings),
        "white_balance": arguments.white_balance or None,  # earlier folders lack these keys
        "shapes": file_hash(arguments.shapes) if arguments.shapes else None,
        "use_shapes": arguments.use_shapes or None,
        "detail": arguments.detail,
    }
    outputs.pin_settings(arguments.out / "settings.json", about)
    network, metadata = checkpoint.load_full_network(arguments.weights)
    todo = [({"photograph": room_cases.name_of(case)}, case) for case in cases]
    rows = runner.resume(
        arguments.out / "rows.jsonl",
        todo,
        lambda case: row_of(case, network, metadata["size"], settings, arguments.detail),
        "photograph",
    )
    write_sheet(arguments.out, cases, network, metadata["size"], settings, arguments.detail)
    report: runner.Report = {"rows": rows, "weights": arguments.weights.name, "seen": seen}
    if arguments.beside:
        report["beside"] = compared(report, arguments.beside)
    return report


def compared(report: runner.Report, path: Path) -> dict[str, Any]:
    """Return "beside" of `measure`: our errors divided by those of another report."""
    import numpy as np

    from learn.experiments.photographs import photographed_fit
    from learn.metrics import bootstrap
    from manifests.errors import InputError

    ours, theirs = photographed_fit.edits_of(report), exposure_line.read_edits(path)
    pairs = [[(row["photograph"], row["target"]) for row in of.rows] for of in (ours, theirs)]
    if pairs[0] != pairs[1]:
        remedy = "measure both with the same --data, --scenes and --after"
        raise InputError(path, "the same photographs", "others", remedy)
    weights = photographed_fit.weights_of(ours)
    errors = {
        "as exposed in use": [of.error(photographed_fit.in_use(of)) for of in (theirs, ours)],
        "under the true exposure": [of.error(of.true) for of in (theirs, ours)],
        "at each edit's best brightness": [np.min(of.l2, 1) for of in (theirs, ours)],
    }
    ratios = {rule: bootstrap.relative(a, b, weights) for rule, (a, b) in errors.items()}
    return {"name": path.parent.name, "edits": len(ours.rows), **ratios}


def row_of(
    case: Case,
    network: torch.nn.Module,
    size: int,
    settings: RefinementSettings | None,
    detail: float = DETAIL,
) -> dict[str, Any]:
    """Return the row of `photographed_edits.row_of` for a photograph in a room.

    settings  of refinement; None: none
    detail    of edits, as learn.editing.compositor takes it
    """
    from learn.evaluation.ladder_design import group_of

    photo = room_cases.photograph_of(case)
    scene = case.scene
    about = {
        "shape": scene.shape,
        "group": group_of(scene.shape, scene.category)[0],
        "light": f"{scene.place}-{scene.seed}",
        "source": case.source,
    }
    others = (name for name in scene.materials if name != case.source)
    targets = (room_cases.truth_of(case, name) for name in others)
    name = room_cases.name_of(case)
    return about | photographed_edits.figures_of(
        photo, name, targets, network, size, settings, case.shape, detail
    )


def write_sheet(
    out: Path,
    cases: Sequence[Case],
    network: torch.nn.Module,
    size: int,
    settings: RefinementSettings | None,
    detail: float = DETAIL,
) -> None:
    """Write sheet.jpg: of some scenes the photograph, its edit into another material, the truth.

    A photograph that cannot be edited is left out.
    """
    import numpy as np

    from learn.editing import decomposition, photograph
    from learn.editing.compositor import Compositor
    from learn.figures import montage
    from manifests import files
    from manifests.errors import InputError
    from shaders import tone

    first = [case for case in cases if case.source == case.scene.materials[0]]
    rows = []
    for case in first[:: -(-len(first) // SHOWN)]:
        photo = room_cases.photograph_of(case)
        truth = room_cases.truth_of(case, case.scene.materials[1])
        try:
            read = photograph.from_arrays(photo.pixels, photo.mask, name=room_cases.name_of(case))
            parts = decomposition.decompose(read, network, size, settings, shape=case.shape)
        except InputError:
            continue
        edited = tone.display(Compositor(parts, detail=detail).edit([truth.label]), 1.0)
        rows += [
            [
                (f"photograph: {case.source}", photo.pixels.astype(np.float32)),
                ("edit", edited),
                (f"truth: {truth.material}", tone.display(photo.of(truth.frame), 1.0)),
            ]
        ]
    if rows:
        tiles = [
            [tile for row in pair for tile in row]
            for pair in zip(rows[::2], rows[1::2], strict=False)
        ]
        tiles += [rows[-1]] if len(rows) % 2 else []
        shown = montage.eight_bit(montage.contact_sheet(tiles, photo.pixels.shape[0]))
        files.write_image(out / "sheet.jpg", shown, "JPEG")


def tables(report: runner.Report) -> str:
    """Return the edits by way of exposing them, in groups, and the line that is fitted to them."""
    from learn.experiments.photographs import photographed_fit

    page = photographed_fit.page(report)
    if beside := report.get("beside"):
        ratios = {rule: of for rule, of in beside.items() if rule not in ("name", "edits")}
        lines = [[rule, runner.interval(ratio, 2)] for rule, ratio in ratios.items()]
        page += f"\n## Beside `{beside['name']}`\n\nL2 divided by that of the same edits there.\n\n"
        page += runner.table(["brightness", "ratio"], lines)
    return page
