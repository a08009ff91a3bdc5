"""Trains one network: steps, validations, weights and checkpoints.

Everything random in step k depends only on (seed, k). A run that was killed therefore continues
from its last checkpoint to bitwise the same weights, unless its schedule ends by the clock
(`schedule.seconds`, `schedule.clock_seconds`).
"""

import json
import math
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch

from learn.data import devices
from learn.data.batch import ExampleBatch
from learn.data.data_split import DataSplit
from learn.data.seen import seen_in_splits
from learn.data.settings import Losses, Run, require_trainable
from learn.data.sources import make_batch_source
from learn.networks import features, weights
from learn.networks.coding import Ranges
from learn.networks.prediction import Coded
from learn.training import (
    checkpoints,
    contact_sheet,
    losses,
    processes,
    repetition,
    revival,
    schedule,
    validation,
)
from learn.training.buffers import StoredBuffers
from learn.training.clock import Clock
from learn.training.initialisation import initialise
from learn.training.journal import Journal
from manifests.errors import InputError
from manifests.files import require_place_for_file, write_bytes
from manifests.progress import tqdm

WRITTEN = ("run.json", "log.jsonl", "weights.safetensors", "checkpoint.safetensors", "made.json")
EVERY_SECONDS = 120  # between checkpoints, if no number of steps is given
VALIDATION_BATCHES = 2


