"""The processes of a run: one that writes into its folder, and workers that make its batches."""

import contextlib
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

import torch

from learn.data.batch import ExampleBatch
from manifests import lock, stop_signals
from manifests.errors import InputError

PATIENCE = 2.0  # seconds that a killed run may take to be gone
_LOCKS: list[int] = []  # descriptors of the folders that this process has locked


class BatchSource(Protocol):
    """Batches by their number; each is a function of the seed and the number alone."""

    def __getitem__(self, k: int) -> ExampleBatch: ...


@contextlib.contextmanager
def lock_run_folder(out: str | Path) -> Iterator[None]:
    """Lock the folder of a run for a block: a second run there would write each line twice.

    Of several processes of one run (torchrun) the first locks it. Raises InputError if another run
    has locked the folder.
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


def load_batches(
    source: BatchSource, order: Sequence[int], workers: int, pin_memory: bool
) -> Iterator[ExampleBatch]:
    """Yield the batches of a source in the given order, made by `workers` processes.

    workers     number of processes; 0: this one makes them
    pin_memory  whether batches are in page-locked memory, for copies to a GPU
    Raises   InputError: a batch that cannot be made, a worker that was killed
    """
    if not workers:
        yield from (source[k] for k in order)
        return
    loader = torch.utils.data.DataLoader(
        ErrorsAsValues(source),
        batch_size=None,
        sampler=order,
        num_workers=workers,
        worker_init_fn=start_worker,
        prefetch_factor=2,
        pin_memory=pin_memory,
    )
    yield from receive_batches(loader)


class ErrorsAsValues(torch.utils.data.Dataset):
    """Batches of a source; in place of one that cannot be made its InputError or OSError.

    A DataLoader passes on the errors of its workers only as text, with a stack trace in it.
    """

    def __init__(self, source: BatchSource):
        self.source = source

    def __getitem__(self, k: int) -> ExampleBatch | Exception:
        """Return the k-th batch, or the error that prevented it."""
        try:
            return self.source[k]
        except (InputError, OSError) as error:
            return error


def receive_batches(loader: Iterable[ExampleBatch | Exception]) -> Iterator[ExampleBatch]:
    """Yield the batches of a DataLoader over ErrorsAsValues.

    Raises the errors among them, and InputError where one of its workers was killed.
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


def start_worker(_: int) -> None:
    """Prepare a worker: one thread, and no lock on the run's folder that would outlive the run."""
    stop_signals.restore_defaults()
    torch.set_num_threads(1)
    for descriptor in _LOCKS:
        os.close(descriptor)


def end_without_finalising() -> None:
    """End one of several processes of a run at once, with status 0, once all is written.

    Python's own end of a process would let threads of torch.distributed release tensors while the
    interpreter shuts down, where they can wait for ever (pytorch's issue 190489); torchrun then
    waits with them. A process that trains alone is left to Python.
    """
    if int(os.environ.get("WORLD_SIZE", 1)) == 1:
        return
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)
