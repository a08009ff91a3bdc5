"""The experiment of Section 4.3: does training through the layer help, for material alone and for normals alone?

Each variant is trained with the same network, data and seed for the same processor time, and measured on shapes, materials and lights
that it never saw. What is not predicted is given true, so that each part stands alone.

material   standalone: squared difference of codes; combined: with I' through the layer; control: with the log-albedo term and no layer
normals    standalone: squared difference of normals; combined: with I' through the layer
"""

import json
import time
from pathlib import Path

import msgspec
import numpy as np
import torch
from tqdm import tqdm

from learn import intervals
from learn.networks.coding import Ranges
from learn.timing.report import made_by
from learn.training import checkpoint, loop, losses, measures
from learn.training.relit import Relit
from learn.training.settings import Losses, Run, Schedule

VARIANTS = {
    "material": {
        "standalone": {"material": 1.0},
        "combined": {"material": 1.0, "image": 10.0},
        "control": {"material": 1.0, "albedo": 0.3},
    },
    "normals": {"standalone": {"normals": 1.0}, "combined": {"normals": 1.0, "image": 3.0}},
}
DRAWS = 4000


def settings(part, variant, data, size, seconds, seed, batch=16):
    """The Run of one variant. Its steps are a bound far beyond what the time allows; the rate follows the clock."""
    weights = {"normals": 0.0, "material": 0.0} | VARIANTS[part][variant]
    about = f"{seconds:g} s of processor time"
    schedule = Schedule(steps=1_000_000, batch=batch, rate=2e-3 if part == "normals" else 1e-3, warm_up=50)
    quiet = msgspec.structs.replace(data, photograph=False)
    return Run(
        name=f"{part} {variant}", about=about, size=size, parts=(part,), data=quiet, losses=Losses(**weights), schedule=schedule, seed=seed
    )


def prove(data, pools, out, size, seconds, seeds, batches=12):
    """Train and measure every variant; report.json and report.md in `out`. A variant that is there already is not trained again."""
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    todo = [(p, v, s) for s in seeds for p, variants in VARIANTS.items() for v in variants]
    for part, variant, seed in tqdm(todo, "variants", unit="run"):
        path = out / f"{part}-{variant}-{seed}.json"
        if not path.exists():
            found = one(settings(part, variant, data, size, seconds, seed), pools, seconds, batches)
            path.write_text(json.dumps(found))
    return report(out, seeds)


def one(run, pools, seconds, batches):
    """One variant trained for `seconds` of this process's time, measured on the test side: {measure: [a value a picture]} and groups."""
    training = Clocked(run, pools, seconds)
    steps = training.train()
    network = training.averaged()
    source, rows = Relit(pools["test"], run.data, run.schedule.batch, run.size, 43), []
    for batch in (source[k] for k in range(batches)):
        with torch.no_grad():
            prediction = training.predict(network, batch)
        figures = measures.of(prediction, batch) if "normals" in run.parts else {}
        lit = prediction._replace(light=None)
        n = batch.n if lit.n is None else lit.n
        label = batch.label if lit.label is None else lit.label
        figures["l2"] = measures.compared(n, label, batch.light, batch.label, batch)
        figures.pop("target_l2", None)
        if lit.code is not None:
            figures["code_l2"] = ((lit.code - network.ranges.code(batch.label)) ** 2).mean((1, 2)).double().numpy()
        for i, name in enumerate(batch.names):
            shape, *_, material = name.split(" ")
            rows.append({"shape": shape, "material": material} | {key: float(value[i]) for key, value in figures.items()})
    return {"steps": steps, "seconds": seconds, "run": msgspec.to_builtins(run), "rows": rows}


