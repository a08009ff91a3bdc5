"""A Ray cluster of several nodes on this machine, by Ray's own utility."""

from contextlib import contextmanager

STORE = 100 << 20  # bytes of each node's object store


@contextmanager
def started(ray, nodes):
    """A head without CPUs and nodes of one CPU each: (Cluster, [node, …]); connected to it."""
    import os

    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_worker_niceness", "0")  # as manifests.ray_cluster does
    from ray.cluster_utils import Cluster

    made = Cluster(
        initialize_head=True,
        head_node_args={
            "num_cpus": 0,
            "include_dashboard": False,
            "object_store_memory": STORE,
        },
    )
    try:
        each = [made.add_node(num_cpus=1, object_store_memory=STORE) for _ in range(nodes)]
        ray.init(address=made.address, log_to_driver=False, logging_level="ERROR")
        yield made, each
    finally:
        ray.shutdown()
        made.shutdown()
