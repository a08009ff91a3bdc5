"""Times and errors of every setting on every case.

seconds, forward   CPU time of one thread, forward and backward in n, m and L, and of the forward picture alone without derivatives: a busy
                   machine alters it little. A few methods go another way where no derivative is wanted
error, forward_error   mean absolute difference over mean radiance, on SAMPLE pixels, against the paper's sum, of each
integral  the same (forward and backward) against the converged integral of the piecewise-constant map: lobes up to an exponent of 1,600
          summed over a map whose texels are parted into 4 × 4, sharper ones by 16,384 half-vector taps
"""

import time
from dataclasses import replace

import torch
from tqdm import tqdm

from learn.charting import cases
from learn.methods import load
from learn.methods.directional import sample

SAMPLE, FINE_PARTS = 192, 4


def measure(materials, lights, cameras, size, settings):
    """Rows (dicts) of material, light, camera, method, knob, seconds, error, integral; materials {name: label}."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    rows = []
    todo = [(m, L, c) for m in materials for L in lights for c in cameras]
    try:
        for setting in settings:  # load and compile before anything is timed
            timed(setting, next(iter(materials.values())), next(iter(lights.values())), 12, "orthographic", True)
        with tqdm(total=len(todo) * len(settings), desc="chart", unit="point", mininterval=2) as bar:
            for m, L, camera in todo:
                rows += one_case(m, materials[m], L, lights[L], camera, size, settings, bar)
    finally:
        torch.set_num_threads(threads)
    return rows


def one_case(m, label, L, light, camera, size, settings, bar):
    batch, _ = cases.batch_of(label, light, size, camera)
    pick = sample(len(batch.n), SAMPLE)
    few = picked(batch, pick)
    paper, integral = load("exact").radiance(few, 1e-2), converged(few)
    rows = []
    for setting in settings:
        bar.update()
        if camera == "perspective" and "orthographic" in load(setting.method).CARD.needs:
            continue
        seconds, seen = timed(setting, label, light, size, camera, True)
        forward, picture = timed(setting, label, light, size, camera, False)
        error, to_integral = ((seen[pick] - truth).abs().mean() / truth.mean() for truth in (paper, integral))
        forward_error = (picture[pick] - paper).abs().mean() / paper.mean()
        rows.append(
            {"material": m, "light": L, "camera": camera, "method": setting.method, "knob": setting.knob}
            | {"seconds": seconds, "error": error.item(), "integral": to_integral.item()}
            | {"forward": forward, "forward_error": forward_error.item(), "pixels": len(batch.n)}
        )
    return rows


def timed(setting, label, light, size, camera, backward):
    """Seconds, and the picture (P, 3)."""
    batch, leaves = cases.batch_of(label, light, size, camera, wanted=backward)
    with torch.set_grad_enabled(backward):
        start = time.thread_time()
        seen = setting.radiance(batch)
        if backward:
            torch.autograd.grad(seen.sum(), leaves, allow_unused=True)
        return time.thread_time() - start, seen.detach()


def picked(batch, pick):
    view = None if batch.view is None else batch.view[pick]
    return replace(batch, n=batch.n[pick], view=view, counts=(len(pick),))


def converged(batch):
    """Radiance (P, 3): the integral over the piecewise-constant map."""
    fine = batch.light.repeat_interleave(FINE_PARTS, 1).repeat_interleave(FINE_PARTS, 2)
    return load("quadrature").radiance(replace(batch, light=fine), 1e-6)
