"""Monte Carlo with multiple importance sampling: half the samples by the light, half by the BRDF.

The estimator is in learn/methods/sampling.py.
"""

import torch

from learn.methods import HELD_SAMPLES, Batch, Card, forbid_second_derivatives, sampling

CARD = Card(
    name="monte_carlo",
    approximates=(
        "the integral by random samples of light and BRDF, weighed by the balance heuristic"
    ),
    error=None,  # noise has no bound
    cost="pixels × samples; the error falls as 1/√samples",
    memory="below 64 MiB: chunks of pixels",
)


def radiance(batch: Batch, tolerance: float) -> torch.Tensor:
    """Return outgoing radiance (P, 3) of a batch."""
    half = sampling.sample_count(tolerance) // 2
    return sampling.radiance_by_samples(
        forbid_second_derivatives(batch, CARD.name, HELD_SAMPLES), half, half
    )
