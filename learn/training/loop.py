"""The training of one network: steps, validations, weights and checkpoints.

Everything random in step k depends on (seed, k) alone: a run that was killed goes on from its last
checkpoint to bitwise the same weights, unless its schedule ends by the clock (`schedule.seconds`).
"""

import contextlib
import json
import math
import os
import time
from pathlib import Path

import msgspec
import numpy as np
import torch
from tqdm import tqdm

from learn.data import devices
from learn.data.settings import decode_run, require_trainable
from learn.data.sources import source_of
from learn.networks import features, tensor_file
from learn.networks import weights as checkpoint
from learn.networks.coding import Ranges
from learn.training import losses, schedule, validation
from learn.training import montage as training_sheet
from learn.training.journal import Journal
from manifests import lock
from manifests.errors import InputError
from manifests.files import require_place_for_file, write_bytes

WRITTEN = ("run.json", "log.jsonl", "weights.safetensors", "checkpoint.safetensors", "made.json")
EVERY_SECONDS = 120  # between checkpoints, if no count of steps is given
PATIENCE = 2.0  # seconds for a killed run to be gone
_LOCKS = []  # descriptors of the folders that this process holds


@contextlib.contextmanager
def only_writer(out):
    """Hold the folder of a run: a second run into it would write each line of the log twice. Raises
    InputError if another one is at it.

    Of several processes of one run (torchrun) the first holds it.
    """
    if int(os.environ.get("RANK", 0)):
        yield
        return
    with lock.writing(out, patience=PATIENCE) as held:
        _LOCKS.extend(held)
        try:
            yield
        finally:
            for descriptor in held:
                _LOCKS.remove(descriptor)


