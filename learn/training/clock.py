"""How long a run has taken, and how much of its time is over."""

import contextlib
import time
from collections.abc import Iterator

import torch

from learn.data.settings import Schedule


class Clock:
    """The time of a run's steps in seconds: `used` by the processor, `passed` by the clock.

    schedule   has the limits of both
    is_shared  whether several processes train the run: the first one's times hold for all
    device     on which they exchange them
    """

    def __init__(self, schedule: Schedule, is_shared: bool, device: torch.device) -> None:
        self.limits = schedule.seconds, schedule.clock_seconds
        self.is_shared = is_shared and any(limit is not None for limit in self.limits)
        self.device = device
        self.used, self.passed = 0.0, 0.0
        self._before = 0.0

    def start(self) -> None:
        """Begin to count: `passed` has all time from here on, with that between steps."""
        self._before = time.monotonic()

    @contextlib.contextmanager
    def step(self) -> Iterator[None]:
        """A block that is one step."""
        begun = time.process_time()
        yield
        self.used += time.process_time() - begun
        now = time.monotonic()
        self.passed, self._before = self.passed + now - self._before, now
        # the learning rate and the end follow the times, and must be the same in all processes
        if self.is_shared:
            times = torch.tensor([self.used, self.passed], dtype=torch.float64, device=self.device)
            torch.distributed.broadcast(times, 0)
            self.used, self.passed = times.tolist()

    def share(self) -> float:
        """Return the share of the run's time limit that is used up; 0 without such a limit."""
        return max(
            0.0 if limit is None else spent / limit
            for spent, limit in zip((self.used, self.passed), self.limits, strict=True)
        )
