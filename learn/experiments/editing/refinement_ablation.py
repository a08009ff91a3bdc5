"""Measure refinement on pictures of known edits: for each weight, from bad starts, and its time.

The data set's scenes must be rendered in several materials, so that the truth of an edit is known.
The report has re-rendering, edit, normals and light before and after refinement for each setting
(one weight, number of outer iterations or of pixels changed at a time), the same from bad
initialisations, and seconds. rows.jsonl and starts.jsonl keep a line per refinement: the same
command continues.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner
from manifests.option_types import whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from learn.data.batch import ExampleBatch
    from learn.data.records import Records
    from learn.networks.prediction import Prediction


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, the weights, the settings and the numbers of pictures and initialisations."""
    options.add_data(parser, "a data set with pictures of each scene in several materials")
    options.add_weights(parser, options.TABLE_WEIGHTS)
    options.add_count(parser, "--pictures", 12, "number of pictures for each setting")
    parser.add_argument(
        "--initialisations",
        type=whole,
        default=100,
        metavar="N",
        help="refinements from initialisations of five kinds in turn (default 100; 0: none)",
    )
    parser.add_argument("--starts", dest="initialisations", type=whole, help=argparse.SUPPRESS)
    parser.add_argument(
        "--only",
        nargs="*",
        metavar="SETTING",
        help=(
            "only these of default, paper, a=0.1, outer_iterations=3, pixels=600 … (default: all;"
            " without a name: none)"
        ),
    )
    options.add_materials(
        parser,
        "source of random materials for bad initialisations: the data set's own, or the built-in"
        " ones (default: dataset)",
    )
    options.add_seed(parser, "seed by which pictures are chosen")


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"settings", "times", "initialisations"}; the last two are absent if not requested."""
    import torch

    from learn.data.records import Records
    from learn.evaluation.methods import make_predictor
    from learn.experiments.editing import refinement_sweep
    from learn.networks import weights as checkpoint
    from manifests.store_paths import file_hash

    torch.set_num_threads(1)  # times are reported for one thread
    weights = arguments.weights
    net, _ = checkpoint.load_full_network(weights)
    about = {
        "data": arguments.data.resolve().name,
        "materials": file_hash(arguments.data / "materials.json"),
        "weights": file_hash(weights),
        "starts_of": arguments.materials,
    }
    records = Records(arguments.data)
    refinement_sweep.pin_settings(arguments.out, about)
    return _measure(arguments, make_predictor(net), records) | {"about": about}


def _measure(
    arguments: argparse.Namespace, predict: Callable[[ExampleBatch], Prediction], records: Records
) -> dict[str, Any]:
    from learn.experiments.editing import refinement_initialisations, refinement_sweep

    # one initialisation of each kind per picture
    needed = -(-arguments.initialisations // len(refinement_initialisations.KINDS))
    known = refinement_sweep.cases(records, max(arguments.pictures, needed), arguments.seed)
    result: dict[str, Any] = {}
    if arguments.only is None or arguments.only:
        result["settings"] = refinement_sweep.sweep(
            predict, known[: arguments.pictures], arguments.out, arguments.only
        )
    batch = known[0].batch
    result["times"] = {
        f"{len(b.image[0, 0])}": refinement_sweep.time_refinement(predict, b)
        for b in (batch, refinement_sweep.double_size(batch))
    }
    if arguments.initialisations:
        labels = refinement_initialisations.labels_of(records, arguments.materials)
        result["initialisations"] = refinement_initialisations.measure_refinements(
            predict, known[:needed], arguments.initialisations, arguments.out, labels
        )
    return result


def tables(report: runner.Report) -> str:
    """Return figures before and after refinement by setting and by initialisation, and seconds."""
    from learn.experiments.editing.refinement_sweep import FIGURES

    parts = ["# Refinement of pictures whose edits are known", ""]
    if settings := report.get("settings"):
        head = ["setting", *FIGURES.values(), "edit, ratio of means", "seconds", "pictures"]
        rows = [
            [
                name,
                *(f"{row[key][0]:.3g} → {row[key][1]:.3g}" for key in FIGURES),
                f"{row['edit_ratio']:.2f}",
                f"{row['seconds']:.1f}",
                row["pictures"],
            ]
            for name, row in settings.items()
        ]
        parts += [
            "Medians over pictures, before and after refinement:",
            "",
            runner.table(head, rows),
        ]
    if result := report.get("initialisations"):
        before, after = result["image_median"]
        parts += [
            f"From {result['starts']} initialisations: {result['above_their_start']} ended with a"
            f" larger energy, {result['not_finite']} were not finite; the re-rendering's median"
            f" display L2 changed from {before:.0f} to {after:.0f}"
            f" ({100 * result['median_change']:+.0f} %).",
            "",
            runner.table(
                ["initialisation", "before", "after"],
                [[kind, *(f"{x:.0f}" for x in pair)] for kind, pair in result["by_kind"].items()],
            ),
        ]
    seconds = [
        [f"{size}²", f"{row['predict']:.2f}", f"{row['refine']:.1f}"]
        for size, row in report["times"].items()
    ]
    parts += [runner.table(["picture", "prediction, s", "refinement, s"], seconds)]
    return "\n".join(parts)


def figure(report: runner.Report) -> Figure | None:
    """Return the chart of each swept value; None if no setting was swept."""
    from learn.experiments.editing import refinement_chart

    return refinement_chart.draw(report.get("settings", {}))
