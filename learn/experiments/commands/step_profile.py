"""`learn.experiments step-profile`: where a training step's time goes, and how fast pictures are
relit.
"""

from pathlib import Path

from manifests.option_types import positive


def register(subparsers):
    parser = subparsers.add_parser(
        "step-profile",
        help="where a training step's time goes, and how fast pictures are relit",
        description=(
            "Makes a few steps of a run and times data, network, layer and losses apart; writes"
            " step-time.json and step-time.md."
        ),
    )
    parser.add_argument(
        "settings", metavar="RUN", help="a run file (JSON), or a preset as for `learn train`"
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
        "--steps", type=positive, default=8, metavar="N", help="to take the median of (default 8)"
    )
    parser.add_argument(
        "--images", type=positive, default=128, metavar="N", help="to relight (default 128)"
    )
    parser.set_defaults(run=run)


def run(options):
    import tempfile

    import msgspec
    import torch

    from learn.data import settings, sources
    from learn.experiments import step_profile

    torch.set_num_threads(1)
    chosen = settings.read_run(options.settings)
    data_splits = sources.data_splits(chosen.data, options.data, options.lights)
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        result = step_profile.measure(
            msgspec.structs.replace(chosen, start=None),
            data_splits,
            options.out,
            Path(scratch),
            options.steps,
            options.images,
        )
    step, relit = result["step"], result["relit"]
    print(", ".join(f"{name} {ms:.0f} ms" for name, ms in step.items()))
    if "layer" in step:
        print(f"layer: {100 * step['layer'] / (step['total'] - step['data']):.0f} % of a step")
    print(f"relighting: {relit['images_per_second_of_one_thread']:.0f} images/s of one thread")
    print(f"See {options.out / 'step-time.md'}")
