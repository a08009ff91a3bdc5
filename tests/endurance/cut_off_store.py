"""The connection to an object store is cut, stalled and slowed while a job is rendered into it: is
anything lost, anything twice, and is the end the same as of an undisturbed run?

    PYTHONPATH=. python tests/endurance/cut_off_store.py JOB --faults 20 --out DIR

renders JOB into DIR/whole, and into a store on this machine, by default a bucket of an S3 server
(moto, as a process; `make s3-server` installs it; for --protocol sftp, az or gs it is one of
tests/support/store_servers.py), through a proxy that disturbs the connection (tests/support/
network_faults.py), with two workers and a stand-in for Blender that takes 20 ms for a picture. Each
fault lasts a random time of up to --seconds, and on until it has met at least one request. The
store is then compared with the folder, verified, and read; DIR/report.json has the result.
"""

import argparse
import os
import random
import sys
import threading
import time
from collections import Counter
from pathlib import Path

import msgspec

from factory.execution import uploads
from factory.execution.run import RunOptions, carry_out, make_plan
from factory.planning import jobs
from factory.planning.assets import resolve
from manifests import object_store
from manifests.cached_store import open_store
from manifests.files import write_json
from manifests.provenance import provenance, shorten
from manifests.verification import faults_of
from tests.support import store_servers
from tests.support.network_faults import KINDS, Proxy
from tests.support.tetrahedron import FAKE, ROOT


class Faults:
    """Makes faults, one after the other, until there were enough or it has to end.

    made  {kind: number}
    """

    def __init__(self, proxy, count, seconds, pause, seed):
        self.made, self.met = Counter(), 0
        self._proxy, self._count, self._seconds, self._pause = proxy, count, seconds, pause
        self._draw, self._ended = random.Random(seed), threading.Event()
        self._thread = threading.Thread(target=self._work)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()

    def _work(self):
        for number in range(self._count):
            if self._ended.wait(self._draw.uniform(*self._pause)):
                return
            kind = KINDS[number % len(KINDS)]
            with self._proxy.fault(kind):
                end = time.monotonic() + self._draw.uniform(0.2, self._seconds)
                while time.monotonic() < end or not self._proxy.disturbed:
                    if self._ended.wait(0.05):
                        break
                disturbed = self._proxy.disturbed
            if disturbed:
                self.made[kind] += 1


def compared(plan, ours, theirs):
    """What was lost, doubled or differs in a store, by an undisturbed one, and what verify says."""
    records = list(theirs.records())
    counts = Counter(record.id for record in records)
    said = [fault.text for fault in faults_of(theirs)]
    undisturbed = {record.id: _content(record) for record in ours.records()}
    return {
        "lost": len({shot.id for shot in plan} - set(counts)),
        "doubled": sum(count > 1 for count in counts.values()),
        "differing": sum(_content(r) != undisturbed.get(r.id) for r in records),
        "faults": [text for text in said if not text.startswith("partial/")][:10],
        # of a file system: what was written and not renamed when the connection was lost
        "drafts": sum(text.startswith("partial/") for text in said),
    }


def _content(record):
    return msgspec.structs.replace(record, seconds=0.0)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("job")
    parser.add_argument("--protocol", choices=store_servers.PROTOCOLS, default="s3")
    parser.add_argument("--faults", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    os.environ["FAKE_STUDIO"] = "slow"
    # many small parts, and requests that are given up soon: more for a fault to meet
    uploads.SECONDS, object_store.TIMEOUT = 0.2, 5
    job, folder = jobs.load(options.job)
    plan = make_plan(job, resolve(job, folder))
    run_options = RunOptions(workers=2, threads=1, studio=FAKE)
    words = " ".join(map(shorten, sys.argv[1:]))
    made_by = provenance(f"PYTHONPATH=. python tests/endurance/cut_off_store.py {words}")
    begun = time.monotonic()
    carry_out(plan, options.out / "whole", run_options)
    alone = time.monotonic() - begun
    own, protocol = options.out.resolve() / "server", options.protocol
    own.mkdir()
    with store_servers.started(protocol, own) as port, Proxy(port) as proxy:
        os.environ |= store_servers.variables(protocol, proxy.port, own)
        url = store_servers.url(protocol, proxy.port, own, "disturbed")
        begun = time.monotonic()
        with Faults(proxy, options.faults, options.seconds, (0.5, 2.0), options.seed) as faults:
            outcome = carry_out(plan, url, run_options)
        seconds = time.monotonic() - begun
        theirs = open_store(url, fresh=True)
        report = made_by | {
            "protocol": protocol,
            "shots": len(plan),
            "made": outcome.made,
            "faults_made": dict(faults.made),
            "parts": len(theirs.record_files()),
            "seconds": round(seconds, 1),
            "seconds_alone": round(alone, 1),
            **compared(plan, open_store(options.out / "whole"), theirs),
        }
    write_json(options.out / "report.json", report)
    print((options.out / "report.json").read_text())


if __name__ == "__main__":
    main()
