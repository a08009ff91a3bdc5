"""Conditioning of a label: how far it moves when the measurement is 1 % off.

The measurement is multiplied by exp(ε · smooth noise), different for each draw and channel, and
fitted again from scratch by the same recipe. The noise is smooth, because independent noise per
sample averages out: it is a sum of a few cosines over (θ_h, θ_d), of unit variance.
"""

import numpy as np

from factory.materials import recipe
from shaders import errors
from shaders.samples import Measured, held_out_samples

WAVES = 6


class Noisy:
    """A source whose values are off by a relative `amount` (standard deviation)."""

    def __init__(self, source: Measured, amount: float, rng: np.random.Generator) -> None:
        self.source, self.amount = source, amount
        self.frequency, self.phase = (
            rng.uniform(1, 6, (WAVES, 2)),
            rng.uniform(0, 2 * np.pi, (WAVES, 3)),
        )

    def __call__(self, cos_h: np.ndarray, cos_d: np.ndarray) -> np.ndarray:
        theta_h, theta_d = (
            np.arccos(np.clip(c, 0, 1))[..., None, None] for c in np.broadcast_arrays(cos_h, cos_d)
        )
        waves = np.cos(
            self.frequency[:, :1] * np.sqrt(theta_h) + self.frequency[:, 1:] * theta_d + self.phase
        )
        return self.source(cos_h, cos_d) * np.exp(self.amount * waves.sum(-2) * np.sqrt(2 / WAVES))


def fit_perturbed(
    source: Measured, recipe_: recipe.Recipe, amount: float, draws: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return how labels of noisy copies differ from the label of the clean source.

    Returns  numbers (draws, 3, 3, 2, 6): differences of the logarithms; l1 (draws,): relative L1 of
             the BRDFs, mean of the held-out views
    """
    samples = held_out_samples()
    clean = recipe.fit(source, recipe_).label
    f = errors.label_values(clean, samples)
    labels = [recipe.fit(Noisy(source, amount, rng), recipe_).label for _ in range(draws)]
    l1 = [
        errors.relative_l1(errors.label_values(label, samples), f, samples).mean()
        for label in labels
    ]
    return np.array(labels) - clean, np.array(l1)
