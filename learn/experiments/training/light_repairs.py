"""Train with and without two repairs of predicted lights, for the same steps.

    as in use               the run as it is: its light head continues maps around the circle and
                            across the poles, and its losses of the light compare maps of unit mean
                            over the three channels
    zeros beyond the edges  the light head of the network "compact", which sees zeros there
    at unit luminance       losses of the light compare maps as predicted, of unit mean luminance
    as in use again         as the first, with other random numbers: what chance alone does

Only the light is trained, by the run's losses of the light; pixels are binned by true normals.
Every variant begins from nothing, sees the same batches in the same order and makes the same number
of steps; its learning rate falls to 0 at the last one. All are measured on shapes, materials and
lights that training never sees. The same command continues; variants that are there are kept.
Batches are kept in the folder while the command runs, and then removed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner
from learn.experiments.training import ablation_options, ratio_chart
from manifests.option_types import positive

if TYPE_CHECKING:
    from learn.data.batch import ExampleBatch
    from learn.data.settings import Run
    from learn.experiments.training import variants
    from learn.networks.prediction import Coded
    from learn.training import loop

REFERENCE, AGAIN = "as in use", "as in use again"
WARM_UP = 1 / 10  # of all steps, at most
THROUGH_LAYER = ("image", "target", "image_features", "target_features")
ERRORS = {
    "irradiance": "irradiance, relative error",
    "light_log": "log(1 + L), mean square",
    "diffuse_rmse": "diffuse sphere, RMSE",
    "silver_rmse": "silver sphere, RMSE",
    "mirror_rmse": "mirror sphere, RMSE",
    "edge_error": "log(1 + L) of the outermost texels",
    "target_l2": "edit of true normals, display L2",
}
SIGNED = {
    "frame": "brightness of the outermost texels, stops",
    "seam": "step from the last column to the first, stops",
    "green": "green of the mean, stops",
}
DIGITS = {"target_l2": 0}


@dataclass(frozen=True)
class Variant:
    """What a variant changes of the run.

    network       in place of the run's; None: the run's
    of_luminance  whether losses of the light compare maps of unit luminance
    further_seed  added to the seed of the network, not of the batches
    """

    network: str | None = None
    of_luminance: bool = False
    further_seed: int = 0


VARIANTS = {
    REFERENCE: Variant(),
    "zeros beyond the edges": Variant(network="compact"),
    "at unit luminance": Variant(of_luminance=True),
    AGAIN: Variant(further_seed=1000),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, the run, and what is trained and measured."""
    options.add_data(parser)
    options.add_lights(parser)
    ablation_options.add_run(parser, "the network compact-wrapped with losses of the light")
    parser.add_argument(
        "--pictures",
        type=positive,
        metavar="N",
        help="pictures of each step (default: as many as the run says)",
    )
    ablation_options.add_variants(parser, VARIANTS, REFERENCE)
    ablation_options.add_batches(parser)
    options.add_size(parser, 64)
    options.add_seed(parser, "seed of the network and the batches")
    options.add_workers(parser)


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"variants": {name: {"figures", "ratios", "milliseconds"}}, "about"}."""
    import shutil

    import msgspec
    import torch

    from learn.data import sources
    from learn.data.settings import read_run
    from learn.data.sources import make_batch_source
    from learn.experiments.training import objective_training, variants
    from learn.experiments.training.kept_batches import KeptBatches
    from manifests import outputs
    from manifests.progress import tqdm
    from manifests.store_paths import file_hash

    names = variants.requested_variants(
        arguments.variants or list(VARIANTS), list(VARIANTS), REFERENCE
    )
    run = read_run(arguments.run_name)
    require_lights(run, arguments.run_name)
    torch.set_num_threads(1)
    pinned = {
        "run": msgspec.to_builtins(run),
        **{name: getattr(arguments, name) for name in ("steps", "pictures", "batches", "size")},
        "seed": arguments.seed,
        "data": file_hash(arguments.data / "dataset.json"),
        "lights": None if arguments.lights is None else arguments.lights.name,
    }
    outputs.pin_settings(arguments.out / "settings.json", pinned)
    data_splits = sources.load_data_splits(run.data, arguments.data, arguments.lights)
    tests = objective_training.tests(data_splits, run, arguments.size, arguments.batches)
    of_all = settings(REFERENCE, run, arguments)
    kept = KeptBatches(
        make_batch_source(data_splits["train"], of_all, of_all.schedule.batch, of_all.seed),
        arguments.out / "batches",
    )
    results = {}
    for name in tqdm(names, "variants", unit="run"):
        results[name] = variants.train_and_measure(
            settings(name, run, arguments),
            data_splits,
            tests,
            arguments.out / "runs" / name.replace(" ", "-"),
            arguments.workers,
            objective_training.maker(kept, True, VARIANTS[name].of_luminance),
            rows,
        )
    shutil.rmtree(kept.folder, ignore_errors=True)
    about = {
        "run": run.name,
        "steps": arguments.steps,
        "batch": of_all.schedule.batch,
        "size": arguments.size,
        "train": data_splits["train"].sizes(),
        "test": data_splits["test"].sizes(),
    }
    return summary(results, about)


def require_lights(run: Run, where: str) -> None:
    """Raise InputError for a run from which the variants cannot be made."""
    from manifests.errors import InputError

    remedy = "take the preset general-compact"
    if run.network != "compact-wrapped":
        raise InputError(f"{where}: network", "compact-wrapped", run.network, remedy)
    if not (run.losses.light_log or run.losses.light_rendered):
        rule = "a weight above 0 of light_log or light_rendered"
        raise InputError(f"{where}: losses", rule, "none", remedy)


def settings(name: str, run: Run, arguments: argparse.Namespace) -> Run:
    """Return the run of one variant, which begins from nothing."""
    import msgspec

    own, steps = VARIANTS[name], arguments.steps
    schedule = msgspec.structs.replace(
        run.schedule,
        steps=steps,
        batch=arguments.pictures or run.schedule.batch,
        warm_up=min(run.schedule.warm_up, int(steps * WARM_UP)),
        seconds=None,
    )
    return msgspec.structs.replace(
        run,
        name=name,
        about=f"{steps} steps of the light of {run.name}",
        network=own.network or run.network,
        size=arguments.size,
        parts=("light",),
        losses=msgspec.structs.replace(run.losses, **dict.fromkeys(THROUGH_LAYER, 0.0)),
        schedule=schedule,
        start=None,
        heads=None,
        revive=False,
        stages=(),
        seed=arguments.seed + own.further_seed,
    )


def rows(
    training: loop.Training | None, network: Coded, batch: ExampleBatch
) -> Iterator[variants.Row]:
    """Yield the figures of each picture of a batch of `objective_training.tests`."""
    import torch

    from learn.data.batch import shape_and_material
    from learn.experiments.training.light_figures import light_figures
    from learn.metrics import light_probes
    from learn.metrics.radiometry import irradiance_error
    from learn.networks.prediction import require_part
    from learn.training import validation

    with torch.no_grad():
        prediction = network(batch.image, batch.mask, None, ("light",), batch.n)
    light, target = require_part(prediction.light), batch.target_label
    edits = validation.compare_renderings(batch.n, target, light, target, batch, batch.target)
    of_batch = light_figures(light, batch.light) | {
        "irradiance": irradiance_error(light, batch.light),
        "target_l2": torch.from_numpy(edits),
    }
    for i, name in enumerate(batch.names):
        shape, material = shape_and_material(name)
        spheres = light_probes.compare(light[i], batch.light[i], batch.elevation)
        own = {key: float(value[i]) for key, value in of_batch.items()}
        own |= {key: spheres[key] for key in ERRORS if key in spheres}
        yield {"shape": shape, "material": material} | own


def summary(results: Mapping[str, variants.Result], about: Mapping[str, Any]) -> runner.Report:
    """Return each variant's figures, and the ratios of its errors to those of the run as it is.

    Intervals of 95 % are over shapes and materials.

    results  {variant: result of learn.experiments.training.variants.train_and_measure}
    """
    from learn.experiments.training import variants

    reference = results[REFERENCE]
    of_variants = {
        name: {
            "figures": variants.figures([result]),
            "ratios": {key: variants.ratio([reference], [result], key) for key in ERRORS},
            "milliseconds": 1e3 * result["seconds"] / max(result["steps"], 1),
        }
        for name, result in results.items()
    }
    return {"variants": of_variants, "about": {**about, "pictures": len(reference["rows"])}}


def tables(report: runner.Report) -> str:
    """Return each variant's errors, their ratios to the run as it is, and edges and colour."""
    about, of_variants = report["about"], report["variants"]
    train, test = about["train"], about["test"]

    def rows_of(kind: str, keys: Mapping[str, str], names: list[str]) -> list[list[object]]:
        digits = {} if kind == "ratios" else DIGITS
        return [
            [
                name,
                *(
                    runner.interval(of_variants[name][kind][key], digits.get(key, 3))
                    for key in keys
                ),
            ]
            for name in names
        ]

    names = list(of_variants)
    others = [name for name in names if name != REFERENCE]
    parts = [
        "# Two repairs of predicted lights, with and without",
        f"{about['steps']} steps of {about['batch']} pictures of {about['size']}² pixels of the run"
        f" `{about['run']}`, of the light alone, from nothing, one training of each variant."
        f" Training drew from {train['shapes']:,} shapes and {train['lights']} light maps. Measured"
        f" on {about['pictures']} pictures of {test['shapes']} shapes, {test['materials']}"
        f" materials and {test['lights']} light maps that are never seen.",
        "Means with 95 % intervals over shapes and materials, which do not cover another training"
        " of the same variant.",
        "## Errors",
        runner.table(["variant", *ERRORS.values()], rows_of("figures", ERRORS, names)),
        f"Ratios to `{REFERENCE}` on the same pictures; below 1 is better:",
        runner.table(["variant", *ERRORS.values()], rows_of("ratios", ERRORS, others)),
        "## Edges of the map, and colour",
        "All beyond the true light's: the outermost texels beside those four texels further in,"
        " below 0 where the map has a dark frame; the mean step between the two columns that meet;"
        " and by how much the mean colour is greener.",
        runner.table(["variant", *SIGNED.values()], rows_of("figures", SIGNED, names)),
    ]
    if AGAIN in names:
        parts.insert(3, f"`{AGAIN}` shows what other random numbers do.")
    return "\n\n".join(part.rstrip() for part in parts) + "\n"


def figure(report: runner.Report) -> Any:
    """Return a chart of each variant's ratios to the run as it is, with their intervals."""
    from matplotlib.figure import Figure

    names = [name for name in report["variants"] if name != REFERENCE]
    drawn = Figure(figsize=(2.1 * len(ERRORS) + 2, 0.3 * len(names) + 1.1), layout="constrained")
    axes = drawn.subplots(1, len(ERRORS), sharey=True)
    for axis, (key, label) in zip(axes, ERRORS.items(), strict=True):
        ratio_chart.draw_ratios(
            axis, label, {name: report["variants"][name]["ratios"][key] for name in names}
        )
    axes[0].invert_yaxis()
    drawn.suptitle(f"ratio to {REFERENCE}, with 95 % intervals", fontsize=10)
    return drawn
