"""Where a training step's time goes, and how fast pictures are relit: what `learn.experiments
step-profile` measures.

All in processor time of one thread, medians over steps; data are timed in this process too, though
training has them made beside it.

data         a batch of relit pictures
network      forward, and its own share of backward
layer        rendering I' and O' forward and backward, with the truth they are compared with
light terms, material terms   forward and backward
features     of I' and O', where a run compares by them
optimiser    gradient clipping, AdamW, moving average
"""

import statistics
import time
from pathlib import Path

import msgspec
import torch

from learn.data.relit import RelitDataset
from learn.training import losses, schedule
from learn.training.loop import Training
from manifests import files
from manifests.provenance import provenance

WARM_UP = 2


def measure(run, data_splits, out, scratch, steps, images):
    """{"step": {part: ms}, "relit": {…}, "about"}; step-time.json and step-time.md in `out`.

    run     learn.data.settings.Run, whose parts and losses are timed; steps: how many
    images  how many pictures to relight for the speed of that; scratch: a folder for the run's
    files
    """
    out = Path(out)
    result = {
        "step": of_step(run, data_splits, scratch, steps),
        "relit": of_relighting(run, data_splits, images),
    }
    result["about"] = provenance() | {
        "run": run.name,
        "size": run.size,
        "batch": run.schedule.batch,
        "steps": steps,
        "threads": 1,
    }
    with files.transaction():
        files.write_json(out / "step-time.json", result)
        files.write_text(out / "step-time.md", page(result))
    return result


def of_step(run, data_splits, folder, steps):
    """{part: median ms} of a step, and "total". What backward takes of each part is found by
    leaving the others' graph out.
    """
    training = Training(run, data_splits, folder, sheet_every=0, workers=0)
    source = RelitDataset(data_splits["train"], run.data, run.schedule.batch, run.size, run.seed)
    times = {}
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


def _one_step(training, batch, run, clock, k):
    """A step as learn.training.loop makes it, but term by term: each one's gradient by the
    prediction, and then the network's.
    """
    training.model.train()
    rng = torch.Generator().manual_seed(k)
    prediction = training.predict(training.model, batch)
    clock.note("network")
    leaves = [t for t in (prediction.n, prediction.code, prediction.light) if t is not None]
    cut = [t.detach().requires_grad_() for t in leaves]
    given = dict(
        zip(
            [name for name in ("n", "code", "light") if getattr(prediction, name) is not None],
            cut,
            strict=True,
        )
    )
    seen = prediction._replace(**given)
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


def groups(requested):
    """{part: Losses with that part's terms alone}. Features cannot be told from the layer that
    renders for them.
    """
    terms = {
        "normals and material terms": ("normals", "material", "albedo"),
        "light terms": ("light_log", "light_rendered"),
        "layer and features" if losses.by_features(requested) else "layer": (
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


def of_relighting(run, data_splits, images):
    """Pictures a second of one thread's processor time, as training has them relit; and the shares
    of it.
    """
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
    """Processor time since the last note, added up by name."""

    def __init__(self):
        self.parts, self.last = {}, time.process_time()

    def note(self, name):
        now = time.process_time()
        self.parts[name] = self.parts.get(name, 0.0) + now - self.last
        self.last = now


def page(found):
    """The table for people."""
    about, step, relit = found["about"], found["step"], found["relit"]
    own = step["total"] - step["data"]
    lines = [f"# Where a step of {about['run']} goes", ""]
    lines += [
        (
            f"{about['batch']} pictures of {about['size']}² pixels, one thread's processor time,"
            f" median of {about['steps']} steps."
        ),
        "",
    ]
    lines += ["| part | ms | share of the step |", "|---|---|---|"]
    for name, value in step.items():
        if name not in ("data", "total"):
            lines.append(f"| {name} | {value:.0f} | {100 * value / own:.0f} % |")
    lines += [
        f"| **a step** | {own:.0f} | |",
        f"| data, made by a process beside it | {step['data']:.0f} | |",
        "",
    ]
    lines += [
        (
            f"Relighting: {relit['images_per_second_of_one_thread']:.0f} pictures of"
            f" {relit['size']}² a second of one thread's processor time ({relit['images']}"
            " pictures, materials, lights and augmentation included; by the clock, on this machine"
            f" as loaded as it was: {relit['images_per_second_by_the_clock']:.0f})."
        ),
        "",
        " · ".join(f"{key}: {value}" for key, value in about.items()),
    ]
    return "\n".join(lines) + "\n"
