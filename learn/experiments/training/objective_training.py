"""What objective_ablation trains and measures: runs on kept batches, networks without their map."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import torch

from learn.data.batch import ExampleBatch, shape_and_material
from learn.data.data_split import DataSplit
from learn.data.settings import Losses, Run
from learn.experiments.training import variants
from learn.layer import predictions
from learn.layer.display_method import method_for
from learn.metrics.radiometry import irradiance_error
from learn.networks import weights
from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from learn.networks.prediction import Coded, require_part
from learn.training import loop, losses, processes, validation
from manifests.errors import InputError


class ObjectiveTraining(loop.Training):
    """A training that takes its batches from `source`, with or without the reflectance map.

    of_luminance  whether losses of the light compare maps of unit mean luminance, as networks
                  predict them
    """

    def __init__(
        self,
        *arguments: Any,
        source: processes.BatchSource,
        reflectance_map: bool,
        of_luminance: bool = False,
        **named: Any,
    ):
        self.source, self.reflectance_map = source, reflectance_map
        self.of_luminance = of_luminance
        super().__init__(*arguments, **named)

    def _source(self) -> processes.BatchSource:
        return self.source

    def _new_network(self, ranges: Ranges) -> Coded:
        network = super()._new_network(ranges)
        return network if self.reflectance_map else without_reflectance_map(network)

    def _terms(
        self, prediction: Any, batch: ExampleBatch, loss_weights: Losses, rng: torch.Generator
    ) -> losses.Terms:
        terms = super()._terms(prediction, batch, loss_weights, rng)
        if self.of_luminance:
            terms |= losses.light_terms(prediction, batch, loss_weights, scaled=lambda light: light)
        return terms


def maker(
    source: processes.BatchSource, reflectance_map: bool, of_luminance: bool = False
) -> Callable[..., ObjectiveTraining]:
    """Return what makes such a training, for variants.train_and_measure."""
    return functools.partial(
        ObjectiveTraining,
        source=source,
        reflectance_map=reflectance_map,
        of_luminance=of_luminance,
    )


def without_reflectance_map(network: Coded) -> Coded:
    """Return a compact network whose heads see zeros in place of the reflectance map's features.

    Its weights have the same names and shapes, so that it can begin from a network with the map.
    """
    assert isinstance(network, Compact)  # as require_all_terms has checked
    network.reflectance.register_forward_hook(_zeros)
    return network


def _zeros(_: torch.nn.Module, __: Any, output: torch.Tensor) -> torch.Tensor:
    return torch.zeros_like(output)


def require_all_terms(run: Run, where: str | Path) -> None:
    """Raise InputError for a run from which a variant of objective_ablation cannot be made."""
    of_run = run.losses
    network = weights.NETWORKS[run.network]
    problems = [
        (issubclass(network, Compact), "network", "a compact one", run.network),
        (
            set(run.parts) == set(weights.PARTS),
            "parts",
            "normals, material and light",
            ", ".join(run.parts),
        ),
        (bool(of_run.image or of_run.image_features), "losses.image", "a weight above 0", "0"),
        (bool(of_run.target or of_run.target_features), "losses.target", "a weight above 0", "0"),
        (run.data.regions == 1, "data.regions", "one region", str(run.data.regions)),
    ]
    for fine, key, rule, result in problems:
        if not fine:
            raise InputError(f"{where}: {key}", rule, result, "take the preset general-compact")


def glossy(data_splits: Mapping[str, DataSplit]) -> dict[str, DataSplit]:
    """Return splits with materials of visible lobes that are narrower than texels alone.

    Raises InputError for a split without one.
    """
    result = {}
    for side, split in data_splits.items():
        labels = {
            name: label
            for name, label in split.labels.items()
            if method_for(torch.from_numpy(label)) == "quadrature"
        }
        if not labels:
            rule = f"materials with narrow lobes on the side {side}"
            raise InputError("--glossy", rule, "none", "leave it out, or take other materials")
        result[side] = replace(split, labels=labels)
    return result


def tests(
    data_splits: dict[str, DataSplit],
    run: Run,
    size: int,
    batches: int,
    policy: predictions.Policy = predictions.VALIDATION,
) -> list[ExampleBatch]:
    """Return batches of the test split with true pictures I and O.

    Each picture has a material and a light of its own.

    policy  by which O is rendered; I is by the run's data
    """
    data = msgspec.structs.replace(run.data, sharing=1)
    return [
        replace(batch, target=_render_truth(batch, policy))
        for batch in variants.held_out_batches(data_splits, data, size, batches)
    ]


def _render_truth(batch: ExampleBatch, policy: predictions.Policy) -> torch.Tensor:
    """Return the true O (B, 3, H, W)."""
    truth = validation.render_batch(batch.n, batch.target_label, batch.light, batch, policy)
    return torch.from_numpy(truth).movedim(-1, 1)


def rows(
    training: loop.Training | None,
    network: Coded,
    batch: ExampleBatch,
    policy: predictions.Policy = predictions.VALIDATION,
) -> Iterator[variants.Row]:
    """Yield the figures of each picture of a batch of `tests`, with everything predicted.

    policy  by which predicted parts are rendered
    """
    with torch.no_grad():
        prediction = network(batch.image, batch.mask, None, weights.PARTS)
    n, label, light = (
        require_part(part) for part in (prediction.n, prediction.label, prediction.light)
    )
    angle = (n * batch.n).sum(1).clamp(-1, 1).arccos().rad2deg()
    true_label, target = batch.label, batch.target_label
    figures = {
        "angle_deg": validation.masked_means(angle, batch.segments > 0),
        "albedo": validation.albedo_errors(label, batch)["albedo"],
        "irradiance": irradiance_error(light, batch.light).double().numpy(),
        "image_l2": validation.compare_renderings(
            n, label, light, true_label, batch, batch.picture, policy
        ),
        "target_l2": validation.compare_renderings(
            n, target, light, target, batch, batch.target, policy
        ),
    }
    for i, name in enumerate(batch.names):
        shape, material = shape_and_material(name)
        own = {key: float(value[i]) for key, value in figures.items()}
        yield {"shape": shape, "material": material} | own


def as_given(
    path: Path,
    tested: list[ExampleBatch],
    policy: predictions.Policy = predictions.VALIDATION,
) -> variants.Result:
    """Return the result of weights without a step of training. Raises InputError."""
    network, _ = weights.load_full_network(path)
    of_tests = [row for batch in tested for row in rows(None, network, batch, policy)]
    return {"steps": 0, "seconds": 0.0, "rows": of_tests}
