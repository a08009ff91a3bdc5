"""Units of fully connected layers that have died: finding and reinitialising them.

A unit behind ReLU that no picture activates has no gradient and learns nothing any more. Where the
learning rate is high for a layer of many inputs, most units of a head can die, and the head is then
much narrower than its layers say. A reinitialised unit gets weights as of a new layer, and
none towards the next layer, so that the network computes what it did before and learns from there.
"""

import math
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import torch
from torch import nn

BATCHES = 6  # by which units are judged


def hidden_layers(network: nn.Module) -> Iterator[tuple[str, nn.Linear, nn.ReLU, nn.Linear]]:
    """Yield each hidden layer: its name, the layer before, its ReLU and the layer after.

    They follow each other in one nn.Sequential; dropout may stand between them.
    """
    for name, module in network.named_modules():
        if isinstance(module, nn.Sequential):
            kept = [
                (f"{name}.{i}", each)
                for i, each in enumerate(module)
                if not isinstance(each, nn.Dropout)
            ]
            for (_, before), ((at, relu), (_, after)) in zip(
                kept, pairwise(kept[1:]), strict=False
            ):
                if (
                    isinstance(before, nn.Linear)
                    and isinstance(relu, nn.ReLU)
                    and isinstance(after, nn.Linear)
                ):
                    yield at, before, relu, after


def revive(
    network: nn.Module, run: Callable[[nn.Module], Any], rng: torch.Generator
) -> dict[str, tuple[int, int]]:
    """Reinitialise the dead units of all hidden layers, in place.

    run      passes pictures through the network, by which units are judged; it is in eval mode
    Returns  {name: (units reinitialised, units)} of each hidden layer
    """
    layers = list(hidden_layers(network))
    alive: dict[str, torch.Tensor] = {}

    def watch(name: str) -> Callable[..., None]:
        def hook(_: nn.Module, __: Any, output: torch.Tensor) -> None:
            active = (output.detach() > 0).flatten(0, -2).any(0)
            alive[name] = active | alive.get(name, torch.zeros_like(active))

        return hook

    hooks = [relu.register_forward_hook(watch(name)) for name, _, relu, _ in layers]
    was_training = network.training
    network.eval()
    with torch.no_grad():
        run(network)
    network.train(was_training)
    for hook in hooks:
        hook.remove()
    result = {}
    for name, before, _, after in layers:
        if name in alive:
            _draw(before, after, ~alive[name], rng)
            result[name] = (int((~alive[name]).sum()), len(alive[name]))
    return result


def _draw(before: nn.Linear, after: nn.Linear, dead: torch.Tensor, rng: torch.Generator) -> None:
    """Give dead units (units,) weights as nn.Linear's own initialisation does, and no effect."""
    bound = 1 / math.sqrt(before.in_features)
    with torch.no_grad():
        for parameter in (before.weight, before.bias):
            drawn = torch.rand(parameter.shape, generator=rng) * 2 - 1
            parameter[dead] = (bound * drawn).to(parameter)[dead]
        after.weight[:, dead] = 0
