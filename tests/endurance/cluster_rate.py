"""Two nodes of one core each on a Ray cluster, and `--workers 2`: which share of the rate is left?

    PYTHONPATH=. python tests/endurance/cluster_rate.py JOB --out DIR [--rounds 4] [--fake]
    [--limit N] [--least 0.9]

renders JOB into new folders, in each round once with two processes and once on a cluster of two
nodes on this machine (ray.cluster_utils), in an order that turns round from one round to the next,
so that other work on the machine meets both. Both kinds of rate are reported:

rate      pictures per second from the first picture that was made to the last: start-up is left out
whole     pictures per second from the call to its return; the cluster runs already
per_processor_second  pictures for each second of a processor that all processes together use, Ray's
          included, from the first picture to the last: the rate where nothing else is the limit,
          which other work on the machine hardly changes

DIR/report.json has each round and the ratios of the cluster to the processes, as the geometric mean
over rounds and the worst round. It fails if the mean of `rate` is below --least. With --fake the
studio is a stand-in without Blender that sleeps 20 ms for each picture.
"""

import argparse
import json
import math
import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import psutil

from factory.execution.run import RunOptions, make_plan
from factory.execution.worker import STUDIO
from factory.planning import jobs
from factory.planning.assets import resolve
from manifests.provenance import provenance, shorten
from tests.endurance.lose_nodes import timed
from tests.support.ray_cluster import started
from tests.support.tetrahedron import FAKE, ROOT

NODES = 2


class Used:
    """Watches a run: the pictures for each second of a processor between the first and the last."""

    def __init__(self, pictures):
        self.pictures, self.made, self.first, self.rate = pictures, 0, 0.0, None

    def __call__(self, event, value):
        if event != "made":
            return
        self.made += 1
        if self.made == 1:
            self.first = processor_seconds()
        elif self.made == self.pictures:
            self.rate = (self.pictures - 1) / (processor_seconds() - self.first)


def processor_seconds():
    """Seconds of this process and all below it, among which are Ray's."""
    total, this = 0.0, psutil.Process()
    for each in (this, *this.children(recursive=True)):
        try:
            times = each.cpu_times()
        except psutil.NoSuchProcess:
            continue
        total += times.user + times.system
    return total


def rounds_of(plan, out, count, run_options):
    """Yield {"processes": figures, "cluster": figures} of each round."""
    import ray

    kinds = {
        "processes": replace(run_options, workers=NODES, threads=1),
        "cluster": replace(run_options, ray="auto"),
    }
    for k in range(count):
        result = {}
        for name in sorted(kinds, reverse=k % 2 == 0):
            folder = out / name
            shutil.rmtree(folder, ignore_errors=True)
            used = Used(min(len(plan), run_options.limit or len(plan)))
            if name == "processes":
                result[name] = timed(plan, folder, kinds[name], used)
            else:
                with started(ray, NODES):
                    result[name] = timed(plan, folder, kinds[name], used)
            figures = result[name] | {"per_processor_second": used.rate}
            result[name] = figures
            figures["load"] = os.getloadavg()[0]
            figures["whole"] = round(figures["made"] / figures["seconds"], 3)
            print(k, name, figures, flush=True)
        yield result


def ratios(rounds, key):
    """The geometric mean and the least of cluster / processes."""
    each = [of["cluster"][key] / of["processes"][key] for of in rounds]
    return {"mean": math.exp(sum(map(math.log, each)) / len(each)), "worst": min(each)}


def main():
    """Measure, write the report, and compare with --least."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("job")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--fake", action="store_true")
    parser.add_argument("--limit", type=int, help="pictures of each run (default: the whole job)")
    parser.add_argument("--least", type=float, default=0.9)
    options = parser.parse_args()
    inherited = os.environ.get("PYTHONPATH", "")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), inherited])
    if options.fake:
        os.environ["FAKE_STUDIO"] = "slow"
    job, folder = jobs.load(options.job)
    plan = make_plan(job, resolve(job, folder))
    studio = FAKE if options.fake else STUDIO
    words = " ".join(map(shorten, sys.argv[1:]))
    report = provenance(f"PYTHONPATH=. python tests/endurance/cluster_rate.py {words}")
    report["rounds"] = []
    options.out.mkdir(parents=True, exist_ok=True)
    run_options = RunOptions(studio=studio, limit=options.limit)
    for each in rounds_of(plan, options.out, options.rounds, run_options):
        report["rounds"].append(each)
        report["rate"] = ratios(report["rounds"], "pictures_per_second")
        report["whole"] = ratios(report["rounds"], "whole")
        report["processor"] = ratios(report["rounds"], "per_processor_second")
        (options.out / "report.json").write_text(json.dumps(report, indent=1) + "\n")
    print(
        json.dumps(
            {key: report[key] for key in ("rate", "whole", "processor", "machine")}, indent=1
        )
    )
    return 0 if report["rate"]["mean"] >= options.least else 1


if __name__ == "__main__":
    sys.exit(main())
