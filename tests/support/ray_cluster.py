"""A Ray cluster of several nodes on this machine, by Ray's own utility."""

import os
from contextlib import contextmanager

STORE = 100 << 20  # bytes of each node's object store
ATTEMPTS = 4  # Ray waits 30 s for each of its processes, which a busy machine may not keep


@contextmanager
def started(ray, nodes):
    """A head without CPUs and nodes of one CPU each: (Cluster, [node, …]); connected to it."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_worker_niceness", "0")  # as manifests.ray_cluster does
    for attempt in range(ATTEMPTS):
        made = _head()
        try:
            each = [made.add_node(num_cpus=1, object_store_memory=STORE) for _ in range(nodes)]
            ray.init(address=made.address, log_to_driver=False, logging_level="ERROR")
            break
        except Exception as error:
            ray.shutdown()
            made.shutdown()
            if "timed out" not in str(error) or attempt == ATTEMPTS - 1:
                raise
    try:
        yield made, each
    finally:
        ray.shutdown()
        made.shutdown()


def _head():
    """A cluster of a head alone."""
    from ray.cluster_utils import Cluster

    for attempt in range(ATTEMPTS):
        try:
            return Cluster(
                initialize_head=True,
                head_node_args={
                    "num_cpus": 0,
                    "include_dashboard": False,
                    "object_store_memory": STORE,
                },
            )
        except Exception as error:
            if "timed out" not in str(error) or attempt == ATTEMPTS - 1:
                raise
    raise AssertionError("the last attempt returns or raises")
