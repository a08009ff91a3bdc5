"""The exact sum, timed in turns with plain torch on the same scene (engine_speed).

A sphere covers 40 % of 256² pixels (26,214 or a few more), under a 64 × 128 map with a sun. Plain
torch (eager_sum) renders evenly spaced pixels of it; its time is proportional to
pixels, and is scaled to all of them. Both wall and processor time are measured: on a busy machine
the second is the steadier.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from learn.experiments.layer import eager_sum
from learn.layer import render
from learn.methods import exact
from manifests import materials as catalogue
from manifests.progress import tqdm
from shaders.frames import ELEVATION, camera_from_light, view_vectors

SIZE, COVER = 256, 0.4
LIGHT = (64, 128)
FOV = np.radians(35.0)
EAGER_CHUNK = 4  # pixels at a time: the fastest of 2, 4, 16, 64 on the machine it was tried on


@dataclass(frozen=True)
class Settings:
    """What is timed: materials by name, thread counts, rounds, and pixels of plain torch."""

    materials: tuple[str, ...]
    threads: tuple[int, ...]
    rounds: int
    eager_pixels: int


@dataclass(frozen=True)
class Scene:
    """n, view (1, SIZE, SIZE, 3) and light (1, *LIGHT, 3), float32; no view is orthographic."""

    n: torch.Tensor
    view: torch.Tensor | None
    light: torch.Tensor
    m: torch.Tensor


@dataclass(frozen=True)
class Row:
    """Median seconds for the whole picture, and the median ratio of plain torch to the engine."""

    material: str
    camera: str
    task: str
    threads: int
    wall: dict[str, float]
    processor: dict[str, float]
    ratio: dict[str, float]
    processor_ratio: dict[str, float]


def scene(material: str, perspective: bool) -> Scene:
    """Return a sphere under a sky with a sun of 2,000 times its radiance."""
    y, x = np.mgrid[0:SIZE, 0:SIZE] - (SIZE - 1) / 2
    square = (x * x + y * y) / (SIZE**2 * COVER / np.pi)
    n = np.stack([x, -y, np.zeros_like(x)], -1) / np.sqrt(SIZE**2 * COVER / np.pi)
    n[..., 2] = np.sqrt(np.maximum(1.0 - square, 0.0))
    n[square >= 1] = 0.0
    light = np.random.default_rng(1).random((*LIGHT, 3)) + 0.2
    light[18, 40] = 2000.0
    view = torch.as_tensor(view_vectors(SIZE, SIZE, FOV))[None].float() if perspective else None
    m = torch.as_tensor(catalogue.find(material).m.reshape(1, 108)).float()
    return Scene(torch.as_tensor(n)[None].float(), view, torch.as_tensor(light)[None].float(), m)


def engine_task(scene: Scene, backward: bool) -> Callable[[], None]:
    """Return a function that renders the picture by the engine, and computes its gradients.

    It includes everything from the layer's arguments on, compaction and tables too.
    """
    tensors = (scene.n, scene.m, scene.light)
    leaves = n, m, light = [a.clone().requires_grad_(backward) for a in tensors]
    view = None if scene.view is None else scene.view.clone().requires_grad_(backward)

    def run() -> None:
        seen = render(n, m, light, view=view, method="exact")
        if backward:
            torch.autograd.grad(seen.sum(), leaves + ([] if view is None else [view]))

    return run


def eager_task(
    scene: Scene, backward: bool, pixels: int, formula: eager_sum.Formula
) -> tuple[Callable[[], None], float]:
    """Return the same for evenly spaced pixels by plain torch, and the factor to all pixels."""
    inside = (scene.n != 0).any(-1)
    n = scene.n[inside]
    view = torch.tensor([0.0, 0.0, 1.0]).expand_as(n) if scene.view is None else scene.view[inside]
    facing = ((n * view).sum(-1) > 1e-2).nonzero().squeeze(-1)
    pick = facing[torch.linspace(0, len(facing) - 1, pixels).long()]
    w, E = exact.texels(scene.light[0], torch.as_tensor(camera_from_light(ELEVATION)))
    arguments = n[pick], view[pick], scene.m.reshape(3, 3, 2, 6), E, w
    g = torch.ones_like(arguments[0])

    def run() -> None:
        if backward:
            eager_sum.forward_backward(formula, *arguments, g, EAGER_CHUNK, scene.view is not None)
        else:
            eager_sum.forward(formula, *arguments, EAGER_CHUNK)

    return run, len(facing) / pixels


def time_call(run: Callable[[], None]) -> np.ndarray:
    """Return wall and processor seconds of one call."""
    wall, processor = time.perf_counter(), time.process_time()
    run()
    return np.array([time.perf_counter() - wall, time.process_time() - processor])


def row(
    settings: Settings,
    material: str,
    perspective: bool,
    backward: bool,
    threads: int,
    progress: tqdm,
) -> Row:
    """Return the row of one case; the engine is compiled before it is timed."""
    torch.set_num_threads(threads)
    place = scene(material, perspective)
    tasks = {"engine": (engine_task(place, backward), 1.0)}
    for name, formula in (("torch, tuned", eager_sum.tune), ("torch, plain", eager_sum.plain)):
        tasks[name] = eager_task(place, backward, settings.eager_pixels, formula)
    tasks["engine"][0]()  # compiled, tables of the map made
    rounds: dict[str, list[np.ndarray]] = {name: [] for name in tasks}
    for _ in range(settings.rounds):
        for name, (run, factor) in tasks.items():
            rounds[name].append(time_call(run) * factor)
        progress.update()
    seconds = {name: np.array(times).T for name, times in rounds.items()}
    middle = [
        {name: statistics.median(times[clock]) for name, times in seconds.items()}
        for clock in (0, 1)
    ]
    ratios = [
        {
            n: statistics.median(t[clock] / seconds["engine"][clock])
            for n, t in seconds.items()
            if n != "engine"
        }
        for clock in (0, 1)
    ]
    camera = "view per pixel" if perspective else "orthographic"
    return Row(
        material, camera, "forward + backward" if backward else "forward", threads, *middle, *ratios
    )


def time_rows(settings: Settings) -> list[Row]:
    """Return all rows; torch's number of threads is put back."""
    before = torch.get_num_threads()
    cases = [
        (material, perspective, backward, threads)
        for threads in settings.threads
        for material in settings.materials
        for perspective in (False, True)
        for backward in (False, True)
    ]
    try:
        with tqdm(total=len(cases) * settings.rounds, unit="round", desc="engine") as progress:
            return [row(settings, *case, progress) for case in cases]
    finally:
        torch.set_num_threads(before)
