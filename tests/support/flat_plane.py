"""A plane that faces the viewer, as a batch and the state that refinement begins with."""

import math

import torch

from learn.data.batch import ExampleBatch
from learn.refinement.energy import State

SIZE = 8


def flat():
    """A batch whose picture is 1 on all but the first row, and a State: a plane that faces the
    viewer, light with log(1 + L) = 1.
    """
    inside = torch.ones(1, SIZE, SIZE, dtype=torch.bool)
    inside[:, 0] = False
    n, light = torch.zeros(1, 3, SIZE, SIZE), torch.full((1, 3, 64, 128), math.e - 1)
    n[:, 2] = 1
    label = torch.zeros(1, 1, 108)
    batch = ExampleBatch(
        torch.ones(1, 3, SIZE, SIZE),
        inside[:, None].float(),
        n,
        inside.long(),
        label,
        light,
        label,
        ("plane",),
        0.349,
    )
    return batch, State(label.double(), light, n, {"material": torch.zeros(1, 3)})
