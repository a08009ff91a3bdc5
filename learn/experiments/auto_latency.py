"""How long `auto` takes on each material of the catalogue: one picture, and a batch that shares
light and material.

The sphere covers 40 % of 256 × 256 (26,204 pixels), forward and, given the derivative by the
picture, backward in n, m and L.
wall     seconds by the clock, the best of ROUNDS (other programs on the machine add to it)
cpu      seconds of one thread doing all the work, the best of ROUNDS
shared   wall seconds a picture, in a batch of BATCH pictures expanded from one material and one
light
"""

import time

import torch
from tqdm import tqdm

from learn.experiments import chart_cases
from learn.layer import render

ROUNDS, BATCH = 3, 8


def measure(labels, light, tolerance, threads):
    """Rows of material, wall, cpu, shared."""
    rows = []
    for name, label in tqdm(
        labels.items(), desc=f"pace {tolerance:g}", unit="material", mininterval=2
    ):
        torch.set_num_threads(threads)
        wall, shared = (
            best(label, light, tolerance, 1, time.perf_counter),
            best(label, light, tolerance, BATCH, time.perf_counter),
        )
        torch.set_num_threads(1)
        cpu = best(label, light, tolerance, 1, time.thread_time)
        rows.append({"material": name, "wall": wall, "cpu": cpu, "shared": shared / BATCH})
    return rows


def best(label, light, tolerance, images, clock):
    m = torch.as_tensor(label, dtype=torch.float32).exp().reshape(1, 108)
    L = torch.as_tensor(light, dtype=torch.float32)[None]
    n = chart_cases.sphere(256).expand(images, -1, -1, -1).contiguous()
    by_picture, result = torch.ones_like(n), []
    for _ in range(ROUNDS):
        leaves = [x.detach().requires_grad_() for x in (n, m, L)]
        start = clock()
        picture = render(
            leaves[0],
            leaves[1].expand(images, -1),
            leaves[2].expand(images, -1, -1, -1),
            tolerance=tolerance,
        )
        torch.autograd.grad(picture, leaves, by_picture)
        result.append(clock() - start)
    return min(result)
