"""The method of Lombardi and Nishino [13] as Section 4.5 uses it: a maximum of a posterior.

Normals are given; material and light are estimated.

    −log p(z_m, z_L | I) = P/(2 σ²) · mean (c(I') − c(I))² + ½ Σ z_m² + ½ Σ z_L²

c is learn.networks.coding.compress, σ = priors.NOISE; P pixels count as PIXELS, for neighbours
are no independent evidence. z_m are the material's coordinates (S, K), z_L the light's (J, 3); the
picture I' is the layer's under a coarse map. The initialisation is the mean light with the typical
training material that fits best. Then L-BFGS with strong Wolfe conditions follows, under 16×32
lights and then 32×64.

Theirs has priors of its own (the paper does not repeat them); ours are learn.baselines.priors'.
"""

from dataclasses import dataclass

import torch

from learn.baselines import priors as fitted
from learn.baselines.priors import Priors
from learn.data.batch import ExampleBatch
from learn.layer import predictions
from learn.networks.coding import compress
from learn.networks.prediction import Prediction

PIXELS = 192
# (size of the light's map, most evaluations); 5 s of one thread together
STAGES: tuple[tuple[tuple[int, int], int], ...] = (((16, 32), 40), ((32, 64), 30))


@dataclass(frozen=True)
class Estimate:
    """An estimate: label (1, S, 108) float32, light (1, 3, 64, 128) float32.

    before, after  energies at the start and the end, by the finest stage
    """

    label: torch.Tensor
    light: torch.Tensor
    before: float
    after: float


class Posterior:
    """The energy of one picture. batch: of one, whose n is assumed to be true."""

    def __init__(self, batch: ExampleBatch, priors: Priors):
        self.batch, self.priors = batch, priors
        self.regions = batch.label.shape[1]
        inside = ((batch.segments[0] > 0) & (batch.mask[0, 0] > 0)).flatten().nonzero()[:, 0]
        self.where = inside[
            torch.linspace(0, len(inside) - 1, min(PIXELS, len(inside))).long().to(inside.device)
        ]
        self.n = batch.n[0].flatten(1).T[self.where][None, None]
        self.segments = batch.segments[0].flatten()[self.where][None, None]
        self.seen = compress(batch.image[0].flatten(1).T[self.where])

    def energy(self, z_m: torch.Tensor, z_L: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
        """Return the energy, a scalar; z_m (S, K), z_L (J, 3), float64; size of the light's map."""
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
        fit = ((compress(picture[0, 0]) - self.seen) ** 2).mean().double()
        return PIXELS * fit / (2 * fitted.NOISE**2) + 0.5 * (z_m**2).sum() + 0.5 * (z_L**2).sum()

    def start(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return z_m (S, K) and z_L (J, 3) of the initialisation.

        It is the mean light, and for all regions the typical material of least energy.
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


def estimate(batch: ExampleBatch, priors: Priors) -> Estimate:
    """Return the Estimate of a batch of one.

    Its energy never ends above its start's, by the finest stage.
    """
    posterior = Posterior(batch, priors)
    point = first = posterior.start()
    for size, evaluations in STAGES:
        point = descend_from(posterior, point, size, evaluations)
    with torch.no_grad():
        before, after = (float(posterior.energy(*z, size=STAGES[-1][0])) for z in (first, point))
        if not after <= before:  # in this form NaN is refused too
            point, after = first, before
        label, light = priors.label(point[0]).float()[None], priors.light(point[1], 64, 128).float()
    return Estimate(label, light, before, after)


def descend_from(
    posterior: Posterior,
    point: tuple[torch.Tensor, torch.Tensor],
    size: tuple[int, int],
    evaluations: int,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the best point (z_m, z_L) that L-BFGS meets from `point`.

    evaluations  most of them
    """
    z = [part.clone().requires_grad_() for part in point]
    optimiser = torch.optim.LBFGS(
        z,
        max_iter=evaluations,
        max_eval=evaluations,
        history_size=20,
        line_search_fn="strong_wolfe",
    )
    least, best = float("inf"), point

    def closure() -> torch.Tensor:
        nonlocal least, best
        optimiser.zero_grad()
        z_m, z_L = z
        energy = posterior.energy(z_m, z_L, size)
        energy.backward()
        if energy.item() < least:
            least, best = energy.item(), (z_m.detach().clone(), z_L.detach().clone())
        return energy

    optimiser.step(closure)
    return best


def predict(batch: ExampleBatch, priors: Priors) -> Prediction:
    """Return the Prediction of a batch of one: normals as given, material and light estimated."""
    result = estimate(batch, priors)
    return Prediction(batch.n, None, result.label, None, result.light)
