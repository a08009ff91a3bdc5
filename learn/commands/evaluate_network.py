"""`learn evaluate-network`: a page of figures for weights, measured on data that they never saw."""

from pathlib import Path

from learn.commands import device_option
from manifests.option_types import positive


def register(subparsers):
    parser = subparsers.add_parser(
        "evaluate-network",
        help="measure weights on shapes, materials and lights that they never saw",
        description=(
            "Measures weights on the test split of a data set. Writes card.md and card.json, which"
            " say what the weights were trained on and how large their errors are, and a contact"
            " sheet (sheet.jpg)."
        ),
    )
    parser.add_argument("weights", type=Path, metavar="FILE", help="weights.safetensors of a run")
    parser.add_argument(
        "--data",
        type=Path,
        required=True,
        metavar="DIR",
        help="the data set that the run was trained on",
    )
    parser.add_argument(
        "--lights",
        type=Path,
        metavar="FILE.npz",
        help="the light maps that the run was trained with",
    )
    parser.add_argument(
        "--pictures",
        type=Path,
        metavar="DIR",
        help="a data set with pictures by Cycles, to measure on its test split as well",
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder for the results"
    )
    parser.add_argument(
        "--seeds",
        type=Path,
        nargs="+",
        default=[],
        metavar="FILE",
        help="weights of the same run with other seeds",
    )
    parser.add_argument(
        "--batches",
        type=positive,
        default=16,
        metavar="N",
        help="number of batches of 16 pictures (default 16)",
    )
    parser.add_argument(
        "--note", default="", metavar="TEXT", help="a note that is printed on the page"
    )
    device_option.add(parser)
    parser.set_defaults(run=run)


def run(options):
    import json

    from learn.data import devices, sources
    from learn.data.settings import decode_run
    from learn.experiments import model_card
    from learn.networks import weights as checkpoint

    device = devices.choose(options.device)
    _, metadata = checkpoint.load_network(options.weights)
    settings = decode_run(json.dumps(metadata["run"]).encode(), options.weights)
    data_splits = sources.data_splits(
        settings.data, options.data, options.lights, pictures=options.pictures
    )
    figures = model_card.make(
        options.weights,
        data_splits,
        options.out,
        options.batches,
        options.note,
        options.seeds,
        device,
    )
    for kind, of_kind in figures.items():
        print(f"{kind}: " + ", ".join(f"{name} {value[0]:.4g}" for name, value in of_kind.items()))
    print(f"See {options.out / 'card.md'}")
