"""Training of the baselines, one file for each name (`learn train-baselines`)."""

import argparse
from pathlib import Path

import msgspec
import torch

from learn.baselines import FILES, priors
from learn.baselines.material_swap import SwapTraining
from learn.data import seen, settings, sources
from learn.data.data_split import DataSplit
from learn.networks import tensor_file
from learn.training import loop, processes
from manifests.files import write_bytes
from manifests.wording import number_of

FILE_OF = {
    "lombardi": FILES["Lombardi-like"],
    "baseline-1": FILES["Baseline 1"],
    "baseline-2": FILES["Baseline 2"],
}


def train_baseline(
    name: str,
    preset: str | Path | None,
    options: argparse.Namespace,
    device: torch.device | str = "cpu",
) -> str:
    """Make one file in options.out; return a line about it.

    preset   of the run; None for priors, which are fitted without a run
    options  as learn.commands.train_baselines parses them
    device   of networks
    """
    target = options.out / FILE_OF[name]
    if target.exists():
        return f"{target} is there already"
    options.out.mkdir(parents=True, exist_ok=True)
    run = None if preset is None else resolve_preset(settings.read_run(preset), options)
    data_splits = sources.load_data_splits(
        hold_out(options, settings.Data() if run is None else run.data),
        options.data,
        options.lights,
    )
    if run is None:
        data_split = data_splits["train"]
        priors.save(
            target,
            priors.fit(list(data_split.labels.values()), data_split.maps),
            {"materials": sorted(data_split.labels), "maps": len(data_split.maps)},
            what_priors_saw(data_split),
        )
        materials = number_of(len(data_split.labels), "material")
        return f"{target}: {materials}, {number_of(len(data_split.maps), 'light map')}"
    kind = SwapTraining if run.network == SwapTraining.network_name else loop.Training
    folder = options.out / name
    with processes.lock_run_folder(folder):
        figures = kind(run, data_splits, folder, workers=options.workers, device=device).train()
    write_bytes(target, (folder / "weights.safetensors").read_bytes())
    return f"{target}: " + ", ".join(f"{key} {value:.4g}" for key, value in figures.items())


def what_priors_saw(data_split: DataSplit) -> seen.Seen:
    """Return what priors saw of a split: materials and light maps, but no shapes."""
    return seen.make_seen(
        {
            "shapes": (),
            "materials": map(seen.label_hash, data_split.labels.values()),
            "lights": (*map(seen.map_hash, data_split.maps), *data_split.copies),
        }
    )


def resolve_preset(run: settings.Run, options: argparse.Namespace) -> settings.Run:
    """Return a preset with the steps and the held-out lights of the options."""
    if options.steps is not None:
        run = msgspec.structs.replace(
            run, schedule=msgspec.structs.replace(run.schedule, steps=options.steps)
        )
    return msgspec.structs.replace(run, data=hold_out(options, run.data))


def hold_out(options: argparse.Namespace, data: settings.Data) -> settings.Data:
    """Return data with the lights and the materials of the weights options.like, if any.

    options.materials, where it is given, takes precedence over the weights' materials.
    """
    if options.like is None:
        return settings.with_materials(data, options.materials)
    with tensor_file.open_tensor_file(options.like) as stored:
        like = settings.decode_run(stored.metadata.get("run", "{}").encode(), options.like).data
    data = msgspec.structs.replace(
        data,
        materials=like.materials,
        measured_lights=data.measured_lights or like.measured_lights,
        validation_lights=like.validation_lights,
        test_lights=like.test_lights,
    )
    return settings.with_materials(data, options.materials)
