"""`learn evaluate-network`: a page of figures for weights, measured on data that they never saw."""

from __future__ import annotations

import argparse
from pathlib import Path

from learn.commands import options
from manifests.help_format import HelpFormatter

EPILOG = """example:
  python -m learn evaluate-network run/weights.safetensors --data geometry-data --out card"""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the command's parser."""
    parser = subparsers.add_parser(
        "evaluate-network",
        help="measure weights on shapes, materials and lights that they never saw",
        description=(
            "Measures weights on the test split of a data set. Writes card.md and card.json,"
            " which say what the weights were trained on and how large their errors are, and a"
            " contact sheet (sheet.jpg)."
        ),
        epilog=EPILOG,
        formatter_class=HelpFormatter,
    )
    parser.add_argument("weights", type=Path, metavar="FILE", help="weights.safetensors of a run")
    options.add_data(parser, "the data set that the run was trained on")
    options.add_lights(parser, "the light maps that the run was trained with")
    parser.add_argument(
        "--pictures",
        type=Path,
        metavar="DIR",
        help="a data set with pictures by Cycles, to measure on its test split as well",
    )
    options.add_out(parser)
    parser.add_argument(
        "--other-seeds",
        type=Path,
        nargs="+",
        default=[],
        metavar="FILE",
        help="weights of the same run with other seeds",
    )
    parser.add_argument("--seeds", dest="other_seeds", type=Path, nargs="+", help=argparse.SUPPRESS)
    options.add_count(parser, "--batches", 16, "number of batches of 16 pictures")
    parser.add_argument(
        "--note", default="", metavar="TEXT", help="a note that is printed on the page"
    )
    parser.add_argument(
        "--printed",
        action="store_true",
        help="measure normals under printed patterns as well, and their ratio to those without",
    )
    options.add_allow_overlap(parser)
    options.add_device(parser)
    options.add_ray(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Run the command on parsed arguments."""
    import json

    from learn.data import devices, sources
    from learn.data.settings import decode_run
    from learn.evaluation import card_batches, model_card, overlap
    from learn.networks import weights as checkpoint

    options.require_cpu(arguments)
    device = devices.choose(arguments.device if arguments.ray is None else "cpu")
    _, metadata = checkpoint.load_network(arguments.weights)
    settings = decode_run(json.dumps(metadata["run"]).encode(), arguments.weights)
    data_splits = sources.load_data_splits(
        settings.data, arguments.data, arguments.lights, pictures=arguments.pictures
    )
    seen = overlap.report_overlap(
        [arguments.weights, *arguments.other_seeds],
        overlap.shown_by_split(data_splits["test"]),
        arguments.data,
        arguments.allow_overlap,
    )
    cluster = None
    if arguments.ray is not None:
        cluster = card_batches.Cluster(
            arguments.ray,
            [arguments.weights, *arguments.other_seeds],
            arguments.data,
            arguments.lights,
            arguments.pictures,
        )
    figures = model_card.write_card(
        arguments.weights,
        data_splits,
        arguments.out,
        arguments.batches,
        note=arguments.note,
        other_seeds=arguments.other_seeds,
        device=device,
        seen=seen,
        printed=arguments.printed,
        cluster=cluster,
    )
    for kind, of_kind in figures.items():
        print(f"{kind}: " + ", ".join(f"{name} {value[0]:.4g}" for name, value in of_kind.items()))
    print(f"See {arguments.out / 'card.md'}")
