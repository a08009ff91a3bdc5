"""Train normals with further losses, a gloss curriculum or fewer shapes, for the same time.

Normals are pre-trained by L2 alone, once per seed. Each variant continues from there for the same
processor time, and all are measured on shapes, materials and lights that they never saw. The same
command continues; variants that are there are kept.

    L2           squared difference of normals alone, all training shapes
    pixels       with I' at sampled pixels, its gradient bounded at each pixel
                 (learn.training.rerendering.bound_gradient)
    all pixels   with I' at every pixel of the mask
    features     with I' compared by features of VGG16 (learn.networks.features), all pixels
    matte first  as pixels, but materials are admitted in order of gloss
    60, 120      L2 alone on so many shapes, pre-trained on them
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from learn.experiments import runner
from learn.experiments.training import ablation_options, ratio_chart
from manifests.option_types import above_zero, whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from learn.data.data_split import DataSplit
    from learn.data.settings import Data, Run

VARIANTS: dict[str, dict[str, Any]] = {
    "L2": {},
    "pixels": {"image": 3.0},
    "all pixels": {"image": 3.0, "rendered": "all"},
    "features": {"image_features": 1.0},
    "matte first": {"image": 3.0},
    "60 shapes": {},
    "120 shapes": {},
}
SHAPES = {"60 shapes": 60, "120 shapes": 120}
STEPS = 1_000_000
# batches: about half of what L2 alone makes of 45 s at 64²; larger pictures make fewer
MATTE_FIRST = 150


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, and what is trained and measured."""
    ablation_options.add(parser, seconds=45)
    parser.add_argument(
        "--pretraining",
        type=above_zero,
        default=60,
        metavar="S",
        help="processor time of the pre-training (default 60)",
    )
    parser.add_argument(
        "--matte-first",
        type=whole,
        default=MATTE_FIRST,
        metavar="N",
        help=f"batches after which that variant admits all materials (default {MATTE_FIRST})",
    )
    parser.add_argument(
        "--variants",
        nargs="*",
        metavar="NAME",
        help=f'of {", ".join(VARIANTS)}; "L2" must be among them (default: all)',
    )


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows": {variant: figures}, "about"}."""
    import torch

    from learn.data import sources
    from learn.data.settings import Data
    from learn.experiments.training import variants
    from manifests.progress import tqdm

    names = variants.requested_variants(arguments.variants or list(VARIANTS), list(VARIANTS), "L2")
    torch.set_num_threads(1)
    data = Data(sharing=8, test_lights=tuple(arguments.held_out))
    data_splits = sources.load_data_splits(data, arguments.data, arguments.lights)
    tests = variants.held_out_batches(data_splits, data, arguments.size, arguments.batches)
    results: dict[str, list] = {name: [] for name in names}
    todo = [(seed, name) for seed in range(arguments.seeds) for name in names]
    for seed, name in tqdm(todo, "variants", unit="run"):
        results[name].append(_train(name, seed, arguments, data, data_splits, tests))
    about = {
        "pretraining": arguments.pretraining,
        "seconds": arguments.seconds,
        "size": arguments.size,
        "seeds": arguments.seeds,
        "shapes": _count(data_splits),
    }
    about |= {"matte_first": arguments.matte_first} if "matte first" in names else {}
    return summary(results, about)


def _train(
    name: str,
    seed: int,
    arguments: argparse.Namespace,
    data: Data,
    data_splits: dict[str, DataSplit],
    tests: list,
) -> dict[str, Any]:
    """The result of one variant after its pre-training; neither is trained if it is there."""
    from learn.experiments.training import variants

    runs, size = arguments.out / "runs", arguments.size
    of_shapes = _limit_shapes(data_splits, SHAPES.get(name))
    first = runs / f"{name.split()[0] + '-' if name in SHAPES else ''}pretraining-{seed}"
    pretraining = settings("pre-training", data, size, arguments.pretraining, seed, 2e-3)
    variants.train_and_measure(pretraining, of_shapes, tests, first, arguments.workers)
    own = Pretrained(
        str(first / "weights.safetensors"),
        VARIANTS[name],
        arguments.matte_first if name == "matte first" else 0,
    )
    run = settings(name, data, size, arguments.seconds, seed + 1000, 1e-3, own)
    folder = runs / f"{name.replace(' ', '-')}-{seed}"
    return variants.train_and_measure(run, of_shapes, tests, folder, arguments.workers)


@dataclass(frozen=True)
class Pretrained:
    """A variant's own settings: it starts from weights, with further terms of the loss.

    gloss_curriculum  batches after which all materials are admitted; 0: all from the first
    """

    start: str | None = None
    losses: Mapping[str, Any] = field(default_factory=dict)
    gloss_curriculum: int = 0


