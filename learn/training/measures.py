"""How good a prediction is, in figures that mean something outside the loss.

angle_deg, cosine     between predicted and true normals, means over mask pixels
irradiance            relative root mean square error over directions, mean over pictures; constant_irradiance: of a constant light
image_l2, target_l2   the paper's display L2 over the mask, of I' against I and of O' against O; exposure from the truth's 99th percentile;
                      truth is a rendered picture where the batch has one, else what the layer makes of the true parts
control_l2            of O' from predicted normals under a constant light
code_l2               mean squared difference of material codes
"""

import numpy as np
import torch

from learn.layer import render
from learn.training.losses import log_rendered
from learn.training.sources import source_of
from shaders import tone

TOLERANCE = 2e-2


def over(predict, pool, run, batches, seed=20):
    """Means over the first batches of a pool. predict: Batch → Prediction."""
    source = source_of(pool, run, run.schedule.batch, seed)
    found = [of(predict(batch), batch) for batch in (source[k] for k in range(batches))]
    return {name: float(np.mean(np.concatenate([f[name] for f in found]))) for name in found[0]}


def of(prediction, batch):
    """{name: (B,) float64} of one batch."""
    found = {}
    n = batch.n if prediction.n is None else prediction.n
    light = batch.light if prediction.light is None else prediction.light
    if prediction.n is not None:
        cosine = (n * batch.n).sum(1).clamp(-1, 1)
        inside = batch.segments > 0
        found["cosine"] = means(cosine, inside)
        found["angle_deg"] = means(cosine.arccos().rad2deg(), inside)
    constant = torch.ones_like(batch.light)
    if prediction.light is not None:
        truth = irradiance(batch.light)
        for name, value in (("irradiance", light), ("constant_irradiance", constant)):
            error = ((irradiance(value) - truth) ** 2).mean((1, 2)).sqrt() / (truth**2).mean((1, 2)).sqrt()
            found[name] = error.double().numpy()
    if prediction.label is not None:
        found["image_l2"] = compared(n, prediction.label, light, batch.label, batch, batch.picture)
    found["target_l2"] = compared(n, batch.target_label, light, batch.target_label, batch, batch.target)
    if prediction.light is not None:
        found["control_l2"] = compared(n, batch.target_label, constant, batch.target_label, batch, batch.target)
    return found


class DeadUnits:
    """While entered, watches which channels of a network's activations are ever above 0; one that never is learns no more."""

    def __init__(self, network):
        self.alive, self.hooks = {}, []
        self.layers = [(name, layer) for name, layer in network.named_modules() if isinstance(layer, torch.nn.ReLU)]

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


def irradiance(light):
    """(B, 3, D) radiance leaving white matte surfaces that face D directions."""
    values = log_rendered(light).exp() - 0.05
    return values[..., : values.shape[-1] // 3]


def compared(n, label, light, true_label, batch, rendered=None):
    """(B,) display L2 over the mask between the layer's picture of what was predicted and the truth.

    rendered  (B, 3, H, W) the true pictures; None: what the layer makes of the true parts
    """
    inside = batch.segments > 0
    mine = picture(n, label, light, batch)
    truth = picture(batch.n, true_label, batch.light, batch) if rendered is None else rendered.movedim(1, -1).numpy()
    out = []
    for a, b, mask in zip(mine, truth, inside.numpy(), strict=True):
        out.append(tone.display_l2(a, b, tone.auto_exposure(b, mask), mask))
    return np.array(out)


def picture(n, label, light, batch):
    """(B, H, W, 3) numpy radiance by the layer."""
    several = label.shape[1] > 1
    with torch.no_grad():
        material = label.exp() if several else label[:, 0].exp()
        radiance = render(
            n.movedim(1, -1).contiguous(),
            material,
            light.movedim(1, -1).contiguous(),
            segments=batch.segments if several else None,
            mask=batch.segments > 0,
            method="hybrid",
            tolerance=TOLERANCE,
            elevation=batch.elevation,
        )
    return radiance.numpy()


def means(values, inside):
    return ((values * inside).sum((1, 2)) / inside.sum((1, 2))).double().numpy()
