"""How good a prediction is, in figures that mean something outside the loss.

angle_deg, cosine     between predicted and true normals, means over the mask's pixels
irradiance            relative root mean square error over directions, mean over pictures;
                      constant_irradiance: of a constant light
image_l2, target_l2   the paper's display L2 over the mask, of I' against I and of O' against O;
                      exposure from the truth's 99th percentile. The truth is a rendered picture
                      where the batch has one, else what the layer makes of the true parts
control_l2            of O' from predicted normals under a constant light
albedo                root mean square over channels of the log albedo's difference
                      (learn.metrics.radiometry.log_albedo). With several regions
                      albedo_1, albedo_2 …, over pictures that show them; constant_albedo: of the
                      mean log albedo of a split's materials
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from learn.data.batch import ExampleBatch
from learn.data.data_split import DataSplit
from learn.data.devices import to_numpy
from learn.data.settings import Run
from learn.data.sources import make_batch_source
from learn.layer import predictions
from learn.metrics.pictures import display_l2
from learn.metrics.radiometry import irradiance_error, log_albedo
from learn.networks.prediction import Prediction

LEAST_PIXELS = 16  # of a region, to count as shown


def validate(
    predict: Callable[[ExampleBatch], Prediction],
    data_split: DataSplit,
    run: Run,
    batches: int,
    seed: int = 20,
    device: torch.device | str = "cpu",
) -> dict[str, float]:
    """Return {figure: mean} of the module's figures over the first batches of a split.

    predict  of batches on `device`
    batches  number of them
    seed     of the batches, whose pictures do not depend on the run's seed
    """
    source, constant = (
        make_batch_source(data_split, run, run.schedule.batch, seed),
        mean_albedo(data_split),
    )
    results = [
        measure_batch(predict(batch), batch, constant)
        for batch in (source[k].to(device) for k in range(batches))
    ]
    return {name: _mean(np.concatenate([f[name] for f in results])) for name in results[0]}


def is_finite(prediction: Any) -> bool:
    """Return whether all parts that a Prediction has are finite."""
    return all(bool(part.detach().isfinite().all()) for part in prediction if part is not None)


def measure_saturation(prediction: Prediction) -> dict[str, float]:
    """Return shares of outputs that have stopped learning: codes saturated in tanh, dark texels."""
    result = {}
    if prediction.code is not None:
        result["saturated"] = (prediction.code.detach().abs() > 0.99).float().mean().item()
    if prediction.light_code is not None:
        result["dark_texels"] = (prediction.light_code.detach() < 1e-4).float().mean().item()
    return result


def _mean(values: np.ndarray) -> float:
    """Return the mean of the finite values; NaN if there are none."""
    finite = np.isfinite(values)
    return float(values[finite].mean()) if finite.any() else math.nan


def mean_albedo(data_split: DataSplit) -> torch.Tensor:
    """Return the mean log albedo (3,) of a split's materials: the best guess without a picture."""
    return log_albedo(torch.from_numpy(np.stack(list(data_split.labels.values())))).mean(0)


def measure_batch(
    prediction: Prediction, batch: ExampleBatch, constant_albedo: torch.Tensor | None = None
) -> dict[str, np.ndarray]:
    """Return {name: (B,) float64} of one batch.

    A value is NaN where a picture does not show what is measured.

    constant_albedo  (3,) of the control; None: no control
    """
    result: dict[str, np.ndarray] = {}
    n = batch.n if prediction.n is None else prediction.n
    light = batch.light if prediction.light is None else prediction.light
    if prediction.n is not None:
        cosine = (n * batch.n).sum(1).clamp(-1, 1)
        inside = batch.segments > 0
        result["cosine"] = masked_means(cosine, inside)
        result["angle_deg"] = masked_means(cosine.arccos().rad2deg(), inside)
    constant = torch.ones_like(batch.light)
    if prediction.light is not None:
        for name, value in (("irradiance", light), ("constant_irradiance", constant)):
            result[name] = to_numpy(irradiance_error(value, batch.light).double())
    if prediction.label is not None:
        result |= albedo_errors(prediction.label, batch, constant_albedo)
        result["image_l2"] = compare_renderings(
            n, prediction.label, light, batch.label, batch, batch.picture
        )
    result["target_l2"] = compare_renderings(
        n, batch.target_label, light, batch.target_label, batch, batch.target
    )
    if prediction.light is not None:
        result["control_l2"] = compare_renderings(
            n, batch.target_label, constant, batch.target_label, batch, batch.target
        )
    return result


