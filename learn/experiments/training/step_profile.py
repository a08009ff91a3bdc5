"""Time the parts of a training step, and how fast pictures are relit.

A few steps of a run are made, and data, network, layer and losses timed separately: processor time
of one thread, in ms, medians over steps. Data are timed in this process too, although training has
them made by another one.

    data       a batch of relit pictures
    network    forward, and its own share of the backward pass
    layer      rendering I' and O' forward and backward, with the truth they are compared with
    optimiser  clipping, the step, and the weights' average
"""

from __future__ import annotations

import argparse
from pathlib import Path

from learn.commands import options
from learn.experiments import runner


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the run, its data, and how much of it is timed."""
    parser.add_argument(
        "settings", metavar="RUN", help="a run file (JSON), or a preset as for `learn train`"
    )
    options.add_data(parser)
    options.add_lights(parser)
    options.add_count(parser, "--steps", 8, "steps whose medians are reported")
    options.add_count(parser, "--images", 128, "number of pictures to relight")


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"step": {part: ms}, "relit": {…}, "about"}."""
    import tempfile

    import msgspec
    import torch

    from learn.data import settings, sources
    from learn.experiments.training import step_timing

    torch.set_num_threads(1)
    chosen = settings.read_run(arguments.settings)
    data_splits = sources.load_data_splits(chosen.data, arguments.data, arguments.lights)
    with tempfile.TemporaryDirectory() as scratch:
        return step_timing.profile(
            msgspec.structs.replace(chosen, start=None),
            data_splits,
            Path(scratch),
            arguments.steps,
            arguments.images,
        )


def tables(report: runner.Report) -> str:
    """Return the parts of a step with their shares, and the speed of relighting."""
    about, step, relit = report["about"], report["step"], report["relit"]
    own = step["total"] - step["data"]
    rows = [
        [name, f"{value:.0f}", f"{100 * value / own:.0f} %"]
        for name, value in step.items()
        if name not in ("data", "total")
    ]
    rows += [["**a step**", f"{own:.0f}", ""]]
    rows += [["data, made by another process", f"{step['data']:.0f}", ""]]
    return (
        f"# Where a step of {about['run']} spends its time\n\n"
        f"{about['batch']} pictures of {about['size']}² pixels, one thread's processor time,"
        f" median of {about['steps']} steps.\n\n"
        + runner.table(["part", "ms", "share of the step"], rows)
        + f"\nRelighting: {relit['images_per_second_of_one_thread']:.0f} pictures of"
        f" {relit['size']}² per second of one thread's processor time ({relit['images']} pictures,"
        " materials, lights and augmentation included; by the clock, on this machine as loaded as"
        f" it was: {relit['images_per_second_by_the_clock']:.0f}).\n"
    )
