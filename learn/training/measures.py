"""How good a prediction is, in figures that mean something outside the loss.

angle_deg, cosine     between predicted and true normals, means over mask pixels
irradiance            relative root mean square error over directions, mean over pictures; constant_irradiance: of a constant light
image_l2, target_l2   the paper's display L2 over the mask, of I' against I and of O' against O; exposure from the truth's 99th percentile
control_l2            of O' from predicted normals under a constant light
code_l2               mean squared difference of material codes
"""

import numpy as np
import torch

from learn.layer import render
from learn.training.losses import log_rendered
from learn.training.relit import Relit
from shaders import tone

TOLERANCE = 2e-2


def over(predict, pool, run, batches, seed=20):
    """Means over the first batches of a pool. predict: Batch → Prediction."""
    data = run.data
    source = Relit(pool, data, run.schedule.batch, run.size, seed)
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
        found["cosine"] = _means(cosine, inside)
        found["angle_deg"] = _means(cosine.arccos().rad2deg(), inside)
    constant = torch.ones_like(batch.light)
    if prediction.light is not None:
        truth = irradiance(batch.light)
        for name, value in (("irradiance", light), ("constant_irradiance", constant)):
            error = ((irradiance(value) - truth) ** 2).mean((1, 2)).sqrt() / (truth**2).mean((1, 2)).sqrt()
            found[name] = error.double().numpy()
    if prediction.label is not None:
        found["image_l2"] = compared(n, prediction.label, light, batch.label, batch)
    found["target_l2"] = compared(n, batch.target_label, light, batch.target_label, batch)
    if prediction.light is not None:
        found["control_l2"] = compared(n, batch.target_label, constant, batch.target_label, batch)
    return found


def irradiance(light):
    """(B, 3, D) radiance leaving white matte surfaces that face D directions."""
    values = log_rendered(light).exp() - 0.05
    return values[..., : values.shape[-1] // 3]


def compared(n, label, light, true_label, batch):
    """(B,) display L2 over the mask between the layer's picture of what was predicted and of what is true."""
    inside = batch.segments > 0
    mine = picture(n, label, light, batch)
    truth = picture(batch.n, true_label, batch.light, batch)
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


def _means(values, inside):
    return ((values * inside).sum((1, 2)) / inside.sum((1, 2))).double().numpy()
