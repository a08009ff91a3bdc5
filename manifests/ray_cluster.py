"""The Ray cluster that rendering and evaluation run on: how it is found, or started here.

Ray unpickles what it is sent, and so does this program where it uses Ray: whoever may send to a
cluster can run programs on it (docs/clusters.md). What this program itself sends is JSON.
"""

import contextlib
from collections.abc import Iterator
from typing import Any

from manifests.errors import InputError
from manifests.subprocesses import processors

OBJECT_STORE_BYTES = 100 << 20  # of a cluster that is started here; messages are small
SCALE_SECONDS = 5.0  # between looks at how many CPUs the cluster has
MOST_LOSSES = 5  # of its worker, after which a piece of work is given up
# workers lost without a result in between, after which the cluster is at fault
MOST_LOST_IN_A_ROW = 20


@contextlib.contextmanager
def connected(address: str) -> Iterator[None]:
    """Connect to a Ray cluster for the length of a block.

    address  "auto": the cluster of this machine, or else a new one with all of its CPUs, which
             ends with the block; or HOST:PORT. Where Ray is connected already, that is used
    Raises   InputError: ray is missing, or no cluster answers there
    """
    import os

    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is reported to anyone
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    # of a cluster that is started here: Ray's own 15 would let any other program go first
    os.environ.setdefault("RAY_worker_niceness", "0")
    try:
        import ray
        from ray.exceptions import RayError
    except ImportError as error:
        remedy = "pip install 'ray==2.60.*'"
        raise InputError("--ray", "the package ray", str(error).split(":")[0], remedy) from None
    if ray.is_initialized():
        yield
        return
    if address != "auto":
        _require_answer(address)
    elif _last_one_is_gone():
        address = "local"
    shared: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    try:
        try:
            if address != "local":
                ray.init(address=address, **shared)
        except ConnectionError:
            if address != "auto":
                raise
            address = "local"
        if address == "local":
            ray.init(
                address="local",
                num_cpus=processors(),
                include_dashboard=False,
                object_store_memory=OBJECT_STORE_BYTES,
                **shared,
            )
    except (ConnectionError, ValueError, RuntimeError, OSError, RayError) as error:
        remedy = "start one with: ray start --head; or give --ray auto"
        reason = (str(error).strip().splitlines() or ["no answer"])[0][:200]
        raise InputError("--ray", f"a Ray cluster at '{address}'", reason, remedy) from None
    try:
        yield
    finally:
        ray.shutdown()


def _last_one_is_gone() -> bool:
    """Return whether Ray's note of the cluster started last on this machine names one that is gone.

    A cluster that was killed leaves its note, and Ray would try its address for minutes.
    """
    import os
    from pathlib import Path

    if os.environ.get("RAY_ADDRESS"):  # Ray looks there first
        return False
    folder = os.environ.get("RAY_TMPDIR") or os.environ.get("TMPDIR") or "/tmp"
    note = Path(folder) / "ray" / "ray_current_cluster"
    try:
        _require_answer(note.read_text().strip())
    except InputError:
        return True
    except (OSError, UnicodeDecodeError):  # no note, or one that cannot be read: Ray's own matter
        return False
    return False


def _require_answer(address: str) -> None:
    """Raise InputError if nothing answers at HOST:PORT; Ray itself would try for a minute."""
    import socket

    remedy = "give HOST:PORT as `ray start --head` prints it, or --ray auto"
    host, _, port = address.rpartition(":")
    if not host or not (port.isascii() and port.isdigit() and 0 < int(port[:6]) < 65536):
        raise InputError("--ray", "auto or HOST:PORT", f"'{address}'", remedy)
    try:
        socket.create_connection((host, int(port)), timeout=10.0).close()
    except (OSError, UnicodeError) as error:
        raise InputError(
            "--ray", f"a Ray cluster at '{address}'", str(error)[:200], remedy
        ) from None


def workers(threads: int) -> int:
    """Return how many workers of so many threads the connected cluster has CPUs for, at least 1."""
    import ray

    return max(1, int(ray.cluster_resources().get("CPU", 0)) // threads)
