"""`learn.experiments layer-ablation`: does training through the layer help? Section 4.3's
experiment.
"""

from pathlib import Path

from manifests.option_types import above_zero, positive


def register(subparsers):
    parser = subparsers.add_parser(
        "layer-ablation",
        help="Section 4.3's experiment: training through the layer against training without it",
        description=(
            "Trains material alone and normals alone, with and without the layer, each for the same"
            " processor time, and measures all on shapes, materials and lights never seen. Writes"
            " report.json; run again to continue."
        ),
    )
    parser.add_argument(
        "--data",
        type=Path,
        required=True,
        metavar="DIR",
        help="a dataset that `python -m factory render` wrote",
    )
    parser.add_argument("--lights", type=Path, metavar="FILE.npz", help="further light maps")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="where the report goes"
    )
    parser.add_argument(
        "--size", type=positive, default=64, metavar="PIXELS", help="of the pictures (default 64)"
    )
    parser.add_argument(
        "--seconds",
        type=above_zero,
        default=60,
        metavar="S",
        help="processor time of each run (default 60)",
    )
    parser.add_argument(
        "--seeds", type=positive, default=3, metavar="N", help="how many seeds (default 3)"
    )
    parser.add_argument(
        "--held-out",
        nargs="*",
        default=[],
        metavar="LIGHT",
        help="names of light maps that only testing sees",
    )
    parser.set_defaults(run=run)


def run(options):
    import torch

    from learn.data import sources
    from learn.data.settings import Data
    from learn.experiments import layer_ablation
    from manifests import lock

    torch.set_num_threads(1)
    data = Data(test_lights=tuple(options.held_out))
    data_splits = sources.data_splits(data, options.data, options.lights)
    with lock.writing(options.out, patience=0):
        result = layer_ablation.prove(
            data, data_splits, options.out, options.size, options.seconds, range(options.seeds)
        )
    for part in layer_ablation.VARIANTS:
        for pair, (value, low, high) in result[part]["ratios"].items():
            print(f"{part}: render L2, {pair} = {value:.3f} [{low:.3f}, {high:.3f}]")
    print(f"See {options.out / 'report.json'}")
