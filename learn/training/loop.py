"""The training loop, read downward.

Everything random in step k depends on (seed, k) alone: a run that was killed goes on from its last checkpoint to bitwise the same weights.
"""

import json
import math
import os
import time
from pathlib import Path

import msgspec
import numpy as np
import torch
from tqdm import tqdm

from learn.networks.coding import Ranges
from learn.training import checkpoint, losses, measures, sheet
from learn.training.relit import Relit
from manifests.problems import Problem

EVERY_SECONDS = 120  # between checkpoints, if no count of steps is given
THIRDS = ((1.0, 0.9), (1e-2, 0.5), (1e-4, 0.5))  # paper: share of the rate and β₁


class Training:
    """One run in one process.

    run    learn.training.settings.Run; pools: learn.training.sources.pools; out: folder for weights, log and sheets
    """

    def __init__(self, run, pools, out, sheet_every=500, checkpoint_every=None, workers=1):
        self.run, self.pools, self.out = run, pools, Path(out)
        self.sheet_every, self.checkpoint_every, self.workers = sheet_every, checkpoint_every, workers
        self.rank, self.world = int(os.environ.get("RANK", 0)), int(os.environ.get("WORLD_SIZE", 1))
        self.out.mkdir(parents=True, exist_ok=True)
        torch.manual_seed(run.seed)
        labels = torch.from_numpy(np.stack(list(pools["train"].labels.values())))
        self.network = checkpoint.NETWORKS[run.network](Ranges.of(labels)).to(memory_format=torch.channels_last)
        self.average = {name: t.detach().clone() for name, t in self.network.state_dict().items()}
        self.optimiser = _optimiser(self.network, run.schedule)
        self.step = self.skipped = 0
        if (self.out / "checkpoint.safetensors").exists():
            self._resume()
        elif run.start:
            tensors, _ = checkpoint.load(run.start)
            checkpoint.fill(self.network, tensors, run.start)
            self.average = {name: t.detach().clone() for name, t in self.network.state_dict().items()}
        self.model = self.network
        if self.world > 1:
            torch.distributed.init_process_group("gloo")
            self.model = torch.nn.parallel.DistributedDataParallel(self.network, find_unused_parameters=True)

    def train(self):
        """All steps that are left; returns the last validation's figures."""
        run, last, figures = self.run, time.monotonic(), {}
        if self.rank == 0:
            (self.out / "run.json").write_bytes(msgspec.json.format(msgspec.json.encode(run), indent=1))
        bar = tqdm(total=run.schedule.steps, initial=self.step, unit="step", desc=run.name, disable=self.rank > 0)
        begun = time.process_time()
        for batch in self._batches():
            record = self._one_step(batch)
            self.step += 1
            bar.update()
            bar.set_postfix_str(
                f"{bar.format_dict['rate'] or 0:.2f} × {run.schedule.batch} samples/s, loss {record['loss']:.3f}", refresh=False
            )
            done = self.step == run.schedule.steps
            if self.rank == 0 and (done or self.step % self.sheet_every == 0):
                figures = self._validate()
                record |= {"validation": figures}
            self._log(record | {"cpu_seconds": round(time.process_time() - begun, 2)})
            due = self.step % self.checkpoint_every == 0 if self.checkpoint_every else time.monotonic() - last > EVERY_SECONDS
            if self.rank == 0 and (done or due):
                self._save()
                last = time.monotonic()
        bar.close()
        return figures

    def _batches(self):
        source = Relit(self.pools["train"], self.run.data, self.run.schedule.batch, self.run.size, self.run.seed, (self.rank, self.world))
        order = range(self.step, self.run.schedule.steps)
        if not self.workers:
            return (source[k] for k in order)
        return torch.utils.data.DataLoader(
            source, batch_size=None, sampler=order, num_workers=self.workers, worker_init_fn=one_thread, prefetch_factor=2
        )

    def _one_step(self, batch):
        run = self.run
        self._set_rates()
        seed = int(np.random.SeedSequence(run.seed, spawn_key=(7, self.step, self.rank)).generate_state(1)[0])
        torch.manual_seed(seed)  # dropout
        rng = torch.Generator().manual_seed(seed)  # sampled pixels
        self.model.train()
        start = time.process_time()
        prediction = self._predict(self.model, batch)
        after_network = time.process_time()
        found = losses.terms(prediction, batch, run.losses, rng, self.network.ranges)
        loss = losses.total(found, run.losses)
        after_losses = time.process_time()
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), run.schedule.clip)
        record = {"step": self.step, "loss": loss.item(), "gradient": norm.item()} | {name: value.item() for name, value in found.items()}
        if math.isfinite(record["loss"]) and math.isfinite(record["gradient"]):
            self.optimiser.step()
            follow(self.average, self.network, self.step, self.run.schedule.average)
        else:
            self._skip(batch, record)
        record |= _health(prediction)
        times = {"network": after_network - start, "losses": after_losses - after_network, "backward": time.process_time() - after_losses}
        return record | {f"{name}_ms": round(1e3 * seconds, 1) for name, seconds in times.items()}

    def _predict(self, model, batch):
        segments = batch.segments if self.run.data.regions > 1 else None
        with torch.autocast("cpu", torch.bfloat16, enabled=self.run.mixed_precision):
            return model(batch.image, batch.mask, segments, self.run.parts, None if "normals" in self.run.parts else batch.n)

    def _set_rates(self):
        schedule, done = self.run.schedule, self.step / self.run.schedule.steps
        if schedule.style == "paper":
            share, beta = THIRDS[min(int(3 * done), 2)]
        else:
            share, beta = min(1.0, (self.step + 1) / max(schedule.warm_up, 1)) * (0.5 + 0.5 * math.cos(math.pi * done)) + 1e-3, 0.9
        for group in self.optimiser.param_groups:
            group["lr"], group["betas"] = share * schedule.rate, (beta, group["betas"][1])

    def _skip(self, batch, record):
        """A step that is not finite changes nothing; its batch is kept for study, and too many of them end the run."""
        self.skipped += 1
        wrong = next((n for n, p in self.network.named_parameters() if p.grad is not None and not p.grad.isfinite().all()), "loss")
        path = self.out / f"skipped-{self.step}.safetensors"
        tensors = {name: value for name, value in vars(batch).items() if isinstance(value, torch.Tensor)}
        checkpoint.save(path, tensors, {"names": json.dumps(batch.names), "tensor": wrong})
        if self.skipped > self.run.skipped_steps:
            values = ", ".join(f"{k} {v:g}" for k, v in record.items() if not math.isfinite(v))
            where = f"step {self.step}, {batch.names[0]} and {len(batch.names) - 1} more"
            raise Problem(
                where,
                f"finite loss and gradients, but for {self.run.skipped_steps} steps",
                f"{values} in {wrong}",
                f"study {path}; the last good weights are in checkpoint.safetensors",
            )

    def _validate(self):
        weights = checkpoint.NETWORKS[self.run.network](self.network.ranges)
        weights.load_state_dict(self.average)
        weights.eval()
        with torch.no_grad():
            figures = measures.over(lambda b: self._predict(weights, b), self.pools["validation"], self.run, batches=2)
            shown = Relit(self.pools["validation"], self.run.data, self.run.schedule.batch, self.run.size, 1)[0]
            sheet.write(self.out / f"sheet-{self.step:07d}.jpg", shown, self._predict(weights, shown))
        checkpoint.save_weights(
            self.out / "weights.safetensors", self.network, self.average, msgspec.json.encode(self.run).decode(), self.run.size
        )
        return figures

    def _log(self, record):
        if self.rank == 0:
            with open(self.out / "log.jsonl", "a", encoding="utf-8") as log:
                log.write(json.dumps(record) + "\n")

    def _save(self):
        tensors = {f"network.{name}": t for name, t in self.network.state_dict().items()} | {
            f"average.{n}": t for n, t in self.average.items()
        }
        for i, parameter in enumerate(self.network.parameters()):
            for name, value in self.optimiser.state.get(parameter, {}).items():
                tensors[f"optimiser.{i}.{name}"] = value
        metadata = {"step": str(self.step), "skipped": str(self.skipped), "run": msgspec.json.encode(self.run).decode()}
        checkpoint.save(self.out / "checkpoint.safetensors", tensors, metadata)

    def _resume(self):
        path = self.out / "checkpoint.safetensors"
        tensors, metadata = checkpoint.load(path)
        if metadata.get("run") != msgspec.json.encode(self.run).decode():
            raise Problem(
                path, "a checkpoint of this run", "one of other settings", "give another --out, or the settings in run.json there"
            )
        checkpoint.fill(self.network, {n.removeprefix("network."): t for n, t in tensors.items() if n.startswith("network.")}, path)
        self.average = {n: tensors[f"average.{n}"] for n in self.average}
        for i, parameter in enumerate(self.network.parameters()):
            prefix = f"optimiser.{i}."
            if state := {n.removeprefix(prefix): t for n, t in tensors.items() if n.startswith(prefix)}:
                self.optimiser.state[parameter] = state
        self.step, self.skipped = int(metadata["step"]), int(metadata["skipped"])


def follow(average, network, step, memory):
    """The moving average {name: tensor} takes a step towards the weights; it hurries at first, so that the start is soon forgotten."""
    share = 1 - min(memory, (1 + step) / (10 + step))
    with torch.no_grad():
        for name, tensor in network.state_dict().items():
            if tensor.is_floating_point():
                average[name].lerp_(tensor, share)
            else:
                average[name].copy_(tensor)


def _optimiser(network, schedule):
    if schedule.style == "paper":
        return torch.optim.Adam(network.parameters(), schedule.rate)
    return torch.optim.AdamW(network.parameters(), schedule.rate, weight_decay=schedule.decay)


def one_thread(_):
    torch.set_num_threads(1)


def _health(prediction):
    """Shares of outputs that learn no more: materials at the ends of tanh, lights without light."""
    found = {}
    if prediction.code is not None:
        found["saturated"] = (prediction.code.detach().abs() > 0.99).float().mean().item()
    if prediction.light_code is not None:
        found["dark_texels"] = (prediction.light_code.detach() < 1e-4).float().mean().item()
    return found
