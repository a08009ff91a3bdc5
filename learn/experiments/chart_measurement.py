"""Times and errors of every setting on every case (work_precision).

seconds, forward  processor time of one thread, forward and backward in n, m and L, and of the
                  forward picture alone without derivatives: a busy machine alters it little. A few
                  methods render differently where no derivative is required.
                  The rivals in plain torch (learn.experiments.torch_rival) are timed on a few
                  pixels; Mitsuba (learn.experiments.mitsuba_rival) in a process of its own, and
                  its derivatives are by m and L
error,            mean absolute difference over mean radiance, on SAMPLE pixels, to the paper's sum,
forward_error     of each of the two
integral          the same (forward and backward) to the converged integral of the
                  piecewise-constant map: lobes up to an exponent of 1,600 summed over a map whose
                  texels are split into 4 × 4, sharper ones by 16,384 half vectors
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from typing import Any

import numpy as np
import torch

from learn.experiments import chart_cases, mitsuba_rival, torch_rival
from learn.methods import Batch, load
from learn.methods.directional import sample
from manifests.progress import tqdm

SAMPLE, FINE_PARTS = 192, 4


@dataclass(frozen=True)
class Case:
    """A shape in a material under a light; leading: by the leading settings alone."""

    material: str
    label: np.ndarray
    light_name: str
    light: np.ndarray
    camera: str
    size: int
    shape: str = "sphere"
    leading: bool = False

    def names(self) -> dict[str, Any]:
        """Return what identifies the case in a row."""
        names = {"material": self.material, "light": self.light_name, "camera": self.camera}
        return names | {"shape": self.shape, "size": self.size}

    def batch(self, with_gradients: bool = False) -> tuple[Batch, list[torch.Tensor]]:
        """Return the case's batch, and its tensors, which require gradients or not."""
        return chart_cases.batch_of(
            self.label, self.light, self.size, self.camera, with_gradients, self.shape
        )


@dataclass(frozen=True)
class Truth:
    """The paper's sum and the converged integral, (S, 3) each, at pixels pick (S,)."""

    pick: np.ndarray
    paper: np.ndarray
    integral: np.ndarray

    def errors(self, seen: np.ndarray, forward: np.ndarray | None = None) -> dict[str, float]:
        """Return the errors of a picture (S, 3) at `pick`; forward: that without derivatives."""
        forward = seen if forward is None else forward
        return {
            "error": relative_error(seen, self.paper),
            "integral": relative_error(seen, self.integral),
            "forward_error": relative_error(forward, self.paper),
        }


def relative_error(seen: np.ndarray, truth: np.ndarray) -> float:
    """Return the mean absolute difference over the mean radiance."""
    return float(np.abs(seen - truth).mean() / truth.mean())


def measured(
    cases: Sequence[Case], processes: int = 1, with_torch: bool = True, with_mitsuba: bool = False
) -> list[dict[str, Any]]:
    """Return rows of material, light, camera, shape, size, method, knob and the above.

    processes                 cases measured side by side, each on one thread
    with_torch, with_mitsuba  whether these rivals are measured; Mitsuba on spheres, by all settings
    """
    rows, truths = [], []
    with ProcessPoolExecutor(
        processes,
        mp_context=get_context("spawn"),
        initializer=warm_up,
        initargs=(cases[0], with_torch),
    ) as pool:
        for of_case, truth in tqdm(
            pool.map(one_case, cases, [with_torch] * len(cases)),
            total=len(cases),
            desc="chart",
            unit="case",
            mininterval=2,
        ):
            rows += of_case
            truths.append(truth)
    if with_mitsuba:
        rows += mitsuba_rows(cases, truths)
    return rows


def warm_up(case: Case, with_torch: bool) -> None:
    """Use one thread, and load and compile everything before it is timed."""
    torch.set_num_threads(1)
    small = replace(case, size=12, camera="orthographic")
    for setting in chart_cases.settings():
        timed(setting, small, True)
    if with_torch:
        for formula in torch_rival.formulas().values():
            torch_rival.timed(formula, small.batch()[0])


def one_case(case: Case, with_torch: bool) -> tuple[list[dict[str, Any]], Truth]:
    """Return the rows of every setting on one case, and what they are compared with."""
    batch, _ = case.batch()
    truth, rows = truth_at(batch, sample(len(batch.n), SAMPLE)), []
    pixels = {"pixels": len(batch.n)}
    settings = chart_cases.leading_settings() if case.leading else chart_cases.settings()
    for setting in settings:
        if case.camera == "perspective" and "orthographic" in load(setting.method).CARD.needs:
            continue
        seconds, seen = timed(setting, case, True)
        forward, picture = timed(setting, case, False)
        names = {"method": setting.method, "knob": setting.knob}
        clocks = {"seconds": seconds, "forward": forward}
        errors = truth.errors(seen.numpy()[truth.pick], picture.numpy()[truth.pick])
        rows.append(case.names() | names | clocks | errors | pixels)
    for name, formula in torch_rival.formulas().items() if with_torch else ():
        result = torch_rival.timed(formula, batch)
        clocks = {"seconds": result.seconds, "forward": result.forward}
        errors = truth_at(batch, result.pick).errors(result.radiance.numpy())
        rows.append(case.names() | {"method": name, "knob": "float32"} | clocks | errors | pixels)
    return rows, truth


def truth_at(batch: Batch, pick: torch.Tensor) -> Truth:
    """Return what pictures are compared with, at pixels pick (S,)."""
    few = picked(batch, pick)
    paper, integral = load("exact").radiance(few, 1e-2), converged(few)
    return Truth(pick.numpy(), paper.numpy(), integral.numpy())


def mitsuba_rows(cases: Sequence[Case], truths: Sequence[Truth]) -> list[dict[str, Any]]:
    """Return the rows of Mitsuba on those cases that are measured by all settings."""
    rows = []
    for camera in dict.fromkeys(case.camera for case in cases):
        chosen = [i for i, c in enumerate(cases) if c.camera == camera and not c.leading]
        batch, _ = cases[chosen[0]].batch()
        n, view = batch.n.numpy(), None if batch.view is None else batch.view.numpy()
        pictures = mitsuba_rival.pictures(
            n, view, [(cases[i].label, cases[i].light) for i in chosen]
        )
        for i, of_samples in zip(chosen, pictures, strict=True):
            for samples, result in of_samples.items():
                names = {"method": "mitsuba", "knob": str(samples)}
                clocks = {"seconds": result.seconds, "forward": result.forward}
                errors = truths[i].errors(result.radiance[truths[i].pick])
                rows.append(cases[i].names() | names | clocks | errors | {"pixels": len(n)})
    return rows


def timed(setting: chart_cases.Setting, case: Case, backward: bool) -> tuple[float, torch.Tensor]:
    """Return seconds, and the picture (P, 3)."""
    batch, leaves = case.batch(with_gradients=backward)
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
