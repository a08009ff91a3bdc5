"""The batch scripts on a Slurm of two nodes whose tasks, processes and nodes are lost: is anything
lost, anything twice, and is the end the same as of an undisturbed run?

    PYTHONPATH=. python tests/endurance/slurm_losses.py JOB --out DIR

starts a Slurm on this machine (tests/support/small_slurm.py) and renders JOB into DIR/whole without
it, and into DIR/array and DIR/ray by docs/jobs/slurm/, submitted by sbatch. DIR/report.json has the
losses, when they came, and the result. JOB takes a minute or so: the losses need to meet it.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from manifests.provenance import provenance, shorten
from manifests.store import Store
from manifests.verification import faults_of
from tests.endurance.kill_and_resume import compared, recorded
from tests.support import small_slurm
from tests.support.tetrahedron import ROOT

SCRIPTS = ROOT / "docs" / "jobs" / "slurm"


class Losses:
    """Makes losses while a job runs.

    made  [(what, records at that moment)]
    """

    def __init__(self, slurm, folder):
        self.slurm, self.folder, self.made = slurm, folder, []

    def after(self, pictures, what, act):
        """Do something once so many pictures more have been made."""
        goal, end = recorded(self.folder) + pictures, time.monotonic() + 300
        while recorded(self.folder) < goal:
            assert time.monotonic() < end, "the job makes no pictures"
            time.sleep(0.1)
        self.made.append((what, recorded(self.folder)))
        act()

    def control(self, *words):
        """A Slurm program's command."""
        subprocess.run(words, env={**os.environ, **self.slurm}, check=True)


def kill(pattern):
    """kill -9 the last of the processes whose command has a pattern."""
    listed = subprocess.run(["pgrep", "-f", "--", pattern], capture_output=True, text=True)
    os.kill(int(listed.stdout.split()[-1]), signal.SIGKILL)


def array_disturbed(slurm, job, folder):
    """A task cancelled, a task killed; the array again, a task queued again."""
    losses = Losses(slurm, folder)

    def submit():
        options = ["--array=1-2", "--cpus-per-task=1", f"--output={folder}-%A_%a.txt"]
        return small_slurm.submitted(slurm, SCRIPTS / "job-array.sh", [job, folder], options)

    number = submit()
    losses.after(20, "scancel of task 1", lambda: losses.control("scancel", f"{number}_1"))
    losses.after(5, "kill -9 of task 2", lambda: kill(f"--out {folder} --shard 2/2"))
    small_slurm.wait_until_ended(slurm)
    number = submit()
    again = ("scontrol", "requeue", f"{number}_2")
    losses.after(20, "scontrol requeue of task 2", lambda: losses.control(*again))
    small_slurm.wait_until_ended(slurm)
    return losses.made


def cluster_disturbed(slurm, job, folder):
    """Ray's process on a node killed, the job cancelled; again, and a node down."""
    losses = Losses(slurm, folder)

    def submit():
        options = ["--nodes=2", "--cpus-per-task=1", f"--output={folder}-%j.txt"]
        return small_slurm.submitted(slurm, SCRIPTS / "ray-cluster.sh", [job, folder], options)

    number = submit()
    losses.after(20, "kill -9 of a raylet", lambda: kill("raylet/raylet --"))
    losses.after(20, "scancel of the job", lambda: losses.control("scancel", number))
    small_slurm.wait_until_ended(slurm)
    submit()
    down = ("scontrol", "update", "nodename=n2", "state=down", "reason=test")
    losses.after(20, "node n2 down", lambda: losses.control(*down))
    small_slurm.wait_until_ended(slurm)
    return losses.made


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("job", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    out, job = options.out.resolve(), options.job.resolve()
    words = " ".join(map(shorten, sys.argv[1:]))
    made_by = provenance(f"PYTHONPATH=. python tests/endurance/slurm_losses.py {words}")
    out.mkdir(parents=True)
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    os.environ["PYTHON"] = sys.executable
    words = [sys.executable, "-m", "factory", "render", str(job), "--out", str(out / "whole")]
    subprocess.run(words, check=True, stderr=subprocess.DEVNULL)
    with (
        tempfile.TemporaryDirectory(prefix="slurm-") as folder,
        small_slurm.started(folder) as slurm,
    ):
        report = made_by | {"slurm": small_slurm.said(slurm, "sbatch", "--version")}
        report["shots"] = recorded(out / "whole")
        for name, disturb in (("array", array_disturbed), ("ray", cluster_disturbed)):
            begun = time.monotonic()
            made = disturb(slurm, job, out / name)
            report[name] = {
                "losses": [{"what": what, "pictures": pictures} for what, pictures in made],
                "records": recorded(out / name),
                "seconds": round(time.monotonic() - begun, 1),
                "differences": compared(out / "whole", out / name)[:10],
                "faults": [fault.text for fault in faults_of(Store(out / name))][:10],
            }
            print(name, json.dumps(report[name]), flush=True)
    (out / "report.json").write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