class Training:
    """One run in one process.

    run          learn.data.settings.Run; pools: learn.data.sources.pools; out: folder for weights,
    log and sheets
    sheet_every  steps between validations, each with a sheet; 0: none
    tensorboard  write its events too
    device       torch.device of network, optimiser, batches and losses; what is random comes from
    the CPU, but dropout
    """

    def __init__(
        self,
        run,
        data_splits,
        out,
        sheet_every=500,
        checkpoint_every=None,
        workers=1,
        tensorboard=False,
        device="cpu",
    ):
        require_trainable(run, f"run '{run.name}'")
        self.run, self.data_splits, self.out = run, data_splits, Path(out)
        self.sheet_every, self.checkpoint_every, self.workers = (
            sheet_every,
            checkpoint_every,
            workers,
        )
        self.rank, self.world = int(os.environ.get("RANK", 0)), int(os.environ.get("WORLD_SIZE", 1))
        self.device = torch.device(device)
        self.out.mkdir(parents=True, exist_ok=True)
        for name in WRITTEN:  # before hours of training, not after them
            require_place_for_file(self.out / name)
        torch.manual_seed(run.seed)
        labels = torch.from_numpy(np.stack(list(data_splits["train"].labels.values())))
        self.network = checkpoint.NETWORKS[run.network](Ranges.of(labels)).to(
            self.device, memory_format=torch.channels_last
        )
        self.average = {name: t.detach().clone() for name, t in self.network.state_dict().items()}
        self.optimiser = schedule.optimiser(self.network, run.schedule)
        self.step, self.skipped, self.used = 0, 0, 0.0
        requested = next(
            (phase.losses for phase in schedule.phases(run) if losses.by_features(phase.losses)),
            None,
        )
        self.features = (
            features.load(requested.features, requested.features_sha256).to(self.device)
            if requested
            else None
        )
        if (self.out / "checkpoint.safetensors").exists():
            self._resume()
        elif run.start:
            with tensor_file.opened(run.start) as stored:
                stored.require(checkpoint.shapes(self.network), f"this {self.network.name} network")
                checkpoint.fill(self.network, stored)
            self.average = {
                name: t.detach().clone() for name, t in self.network.state_dict().items()
            }
        self.journal = Journal(self.out, self.step, tensorboard) if self.rank == 0 else None
        self.model = self.network
        if self.world > 1:
            torch.distributed.init_process_group(devices.process_group_backend(self.device))
            own = None if self.device.type == "cpu" else [self.device]
            self.model = torch.nn.parallel.DistributedDataParallel(
                self.network, own, find_unused_parameters=True
            )

    def train(self):
        """All steps that are left; returns the last validation's figures."""
        run, last, figures = self.run, time.monotonic(), {}
        if self.rank == 0:
            write_bytes(
                self.out / "run.json", msgspec.json.format(msgspec.json.encode(run), indent=1)
            )
        total = schedule.steps(run)
        bar = tqdm(
            total=total, initial=self.step, unit="step", desc=run.name, disable=self.rank > 0
        )
        for batch in self._batches() if not self._is_done() else ():
            begun = time.process_time()
            record = self._one_step(batch.to(self.device, non_blocking=True))
            self.used += time.process_time() - begun
            self.step += 1
            bar.update()
            bar.set_postfix_str(
                f"{bar.format_dict['rate'] or 0:.2f} × {run.schedule.batch} samples/s, loss"
                f" {record['loss']:.3f}",
                refresh=False,
            )
            done = self._is_done()
            if self.rank == 0 and self.sheet_every and (done or self.step % self.sheet_every == 0):
                figures = self._validate()
                record |= {"validation": figures}
            if self.rank == 0:
                self.journal.write(record | {"cpu_seconds": round(self.used, 2)})
            due = (
                self.step % self.checkpoint_every == 0
                if self.checkpoint_every
                else time.monotonic() - last > EVERY_SECONDS
            )
            if self.rank == 0 and (done or due):
                self._save()
                last = time.monotonic()
            if done:
                break
        bar.close()
        if self.rank == 0:
            self.journal.close()
        if self.world > 1:
            torch.distributed.destroy_process_group()
        return figures

    def _is_done(self):
        seconds = self.run.schedule.seconds
        return self.step >= schedule.steps(self.run) or (
            seconds is not None and self.used >= seconds
        )

    def _source(self):
        """What the run learns from, by the number of its batch."""
        return source_of(
            self.data_splits["train"],
            self.run,
            self.run.schedule.batch,
            self.run.seed,
            (self.rank, self.world),
        )

    def _batches(self):
        source, order = self._source(), range(self.step, schedule.steps(self.run))
        if not self.workers:
            return (source[k] for k in order)
        return received(
            torch.utils.data.DataLoader(
                ErrorsAsValues(source),
                batch_size=None,
                sampler=order,
                num_workers=self.workers,
                worker_init_fn=begin_worker,
                prefetch_factor=2,
                pin_memory=self.device.type == "cuda",
            )
        )

    def _one_step(self, batch):
        run, phase = self.run, schedule.phase_at(self.run, self.step)
        self._set_rates(phase)
        seed = int(
            np.random.SeedSequence(run.seed, spawn_key=(7, self.step, self.rank)).generate_state(1)[
                0
            ]
        )
        torch.manual_seed(seed)  # dropout
        rng = torch.Generator().manual_seed(seed)  # sampled pixels
        self.model.train()
        # running statistics, which the forward pass moves
        buffers = [buffer.clone() for buffer in self.network.buffers()]
        start = time.process_time()
        prediction = self.predict(self.model, batch, phase.parts)
        after_network = time.process_time()
        if _is_finite(prediction):
            result = self._terms(prediction, batch, phase.losses, rng)
            loss = losses.total(result, phase.losses)
        # the layer would refuse it; gradients that are not finite let all processes of a run skip
        # this step
        else:
            result = {}
            loss = math.nan * sum(part.float().sum() for part in prediction if part is not None)
        after_losses = time.process_time()
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), run.schedule.clip)
        record = {"step": self.step, "loss": loss.item(), "gradient": norm.item()} | {
            name: value.item() for name, value in result.items()
        }
        if math.isfinite(record["loss"]) and math.isfinite(record["gradient"]):
            self.optimiser.step()
            schedule.follow(self.average, self.network, self.step, self.run.schedule.ema_decay)
        else:
            for buffer, before in zip(self.network.buffers(), buffers, strict=True):
                buffer.copy_(before)
            self._skip(batch, record)
        record |= _health(prediction)
        times = {
            "network": after_network - start,
            "losses": after_losses - after_network,
            "backward": time.process_time() - after_losses,
        }
        return record | {f"{name}_ms": round(1e3 * seconds, 1) for name, seconds in times.items()}

    def predict(self, model, batch, parts=None):
        """The model's Prediction of a batch, in the run's precision; parts: None for the run's."""
        parts = self.run.parts if parts is None else parts
        segments = batch.segments if self.run.data.regions > 1 else None
        with devices.mixed_precision(self.device, self.run.mixed_precision):
            n = None if "normals" in parts else batch.n
            return model(batch.image, batch.mask, segments, parts, n, self.run.data.regions)

    def _terms(self, prediction, batch, weights, rng):
        return losses.terms(prediction, batch, weights, rng, self.network.ranges, self.features)

    def averaged(self):
        """A network with the moving average's weights, ready to predict."""
        network = checkpoint.NETWORKS[self.run.network](self.network.ranges)
        network = network.to(self.device, memory_format=torch.channels_last)
        network.load_state_dict(self.average)
        return network.eval()

    def _set_rates(self, phase):
        done = (self.step - phase.first) / phase.steps
        if self.run.schedule.seconds is not None:
            done = max(done, self.used / self.run.schedule.seconds)
        rate, beta = schedule.learning_rate(self.run, phase, self.step, done)
        for group in self.optimiser.param_groups:
            group["lr"], group["betas"] = rate, (beta, group["betas"][1])

    def _skip(self, batch, record):
        """A step that is not finite changes nothing; its batch is kept for study, and too many of
        them end the run.
        """
        self.skipped += 1
        wrong = next(
            (
                n
                for n, p in self.network.named_parameters()
                if p.grad is not None and not p.grad.isfinite().all()
            ),
            "loss",
        )
        path = self.out / f"skipped-{self.step}{f'-{self.rank}' * (self.world > 1)}.safetensors"
        shown = {
            name: value for name, value in vars(batch).items() if isinstance(value, torch.Tensor)
        }
        checkpoint.save(path, shown, {"names": json.dumps(batch.names), "tensor": wrong})
        if self.skipped > self.run.skipped_steps:
            values = ", ".join(f"{k} {v:g}" for k, v in record.items() if not math.isfinite(v))
            where = f"step {self.step}, {batch.names[0]} and {len(batch.names) - 1} more"
            raise InputError(
                where,
                f"finite loss and gradients, but for {self.run.skipped_steps} steps",
                f"{values} in {wrong}",
                f"study {path}; the last good weights are in checkpoint.safetensors",
            )

    def _predicted(self, network, batch):
        """A Prediction for people and figures. Raises InputError if it is not finite."""
        prediction = self.predict(network, batch)
        if not _is_finite(prediction):
            where, remedy = (
                f"{self.out}: validation after step {self.step}",
                "lower schedule.rate in the run, and give another --out",
            )
            raise InputError(where, "finite predictions", "NaN or infinity", remedy)
        return prediction

    def _validate(self):
        """Figures of the moving average on the validation side; its sheet; weights for users."""
        network, data_split, batch = (
            self.averaged(),
            self.data_splits["validation"],
            self.run.schedule.batch,
        )
        with torch.no_grad(), validation.DeadUnits(network) as dead:
            figures = validation.over(
                lambda b: self._predicted(network, b),
                data_split,
                self.run,
                batches=2,
                device=self.device,
            )
            figures |= dead.figures()
            shown = source_of(data_split, self.run, batch, 1)[0].to(self.device)
            self.journal.show(
                self.step - 1,
                training_sheet.write(
                    self.out / f"sheet-{self.step:07d}.jpg", shown, self._predicted(network, shown)
                ),
            )
        run_json = msgspec.json.encode(self.run).decode()
        checkpoint.save_weights(
            self.out / "weights.safetensors",
            self.network,
            self.average,
            run_json,
            self.run.size,
            self.step,
        )
        return figures

    def _save(self):
        kept = {f"network.{name}": t for name, t in self.network.state_dict().items()} | {
            f"average.{n}": t for n, t in self.average.items()
        }
        for i, parameter in enumerate(self.network.parameters()):
            for name, value in self.optimiser.state.get(parameter, {}).items():
                kept[f"optimiser.{i}.{name}"] = value
        metadata = {
            "step": str(self.step),
            "skipped": str(self.skipped),
            "used": str(self.used),
            "run": msgspec.json.encode(self.run).decode(),
            "digest": checkpoint.digest_of(kept),
        }
        checkpoint.save(self.out / "checkpoint.safetensors", kept, metadata)

    def _resume(self):
        """Go on from the checkpoint. Raises InputError for one of other settings, and for a damaged
        one, which stays as it is.
        """
        path = self.out / "checkpoint.safetensors"
        with (
            checkpoint.remedy(checkpoint.DAMAGED),
            tensor_file.opened(path, "a checkpoint") as stored,
        ):
            progress = checkpoint.progress_of(stored)
            is_ours = decode_run(progress.run.encode(), path) == self.run
            if is_ours:
                expected, of_optimiser = self._shapes(stored)
                stored.require(expected, "this run")
                kept = {name: stored.tensor(name) for name in expected}
        if not is_ours:
            hint = "give another --out, or the settings in run.json there"
            raise InputError(path, "a checkpoint of this run", "one of other settings", hint)
        total = schedule.steps(self.run)
        if progress.step > total:
            raise InputError(
                path,
                f"a checkpoint of at most {total} steps",
                f"one of {progress.step}",
                checkpoint.DAMAGED,
            )
        if progress.digest not in (None, checkpoint.digest_of(kept)):
            raise InputError(path, "the numbers that were saved", "others", checkpoint.DAMAGED)
        for state, prefix in ((self.network.state_dict(), "network."), (self.average, "average.")):
            for name, tensor in state.items():
                tensor.copy_(kept[prefix + name])
        for i, parameter in enumerate(self.network.parameters()):
            if i in of_optimiser:
                # "step" stays on the CPU: torch counts it there
                state = {name: kept[f"optimiser.{i}.{name}"] for name in of_optimiser[i]}
                moments = {
                    name: state[name].to(parameter.device) for name in ("exp_avg", "exp_avg_sq")
                }
                self.optimiser.state[parameter] = state | moments
        self.step, self.skipped, self.used = progress.step, progress.skipped, progress.used

    def _shapes(self, stored):
        """({name: shape} of all tensors of a checkpoint, {number of a parameter: {name: shape} of
        what the optimiser keeps of it}).

        Parameters that no stage has trained so far have no state.
        """
        optimiser = {}
        for i, parameter in enumerate(self.network.parameters()):
            if any(name.startswith(f"optimiser.{i}.") for name in stored.shapes):
                optimiser[i] = {
                    "step": (),
                    "exp_avg": tuple(parameter.shape),
                    "exp_avg_sq": tuple(parameter.shape),
                }
        result = checkpoint.shapes(self.network, "network.") | checkpoint.shapes(
            self.network, "average."
        )
        for i, of_one in optimiser.items():
            result |= {f"optimiser.{i}.{name}": shape for name, shape in of_one.items()}
        return result, optimiser


