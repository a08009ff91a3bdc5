"""What second derivatives of the exact sum cost beside first ones: `python -m
learn.experiments.second_derivatives OUT.json`.

The picture: a sphere of 3,680 pixels under a light of 64 × 128 texels, lobes from matte to sharp;
derivatives by n, material, light and view. Both cameras, in float32 (the kernels) and float64
(plain torch), one thread, each in a process of its own. Processor seconds, medians:

forward, backward   of the picture, and of a weighted sum of it without a graph
kept                the backward pass with its graph kept
second              the backward pass of a weighted sum of those first derivatives
memory              MiB that the process grew by, beyond one pixel: with first derivatives, and from
these to second ones
"""

import itertools
import json
import math
import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path

import torch

from manifests import files

SIDE, RADIUS, LIGHT = 96, 34.2, (64, 128)
ROUNDS = {"float32": 9, "float64": 1}  # plain torch takes its time, and the same each time


def scene(dtype, perspective):
    """Leaves (n, material, light, view or None) for `render`."""
    place = torch.arange(SIDE, dtype=torch.float64) - (SIDE - 1) / 2
    y, x = torch.meshgrid(place, place, indexing="ij")
    z = (1 - (x * x + y * y) / RADIUS**2).clamp(min=0).sqrt()
    n = torch.where(z[..., None] > 0, torch.stack([x / RADIUS, -y / RADIUS, z], -1), 0.0)
    m = torch.tensor([[0.3, 0.5], [0.2, 30.0], [1.0, 1000.0]])[:, :, None].expand(3, 3, 2, 6)
    light = 0.2 + torch.rand(1, *LIGHT, 3, generator=torch.Generator().manual_seed(0))
    given = [n[None], m.reshape(1, 108), light]
    if perspective:
        view = torch.stack([-0.003 * x, 0.003 * y, torch.ones_like(x)], -1)
        given.append(torch.nn.functional.normalize(view, dim=-1)[None])
    leaves = [a.to(dtype).clone().requires_grad_() for a in given]
    return leaves if perspective else [*leaves, None]


def one_case(dtype, perspective, rounds):
    """{"pixels": …, what: seconds, "memory": [first, second]}, measured in this process."""
    from learn.layer import render

    torch.set_num_threads(1)
    n, m, light, view = scene(getattr(torch, dtype), perspective)
    leaves = [a for a in (n, m, light, view) if a is not None]
    g = torch.linspace(-1, 1, n.numel(), dtype=n.dtype).reshape(n.shape)
    inside = (n != 0).any(-1)

    def passes(mask, twice=True):
        """Seconds of each pass."""
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
    one[0, SIDE // 2, SIDE // 2] = True
    passes(one)  # kernels compiled and loaded, tables of the map made
    memory = [peak()]
    for twice in (False, True):
        results = [passes(inside, twice)]
        memory.append(peak())
    results += [passes(inside) for _ in range(rounds - 1)]
    growth = [round(after - before, 1) for before, after in itertools.pairwise(memory)]
    medians = {name: statistics.median(x[name] for x in results) for name in results[0]}
    return {"pixels": int(inside.sum())} | medians | {"memory": growth}


def peak():
    """MiB that this process has taken at most."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main(out):
    from manifests.provenance import provenance

    cases = {}
    for dtype, rounds in ROUNDS.items():
        for perspective in (False, True):
            command = [
                sys.executable,
                "-m",
                "learn.experiments.second_derivatives",
                "--case",
                dtype,
                str(int(perspective)),
                str(rounds),
            ]
            result = json.loads(
                subprocess.run(command, capture_output=True, text=True, check=True).stdout
            )
            name = f"{dtype}, {'view per pixel' if perspective else 'orthographic'}"
            cases[name] = result | {"second ÷ backward": result["second"] / result["backward"]}
            print(f"{name}: second ÷ backward {cases[name]['second ÷ backward']:.2f}", result)
    made = provenance() | {
        "command": f"python -m learn.experiments.second_derivatives {Path(out).name}"
    }
    files.write_json(
        Path(out), {"lights": math.prod(LIGHT), "threads": 1, "cases": cases, "about": made}
    )


if __name__ == "__main__":
    if sys.argv[1:2] == ["--case"]:
        print(json.dumps(one_case(sys.argv[2], sys.argv[3] == "1", int(sys.argv[4]))))
    else:
        main(*sys.argv[1:])