def settings(
    name: str,
    data: Data,
    size: int,
    seconds: float,
    seed: int,
    learning_rate: float,
    own: Pretrained = Pretrained(),
) -> Run:
    """Return the run of one variant; without settings of its own, of the pre-training."""
    import msgspec

    from learn.data.settings import Losses, Run, Schedule
    from learn.experiments.training import variants

    return Run(
        name=f"normals {name}",
        about=f"{seconds:g} s of processor time",
        size=size,
        parts=("normals",),
        data=msgspec.structs.replace(data, photograph=False, gloss_curriculum=own.gloss_curriculum),
        losses=Losses(normals=1.0, material=0.0, **own.losses),
        schedule=Schedule(
            steps=STEPS,
            batch=variants.BATCH,
            learning_rate=learning_rate,
            warm_up=30,
            ema_decay=0.99,
            seconds=seconds,
        ),
        start=own.start,
        seed=seed,
    )


def _count(data_splits: dict[str, DataSplit]) -> int:
    return len({data_splits["train"].geometry.views[v].shape for v in data_splits["train"].views})


def _limit_shapes(data_splits: dict[str, DataSplit], count: int | None) -> dict[str, DataSplit]:
    """Return splits with so many training shapes, chosen by their names' hashes.

    Raises InputError if there are fewer.
    """
    import numpy as np

    from learn.data.sources import number_from_hash
    from manifests.errors import InputError

    if count is None:
        return data_splits
    data_split = data_splits["train"]
    shapes = sorted(
        {data_split.geometry.views[v].shape for v in data_split.views},
        key=lambda name: number_from_hash(name, 1 << 30),
    )
    if len(shapes) < count:
        raise InputError(
            data_split.geometry.folder,
            f"{count} training shapes",
            str(len(shapes)),
            "render more, or leave this variant out",
        )
    kept = set(shapes[:count])
    views = np.array([v for v in data_split.views if data_split.geometry.views[v].shape in kept])
    return data_splits | {"train": replace(data_split, views=views)}


def summary(results: dict[str, list], about: dict[str, Any]) -> runner.Report:
    """Return each variant's figures, and its ratios to L2 alone, with 95 % intervals.

    results  {variant: [result of variants.train_and_measure, one per seed]}
    """
    from learn.experiments.training import variants

    rows = {
        name: variants.figures(outcome)
        | {
            "steps": [result["steps"] for result in outcome],
            "ratio": variants.ratio(results["L2"], outcome),
            "angle_ratio": variants.ratio(results["L2"], outcome, "angle_deg"),
        }
        for name, outcome in results.items()
    }
    return {"rows": rows, "about": about | {"pictures": len(results["L2"][0]["rows"])}}


def tables(report: runner.Report) -> str:
    """Return each variant's figures with their intervals."""
    about = report["about"]
    head = ["variant", "render L2", "ratio", "mean angle (°)", "ratio", "cosine", "SSIM"]
    rows = [
        [
            name,
            runner.interval(row["l2"], 0),
            runner.interval(row["ratio"]),
            runner.interval(row["angle_deg"], 2),
            runner.interval(row["angle_ratio"]),
            f"{row['cosine'][0]:.4f}",
            f"{row['ssim'][0]:.4f}",
            f"{row['l2_frame'][0]:.0f}",
            ", ".join(map(str, row["steps"])),
        ]
        for name, row in report["rows"].items()
    ]
    return (
        "# Normals: what helps at equal processor time\n\n"
        f"{about['pretraining']:g} s of pre-training by L2, then {about['seconds']:g} s of each"
        f" variant, {about['seeds']} seeds, {about['shapes']} training shapes, {about['pictures']}"
        f" pictures of {about['size']}² pixels of shapes, materials and lights never seen. Means"
        " with 95 % intervals over shapes, materials and seeds; ratios to L2 alone on the same"
        " pictures.\n\n" + runner.table([*head, "L2, frame", "steps"], rows)
    )


def figure(report: runner.Report) -> Figure:
    """Return a chart of the ratios of render L2 and of the mean angle, with their intervals."""
    from matplotlib.figure import Figure

    names = [name for name in report["rows"] if name != "L2"]
    drawn = Figure(figsize=(9, 0.5 * len(names) + 1.2), layout="constrained")
    axes = drawn.subplots(1, 2, sharey=True)
    for axis, key, title in (
        (axes[0], "ratio", "render L2 against L2 alone"),
        (axes[1], "angle_ratio", "mean angle against L2 alone"),
    ):
        ratio_chart.draw_ratios(
            axis, title, {name: report["rows"][name][key] for name in names}, size=10
        )
    axes[0].invert_yaxis()
    return drawn
