"""A training step taken term by term, with a clock between its parts (step_profile)."""

from __future__ import annotations

import statistics
import time
from pathlib import Path
from typing import Any

import msgspec
import torch

from learn.data.batch import ExampleBatch
from learn.data.data_split import DataSplit
from learn.data.relit import RelitDataset
from learn.data.settings import Losses, Run
from learn.training import losses, schedule
from learn.training.loop import Training

WARM_UP = 2


def profile(
    run: Run, data_splits: dict[str, DataSplit], scratch: Path, steps: int, images: int
) -> dict[str, Any]:
    """Return {"step": {part: ms}, "relit": {…}, "about"}.

    run      whose parts and losses are timed
    scratch  a folder for the run's files
    steps    how many are timed
    images   how many pictures are relit
    """
    about = {"run": run.name, "size": run.size, "batch": run.schedule.batch}
    return {
        "step": of_step(run, data_splits, scratch, steps),
        "relit": of_relighting(run, data_splits, images),
        "about": about | {"steps": steps, "threads": 1},
    }


def of_step(
    run: Run, data_splits: dict[str, DataSplit], folder: Path, steps: int
) -> dict[str, float]:
    """Return {part: median ms} of a step, and their "total".

    A part's share of the backward pass is measured by leaving the others' graph out.
    """
    training = Training(run, data_splits, folder, sheet_every=0, workers=0)
    source = RelitDataset(data_splits["train"], run.data, run.schedule.batch, run.size, run.seed)
    times: dict[str, list[float]] = {}
    for k in range(WARM_UP + steps):
        clock = Clock()
        batch = source[k]
        clock.note("data")
        _one_step(training, batch, run, clock, k)
        if k >= WARM_UP:
            for name, seconds in clock.parts.items():
                times.setdefault(name, []).append(1e3 * seconds)
    result = {name: statistics.median(values) for name, values in times.items()}
    return result | {"total": sum(result.values())}


def _one_step(training: Training, batch: ExampleBatch, run: Run, clock: Clock, k: int) -> None:
    """Make a step as learn.training.loop does, but term by term.

    Each term's gradient by the prediction is computed first, and then the network's.
    """
    training.model.train()
    rng = torch.Generator().manual_seed(k)
    prediction = training.predict(training.model, batch)
    clock.note("network")
    leaves = [t for t in (prediction.n, prediction.code, prediction.light) if t is not None]
    cut = [t.detach().requires_grad_() for t in leaves]
    cut_by_name = dict(
        zip(
            [name for name in ("n", "code", "light") if getattr(prediction, name) is not None],
            cut,
            strict=True,
        )
    )
    seen = prediction._replace(**cut_by_name)
    if seen.code is not None:
        seen = seen._replace(label=training.network.ranges.label(seen.code))
    clock.note("network")
    for name, group in groups(run.losses).items():
        result = losses.terms(seen, batch, group, rng, training.network.ranges, training.features)
        if result:
            losses.total(result, group).backward(retain_graph=True)
        clock.note(name)
    training.optimiser.zero_grad(set_to_none=True)
    pairs = [(t, c.grad) for t, c in zip(leaves, cut, strict=True) if c.grad is not None]
    torch.autograd.backward([t for t, _ in pairs], [g for _, g in pairs])
    clock.note("network")
    torch.nn.utils.clip_grad_norm_(training.network.parameters(), run.schedule.clip)
    training.optimiser.step()
    schedule.update_average(training.average, training.network, k, run.schedule.ema_decay)
    clock.note("optimiser")


def groups(requested: Losses) -> dict[str, Losses]:
    """Return {part: Losses with that part's terms alone}.

    Features are not separated from the layer that renders for them.
    """
    terms = {
        "normals and material terms": ("normals", "material", "albedo"),
        "light terms": ("light_log", "light_rendered"),
        "layer and features" if losses.uses_features(requested) else "layer": (
            "image",
            "target",
            "image_features",
            "target_features",
        ),
    }
    every = [name for names in terms.values() for name in names]
    return {
        part: msgspec.structs.replace(
            requested, **{name: 0.0 for name in every if name not in names}
        )
        for part, names in terms.items()
    }


def of_relighting(run: Run, data_splits: dict[str, DataSplit], images: int) -> dict[str, float]:
    """Return pictures per second of one thread's processor time, and by the clock, when relit."""
    source = RelitDataset(
        data_splits["train"], run.data, run.schedule.batch, run.size, run.seed + 1
    )
    source[0]
    batches = max(1, images // run.schedule.batch)
    begun, began = time.process_time(), time.perf_counter()
    for k in range(1, batches + 1):
        source[k]
    used, passed = time.process_time() - begun, time.perf_counter() - began
    made = batches * run.schedule.batch
    return {
        "images": made,
        "images_per_second_of_one_thread": made / used,
        "images_per_second_by_the_clock": made / passed,
        "size": run.size,
    }


class Clock:
    """Processor seconds between notes, added up by name."""

    def __init__(self) -> None:
        self.parts: dict[str, float] = {}
        self.last = time.process_time()

    def note(self, name: str) -> None:
        """Add the time since the last note to `name`."""
        now = time.process_time()
        self.parts[name] = self.parts.get(name, 0.0) + now - self.last
        self.last = now
