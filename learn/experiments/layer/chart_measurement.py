"""Times and errors of every setting on every case (work_precision).

seconds, forward  processor time of one thread, forward and backward in n, m and L, and of the
                  forward picture alone without derivatives: a busy machine alters it little. A few
                  methods render differently where no derivative is required.
                  The rivals in plain torch (torch_rival) are timed on a few
                  pixels; Mitsuba (mitsuba_rival) in a process of its own, and
                  its derivatives are by m and L
error,            mean absolute difference over mean radiance, on SAMPLE pixels, to the paper's sum,
forward_error     of each of the two
integral          the same (forward and backward) to the converged integral of the
                  piecewise-constant map: lobes up to an exponent of 1,600 summed over a map whose
                  texels are split into 4 × 4, sharper ones by 16,384 half vectors
"""

from __future__ import annotations

import functools
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from learn.experiments import runner
from learn.experiments.layer import chart_cases, mitsuba_rival, torch_rival
from learn.methods import Batch, load
from learn.methods.directional import sample
from manifests import materials as catalogue

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


def measure_rows(
    cases: Sequence[Case],
    folder: Path,
    with_torch: bool = True,
    with_mitsuba: bool = False,
    methods: Sequence[str] | None = None,
) -> list[dict[str, Any]]:
    """Return rows of material, light, camera, shape, size, method, knob and the above.

    folder        keeps what is measured, so that a stopped measurement continues
    with_torch, with_mitsuba  whether these rivals are measured; Mitsuba on spheres, by all settings
    methods       names of those that are measured; None: all
    """
    torch.set_num_threads(1)
    chosen: dict[str, Any] = {"torch": with_torch}
    if methods is not None:  # only then: folders of before have no such key
        chosen["methods"] = " ".join(methods)
    todo = [(case.names() | chosen, case) for case in cases]
    kept = runner.resume(
        folder / "cases.jsonl", todo, lambda case: one_case(case, with_torch, methods), "case"
    )
    rows = [row for of_case in kept for row in of_case["rows"]]
    if with_mitsuba:
        main = [(c, k["truth"]) for c, k in zip(cases, kept, strict=True) if not c.leading]
        groups = [
            [pair for pair in main if pair[0].camera == camera]
            for camera in dict.fromkeys(case.camera for case, _ in main)
        ]
        named = [
            ({"cases": str([list(case.names().values()) for case, _ in group])}, group)
            for group in groups
        ]
        for group in runner.resume(folder / "mitsuba.jsonl", named, mitsuba_rows, "camera"):
            rows += group["rows"]
    return rows


@functools.cache
def warm_up(with_torch: bool) -> None:
    """Load and compile everything before it is timed."""
    light = chart_cases.computed_lights()["lamps"]
    label = catalogue.find(chart_cases.MATERIALS[0]).label
    small = Case("", label, "", light, "orthographic", 12)
    for setting in chart_cases.settings():
        time_picture(setting, small, True)
    if with_torch:
        for formula in torch_rival.formulas().values():
            torch_rival.time_formula(formula, small.batch()[0])


def one_case(case: Case, with_torch: bool, methods: Sequence[str] | None = None) -> dict[str, Any]:
    """Return {"rows": those of every setting on one case, "truth": what they are compared with}.

    methods  names of those that are measured; None: all
    """
    warm_up(with_torch)
    batch, _ = case.batch()
    truth, rows = truth_at(batch, sample(len(batch.n), SAMPLE)), []
    pixels = {"pixels": len(batch.n)}
    settings = chart_cases.leading_settings() if case.leading else chart_cases.settings()
    for setting in settings:
        if methods is not None and setting.method not in methods:
            continue
        if case.camera == "perspective" and "orthographic" in load(setting.method).CARD.needs:
            continue
        seconds, seen = time_picture(setting, case, True)
        forward, picture = time_picture(setting, case, False)
        names = {"method": setting.method, "knob": setting.knob}
        clocks = {"seconds": seconds, "forward": forward}
        errors = truth.errors(seen.numpy()[truth.pick], picture.numpy()[truth.pick])
        rows.append(case.names() | names | clocks | errors | pixels)
    for name, formula in torch_rival.formulas().items() if with_torch else ():
        result = torch_rival.time_formula(formula, batch)
        clocks = {"seconds": result.seconds, "forward": result.forward}
        errors = truth_at(batch, result.pick).errors(result.radiance.numpy())
        rows.append(case.names() | {"method": name, "knob": "float32"} | clocks | errors | pixels)
    arrays = {key: value.tolist() for key, value in vars(truth).items()}
    return {"rows": rows, "truth": arrays}


def truth_at(batch: Batch, pick: torch.Tensor) -> Truth:
    """Return what pictures are compared with, at pixels pick (S,)."""
    few = pick_pixels(batch, pick)
    paper, integral = load("exact").radiance(few, 1e-2), converged_radiance(few)
    return Truth(pick.numpy(), paper.numpy(), integral.numpy())


def mitsuba_rows(group: Sequence[tuple[Case, dict[str, list[Any]]]]) -> dict[str, Any]:
    """Return {"rows": those of Mitsuba}; group: cases of one camera and size, and their truths."""
    batch, _ = group[0][0].batch()
    n, view = batch.n.numpy(), None if batch.view is None else batch.view.numpy()
    pictures = mitsuba_rival.pictures(n, view, [(case.label, case.light) for case, _ in group])
    rows = []
    for (case, arrays), of_samples in zip(group, pictures, strict=True):
        truth = Truth(**{key: np.array(value) for key, value in arrays.items()})
        for samples, result in of_samples.items():
            names = {"method": "mitsuba", "knob": str(samples)}
            clocks = {"seconds": result.seconds, "forward": result.forward}
            errors = truth.errors(result.radiance[truth.pick])
            rows.append(case.names() | names | clocks | errors | {"pixels": len(n)})
    return {"rows": rows}


def time_picture(
    setting: chart_cases.Setting, case: Case, backward: bool
) -> tuple[float, torch.Tensor]:
    """Return seconds, and the picture (P, 3)."""
    batch, leaves = case.batch(with_gradients=backward)
    with torch.set_grad_enabled(backward):
        start = time.thread_time()
        seen = setting.radiance(batch)
        if backward:
            torch.autograd.grad(seen.sum(), leaves, allow_unused=True)
        return time.thread_time() - start, seen.detach()


def pick_pixels(batch: Batch, pick: torch.Tensor) -> Batch:
    """Return a batch of some of its pixels."""
    view = None if batch.view is None else batch.view[pick]
    return replace(batch, n=batch.n[pick], view=view, counts=(len(pick),))


def converged_radiance(batch: Batch) -> torch.Tensor:
    """Return radiance (P, 3), the integral over the piecewise-constant map."""
    fine = batch.light.repeat_interleave(FINE_PARTS, 1).repeat_interleave(FINE_PARTS, 2)
    return load("quadrature").radiance(replace(batch, light=fine), 1e-6)
