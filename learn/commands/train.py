"""`learn train`: train a network on a data set."""

from __future__ import annotations

import argparse
from pathlib import Path

from learn.commands import options
from manifests import RUNS
from manifests.help_format import HelpFormatter
from manifests.notices import notice
from manifests.option_types import positive, whole

EPILOG = """example:
  python -m learn train joint-compact --data geometry-data --out run

docs/learning.md describes presets and run files. For geometry-data, render the preset geometry."""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the command's parser."""
    presets = ", ".join(sorted(p.stem for p in RUNS.glob("*.json")))
    parser = subparsers.add_parser(
        "train",
        help="train networks that predict normals, material and light from a picture",
        description=(
            "Trains a network on the normals of a data set. During training, the rendering layer"
            " relights them: it makes pictures with materials and lights of the data set, or with"
            " the built-in materials if the run or --materials says so. Writes the network"
            " (weights.safetensors), what continues an interrupted run (checkpoint.safetensors),"
            " its settings, log and provenance (run.json, log.jsonl, made.json) and, at intervals,"
            " a contact sheet. To continue a run that was stopped, give the same command again; the"
            " weights are the same as without the stop."
        ),
        epilog=EPILOG,
        formatter_class=HelpFormatter,
    )
    parser.add_argument(
        "settings", metavar="RUN", help=f"a run file (JSON), or the name of a preset: {presets}"
    )
    options.add_data(parser)
    options.add_out(parser)
    options.add_lights(parser)
    options.add_training_materials(parser, "as the run says")
    parser.add_argument(
        "--pictures",
        type=Path,
        metavar="DIR",
        help=(
            "a data set with pictures that Cycles rendered, for runs whose data.source is"
            ' "pictures" or "mix" (default: --data)'
        ),
    )
    parser.add_argument(
        "--skip-bad",
        action="store_true",
        help="leave damaged records out and report how many, instead of refusing to train",
    )
    parser.add_argument(
        "--tensorboard",
        action="store_true",
        help="also write events for TensorBoard (extra tensorboard)",
    )
    parser.add_argument(
        "--steps", type=positive, metavar="N", help="number of steps (default: as the run says)"
    )
    parser.add_argument(
        "--seed", type=whole, metavar="N", help="random seed (default: as the run says)"
    )
    parser.add_argument(
        "--start",
        type=Path,
        metavar="FILE",
        help="weights.safetensors of an earlier run to start from (default: as the run says)",
    )
    options.add_count(
        parser, "--sheet-every", 500, "steps between contact sheets and validations", least=0
    )
    parser.add_argument(
        "--checkpoint-every",
        type=positive,
        metavar="N",
        help="steps between checkpoints (default: one every two minutes)",
    )
    options.add_training_processes(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Run the command on parsed arguments."""
    import torch

    from learn.baselines.material_swap import SwapTraining
    from learn.data import devices, settings, sources
    from learn.training import loop, processes
    from manifests.errors import InputError
    from manifests.provenance import provenance

    device = devices.choose(arguments.device)
    chosen = settings.read_run(
        arguments.settings,
        arguments.steps,
        arguments.seed,
        arguments.materials,
        arguments.start,
    )
    if arguments.pictures is not None and chosen.data.source == "relit":
        rule = 'a run whose data.source is "pictures" or "mix"'
        remedy = "leave --pictures out, or change data.source in the run"
        raise InputError("--pictures", rule, '"relit", which uses no pictures', remedy)
    torch.set_num_threads(arguments.threads)
    with processes.lock_run_folder(arguments.out):
        data_splits = sources.load_data_splits(
            chosen.data,
            arguments.data,
            arguments.lights,
            pictures=arguments.pictures,
            skip_bad=arguments.skip_bad,
        )
        if left_out := sources.list_skipped(data_splits):
            notice(f"{len(left_out)} left out, the first: {next(iter(left_out.values()))}")
        kind = SwapTraining if chosen.network == SwapTraining.network_name else loop.Training
        saving = arguments.sheet_every, arguments.checkpoint_every
        training = kind(
            chosen,
            data_splits,
            arguments.out,
            *saving,
            arguments.workers,
            arguments.tensorboard,
            device,
        )
        begun = training.step
        figures = training.train()
        known = training.step == begun and (arguments.out / "made.json").exists()
        # only the first process has a journal; a run that was complete already keeps its made.json
        if training.journal is not None and not known:
            training.journal.write_made(
                provenance(),
                {side: data_split.sizes() for side, data_split in data_splits.items()},
                len(left_out),
                training.step,
                figures,
            )
    if figures:
        print(", ".join(f"{name} {value:.4g}" for name, value in figures.items()))
    print(f"See {arguments.out}: weights.safetensors, log.jsonl, sheet-*.jpg")
    processes.end_without_finalising()