class ErrorsAsValues(torch.utils.data.Dataset):
    """Batches of a source; in place of one that cannot be made its InputError or OSError.

    A DataLoader raises errors of its processes anew from their text alone, with a trace in it.
    """

    def __init__(self, source):
        self.source = source

    def __getitem__(self, k):
        """The k-th Batch, or why there is none."""
        try:
            return self.source[k]
        except (InputError, OSError) as error:
            return error


def received(loader):
    """The batches of a DataLoader over ErrorsAsValues. Raises the errors among them; InputError
    where one of its processes was killed.
    """
    try:
        for batch in loader:
            if isinstance(batch, Exception):
                raise batch
            yield batch
    except RuntimeError as error:
        if "DataLoader worker" not in str(error):
            raise
        remedy = "run the same command again, which continues, with --workers 0"
        raise InputError(
            "--workers",
            "processes that live",
            "one that was killed, for want of memory perhaps",
            remedy,
        ) from None


def begin_worker(_):
    """A process that relights: one thread, and no hold on the run's folder when the run itself has
    ended.
    """
    torch.set_num_threads(1)
    for descriptor in _LOCKS:
        os.close(descriptor)


def _is_finite(prediction):
    """Whether all parts of a Prediction that are there are finite."""
    return all(bool(part.detach().isfinite().all()) for part in prediction if part is not None)


def _health(prediction):
    """Shares of outputs that learn no more: materials at the ends of tanh, lights without light."""
    result = {}
    if prediction.code is not None:
        result["saturated"] = (prediction.code.detach().abs() > 0.99).float().mean().item()
    if prediction.light_code is not None:
        result["dark_texels"] = (prediction.light_code.detach() < 1e-4).float().mean().item()
    return result