class Training:
    """The training of one run; under torchrun, one process's part of it.

    run           the run's settings
    data_splits   {side: DataSplit} as learn.data.sources.load_data_splits returns them
    out           folder for weights, log and contact sheets
    sheet_every   steps between validations, each with a contact sheet; 0: none
    checkpoint_every  steps between checkpoints; None: one every EVERY_SECONDS
    workers       number of processes that make batches; 0: this process makes them
    tensorboard   whether to write TensorBoard's events too
    device        of network, optimiser, batches and losses; random numbers come from the CPU,
                  except those of dropout
    """

    def __init__(
        self,
        run: Run,
        data_splits: Mapping[str, DataSplit],
        out: str | Path,
        sheet_every: int = 500,
        checkpoint_every: int | None = None,
        workers: int = 1,
        tensorboard: bool = False,
        device: torch.device | str = "cpu",
    ):
        require_trainable(run, f"run '{run.name}'")
        self.run, self.data_splits, self.out = run, data_splits, Path(out)
        self.sheet_every, self.checkpoint_every = sheet_every, checkpoint_every
        self.workers = workers
        self.rank, self.world = int(os.environ.get("RANK", 0)), int(os.environ.get("WORLD_SIZE", 1))
        self.device = torch.device(device)
        torch.backends.cudnn.benchmark = True  # all batches have one size
        self.out.mkdir(parents=True, exist_ok=True)
        for name in WRITTEN:  # before hours of training, not after them
            require_place_for_file(self.out / name)
        torch.manual_seed(run.seed)
        labels = torch.from_numpy(np.stack(list(data_splits["train"].labels.values())))
        self.network = self._new_network(Ranges.of(labels))
        self.average = _copies(self.network)
        self.optimiser = schedule.make_optimiser(self.network, run.schedule)
        self.step, self.skipped = 0, 0
        self.clock = Clock(run.schedule, self.world > 1, self.device)
        self.features = self._load_features()
        self.seen = seen_in_splits(
            [data_splits[side] for side in ("train", "validation")], self._source_of_examples()
        )
        if (self.out / "checkpoint.safetensors").exists():
            progress, before = checkpoints.restore(
                self.out / "checkpoint.safetensors", run, self.network, self.average, self.optimiser
            )
            self.step, self.skipped = progress.step, progress.skipped
            self.clock.used, self.clock.passed = progress.used, progress.passed
            self.seen = self.seen.join(before)
        else:
            self.seen = initialise(self.network, run, self.seen)
            if run.revive:
                self._revive()
            self.average = _copies(self.network)
        self.journal = Journal(self.out, self.step, tensorboard) if self.rank == 0 else None
        self.buffers = StoredBuffers(self.network)
        self.model: torch.nn.Module = self.network
        if self.world > 1:
            torch.distributed.init_process_group(devices.process_group_backend(self.device))
            own = None if self.device.type == "cpu" else [self.device]
            self.model = torch.nn.parallel.DistributedDataParallel(
                self.network, own, find_unused_parameters=True
            )

    def train(self) -> dict[str, float]:
        """Make the remaining steps; return the figures of the last validation."""
        run, last = self.run, time.monotonic()
        self.clock.start()
        figures: dict[str, float] = {}
        if self.rank == 0:
            write_bytes(
                self.out / "run.json", msgspec.json.format(msgspec.json.encode(run), indent=1)
            )
        total = schedule.total_steps(run)
        bar = tqdm(
            total=total, initial=self.step, unit="step", desc=run.name, disable=self.rank > 0
        )
        for batch in self._batches() if not self._is_done() else ():
            with self.clock.step():
                record = self._make_step(batch)
            self.step += 1
            bar.update()
            bar.set_postfix_str(
                f"{bar.format_dict['rate'] or 0:.2f} × {run.schedule.batch} samples/s, loss"
                f" {record['loss']:.3f}",
                refresh=False,
            )
            done = self._is_done()
            if self.journal:
                if self.sheet_every and (done or self.step % self.sheet_every == 0):
                    figures = self._validate()
                    record |= {"validation": figures}
                elif done:
                    self._save_weights()
                self.journal.write(record | {"cpu_seconds": round(self.clock.used, 2)})
            due = (
                self.step % self.checkpoint_every == 0
                if self.checkpoint_every
                else time.monotonic() - last > EVERY_SECONDS
            )
            if self.rank == 0 and (done or due):
                self._save_checkpoint()
                last = time.monotonic()
            if done:
                break
        bar.close()
        # a run may have been stopped after its last step and before its weights were written
        if self.rank == 0 and not (self.out / "weights.safetensors").exists():
            self._save_weights()
        if self.journal:
            self.journal.close()
        if self.world > 1:
            torch.distributed.destroy_process_group()
        return figures

    def predict(
        self,
        model: torch.nn.Module,
        batch: ExampleBatch,
        parts: tuple[str, ...] | None = None,
    ) -> Any:
        """Return the model's Prediction of a batch, in the run's precision.

        parts  to predict; None: the run's
        """
        parts = self.run.parts if parts is None else parts
        segments = batch.segments if self.run.data.regions > 1 else None
        with devices.mixed_precision(self.device, self.run.mixed_precision):
            n = None if "normals" in parts else batch.n
            return model(batch.image, batch.mask, segments, parts, n, self.run.data.regions)

    def averaged_network(self) -> Coded:
        """Return a network with the moving average's weights, ready to predict."""
        network = self._new_network(self.network.ranges)
        network.load_state_dict(self.average)
        return network.eval()

    def _revive(self) -> None:
        """Reinitialise hidden units that the first batches never activate; print how many."""
        source = self._source()
        batches = [source[k].to(self.device) for k in range(revival.BATCHES)]
        rng = torch.Generator().manual_seed(self.run.seed)
        drawn = revival.revive(
            self.network, lambda network: [self.predict(network, b) for b in batches], rng
        )
        if self.rank == 0:
            counts = [f"{count} of {total} in {name}" for name, (count, total) in drawn.items()]
            print("units that no picture activated, reinitialised: " + ", ".join(counts))

    def _new_network(self, ranges: Ranges) -> Coded:
        network = weights.NETWORKS[self.run.network](ranges)
        # mypy knows no `to` with a memory format alone
        return network.to(self.device, memory_format=torch.channels_last)  # type: ignore[call-overload]

    def _load_features(self) -> features.Features | None:
        """Load the features of the first phase whose losses use features, if there is one."""
        for phase in schedule.phases(self.run):
            if losses.uses_features(phase.losses):
                loaded = features.load(phase.losses.features, phase.losses.features_sha256)
                return loaded.to(self.device)
        return None

    def _is_done(self) -> bool:
        return self.step >= schedule.total_steps(self.run) or self.clock.share() >= 1

    def _source_of_examples(self) -> str:
        """Return "relit", "pictures" or "mix"."""
        return self.run.data.source

    def _source(self) -> processes.BatchSource:
        """Return the source of the run's training batches, which are called by number."""
        return make_batch_source(
            self.data_splits["train"],
            self.run,
            self.run.schedule.batch,
            self.run.seed,
            (self.rank, self.world),
        )

    def _batches(self) -> Iterator[ExampleBatch]:
        """Yield the batch of each step that is left, on the run's device."""
        order = range(self.step, schedule.total_steps(self.run))
        source = self._source()

        def load(numbers: Sequence[int]) -> Iterator[ExampleBatch]:
            on_cuda = self.device.type == "cuda"
            for batch in processes.load_batches(source, numbers, self.workers, pin_memory=on_cuda):
                yield batch.to(self.device, non_blocking=True)

        # the versions are made on the device, to which each batch is copied once
        return repetition.repeat_batches(order, repetition.versions_of(self.run.data), load)

    def _make_step(self, batch: ExampleBatch) -> dict[str, Any]:
        """Make one step; return its figures."""
        phase = schedule.phase_at(self.run, self.step)
        self._set_learning_rate(phase)
        sequence = np.random.SeedSequence(self.run.seed, spawn_key=(7, self.step, self.rank))
        seed = int(sequence.generate_state(1)[0])
        torch.manual_seed(seed)  # dropout
        rng = torch.Generator().manual_seed(seed)  # sampled pixels
        self.model.train()
        self.buffers.store()  # the forward pass changes running statistics
        start = time.process_time()
        prediction = self.predict(self.model, batch, phase.parts)
        after_network = time.process_time()
        if validation.is_finite(prediction):
            terms = self._terms(prediction, batch, phase.losses, rng)
            loss = losses.total(terms, phase.losses)
        # The layer would refuse such a prediction. A loss that is not finite instead makes all
        # processes of the run skip this step.
        else:
            terms = {}
            loss = math.nan * sum(part.float().sum() for part in prediction if part is not None)
        after_losses = time.process_time()
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.run.schedule.clip)
        record = {"step": self.step, "loss": loss.item(), "gradient": norm.item()} | {
            name: value.item() for name, value in terms.items()
        }
        if math.isfinite(record["loss"]) and math.isfinite(record["gradient"]):
            self.optimiser.step()
            schedule.update_average(
                self.average, self.network, self.step, self.run.schedule.ema_decay
            )
        else:
            self.buffers.restore()
            self._skip(batch, record)
        times = {
            "network": after_network - start,
            "losses": after_losses - after_network,
            "backward": time.process_time() - after_losses,
        }
        milliseconds = {f"{name}_ms": round(1e3 * seconds, 1) for name, seconds in times.items()}
        return record | validation.measure_saturation(prediction) | milliseconds

    def _terms(
        self, prediction: Any, batch: ExampleBatch, loss_weights: Losses, rng: torch.Generator
    ) -> dict[str, torch.Tensor]:
        return losses.terms(
            prediction, batch, loss_weights, rng, self.network.ranges, self.features
        )

    def _set_learning_rate(self, phase: schedule.Phase) -> None:
        done = max((self.step - phase.first) / phase.steps, self.clock.share())
        learning_rate, beta = schedule.learning_rate(self.run, phase, self.step, done)
        schedule.set_learning_rate(self.optimiser, learning_rate, beta)

    def _skip(self, batch: ExampleBatch, record: Mapping[str, float]) -> None:
        """Count a step whose loss or gradients are not finite, and save its batch for inspection.

        Such a step changes nothing. Raises InputError if there are too many of them.
        """
        self.skipped += 1
        wrong = next(
            (
                name
                for name, parameter in self.network.named_parameters()
                if parameter.grad is not None and not parameter.grad.isfinite().all()
            ),
            "loss",
        )
        path = self.out / f"skipped-{self.step}{f'-{self.rank}' * (self.world > 1)}.safetensors"
        tensors = {
            name: value for name, value in vars(batch).items() if isinstance(value, torch.Tensor)
        }
        weights.save(path, tensors, {"names": json.dumps(batch.names), "tensor": wrong})
        if self.skipped > self.run.skipped_steps:
            values = ", ".join(f"{k} {v:g}" for k, v in record.items() if not math.isfinite(v))
            where = f"step {self.step}, {batch.names[0]} and {len(batch.names) - 1} more"
            raise InputError(
                where,
                f"finite loss and gradients, but for {self.run.skipped_steps} steps",
                f"{values} in {wrong}",
                f"study {path}; the last good weights are in checkpoint.safetensors",
            )

    def _predict_finite(self, network: torch.nn.Module, batch: ExampleBatch) -> Any:
        """Return a Prediction for validation. Raises InputError if it is not finite."""
        prediction = self.predict(network, batch)
        if not validation.is_finite(prediction):
            where = f"{self.out}: validation after step {self.step}"
            remedy = "lower schedule.learning_rate in the run, and give another --out"
            raise InputError(where, "finite predictions", "NaN or infinity", remedy)
        return prediction

    def _validate(self) -> dict[str, float]:
        """Measure the moving average of the weights on the validation split; return the figures.

        Also writes a contact sheet and weights.safetensors.
        """
        network, data_split = self.averaged_network(), self.data_splits["validation"]
        with torch.no_grad(), validation.DeadUnits(network) as dead:
            figures = validation.validate(
                lambda b: self._predict_finite(network, b),
                data_split,
                self.run,
                VALIDATION_BATCHES,
                device=self.device,
            )
            figures |= dead.figures()
            source = make_batch_source(data_split, self.run, self.run.schedule.batch, 1)
            batch = source[0].to(self.device)
            picture = contact_sheet.write(
                self._sheet_path(), batch, self._predict_finite(network, batch)
            )
            if self.journal:
                self.journal.add_contact_sheet(self.step - 1, picture)
        self._save_weights()
        return figures

    def _sheet_path(self) -> Path:
        return self.out / f"sheet-{self.step:07d}.jpg"

    def _save_weights(self) -> None:
        """Write weights.safetensors.

        If the run uses the data set's own materials, the file also holds their labels, from which
        refinement derives the directions in which it changes a material.
        """
        of_dataset = self.run.data.materials == "dataset"
        labels = list(self.data_splits["train"].labels.values()) if of_dataset else None
        weights.save_weights(
            self.out / "weights.safetensors",
            self.network,
            self.average,
            msgspec.json.encode(self.run).decode(),
            self.run.size,
            self.step,
            None if labels is None else np.stack(labels),
            self.seen,
        )

    def _save_checkpoint(self) -> None:
        progress = {
            "step": self.step,
            "skipped": self.skipped,
            "used": self.clock.used,
            "passed": self.clock.passed,
        }
        path = self.out / "checkpoint.safetensors"
        checkpoints.write(
            path, self.run, self.network, self.average, self.optimiser, progress, self.seen
        )


def _copies(network: torch.nn.Module) -> dict[str, torch.Tensor]:
    """Return {name: copy} of a network's tensors."""
    return {name: t.detach().clone() for name, t in network.state_dict().items()}
