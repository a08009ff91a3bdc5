"""Times and errors of every setting on every case (work_precision).

seconds, forward  processor time of one thread, forward and backward in n, m and L, and of the
                  forward picture alone without derivatives: a busy machine alters it little. A few
                  methods render differently where no derivative is required
error,            mean absolute difference over mean radiance, on SAMPLE pixels, to the paper's sum,
forward_error     of each of the two
integral          the same (forward and backward) to the converged integral of the
                  piecewise-constant map: lobes up to an exponent of 1,600 summed over a map whose
                  texels are split into 4 × 4, sharper ones by 16,384 half vectors
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from typing import Any

import numpy as np
import torch

from learn.experiments import chart_cases
from learn.methods import Batch, load
from learn.methods.directional import sample
from manifests.progress import tqdm

SAMPLE, FINE_PARTS = 192, 4


def measured(
    materials: Mapping[str, np.ndarray],
    lights: Mapping[str, np.ndarray],
    cameras: Sequence[str],
    size: int,
    processes: int = 1,
) -> list[dict[str, Any]]:
    """Return rows of material, light, camera, method, knob and the above.

    materials  {name: label}
    lights     {name: map (64, 128, 3)}
    processes  cases measured side by side, each on one thread
    """
    todo = [
        (m, label, L, light, c, size)
        for m, label in materials.items()
        for L, light in lights.items()
        for c in cameras
    ]
    rows = []
    with ProcessPoolExecutor(
        processes, mp_context=get_context("spawn"), initializer=warm_up, initargs=todo[0]
    ) as pool:
        for result in tqdm(
            pool.map(one_case, *zip(*todo, strict=True)),
            total=len(todo),
            desc="chart",
            unit="case",
            mininterval=2,
        ):
            rows += result
    return rows


def warm_up(
    _m: str, label: np.ndarray, _L: str, light: np.ndarray, _camera: str, _size: int
) -> None:
    """Use one thread, and load and compile everything before it is timed."""
    torch.set_num_threads(1)
    for setting in chart_cases.settings():
        timed(setting, label, light, 12, "orthographic", True)


def one_case(
    m: str, label: np.ndarray, L: str, light: np.ndarray, camera: str, size: int
) -> list[dict[str, Any]]:
    """Return the rows of every setting on one material, light and camera."""
    batch, _ = chart_cases.batch_of(label, light, size, camera)
    pick = sample(len(batch.n), SAMPLE)
    few = picked(batch, pick)
    paper, integral = load("exact").radiance(few, 1e-2), converged(few)
    rows = []
    for setting in chart_cases.settings():
        if camera == "perspective" and "orthographic" in load(setting.method).CARD.needs:
            continue
        seconds, seen = timed(setting, label, light, size, camera, True)
        forward, picture = timed(setting, label, light, size, camera, False)
        error, to_integral = (
            (seen[pick] - truth).abs().mean() / truth.mean() for truth in (paper, integral)
        )
        forward_error = (picture[pick] - paper).abs().mean() / paper.mean()
        rows.append(
            {
                "material": m,
                "light": L,
                "camera": camera,
                "method": setting.method,
                "knob": setting.knob,
            }
            | {"seconds": seconds, "error": error.item(), "integral": to_integral.item()}
            | {"forward": forward, "forward_error": forward_error.item(), "pixels": len(batch.n)}
        )
    return rows


def timed(
    setting: chart_cases.Setting,
    label: np.ndarray,
    light: np.ndarray,
    size: int,
    camera: str,
    backward: bool,
) -> tuple[float, torch.Tensor]:
    """Return seconds, and the picture (P, 3)."""
    batch, leaves = chart_cases.batch_of(label, light, size, camera, with_gradients=backward)
    with torch.set_grad_enabled(backward):
        start = time.thread_time()
        seen = setting.radiance(batch)
        if backward:
            torch.autograd.grad(seen.sum(), leaves, allow_unused=True)
        return time.thread_time() - start, seen.detach()


def picked(batch: Batch, pick: torch.Tensor) -> Batch:
    """Return a batch of some of its pixels."""
    view = None if batch.view is None else batch.view[pick]
    return replace(batch, n=batch.n[pick], view=view, counts=(len(pick),))


def converged(batch: Batch) -> torch.Tensor:
    """Return radiance (P, 3), the integral over the piecewise-constant map."""
    fine = batch.light.repeat_interleave(FINE_PARTS, 1).repeat_interleave(FINE_PARTS, 2)
    return load("quadrature").radiance(replace(batch, light=fine), 1e-6)
