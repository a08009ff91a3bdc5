"""What a run trains, and how fast, at each step: stage after stage, then the run's own parts and
losses.

The rate starts anew with each stage. compact: AdamW, warm-up, cosine to 0; paper: Adam at rate,
1e-2 rate, 1e-4 rate over thirds.
"""

import math
from dataclasses import dataclass

import torch

THIRDS = ((1.0, 0.9), (1e-2, 0.5), (1e-4, 0.5))  # paper: share of the rate and β₁


@dataclass(frozen=True)
class Phase:
    """Steps first … first + steps − 1 of a run. parts and losses as in learn.data.settings.Run."""

    first: int
    steps: int
    parts: tuple
    losses: object


def phases(run):
    """All of a run's, in order; the last is its own."""
    result, first = [], 0
    for stage in run.stages:
        result.append(Phase(first, stage.steps, stage.parts, stage.losses))
        first += stage.steps
    return [*result, Phase(first, run.schedule.steps, run.parts, run.losses)]


def steps(run):
    """Of all stages together."""
    return sum(phase.steps for phase in phases(run))


def phase_at(run, step):
    """The Phase that a step belongs to."""
    return next(phase for phase in reversed(phases(run)) if step >= phase.first)


def learning_rate(run, phase, step, done):
    """(step size, β₁) at a step of a phase of which a share `done` is over."""
    if run.schedule.style == "paper":
        share, beta = THIRDS[min(int(3 * done), 2)]
    else:
        warm = min(1.0, (step - phase.first + 1) / max(run.schedule.warm_up, 1))
        share, beta = warm * (0.5 + 0.5 * math.cos(math.pi * min(done, 1.0))) + 1e-3, 0.9
    return share * run.schedule.learning_rate, beta


def optimiser(network, schedule):
    """Adam or AdamW, at a rate that is set anew before each step."""
    if schedule.style == "paper":
        return torch.optim.Adam(network.parameters(), schedule.learning_rate)
    return torch.optim.AdamW(
        network.parameters(), schedule.learning_rate, weight_decay=schedule.weight_decay
    )


def follow(average, network, step, memory):
    """The moving average {name: tensor} takes a step towards the weights; it hurries at first, so
    that the start is soon forgotten.
    """
    share = 1 - min(memory, (1 + step) / (10 + step))
    with torch.no_grad():
        for name, tensor in network.state_dict().items():
            if tensor.is_floating_point():
                average[name].lerp_(tensor, share)
            else:
                average[name].copy_(tensor)
