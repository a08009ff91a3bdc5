"""How processes of this program's own are started.

`python -m MODULE` puts the working folder first on the search path, where a user may have a
factory.py or a folder learn/. Such a process therefore leaves the working folder out (`-P`), and is
told where this process's packages are.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import threading
from collections.abc import Callable, Generator, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from manifests import stop_signals
from manifests.errors import InputError

if TYPE_CHECKING:
    from concurrent.futures import Executor

T = TypeVar("T")
R = TypeVar("R")

PACKAGES = Path(__file__).resolve().parents[1]


def command_of(module: str) -> list[str]:
    """Return the words that start a module of this program in a process of its own."""
    return [sys.executable, "-P", "-m", module]


def environment() -> dict[str, str]:
    """Return this process's environment variables, with the folder of its packages on the path."""
    inherited = os.environ.get("PYTHONPATH")
    path = os.pathsep.join([str(PACKAGES), *([inherited] if inherited else [])])
    return {**os.environ, "PYTHONPATH": path}


def processors() -> int:
    """Return the number of CPUs that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def results_of(
    pool: Executor, work: Callable[[T], R], tasks: Iterable[T], where: str, remedy: str
) -> Generator[tuple[T, R]]:
    """Yield each task with its result as soon as it is done, and shut the pool down.

    After an error, tasks that were not begun are left out: all together may take hours.

    where, remedy  of the InputError
    Raises         InputError where a process of the pool was killed; what the work raises
    """
    from concurrent.futures import as_completed
    from concurrent.futures.process import BrokenProcessPool

    try:
        pending = {pool.submit(work, task): task for task in tasks}
        for done in as_completed(pending):
            yield pending[done], done.result()
    except BrokenProcessPool:
        rule, result = "processes that live", "one that was killed, for want of memory perhaps"
        raise InputError(where, rule, result, remedy) from None
    finally:
        pool.shutdown(cancel_futures=True)


def end_with_parent() -> None:
    """Let this process of a pool end when the process that started it has ended.

    A pool whose owner was killed would otherwise wait for work, and keep its memory, for ever.
    """
    stop_signals.restore_defaults()
    parent = multiprocessing.parent_process()
    if parent is not None:

        def end() -> None:
            parent.join()
            os._exit(1)

        threading.Thread(target=end, daemon=True).start()
