"""A hundred kills of whatever is there, workers and the run itself, drawn at random: is anything
lost, twice or different?

    PYTHONPATH=. python tests/endurance/random_kills.py docs/jobs/random-kills.json --kills 100
    --out DIR [--blender] [--workers 2] [--most 6] [--seed 0]

renders JOB into DIR/whole undisturbed, and into DIR/killed with kills by SIGKILL, each between one
and `--most` pictures after the last one, at a random moment of the picture in hand. What is killed
is drawn each time:

worker    one of the run's workers; the run lives and replaces it
run       the process that was started, whose workers must then stop by themselves
everything   the run and its workers at once

After a kill of the run the same command is started again. A job that ends before the last kill goes
on in a new folder, DIR/killed-2 and so on. A picture whose worker dies twice is given up; the same
command, which is repeated at the end of each folder, makes it. All folders are compared with the
undisturbed one: with the stand-in for Blender (20 ms for a picture) by all that records say, hashes
of files included, and with --blender as kill_and_resume.py does. All are verified, and no draft may
be left. DIR/report.json is written; exit status 0 if nothing is wrong. Nodes of a Ray cluster are
killed by lose_nodes.py.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import psutil

from manifests.files import write_json
from manifests.provenance import provenance, shorten
from manifests.store import Store
from manifests.verification import faults_of
from tests.endurance.full_disk import drafts
from tests.endurance.kill_and_resume import compared
from tests.endurance.kill_workers import recorded, workers_of
from tests.support.tetrahedron import ROOT, lines

KINDS = ("worker", "run", "everything")


class Killer:
    """Starts a command again and again and kills what is drawn."""

    def __init__(self, command, kills, most, seed):
        self.left, self.killed, self.started, self.repeated = kills, Counter(), 0, 0
        self._command, self._most, self._draw = command, most, random.Random(seed)

    def into(self, folder):
        """Render into a folder, with kills while there are some left, until all is made."""
        while True:
            process = self._command(folder)
            self.started += 1
            if self._disturb(process, folder):
                continue
            if process.returncode == 0:
                return
            # pictures were given up, because their workers were killed twice, or workers of the
            # run before held its lock for longer than this one waited
            self.repeated += 1
            if self.repeated > self.started // 2 + 5:
                raise SystemExit(f"{folder}: the run fails by itself (run.log)")

    def _disturb(self, process, folder):
        """Kill workers until the run is killed or ends; return whether it was killed."""
        run = psutil.Process(process.pid)
        enough = recorded(folder) + self._draw.randint(1, self._most)
        while process.poll() is None:
            if self.left and recorded(folder) >= enough:
                time.sleep(self._draw.uniform(0.0, 0.3))
                kind = self._draw.choice(KINDS)
                if self._kill(kind, run):
                    self.left -= 1
                    self.killed[kind] += 1
                    print(f"{sum(self.killed.values())} kills, {recorded(folder)}", flush=True)
                    if kind != "worker":
                        process.wait()
                        return True
                enough = recorded(folder) + self._draw.randint(1, self._most)
            time.sleep(0.02)
        return False

    def _kill(self, kind, run):
        """Kill it; return whether there was something to kill."""
        try:
            if kind == "worker":
                living = workers_of(run)
                if living:
                    self._draw.choice(living).kill()
                return bool(living)
            if kind == "run":
                run.kill()
            else:
                os.killpg(run.pid, signal.SIGKILL)
        except (psutil.NoSuchProcess, ProcessLookupError):  # it has just ended
            return False
        return True


def main():
    """Run it and write the report; 0 if nothing is wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("job", type=Path)
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--most", type=int, default=6, help="pictures between two kills")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--blender", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    options.out.mkdir(parents=True)
    words = " ".join(map(shorten, sys.argv[1:]))
    made_by = provenance(f"PYTHONPATH=. python tests/endurance/random_kills.py {words}")
    module = "factory" if options.blender else "tests.support.fake_command"
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
        "FAKE_STUDIO": "slow",
        "TQDM_DISABLE": "1",
    }
    log = open(options.out / "run.log", "ab")  # noqa: SIM115 (all processes write to it)

    def command(folder):
        given = [str(options.job), "--out", str(folder), "--workers", str(options.workers)]
        return subprocess.Popen(
            [sys.executable, "-m", module, "render", *given],
            env=environment,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )

    start = time.monotonic()
    whole = options.out / "whole"
    if command(whole).wait():
        raise SystemExit(f"{whole}: the undisturbed run failed (run.log)")
    undisturbed = time.monotonic() - start
    killer, folders = Killer(command, options.kills, options.most, options.seed), []
    while killer.left:
        folders.append(options.out / ("killed" + (f"-{len(folders) + 1}" if folders else "")))
        killer.into(folders[-1])
    log.close()
    report = made_by | {
        "kills": dict(sorted(killer.killed.items())),
        "starts": killer.started,
        "runs_that_ended_with_status_1": killer.repeated,
        "pictures": {folder.name: recorded(folder) for folder in [whole, *folders]},
        "differences": [
            f"{folder.name}: {line}"
            for folder in folders
            for line in (compared(whole, folder) if options.blender else differing(whole, folder))
        ],
        "faults": [
            f"{folder.name}: {text}"
            for folder in folders
            for text in faults(folder) - faults(whole)
        ],
        "drafts": [path.name for folder in folders for path in drafts(folder)],
        "seconds": {
            "killed": round(time.monotonic() - start - undisturbed),
            "undisturbed": round(undisturbed),
        },
    }
    write_json(options.out / "report.json", report)
    print((options.out / "report.json").read_text())
    return 1 if report["differences"] or report["faults"] or report["drafts"] else 0


def faults(folder):
    """What `verify` finds in a folder; of the stand-in's pictures some are black by themselves."""
    return {fault.text for fault in faults_of(Store(folder))}


def differing(whole, folder):
    """A line where the records of two folders are not the same, each once."""
    ours, theirs = lines(whole, "records"), lines(folder, "records")
    return [] if ours == theirs else [f"{len(ours)} and {len(theirs)} records, not the same"]


if __name__ == "__main__":
    sys.exit(main())