def albedo_errors(
    label: torch.Tensor, batch: ExampleBatch, constant: torch.Tensor | None = None
) -> dict[str, np.ndarray]:
    """Return {name: (B,)} of the errors of albedo, and of the control where there is one.

    label     (B, S, 108) as predicted
    constant  (3,) log albedo of the control
    """
    result: dict[str, np.ndarray] = {}
    regions = label.shape[1]
    true = log_albedo(batch.label[:, :regions])
    guesses = {"albedo": log_albedo(label)} | (
        {} if constant is None else {"constant_albedo": constant.to(true.device).expand_as(true)}
    )
    for s in range(regions):
        shown = (batch.segments == s + 1).sum((1, 2)) >= LEAST_PIXELS
        for name, guess in guesses.items():
            error = ((guess - true)[:, s] ** 2).mean(-1).sqrt()
            result[f"{name}_{s + 1}" if regions > 1 else name] = to_numpy(
                error.where(shown, math.nan).double()
            )
    return result


class DeadUnits:
    """Records, while entered, which channels of a network's activations are ever above 0.

    A channel that never is does not learn any more.
    """

    def __init__(self, network: torch.nn.Module):
        self.alive: dict[str, torch.Tensor] = {}
        self.hooks: list[Any] = []
        self.layers = [
            (name, layer)
            for name, layer in network.named_modules()
            if isinstance(layer, torch.nn.ReLU)
        ]

    def __enter__(self) -> "DeadUnits":
        self.hooks = [layer.register_forward_hook(self._watch(name)) for name, layer in self.layers]
        return self

    def __exit__(self, *_: object) -> None:
        for hook in self.hooks:
            hook.remove()

    def _watch(self, name: str) -> Callable[..., None]:
        def hook(_: Any, __: Any, output: torch.Tensor) -> None:
            channels = output.detach().movedim(1, 0).flatten(1).amax(1) > 0
            self.alive[name] = channels | self.alive.get(name, torch.zeros_like(channels))

        return hook

    def figures(self) -> dict[str, float]:
        """Return {"dead_units": share of all channels}; {} before anything was predicted."""
        channels = torch.cat(list(self.alive.values())) if self.alive else torch.zeros(0)
        return {"dead_units": 1 - channels.float().mean().item()} if len(channels) else {}


def compare_renderings(
    n: torch.Tensor,
    label: torch.Tensor,
    light: torch.Tensor,
    true_label: torch.Tensor,
    batch: ExampleBatch,
    rendered: torch.Tensor | None = None,
    policy: predictions.Policy = predictions.VALIDATION,
) -> np.ndarray:
    """Return the display L2 (B,) over the mask between the layer's picture and the truth.

    n, label, light  predicted, or true where they were not
    rendered         (B, 3, H, W) the true pictures; None: what the layer makes of the true parts
    """
    inside = batch.segments > 0
    predicted = render_batch(n, label, light, batch, policy)
    truth = (
        render_batch(batch.n, true_label, batch.light, batch, policy)
        if rendered is None
        else to_numpy(rendered.movedim(1, -1))
    )
    out = []
    for a, b, mask in zip(predicted, truth, to_numpy(inside), strict=True):
        out.append(display_l2(a, b, mask))
    return np.array(out)


def render_batch(
    n: torch.Tensor,
    label: torch.Tensor,
    light: torch.Tensor,
    batch: ExampleBatch,
    policy: predictions.Policy = predictions.VALIDATION,
) -> np.ndarray:
    """Return radiance (B, H, W, 3) of a batch, channels last, on the CPU."""
    return to_numpy(predictions.picture(n, label, light, batch.segments, batch.elevation, policy))


def masked_means(values: torch.Tensor, inside: torch.Tensor) -> np.ndarray:
    """Return means (B,) of values (B, H, W) over the pixels inside (B, H, W)."""
    return to_numpy(((values * inside).sum((1, 2)) / inside.sum((1, 2))).double())
