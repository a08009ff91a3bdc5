"""One case of second_derivatives, measured in a process of its own.

It is run as `python -m learn.experiments.layer.derivative_timing DTYPE PERSPECTIVE ROUNDS SIZE`,
where PERSPECTIVE is 0 or 1, and prints one line of JSON.
"""

from __future__ import annotations

import itertools
import json
import resource
import statistics
import sys
import time
from typing import Any

import torch

COVER, LIGHT = 34.2 / 96, (64, 128)  # the sphere's radius by the picture's side; texels


def scene(dtype: torch.dtype, perspective: bool, size: int) -> list[torch.Tensor]:
    """Return leaves [n, material, light] for `render`, and a view if perspective."""
    place = torch.arange(size, dtype=torch.float64) - (size - 1) / 2
    y, x = torch.meshgrid(place, place, indexing="ij")
    radius = COVER * size
    z = (1 - (x * x + y * y) / radius**2).clamp(min=0).sqrt()
    n = torch.where(z[..., None] > 0, torch.stack([x / radius, -y / radius, z], -1), 0.0)
    m = torch.tensor([[0.3, 0.5], [0.2, 30.0], [1.0, 1000.0]])[:, :, None].expand(3, 3, 2, 6)
    light = 0.2 + torch.rand(1, *LIGHT, 3, generator=torch.Generator().manual_seed(0))
    tensors = [n[None], m.reshape(1, 108), light]
    if perspective:
        view = torch.stack([-0.003 * x, 0.003 * y, torch.ones_like(x)], -1)
        tensors.append(torch.nn.functional.normalize(view, dim=-1)[None])
    return [a.to(dtype).clone().requires_grad_() for a in tensors]


def one_case(dtype: str, perspective: bool, rounds: int, size: int) -> dict[str, Any]:
    """Return {"pixels": …, what: seconds, "memory": [first, second]}, measured in this process."""
    from learn.layer import render

    torch.set_num_threads(1)
    leaves = scene(getattr(torch, dtype), perspective, size)
    n, m, light = leaves[:3]
    view = leaves[3] if perspective else None
    g = torch.linspace(-1, 1, n.numel(), dtype=n.dtype).reshape(n.shape)
    inside = (n != 0).any(-1)

    def seconds_of_passes(mask: torch.Tensor, twice: bool = True) -> dict[str, float]:
        clock, seconds = time.process_time, {}
        start = clock()
        seen = render(n, m, light, view, mask=mask, method="exact")
        seconds["forward"] = clock() - start
        start = clock()
        torch.autograd.grad(seen, leaves, g, retain_graph=True)
        seconds["backward"] = clock() - start
        if twice:
            start = clock()
            first = torch.autograd.grad(seen, leaves, g, create_graph=True)
            seconds["kept"] = clock() - start
            start = clock()
            torch.autograd.grad(first, leaves, [x.detach() for x in first])
            seconds["second"] = clock() - start
        return seconds

    one = torch.zeros_like(inside)
    one[0, size // 2, size // 2] = True
    seconds_of_passes(one)  # kernels compiled and loaded, tables of the map made
    memory = [peak()]
    for twice in (False, True):
        results = [seconds_of_passes(inside, twice)]
        memory.append(peak())
    results += [seconds_of_passes(inside) for _ in range(rounds - 1)]
    growth = [round(after - before, 1) for before, after in itertools.pairwise(memory)]
    medians = {name: statistics.median(x[name] for x in results) for name in results[0]}
    return {"pixels": int(inside.sum())} | medians | {"memory": growth}


def peak() -> float:
    """Return the most MiB that this process has used."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    dtype, perspective, rounds, size = sys.argv[1:]
    print(json.dumps(one_case(dtype, perspective == "1", int(rounds), int(size))))
