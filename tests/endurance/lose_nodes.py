"""Nodes of a Ray cluster are killed while they work: is anything lost, anything twice, and is the
end the same as of an undisturbed run?

    PYTHONPATH=. python tests/endurance/lose_nodes.py JOB --losses 20 --out DIR [--fake] [--nodes 2]

renders JOB into DIR/alone with `--workers` of as many processes as there are nodes, and into
DIR/cluster on a cluster of nodes of one CPU each, all on this machine (ray.cluster_utils). Whenever
a share of the pictures is made, a random node is killed without notice and a new one is added. It
compares the two folders, verifies the second, and writes DIR/report.json. With --losses 0 the two
rates of pictures are those to compare. With --fake the studio is a stand-in without Blender that
takes 20 ms for a picture, and records are compared by their files' hashes; with Blender by their
ids, since two renders of a shot differ by 2e-6.
"""

import argparse
import os
import random
import sys
import time
from collections import Counter
from pathlib import Path

import msgspec

from factory.execution.run import RunOptions, carry_out, make_plan
from factory.execution.worker import STUDIO
from factory.planning import jobs
from factory.planning.assets import resolve
from manifests.files import write_json
from manifests.provenance import provenance, shorten
from manifests.store import Store
from manifests.verification import faults_of
from tests.support.ray_cluster import STORE, started
from tests.support.tetrahedron import FAKE, ROOT


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("job")
    parser.add_argument("--losses", type=int, default=20)
    parser.add_argument("--nodes", type=int, default=2)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--fake", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    import ray

    inherited = os.environ.get("PYTHONPATH", "")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), inherited])
    if options.fake:
        os.environ["FAKE_STUDIO"] = "slow"
    studio = FAKE if options.fake else STUDIO
    job, folder = jobs.load(options.job)
    plan = make_plan(job, resolve(job, folder))
    alone = RunOptions(workers=options.nodes, threads=1, studio=studio)
    words = " ".join(map(shorten, sys.argv[1:]))
    report = provenance(f"PYTHONPATH=. python tests/endurance/lose_nodes.py {words}")
    report |= {"shots": len(plan), "losses": 0, "alone": timed(plan, options.out / "alone", alone)}
    draw = random.Random(options.seed)
    made = 0
    with started(ray, options.nodes) as (cluster, nodes):

        def watch(event, value):
            nonlocal made
            if event == "note":
                print(value, flush=True)
            if event != "made":
                return
            made += 1
            share = len(plan) // (options.losses + 1)
            if made % max(share, 1) == 0 and report["losses"] < options.losses:
                node = nodes.pop(draw.randrange(len(nodes)))
                cluster.remove_node(node, allow_graceful=False)
                nodes.append(cluster.add_node(num_cpus=1, object_store_memory=STORE))
                report["losses"] += 1

        on_nodes = RunOptions(studio=studio, ray="auto")
        report["cluster"] = timed(plan, options.out / "cluster", on_nodes, watch)
    report |= compared(plan, options.out, options.fake)
    write_json(options.out / "report.json", report)
    print((options.out / "report.json").read_text())


def timed(plan, folder, run_options, watch=None):
    """Carry a plan out; what was made, and pictures per second from the first one on."""
    first = last = None

    def times(event, value):
        nonlocal first, last
        if event == "made":
            last = time.perf_counter()
            first = first or last
        if watch:
            watch(event, value)

    begun = time.perf_counter()
    outcome = carry_out(plan, folder, run_options, times)
    span = (last - first) if first is not None else 0.0
    return {
        "made": outcome.made,
        "failed": outcome.failed,
        "seconds": round(time.perf_counter() - begun, 1),
        "pictures_per_second": round((outcome.made - 1) / span, 2) if span else None,
    }


def compared(plan, folder, fake):
    """How many shots were lost, doubled or differ, and what `verify` has to say."""
    ids = {shot.id for shot in plan}
    records = {name: list(Store(folder / name).records()) for name in ("alone", "cluster")}
    counts = Counter(record.id for record in records["cluster"])
    theirs = {record.id: content(record, fake) for record in records["alone"]}
    return {
        "lost": len(ids - set(counts)),
        "doubled": sum(count > 1 for count in counts.values()),
        "differing": sum(content(r, fake) != theirs.get(r.id) for r in records["cluster"]),
        "faults": [fault.text for fault in faults_of(Store(folder / "cluster"))][:10],
    }


def content(record, fake):
    """What of a record must be the same in both runs."""
    words = msgspec.to_builtins(record)
    varying = {"seconds"}
    if not fake:
        varying |= {"image_hash", "geometry_hash", "statistics"}
    return {key: value for key, value in words.items() if key not in varying}


if __name__ == "__main__":
    main()
