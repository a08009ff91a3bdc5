"""A program's first use of the layer, timed from inside a fresh process (cold_start).

It is run as `python -m learn.experiments.layer.first_use CASE THREADS` and prints one line of JSON,
in seconds by the clock: import (what `learn.layer` adds to torch), picture (the first), derivatives
(the first picture with them), and both once more. The picture is a sphere over 40 % of 256 × 256
pixels under a light of 64 × 128 texels, with lobes from matte to sharp.
"""

from __future__ import annotations

import json
import math
import sys
import time

import torch

SIZE, COVER, LIGHT = 256, 0.4, (64, 128)


def scene(
    view_per_pixel: bool,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor | None]:
    """Return n (1, SIZE, SIZE, 3), material (1, 108), light (1, *LIGHT, 3) and view, or None.

    It is made here and not by chart_cases, because what that imports would count
    as the layer's own.
    """
    place = torch.arange(SIZE) - (SIZE - 1) / 2
    y, x = torch.meshgrid(place, place, indexing="ij")
    radius = SIZE * math.sqrt(COVER / math.pi)
    z = (1 - (x * x + y * y) / radius**2).clamp(min=0).sqrt()
    n = torch.where(z[..., None] > 0, torch.stack([x / radius, -y / radius, z], -1), 0)
    m = torch.tensor([[0.3, 0.5], [0.2, 30.0], [1.0, 1000.0]])[:, :, None].expand(3, 3, 2, 6)
    light = 0.2 + torch.rand(1, *LIGHT, 3, generator=torch.Generator().manual_seed(0))
    view = (
        torch.stack([0.0005 * x, -0.0005 * y, torch.ones_like(x)], -1) if view_per_pixel else None
    )
    return (
        n[None],
        m.reshape(1, 108),
        light,
        None if view is None else torch.nn.functional.normalize(view, dim=-1)[None],
    )


def main(case: str, threads: int) -> None:
    """Print the seconds of each part."""
    torch.set_num_threads(threads)
    method, _, view_per_pixel = case.partition(", ")
    start = time.perf_counter()
    from learn.layer import render

    result = {"import": time.perf_counter() - start}
    n, material, light, view = scene(bool(view_per_pixel))

    def picture() -> None:
        render(n, material, light, view, method=method)

    def derivatives() -> None:
        leaves = n_leaf, m, L = [a.clone().requires_grad_() for a in (n, material, light)]
        torch.autograd.grad(render(n_leaf, m, L, view, method=method).sum(), leaves)

    for name, work in (
        ("picture", picture),
        ("derivatives", derivatives),
        ("later picture", picture),
        ("later derivatives", derivatives),
    ):
        start = time.perf_counter()
        work()
        result[name] = time.perf_counter() - start
    print(json.dumps(result))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