class Clocked:
    """Training without files, that ends when this process has used its time; the rate falls along a cosine of the time used."""

    def __init__(self, run, pools, seconds):
        self.run, self.seconds = run, seconds
        torch.manual_seed(run.seed)
        labels = torch.from_numpy(np.stack(list(pools["train"].labels.values())))
        self.network = checkpoint.NETWORKS[run.network](Ranges.of(labels)).to(memory_format=torch.channels_last)
        self.average = {name: t.detach().clone() for name, t in self.network.state_dict().items()}
        self.source = Relit(pools["train"], run.data, run.schedule.batch, run.size, run.seed)
        self.optimiser = torch.optim.AdamW(self.network.parameters(), run.schedule.rate, weight_decay=run.schedule.decay)

    def train(self):
        """Steps made. Data come from another process, so that only networks, losses and layer are counted."""
        loader = torch.utils.data.DataLoader(
            self.source, batch_size=None, sampler=range(10**6), num_workers=1, worker_init_fn=loop.one_thread
        )
        used, self.step = 0.0, 0
        for batch in loader:
            start = time.process_time()
            self._one_step(batch, used / self.seconds)
            used += time.process_time() - start
            self.step += 1
            if used >= self.seconds:
                return self.step

    def _one_step(self, batch, done):
        rng = torch.Generator().manual_seed(self.step)
        for group in self.optimiser.param_groups:
            group["lr"] = (
                self.run.schedule.rate * min(1, (self.step + 1) / self.run.schedule.warm_up) * (0.5 + 0.5 * np.cos(np.pi * min(done, 1)))
            )
        self.network.train()
        prediction = self.predict(self.network, batch)
        loss = losses.total(losses.terms(prediction, batch, self.run.losses, rng, self.network.ranges), self.run.losses)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.run.schedule.clip)
        self.optimiser.step()
        loop.follow(self.average, self.network, self.step, 0.99)

    def predict(self, network, batch):
        with torch.autocast("cpu", torch.bfloat16):
            return network(batch.image, batch.mask, None, self.run.parts, None if "normals" in self.run.parts else batch.n)

    def averaged(self):
        """A network with the moving average's weights, ready to predict."""
        self.network.load_state_dict(self.average)
        return self.network.eval()


def report(out, seeds):
    """Ratios against standalone with 95 % intervals: bootstrap over shapes × materials, and over seeds; report.json, report.md."""
    summary = {}
    for part, variants in VARIANTS.items():
        runs = {v: [json.loads((out / f"{part}-{v}-{s}.json").read_text()) for s in seeds] for v in variants}
        keys = [k for k in runs["standalone"][0]["rows"][0] if k not in ("shape", "material")]
        summary[part] = {v: {k: float(np.mean([[row[k] for row in r["rows"]] for r in runs[v]])) for k in keys} for v in variants}
        for v in variants:
            summary[part][v]["steps"] = [r["steps"] for r in runs[v]]
        pairs = [("standalone", v) for v in variants if v != "standalone"] + ([("control", "combined")] if "control" in variants else [])
        summary[part]["ratios"] = {f"{b} / {a}": ratio(runs[a], runs[b], "l2") for a, b in pairs}
    first = runs["standalone"][0]
    summary["about"] = made_by() | {"seconds": first["seconds"], "pictures": len(first["rows"]), "seeds": len(seeds)}
    (out / "report.json").write_text(json.dumps(summary, indent=1) + "\n")
    (out / "report.md").write_text(page(summary), encoding="utf-8")
    return summary


def page(summary):
    """The report as a table for people."""
    about = summary["about"]
    lines = ["# Training through the layer against training without it (Section 4.3)", ""]
    told = f"{about['seconds']:g} s of processor time a run, {about['seeds']} seeds, {about['pictures']} pictures"
    lines += [told + " of shapes, materials and lights never seen.", ""]
    lines += ["| part | variant | render L2 | others | steps |", "|---|---|---|---|---|"]
    for part, variants in VARIANTS.items():
        for variant in variants:
            row = summary[part][variant]
            others = ", ".join(f"{key} {value:.4g}" for key, value in row.items() if key not in ("l2", "steps"))
            lines.append(f"| {part} | {variant} | {row['l2']:.0f} | {others} | {', '.join(map(str, row['steps']))} |")
    lines += ["", "Ratios of render L2, 95 % interval over shapes, materials and seeds:", ""]
    for part in VARIANTS:
        lines += [f"- {part}: {pair} = {x:.2f} [{low:.2f}, {high:.2f}]" for pair, (x, low, high) in summary[part]["ratios"].items()]
    lines += ["", " · ".join(f"{key}: {value}" for key, value in about.items())]
    return "\n".join(lines) + "\n"


def ratio(a, b, key):
    """[ratio of means b/a, low, high]: the pictures' shapes and materials, and the seeds, drawn with replacement DRAWS times."""
    A, B = (np.array([[row[key] for row in run["rows"]] for run in runs]) for runs in (a, b))
    groups = intervals.groups_of(*([row[name] for row in a[0]["rows"]] for name in ("shape", "material")))
    return intervals.ratio(A, B, groups, DRAWS)
