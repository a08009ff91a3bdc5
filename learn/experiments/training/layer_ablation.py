"""Train with and without the layer for the same processor time: the experiment of Section 4.3.

Material alone and normals alone are trained with the same network, data and seed, and measured on
shapes, materials and lights that they never saw. What is not predicted is given its true value, so
that each part stands alone. The same command continues; variants that are there are kept.

    material  standalone: squared difference of codes; combined: with I' through the layer;
              control: with the log-albedo term and no layer; both: with that term and the layer
    normals   standalone: squared difference of normals; combined: with I' through the layer
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from learn.experiments import runner
from learn.experiments.training import ablation_options

if TYPE_CHECKING:
    from learn.data.settings import Data, Run
    from manifests.training_runs import Part

VARIANTS: dict[Part, dict[str, dict[str, float]]] = {
    "material": {
        "standalone": {"material": 1.0},
        "combined": {"material": 1.0, "image": 10.0},
        "control": {"material": 1.0, "albedo": 0.3},
        "both": {"material": 1.0, "albedo": 0.3, "image": 10.0},
    },
    "normals": {"standalone": {"normals": 1.0}, "combined": {"normals": 1.0, "image": 3.0}},
}
LEARNING_RATES: dict[Part, float] = {"material": 1e-3, "normals": 2e-3}
STEPS = 1_000_000  # a bound far beyond what the time allows


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, and what is trained and measured."""
    ablation_options.add(parser, seconds=60)


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {part: {variant: figures, "ratios": {pair: [ratio, low, high]}}, "about"}."""
    import torch

    from learn.data import sources
    from learn.data.settings import Data
    from learn.experiments.training import variants
    from manifests.progress import tqdm

    torch.set_num_threads(1)
    data = Data(test_lights=tuple(arguments.held_out))
    data_splits = sources.load_data_splits(data, arguments.data, arguments.lights)
    tests = variants.held_out_batches(data_splits, data, arguments.size, arguments.batches)
    seeds = range(arguments.seeds)
    todo = [(s, p, v) for s in seeds for p, of_part in VARIANTS.items() for v in of_part]
    results: dict[Part, dict[str, list]] = {}
    for seed, part, variant in tqdm(todo, "variants", unit="run"):
        run = settings(part, variant, data, arguments.size, arguments.seconds, seed)
        folder = arguments.out / f"{part}-{variant}-{seed}"
        result = variants.train_and_measure(run, data_splits, tests, folder, arguments.workers)
        results.setdefault(part, {}).setdefault(variant, []).append(result)
    about = {"seconds": arguments.seconds, "size": arguments.size, "seeds": arguments.seeds}
    return summary(results, about)


def settings(part: Part, variant: str, data: Data, size: int, seconds: float, seed: int) -> Run:
    """Return the run of one variant."""
    import msgspec

    from learn.data.settings import Losses, Run, Schedule
    from learn.experiments.training import variants

    schedule = Schedule(
        steps=STEPS,
        batch=variants.BATCH,
        learning_rate=LEARNING_RATES[part],
        warm_up=50,
        ema_decay=0.99,
        seconds=seconds,
    )
    return Run(
        name=f"{part} {variant}",
        about=f"{seconds:g} s of processor time",
        size=size,
        parts=(part,),
        data=msgspec.structs.replace(data, photograph=False),
        losses=msgspec.structs.replace(
            Losses(normals=0.0, material=0.0), **VARIANTS[part][variant]
        ),
        schedule=schedule,
        seed=seed,
    )


def summary(results: dict[Part, dict[str, list]], about: dict[str, Any]) -> runner.Report:
    """Return figures of each variant, and ratios of render L2 with 95 % intervals.

    results  {part: {variant: [result of variants.train_and_measure, one per seed]}}
    """
    from learn.experiments.training import variants

    report: runner.Report = {}
    for part, of_part in results.items():
        report[part] = {
            v: variants.figures(result) | {"steps": [r["steps"] for r in result]}
            for v, result in of_part.items()
        }
        pairs = [("standalone", v) for v in of_part if v != "standalone"]
        pairs += [("control", v) for v in ("combined", "both") if {"control", v} <= of_part.keys()]
        report[part]["ratios"] = {
            f"{b} / {a}": variants.ratio(of_part[a], of_part[b]) for a, b in pairs
        }
    pictures = len(next(iter(next(iter(results.values())).values()))[0]["rows"])
    return report | {"about": about | {"pictures": pictures}}


def tables(report: runner.Report) -> str:
    """Return figures of each variant, and ratios of render L2."""
    about = report["about"]
    usual = ("l2", "l2_frame", "ssim", "steps")
    rows = [
        [
            part,
            variant,
            runner.interval(row["l2"], 0),
            f"{row['l2_frame'][0]:.0f}",
            f"{row['ssim'][0]:.4f}",
            ", ".join(f"{key} {row[key][0]:.4g}" for key in row if key not in usual),
            ", ".join(map(str, row["steps"])),
        ]
        for part in VARIANTS
        for variant, row in report[part].items()
        if variant != "ratios"
    ]
    ratios = [
        [part, pair, runner.interval(values, 2)]
        for part in VARIANTS
        for pair, values in report[part]["ratios"].items()
    ]
    head = ["part", "variant", "render L2", "L2, frame", "SSIM", "others", "steps"]
    return (
        "# Training through the layer against training without it (Section 4.3)\n\n"
        f"{about['seconds']:g} s of processor time per run, {about['seeds']} seeds,"
        f" {about['pictures']} pictures of {about['size']}² pixels of shapes, materials and lights"
        " never seen; 95 % intervals over shapes, materials and seeds.\n\n"
        + runner.table(head, rows)
        + "\n"
        + runner.table(["part", "ratio of render L2", "value"], ratios)
    )
