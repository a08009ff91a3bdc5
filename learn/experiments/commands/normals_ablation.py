"""`learn.experiments normals-ablation`: what helps normals beyond their own squared difference, at
equal processor time.
"""

from pathlib import Path

from manifests.option_types import above_zero, positive, whole


def register(subparsers):
    parser = subparsers.add_parser(
        "normals-ablation",
        help=(
            "normals: what the layer's picture, features, a curriculum and more shapes add at equal"
            " processor time"
        ),
        description=(
            "Trains normals by L2 alone, then goes on from there with each variant for the same"
            " processor time, and measures all on shapes, materials and lights never seen. Writes"
            " table.json, table.md, chart.png; run again to continue."
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
        "--out", type=Path, required=True, metavar="DIR", help="where the table goes"
    )
    parser.add_argument(
        "--size", type=positive, default=64, metavar="PIXELS", help="of the pictures (default 64)"
    )
    parser.add_argument(
        "--pretraining",
        type=above_zero,
        default=60,
        metavar="S",
        help="processor time of the pre-training (default 60)",
    )
    parser.add_argument(
        "--seconds",
        type=above_zero,
        default=45,
        metavar="S",
        help="processor time of each variant (default 45)",
    )
    parser.add_argument(
        "--seeds", type=positive, default=3, metavar="N", help="how many seeds (default 3)"
    )
    parser.add_argument(
        "--matte-first",
        type=whole,
        default=150,
        metavar="N",
        help="batches after which that variant admits all materials (default 150)",
    )
    parser.add_argument(
        "--variants",
        nargs="*",
        metavar="NAME",
        help='of learn.experiments.normals_ablation; "L2" must be among them (default: all)',
    )
    parser.add_argument(
        "--batches",
        type=positive,
        default=12,
        metavar="N",
        help="of 16 pictures to measure on (default 12)",
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
    from learn.experiments import normals_ablation
    from manifests import lock
    from manifests.errors import InputError, closest

    torch.set_num_threads(1)
    names = tuple(options.variants or normals_ablation.VARIANTS)
    for name in names:
        if name not in normals_ablation.VARIANTS:
            raise InputError(
                f"--variants: '{name}'",
                "a variant",
                "none of that name",
                closest(name, normals_ablation.VARIANTS),
            )
    if "L2" not in names:
        raise InputError(
            "--variants", '"L2", which all others are compared with', ", ".join(names), "add it"
        )
    data = Data(sharing=8, test_lights=tuple(options.held_out))
    data_splits = sources.data_splits(data, options.data, options.lights)
    with lock.writing(options.out, patience=0):
        result = normals_ablation.run_ablation(
            data,
            data_splits,
            options.out,
            options.size,
            options.pretraining,
            options.seconds,
            range(options.seeds),
            names,
            options.batches,
            matte=options.matte_first,
        )
    for name, row in result["rows"].items():
        print(
            "{}: render L2 {:.0f}, {:.3f} [{:.3f}, {:.3f}] of L2 alone".format(
                name, row["l2"][0], *row["ratio"]
            )
        )
    print(f"See {options.out / 'table.md'}")
