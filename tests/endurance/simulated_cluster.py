"""A large job on a simulated cluster: the real scheduler, and workers that only let time pass.

    PYTHONPATH=. python tests/endurance/simulated_cluster.py PRESET --report DIR/report.json
    [--workers 640] [--shots N] [--out FILE]

factory.execution.ray_pool hands out all shots of a preset to as many workers, in simulated time. A
shot takes as many seconds of a processor as tests/endurance/thousandth.py measured for the kinds of
work that it needs (its report.json): what it shares with the worker's last shot costs nothing.
Printed are

hours     until the last worker is done, and what an even division of the work would take
again     how often a shape is loaded, and geometry rendered, beyond once for each shape and view
scheduler processor seconds of the scheduling process for each picture: its inverse is the rate of
          pictures that one such process can hand out, whatever the number of workers
"""

import argparse
import heapq
import json
import sys
import time
from types import ModuleType, SimpleNamespace

import msgspec

from factory.execution import ray_pool
from factory.execution.ray_worker import RayWorker
from factory.execution.run import (
    RunOptions,
    make_assignment,
    make_plan,
    shape_sources,
    worker_config,
)
from factory.execution.worker import Chunk, Reply
from factory.planning import jobs
from factory.planning.assets import resolve
from manifests.provenance import provenance, shorten
from manifests.store import Store
from manifests.subprocesses import processors


class Cluster(ModuleType):
    """Stands for the module ray: workers whose answers arrive in the order of simulated time."""

    def __init__(self, workers, cost):
        super().__init__("ray")
        self.workers, self.cost = workers, cost
        self.now, self.busy, self.due, self.count = 0.0, 0.0, [], 0
        self.loads, self.geometries = 0, 0
        self.exceptions = ModuleType("ray.exceptions")
        self.exceptions.RayError = type("RayError", (Exception,), {})

    def cluster_resources(self):
        return {"CPU": self.workers}

    def remote(self, **words):
        """Of an actor's class: its constructor."""
        assert words["num_cpus"] == 1
        return lambda of: SimpleNamespace(remote=lambda config: self.actor(of))

    def actor(self, of):
        """A worker."""
        assert of is RayWorker
        last = {"shape": None, "light": None, "materials": None, "views": set()}

        def make(line, is_retry):
            assert not is_retry
            seconds = 0.0
            replies = []
            for shot in msgspec.json.decode(line, type=Chunk).shots:
                took = self.seconds(shot, last)
                seconds += took
                replies.append(msgspec.json.encode(Reply(made=shot.id, seconds=took)))
            return self.after(seconds, replies)

        return SimpleNamespace(
            ready=SimpleNamespace(remote=lambda: self.after(0.0, True)),
            make=SimpleNamespace(remote=make),
        )

    def seconds(self, shot, last):
        """How long a worker takes for a shot after its last one."""
        kinds = ["picture", "writing"]
        if shot.shape != last["shape"]:
            last |= {"shape": shot.shape, "light": None, "materials": None, "views": set()}
            self.loads += 1
            kinds.append("shape")
        for name, value in (
            ("light", (shot.light, shot.rotation_texels)),
            ("materials", shot.materials),
        ):
            if last[name] != value:
                last[name] = value
                kinds.append(name)
        if shot.viewpoint not in last["views"]:
            last["views"].add(shot.viewpoint)
            self.geometries += 1
            kinds.append("geometry")
        took = sum(self.cost[kind] for kind in kinds)
        self.busy += took
        return took

    def after(self, seconds, answer):
        """A reference to an answer that comes so many seconds from now."""
        self.count += 1
        reference = (self.now + seconds, self.count)
        heapq.heappush(self.due, (*reference, answer))
        return reference

    def wait(self, references, num_returns, timeout):
        """The next answer."""
        when, number, answer = heapq.heappop(self.due)
        self.now, self.answer = when, answer
        return [(when, number)], []

    def get(self, reference):
        """What the reference stands for, that of the last `wait`."""
        return self.answer

    def kill(self, actor):
        """Nothing lives."""


def main():
    """Simulate and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("preset")
    parser.add_argument("--report", required=True, help="report.json of thousandth.py")
    parser.add_argument("--workers", type=int, default=640)
    parser.add_argument("--out", help="write the figures into this file too")
    options = parser.parse_args()
    words = " ".join(map(shorten, sys.argv[1:]))
    made_by = provenance(f"PYTHONPATH=. python tests/endurance/simulated_cluster.py {words}")
    with open(options.report) as file:
        cost = json.load(file)["presets"][options.preset]["processor"]["kinds"]
    job, folder = jobs.load(jobs.presets()[options.preset])
    plan = make_plan(job, resolve(job, folder, processes=processors()))
    cluster = Cluster(options.workers, cost)
    sys.modules["ray"], sys.modules["ray.exceptions"] = cluster, cluster.exceptions
    ray_pool._is_free = lambda config: True
    store, assignment = Store("nowhere"), make_assignment(plan)
    pool = ray_pool.RayPool(
        lambda k: worker_config(store, f"w{k}", assignment, RunOptions(ray="auto")),
        shape_sources(plan.assets.shapes),
        1,
        print,
    )
    begun, made, views = time.process_time(), 0, set()
    for shot, reply in pool.run(plan):
        made += bool(reply.made)
        views.add((shot.shape, shot.viewpoint))
    spent = time.process_time() - begun
    figures = {
        "made_by": made_by,
        "preset": options.preset,
        "workers": options.workers,
        "pictures": made,
        "seconds": cost,
        "hours": cluster.now / 3600,
        "hours_even": cluster.busy / options.workers / 3600,
        "shapes": len(plan.assets.shapes),
        "loads": cluster.loads,
        "views": len(views),
        "geometries": cluster.geometries,
        "scheduler_ms": 1e3 * spent / made,
    }
    text = json.dumps(figures, indent=1)
    print(text)
    if options.out:
        with open(options.out, "w") as file:
            file.write(text + "\n")
    return 0 if made == len(plan) else 1


if __name__ == "__main__":
    sys.exit(main())
