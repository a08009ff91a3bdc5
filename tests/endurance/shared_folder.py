"""Two machines write into one folder by NFS: do the locks hold, and is anything lost or twice?

    PYTHONPATH=. python tests/endurance/shared_folder.py docs/jobs/shared-folder.json --out DIR
    [--only CASE ...]

boots three small machines, each with a Linux kernel of its own (tests/support/small_machines.py):
one exports a disk by NFS 4.2, the others mount it. They render JOB with the stand-in for Blender.

parts     each machine renders one `--shard` of the job, at the same time
refused   one machine renders, the other one begins the same command meanwhile: it must end with one
          line, while the first one is still at work, which takes 0.4 s for a picture here
one-name  as parts, but both machines have the same host name, so that an NFS server takes one for
          the other and gives up its locks: a run whose pictures are not all recorded must not end
          as if they were, and the same commands, one after the other, must make what is missing
power     one machine renders, and its power is cut once it has recorded some pictures; the other
          one repeats the command until it is not refused. The server gives up the locks of a
          machine that is gone after its lease, 90 seconds

The folders are copied from the share by one of the machines, compared with an undisturbed run on
this one, and verified. DIR/report.json is written; exit status 0 if nothing is wrong.
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

from manifests.files import write_json
from manifests.provenance import provenance, shorten
from manifests.store import Store
from manifests.verification import faults_of
from tests.support.small_machines import SHARE, Network, missing
from tests.support.tetrahedron import ROOT, lines

BUSY = "one in use"  # of the line with which a second run ends


class Machines:
    """The network, and the command that its machines render with."""

    def __init__(self, network, job, shots):
        self.network, self._job, self.shots = network, job, shots

    def words(self, name, *options, studio="slow"):
        """The command as words of a shell, into a folder of the share."""
        folder = f"{SHARE}/{name}"
        module = [sys.executable, "-B", "-m", "tests.support.fake_command"]
        given = [*module, "render", str(self._job), "--out", folder, *options]
        return (
            f"cd {ROOT}; export PYTHONPATH={ROOT} OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1"
            f" FAKE_STUDIO={studio} TQDM_DISABLE=1; exec {' '.join(given)}"
        )

    def render(self, machine, name, *options, **more):
        """Let a machine begin the command."""
        return self.network.begin(machine, self.words(name, *options, **more))

    def recorded(self, machine, name):
        """How many pictures a machine sees in a folder of the share."""
        counting = self.network.begin(
            machine, f"cat {SHARE}/{name}/records/*.jsonl 2>/dev/null | wc -l"
        )
        self.network.status(counting)
        return int(self.network.said(counting) or 0)


def parts(machines, name):
    begun = [
        machines.render(machine, name, "--shard", f"{k + 1}/2")
        for k, machine in enumerate(machines.network.names)
    ]
    return {"statuses": [machines.network.status(each) for each in begun]}


def refused(machines, name):
    network, (one, other) = machines.network, machines.network.names
    first = machines.render(one, name, studio="slower")
    while not machines.recorded(one, name):
        time.sleep(0.2)
    start = time.monotonic()
    second = machines.render(other, name)
    status = network.status(second)
    took = time.monotonic() - start
    said = [line for line in network.said(second).splitlines() if line.startswith("factory: ")]
    return {
        "statuses": [network.status(first), 0 if status == 1 and len(said) == 1 else 1],
        "said": said,
        "seconds_until_refused": round(took, 1),
    }


def power(machines, name):
    network, (one, other) = machines.network, machines.network.names
    machines.render(one, name)
    while (before := machines.recorded(other, name)) < 20:
        time.sleep(0.2)
    network.cut_power(one)
    start, refusals, status = time.monotonic(), 0, 1
    while status and time.monotonic() - start < 400:
        again = machines.render(other, name)
        status = network.status(again)
        refusals += BUSY in network.said(again)
        if status and BUSY not in network.said(again):
            break
    took = time.monotonic() - start
    network.start(one)
    return {
        "statuses": [status],
        "pictures_before": before,
        "refusals": refusals,
        "seconds_until_all_were_made": round(took, 1),
        "last_words": network.said(again).splitlines()[-1:],
    }


def one_name(machines, name):
    network = machines.network
    begun = [
        machines.render(machine, name, "--shard", f"{k + 1}/2")
        for k, machine in enumerate(network.names)
    ]
    first = [network.status(each) for each in begun]
    said = [network.said(each).splitlines()[-1:] for each in begun]
    made = machines.recorded(network.names[0], name)
    network.cut_power(network.names[1])
    again = machines.render(network.names[0], name)
    return {
        # a run that loses pictures must say so
        "statuses": [network.status(again), int(not any(first) and made < machines.shots)],
        "statuses_of_the_parts": first,
        "said": said,
        "pictures_before": made,
        "last_words": network.said(again).splitlines()[-1:],
    }


CASES = {"parts": parts, "refused": refused, "power": power, "one-name": one_name}


def measured(name, out, job, whole):
    """A row of the report: a case on machines of its own, and what it left in the shared folder."""
    shots = len(lines(whole, "records"))
    network = Network(out / f"machines-{name}", 2, "node" if name == "one-name" else "")
    try:
        start = time.monotonic()
        found = CASES[name](Machines(network, job, shots), name)
        seconds = time.monotonic() - start
        copied = network.begin(network.names[0], f"cp -r {SHARE}/{name} {out / name}; sync")
        if network.status(copied):
            raise SystemExit(network.said(copied))
    finally:
        network.close()
    same = lines(whole, "records") == lines(out / name, "records")
    return {
        "case": name,
        **found,
        "seconds": round(seconds, 1),
        "pictures": len(lines(out / name, "records")),
        "differences": [] if same else ["records differ"],
        "faults": [fault.text for fault in faults_of(Store(out / name))][:5],
    }


def main():
    """Run the cases and write the report; 0 if nothing is wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("job", type=Path)
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES), metavar="CASE")
    options = parser.parse_args()
    if lacking := missing():
        sys.exit(f"shared_folder.py: expected root, and {', '.join(lacking)}, found none")
    options.out = options.out.resolve()
    options.out.mkdir(parents=True)
    words = " ".join(map(shorten, sys.argv[1:]))
    made_by = provenance(f"PYTHONPATH=. python tests/endurance/shared_folder.py {words}")
    job, whole = options.job.resolve(), options.out / "whole"
    subprocess.run(
        [sys.executable, "-m", "tests.support.fake_command", "render", job, "--out", whole],
        check=True,
        env=os.environ | {"PYTHONPATH": str(ROOT), "TQDM_DISABLE": "1"},
    )
    rows = []
    for name in options.only:
        rows.append(measured(name, options.out, job, whole))
        print(rows[-1], flush=True)
    write_json(options.out / "report.json", made_by | {"cases": rows})
    return int(any(any(r["statuses"]) or r["differences"] or r["faults"] for r in rows))


if __name__ == "__main__":
    sys.exit(main())
