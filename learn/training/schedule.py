"""What a run trains, and at which learning rate, at each step.

A run goes through its stages, then through its own parts and losses; each of these phases has the
whole course of the learning rate. compact: AdamW, warm-up, cosine down to 0; paper: Adam at
learning_rate, 1e-2 and 1e-4 of it over thirds.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch

from learn.data.settings import Losses, Run, Schedule

THIRDS = ((1.0, 0.9), (1e-2, 0.5), (1e-4, 0.5))  # paper: share of the learning rate and β₁


@dataclass(frozen=True)
class Phase:
    """Steps first … first + steps − 1 of a run. parts and losses as in learn.data.settings.Run."""

    first: int
    steps: int
    parts: tuple[str, ...]
    losses: Losses


def phases(run: Run) -> list[Phase]:
    """Return all phases of a run in order; the last one is its own after the stages."""
    result, first = [], 0
    for stage in run.stages:
        result.append(Phase(first, stage.steps, stage.parts, stage.losses))
        first += stage.steps
    return [*result, Phase(first, run.schedule.steps, run.parts, run.losses)]


def total_steps(run: Run) -> int:
    """Return the number of steps of all phases together."""
    return sum(phase.steps for phase in phases(run))


def phase_at(run: Run, step: int) -> Phase:
    """Return the Phase that a step belongs to."""
    return next(phase for phase in reversed(phases(run)) if step >= phase.first)


def learning_rate(run: Run, phase: Phase, step: int, done: float) -> tuple[float, float]:
    """Return (learning rate, β₁) at a step of a phase of which the share `done` is over."""
    if run.schedule.style == "paper":
        share, beta = THIRDS[min(int(3 * done), 2)]
    else:
        warm = min(1.0, (step - phase.first + 1) / max(run.schedule.warm_up, 1))
        share, beta = warm * (0.5 + 0.5 * math.cos(math.pi * min(done, 1.0))) + 1e-3, 0.9
    return share * run.schedule.learning_rate, beta


def make_optimiser(network: torch.nn.Module, schedule: Schedule) -> torch.optim.Optimizer:
    """Return Adam or AdamW, whose learning rates `set_learning_rate` sets before each step.

    On a GPU one launch updates many weights.
    """
    fused = next(network.parameters()).is_cuda or None
    if schedule.style == "paper":
        groups = _groups(network, schedule)
        return torch.optim.Adam(groups, schedule.learning_rate, fused=fused)
    return torch.optim.AdamW(
        _groups(network, schedule),
        schedule.learning_rate,
        weight_decay=schedule.weight_decay,
        fused=fused,
    )


def _groups(network: torch.nn.Module, schedule: Schedule) -> list[dict[str, Any]]:
    """Return the parameters, those of fully connected layers apart if they have their own rate."""
    share = schedule.fully_connected
    if share == 1.0:
        return [{"params": list(network.parameters())}]
    connected = {
        parameter
        for module in network.modules()
        if isinstance(module, torch.nn.Linear)
        for parameter in module.parameters()
    }
    return [
        {"params": [each for each in network.parameters() if each not in connected]},
        {"params": [each for each in network.parameters() if each in connected], "share": share},
    ]


def set_learning_rate(optimiser: torch.optim.Optimizer, learning_rate: float, beta: float) -> None:
    """Set the learning rate and β₁ of all parameters, of each group by its share."""
    for group in optimiser.param_groups:
        group["lr"] = learning_rate * group.get("share", 1.0)
        group["betas"] = (beta, group["betas"][1])


def update_average(
    average: Mapping[str, torch.Tensor], network: torch.nn.Module, step: int, ema_decay: float
) -> None:
    """Move the exponential moving average {name: tensor} towards the network's weights.

    It moves faster in the first steps, so that the initial weights soon no longer count.
    """
    share = 1 - min(ema_decay, (1 + step) / (10 + step))
    moved, towards = [], []
    with torch.no_grad():
        for name, tensor in network.state_dict().items():
            if tensor.is_floating_point():
                moved.append(average[name])
                towards.append(tensor)
            else:
                average[name].copy_(tensor)
        # as Tensor.lerp_ of each, but a GPU gets a few launches instead of hundreds
        torch._foreach_lerp_(moved, towards, share)
