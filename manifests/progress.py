"""Progress bars whose rate and time left do not depend on the system's clock, which may jump.

tqdm reads time.time. When the clock of a laptop or a cluster's node is set while a job runs, its
bars show negative times, and rates of nothing per second.

In a log file, where each state of a bar stays, it is written every ten seconds.
"""

from __future__ import annotations

import sys
import time
from typing import Any

from tqdm import tqdm as _WallClock


class tqdm(_WallClock):
    """tqdm.tqdm by the monotonic clock."""

    monitor_interval = 0  # its thread would compare with time.time

    def __init__(self, *words: Any, **named: Any):
        named.setdefault("mininterval", 0.1 if sys.stderr.isatty() else 10.0)
        super().__init__(*words, **named)
        if not self.disable:
            self._time = time.monotonic
            self.start_t = self.last_print_t = time.monotonic()
