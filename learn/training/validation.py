"""How good a prediction is, in figures that mean something outside the loss.

angle_deg, cosine     between predicted and true normals, means over mask pixels
irradiance            relative root mean square error over directions, mean over pictures;
constant_irradiance: of a constant light
image_l2, target_l2   the paper's display L2 over the mask, of I' against I and of O' against O;
exposure from the truth's 99th percentile;
                      truth is a rendered picture where the batch has one, else what the layer makes
                      of the true parts
control_l2            of O' from predicted normals under a constant light
albedo                root mean square over channels of the log albedo's difference
(learn.training.losses.log_albedo); of several regions
                      albedo_1, albedo_2 …, over pictures that show them; constant_albedo: of the
                      mean log albedo of a pool's materials
"""

import math

import numpy as np
import torch

from learn.data.devices import array
from learn.data.sources import source_of
from learn.layer import predictions
from learn.metrics.pictures import display_l2
from learn.metrics.radiometry import irradiance, log_albedo

LEAST_PIXELS = 16  # of a region, to count as shown


def over(predict, data_split, run, batches, seed=20, device="cpu"):
    """Means over the first batches of a pool. predict: Batch → Prediction, both on the device."""
    source, constant = source_of(data_split, run, run.schedule.batch, seed), mean_albedo(data_split)
    results = [
        of(predict(batch), batch, constant)
        for batch in (source[k].to(device) for k in range(batches))
    ]
    return {name: _mean(np.concatenate([f[name] for f in results])) for name in results[0]}


def _mean(values):
    """Of the values that are there."""
    there = np.isfinite(values)
    return float(values[there].mean()) if there.any() else math.nan


def mean_albedo(data_split):
    """(3,) mean log albedo of a pool's materials: the best guess without looking."""
    return log_albedo(torch.from_numpy(np.stack(list(data_split.labels.values())))).mean(0)


def of(prediction, batch, constant_albedo=None):
    """{name: (B,) float64} of one batch; NaN where a picture does not show what is measured.
    constant_albedo (3,): the control's.
    """
    result = {}
    n = batch.n if prediction.n is None else prediction.n
    light = batch.light if prediction.light is None else prediction.light
    if prediction.n is not None:
        cosine = (n * batch.n).sum(1).clamp(-1, 1)
        inside = batch.segments > 0
        result["cosine"] = means(cosine, inside)
        result["angle_deg"] = means(cosine.arccos().rad2deg(), inside)
    constant = torch.ones_like(batch.light)
    if prediction.light is not None:
        truth = irradiance(batch.light)
        for name, value in (("irradiance", light), ("constant_irradiance", constant)):
            error = ((irradiance(value) - truth) ** 2).mean((1, 2)).sqrt() / (truth**2).mean(
                (1, 2)
            ).sqrt()
            result[name] = array(error.double())
    if prediction.label is not None:
        result |= albedos(prediction.label, batch, constant_albedo)
        result["image_l2"] = compared(n, prediction.label, light, batch.label, batch, batch.picture)
    result["target_l2"] = compared(
        n, batch.target_label, light, batch.target_label, batch, batch.target
    )
    if prediction.light is not None:
        result["control_l2"] = compared(
            n, batch.target_label, constant, batch.target_label, batch, batch.target
        )
    return result


def albedos(label, batch, constant=None):
    """{name: (B,)} of albedo's errors, and of the control's where there is one; label (B, S,
    108).
    """
    result, regions = {}, label.shape[1]
    true = log_albedo(batch.label[:, :regions])
    guesses = {"albedo": log_albedo(label)} | (
        {} if constant is None else {"constant_albedo": constant.to(true.device).expand_as(true)}
    )
    for s in range(regions):
        shown = (batch.segments == s + 1).sum((1, 2)) >= LEAST_PIXELS
        for name, guess in guesses.items():
            error = ((guess - true)[:, s] ** 2).mean(-1).sqrt()
            result[f"{name}_{s + 1}" if regions > 1 else name] = array(
                error.where(shown, math.nan).double()
            )
    return result


class DeadUnits:
    """While entered, watches which channels of a network's activations are ever above 0; one that
    never is learns no more.
    """

    def __init__(self, network):
        self.alive, self.hooks = {}, []
        self.layers = [
            (name, layer)
            for name, layer in network.named_modules()
            if isinstance(layer, torch.nn.ReLU)
        ]

    def __enter__(self):
        self.hooks = [layer.register_forward_hook(self._watch(name)) for name, layer in self.layers]
        return self

    def __exit__(self, *_):
        for hook in self.hooks:
            hook.remove()

    def _watch(self, name):
        def hook(_, __, output):
            channels = output.detach().movedim(1, 0).flatten(1).amax(1) > 0
            self.alive[name] = self.alive.get(name, False) | channels

        return hook

    def figures(self):
        """{"dead_units": share of all channels}; {} before anything was predicted."""
        channels = torch.cat(list(self.alive.values())) if self.alive else torch.zeros(0)
        return {"dead_units": 1 - channels.float().mean().item()} if len(channels) else {}


def compared(n, label, light, true_label, batch, rendered=None):
    """(B,) display L2 over the mask between the layer's picture of what was predicted and the
    truth.

    rendered  (B, 3, H, W) the true pictures; None: what the layer makes of the true parts
    """
    inside = batch.segments > 0
    mine = picture(n, label, light, batch)
    truth = (
        picture(batch.n, true_label, batch.light, batch)
        if rendered is None
        else array(rendered.movedim(1, -1))
    )
    out = []
    for a, b, mask in zip(mine, truth, array(inside), strict=True):
        out.append(display_l2(a, b, mask))
    return np.array(out)


def picture(n, label, light, batch):
    """(B, H, W, 3) numpy radiance by the policy learn.layer.predictions.VALIDATION."""
    policy = predictions.VALIDATION
    return array(predictions.picture(n, label, light, batch.segments, batch.elevation, policy))


def means(values, inside):
    return array(((values * inside).sum((1, 2)) / inside.sum((1, 2))).double())
