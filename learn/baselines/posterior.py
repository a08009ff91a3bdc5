"""After Lombardi and Nishino [13], as Section 4.5 uses them: normals given, material and light by
the maximum of a posterior.

    −log p(z_m, z_L | I) = P/(2 σ²) · mean (c(I') − c(I))² + ½ Σ z_m² + ½ Σ z_L²

c as in learn.networks.coding.compressed, σ = priors.NOISE; P pixels count as PIXELS, for neighbours
are no independent evidence. z_m are the material's coordinates (S, K), z_L the light's (J, 3); the
picture I' is the layer's under a coarse map. The first start is the mean light with the typical
training material that fits best; then L-BFGS with strong Wolfe conditions, under 16×32 lights, then
32×64.

Theirs has priors of its own making (the paper does not repeat them): ours are
learn.baselines.priors'.
"""

from dataclasses import dataclass

import torch

from learn.baselines import priors as fitted
from learn.layer import predictions
from learn.networks.coding import compressed
from learn.networks.prediction import Prediction

PIXELS = 192
# size of the light's map, evaluations at most: 5 s of one thread together
STAGES = (((16, 32), 40), ((32, 64), 30))


@dataclass(frozen=True)
class Estimate:
    """label (1, S, 108) float32, light (1, 3, 64, 128) float32; energies at the start and the end,
    by the finest stage.
    """

    label: torch.Tensor
    light: torch.Tensor
    before: float
    after: float


class Posterior:
    """The energy of one picture. batch: learn.data.batch.ExampleBatch of one, whose n is taken as true."""

    def __init__(self, batch, priors):
        self.batch, self.priors = batch, priors
        self.regions = batch.label.shape[1]
        inside = ((batch.segments[0] > 0) & (batch.mask[0, 0] > 0)).flatten().nonzero()[:, 0]
        self.where = inside[
            torch.linspace(0, len(inside) - 1, min(PIXELS, len(inside))).long().to(inside.device)
        ]
        self.n = batch.n[0].flatten(1).T[self.where][None, None]
        self.segments = batch.segments[0].flatten()[self.where][None, None]
        self.seen = compressed(batch.image[0].flatten(1).T[self.where])

    def energy(self, z_m, z_L, size):
        """A scalar; z_m (S, K), z_L (J, 3), float64."""
        label, light = self.priors.label(z_m).float()[None], self.priors.light(z_L.float(), *size)
        picture = predictions.radiance(
            self.n,
            label,
            light,
            self.segments,
            torch.ones_like(self.segments, dtype=torch.bool),
            self.batch.elevation,
            predictions.PIXEL_LOSS,
        )
        fit = ((compressed(picture[0, 0]) - self.seen) ** 2).mean().double()
        return PIXELS * fit / (2 * fitted.NOISE**2) + 0.5 * (z_m**2).sum() + 0.5 * (z_L**2).sum()

    def start(self):
        """z_m (S, K), z_L (J, 3): the mean light, and the typical material of least energy, the
        same for all regions.
        """
        z_L = torch.zeros_like(self.priors.light_mean)
        candidates = [torch.zeros_like(self.priors.medoids[0]), *self.priors.medoids]
        size = STAGES[0][0]
        with torch.no_grad():
            energies = [
                float(self.energy(z.expand(self.regions, -1), z_L, size)) for z in candidates
            ]
        best = candidates[min(range(len(energies)), key=energies.__getitem__)]
        return best.expand(self.regions, -1).clone(), z_L


def estimate(batch, priors):
    """The Estimate of a batch of one. It never ends above its start: the best point met is kept, by
    the finest stage's energy.
    """
    posterior = Posterior(batch, priors)
    point = first = posterior.start()
    for size, evaluations in STAGES:
        point = lowered(posterior, point, size, evaluations)
    with torch.no_grad():
        before, after = (float(posterior.energy(*z, STAGES[-1][0])) for z in (first, point))
        if not after <= before:  # so asked, NaN is refused too
            point, after = first, before
        label, light = priors.label(point[0]).float()[None], priors.light(point[1], 64, 128).float()
    return Estimate(label, light, before, after)


def lowered(posterior, point, size, evaluations):
    """The best point (z_m, z_L) that L-BFGS meets from `point` on, within so many evaluations."""
    z = [part.clone().requires_grad_() for part in point]
    optimiser = torch.optim.LBFGS(
        z,
        max_iter=evaluations,
        max_eval=evaluations,
        history_size=20,
        line_search_fn="strong_wolfe",
    )
    best = [float("inf"), point]

    def closure():
        optimiser.zero_grad()
        energy = posterior.energy(*z, size)
        energy.backward()
        if energy.item() < best[0]:
            best[:] = energy.item(), tuple(part.detach().clone() for part in z)
        return energy

    optimiser.step(closure)
    return best[1]


def prediction(batch, priors):
    """The Prediction of a batch of one: normals as given, the estimate's material and light."""
    result = estimate(batch, priors)
    return Prediction(batch.n, None, result.label, None, result.light)
