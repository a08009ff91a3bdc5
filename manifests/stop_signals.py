"""Signals by which others end a program, handled as Ctrl-C is.

`kill`, container engines, services and Slurm send SIGTERM, and terminals that close send SIGHUP.
By default, either ends Python at once and without a word. Raised as an exception instead, they end
workers, close files and say how to continue.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

NUMBERS = tuple(
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)
)  # Windows has no SIGHUP


class Stopped(KeyboardInterrupt):
    """One of these signals was received: its `number`."""

    def __init__(self, number: int):
        super().__init__(number)
        self.number = number


def raise_stopped(number: int, frame: FrameType | None) -> None:
    """Raise Stopped, as the handler of a signal. A second signal ends the program at once."""
    signal.signal(number, signal.SIG_DFL)
    raise Stopped(number)


@contextmanager
def raise_on_signals() -> Iterator[None]:
    """Raise Stopped for these signals in the block, unless somebody handles or ignores them."""
    main = threading.current_thread() is threading.main_thread()
    ours = [number for number in NUMBERS if main and signal.getsignal(number) == signal.SIG_DFL]
    for number in ours:
        signal.signal(number, raise_stopped)
    try:
        yield
    finally:
        for number in ours:
            if signal.getsignal(number) == raise_stopped:
                signal.signal(number, signal.SIG_DFL)


def restore_defaults() -> None:
    """End this process at once by these signals, as a worker that inherited their handler must."""
    for number in NUMBERS:
        if signal.getsignal(number) == raise_stopped:
            signal.signal(number, signal.SIG_DFL)
