"""How processes of this program's own are started.

`python -m MODULE` puts the working folder first on the search path, where a user may have a
factory.py or a folder learn/. Such a process therefore leaves the working folder out (`-P`), and is
told where this process's packages are.
"""

import multiprocessing
import os
import sys
import threading
from pathlib import Path

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


def end_with_parent() -> None:
    """Let this process of a pool end when the process that started it has ended.

    A pool whose owner was killed would otherwise wait for work, and keep its memory, for ever.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:

        def end() -> None:
            parent.join()
            os._exit(1)

        threading.Thread(target=end, daemon=True).start()
