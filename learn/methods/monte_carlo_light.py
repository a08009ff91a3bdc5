"""Monte Carlo with samples drawn by the light's energy alone: noisy for sharp lobes.

The estimator is in learn/methods/sampling.py.
"""

import torch

from learn.methods import HELD_SAMPLES, Batch, Card, forbid_second_derivatives, sampling

CARD = Card(
    name="monte_carlo_light",
    approximates="the integral by random samples of the light",
    error=None,  # noise has no bound
    cost="pixels × samples; the error falls as 1/√samples",
    memory="below 64 MiB: chunks of pixels",
)


def radiance(batch: Batch, tolerance: float) -> torch.Tensor:
    """Return outgoing radiance (P, 3) of a batch."""
    if batch.light.requires_grad:  # the samples follow the light, and nothing else
        batch = forbid_second_derivatives(batch, CARD.name, HELD_SAMPLES)
    return sampling.radiance_by_samples(batch, sampling.sample_count(tolerance), 0)
