"""Decompositions in a thread of their own, with progress, which can be stopped."""

import threading
import time
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue

import torch

from learn.editing import decomposition
from learn.editing.decomposition import Decomposition
from learn.editing.photograph import Photograph
from learn.networks import weights as checkpoint
from learn.refinement import PHOTOGRAPHS


class Stopped(Exception):
    """The user pressed Stop, or closed the page."""


class Network:
    """The network that decomposes, loaded by the first photograph."""

    def __init__(self, weights: Path, device: str | torch.device = "cpu"):
        self.weights, self.device = weights, device
        self._lock = threading.Lock()
        self._loaded: tuple[torch.nn.Module, dict] | None = None

    def loaded(self) -> tuple[torch.nn.Module, dict]:
        """Return the network and its metadata."""
        with self._lock:
            if self._loaded is None:
                self._loaded = checkpoint.load_full_network(self.weights, self.device)
            return self._loaded


@dataclass
class Progress:
    """How far a decomposition is. share: 0 to 1; text: what is being done, for people."""

    share: float
    text: str


def decompose(
    opened: Photograph,
    network: Network,
    refine: bool,
    stop: threading.Event,
    shape: str | None = None,
) -> Generator[Progress, None, Decomposition]:
    """Yield the progress of a decomposition, and return it.

    stop    ends it within a step when it is set
    shape   as learn.editing.decomposition.decompose has it
    Raises  InputError; Stopped
    """
    reports: SimpleQueue[Progress | BaseException | Decomposition] = SimpleQueue()
    began = time.monotonic()

    def watch(done: int, expected: int) -> None:
        if stop.is_set():
            raise Stopped
        share = min(0.15 + 0.8 * done / expected, 0.95)
        seconds = time.monotonic() - began
        left = "" if done < 5 else f", about {seconds * (1 / share - 1):.0f} s left"
        text = f"refining, step {done} of about {max(expected, done)}{left}"
        reports.put(Progress(share, text))

    def work() -> None:
        try:
            reports.put(Progress(0.02, "loading the network"))
            module, metadata = network.loaded()
            if stop.is_set():
                raise Stopped
            reports.put(Progress(0.08, "reading shape, light and material"))
            settings = PHOTOGRAPHS if refine else None
            size = metadata["size"]
            reports.put(decomposition.decompose(opened, module, size, settings, watch, shape))
        except BaseException as error:
            reports.put(error)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    while True:
        try:
            report = reports.get(timeout=0.25)
        except Empty:
            if stop.is_set() and not thread.is_alive():
                raise Stopped from None
            continue
        while not reports.empty():  # the latest one
            if not isinstance(report, Progress):
                break
            report = reports.get()
        if isinstance(report, BaseException):
            raise report
        if isinstance(report, Decomposition):
            break
        yield report
    if stop.is_set():
        raise Stopped
    return report
