"""`learn.experiments upsampling`: how an edit gets to the photograph's own size, measured."""

from pathlib import Path

from manifests.option_types import positive


def register(subparsers):
    parser = subparsers.add_parser(
        "upsampling",
        help="measure ways to bring an edit to the photograph's own size, and what --detail does",
        description=(
            "Edits rendered pictures larger than the network's size whose truth is known, by the"
            " way in use, with detail carried over, and by others, with our parts and with true"
            " ones. Writes enlarging.json: display L2 and SSIM over the object."
        ),
    )
    parser.add_argument(
        "--data",
        type=Path,
        required=True,
        metavar="DIR",
        help="a dataset of large pictures, each scene in two materials or more",
    )
    parser.add_argument(
        "--weights",
        type=Path,
        metavar="FILE",
        help=(
            "weights.safetensors of a training run (default: the weights that come with the"
            " program)"
        ),
    )
    parser.add_argument(
        "--edits", type=positive, default=24, metavar="N", help="how many (default 24)"
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="where enlarging.json goes"
    )
    parser.set_defaults(run=run)


def run(options):
    import torch

    from learn.data.records import Records
    from learn.editing.predict import WEIGHTS
    from learn.experiments import upsampling_study

    torch.set_num_threads(1)
    result = upsampling_study.measure_upsampling(
        Records(options.data), options.weights or WEIGHTS, options.out, options.edits
    )
    for parts, rows in result["parts"].items():
        for name, row in rows.items():
            ratio, gain = (
                "{:.3f} [{:.3f}, {:.3f}]".format(*row[key]) for key in ("l2_ratio", "ssim_gain")
            )
            print(
                f"{parts}, {name}: L2 {row['l2'][0]:.0f}, {ratio} of the way in use; SSIM"
                f" {row['ssim'][0]:.3f}, {gain}"
            )
