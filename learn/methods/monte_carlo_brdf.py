"""Monte Carlo with samples drawn by the BRDF alone: noisy under a small sun.

The estimator is in learn/methods/sampling.py.
"""

import torch

from learn.methods import HELD_SAMPLES, Batch, Card, forbid_second_derivatives, sampling

CARD = Card(
    name="monte_carlo_brdf",
    approximates="the integral by random samples of the BRDF",
    error=None,  # noise has no bound
    cost="pixels × samples; the error falls as 1/√samples",
    memory="below 64 MiB: chunks of pixels",
)


def radiance(batch: Batch, tolerance: float) -> torch.Tensor:
    """Return outgoing radiance (P, 3) of a batch."""
    return sampling.radiance_by_samples(
        forbid_second_derivatives(batch, CARD.name, HELD_SAMPLES),
        0,
        sampling.sample_count(tolerance),
    )
