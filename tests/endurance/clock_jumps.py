"""Wall clocks that jump while a job runs: does it go on, is anything lost, twice or different, and
is what it says of the time left true?

    PYTHONPATH=. python tests/endurance/clock_jumps.py JOB --out DIR [--blender] [--seed 0]
    [--only CASE ...]

renders JOB undisturbed into DIR/whole, and in each case into a folder of its own, in processes
whose wall clock jumps by up to ten hours ahead or back every third of a second
(tests/support/jumping_clock.c). The stand-in for Blender takes 20 ms for a picture; --blender
renders with Blender.

running    one run with two workers
continued  six runs that are killed once they have recorded pictures, each with a clock of another
           day, and one that ends
parts      two tasks of a job array at once, whose clocks are ten hours apart and jump
refused    a second run into a folder in use, whose clock is ten hours behind: it must end with one
           line, and the first one, which stands still meanwhile, must go on
store      a run into an object store (a folder by its URL), and a second one that its lease refuses
ray        one run on a Ray cluster of this machine, all of whose processes have the clock; it jumps
           every five seconds from the first picture on

Each case is compared with the undisturbed run, verified, and its progress bars are read: none may
show a negative time or rate, a time gone of more than the seconds that the case took, or, once a
tenth of the pictures is made, a time left of more than ten times those. A case must not take more
than four times the undisturbed seconds and 60 more, or it counts as hung.
DIR/report.json is written; exit status 0 if nothing is wrong.
"""

import argparse
import os
import random
import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

from manifests.files import write_json
from manifests.provenance import provenance, shorten
from manifests.store import Store
from manifests.verification import faults_of
from tests.endurance.kill_and_resume import compared, recorded
from tests.support.jumping_clock import JumpingClock
from tests.support.tetrahedron import ROOT, lines

HOURS = 10.0  # of the largest jump
EVERY = 0.33  # seconds between two jumps
BAR = re.compile(r"(\d+)/(\d+) \[(-?[\d:]+)<(-?[\d:?]+), +(-?[\d.?]+)")
EARLY = 0.1  # share of the pictures before which the start of the workers is all of the time gone


class Runs:
    """Starts the program's command line with a clock, and remembers how often it jumped."""

    def __init__(self, job, out, blender, seed):
        self.job, self.out, self.jumps = job, out, 0
        self.draw = random.Random(seed)
        self.clocks = out / "clocks"
        self.clocks.mkdir()
        module = "factory" if blender else "tests.support.fake_command"
        self._words = [sys.executable, "-m", module, "render", str(job)]
        paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
        self._environment = os.environ | {"PYTHONPATH": paths, "FAKE_STUDIO": "slow"}

    def start(self, folder, *options, clock=None, log=None):
        """A process of the command; what it says goes to the file `log`."""
        environment = self._environment | (clock.environment if clock else {})
        with open(log or os.devnull, "ab") as said:
            return subprocess.Popen(
                [*self._words, "--out", str(folder), *options],
                env=environment,
                stdout=said,
                stderr=said,
                start_new_session=True,
            )

    @contextmanager
    def jumping(self, *clocks, every=EVERY):
        """Let clocks jump until the block ends."""
        ended = threading.Event()

        def jump():
            while not ended.wait(every):
                for clock in clocks:
                    clock.jump(3600 * self.draw.uniform(-HOURS, HOURS))
                    self.jumps += 1

        thread = threading.Thread(target=jump)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()


def finished(process, seconds):
    """Its exit status; None where it had to be killed after so many seconds."""
    try:
        return process.wait(seconds)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return None


def running(runs, folder, patience):
    clock = JumpingClock(runs.clocks, "running")
    with runs.jumping(clock):
        process = runs.start(folder, "--workers", "2", clock=clock, log=runs.out / "running.log")
        return [finished(process, patience)]


def continued(runs, folder, patience):
    clock = JumpingClock(runs.clocks, "continued")
    with runs.jumping(clock):
        for number in range(7):
            clock.jump(86_400.0 * (number + 1) * (-1) ** number)
            before = recorded(folder)
            process = runs.start(
                folder, "--workers", "2", clock=clock, log=runs.out / "continued.log"
            )
            if number == 6:
                return [finished(process, patience)]
            end = time.monotonic() + patience
            while process.poll() is None and recorded(folder) < before + 20:
                if time.monotonic() > end:
                    break
                time.sleep(0.02)
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def parts(runs, folder, patience):
    clocks = [JumpingClock(runs.clocks, f"part-{k}") for k in (1, 2)]
    with runs.jumping(*clocks):
        processes = [
            runs.start(
                folder, "--shard", f"{k + 1}/2", clock=clock, log=runs.out / f"parts-{k + 1}.log"
            )
            for k, clock in enumerate(clocks)
        ]
        return [finished(process, patience) for process in processes]


def refused(runs, folder, patience, *options):
    """A second run that must be refused; the list's second status is 0 if it was, in one line."""
    clocks = [JumpingClock(runs.clocks, f"{folder.name}-{k}") for k in (1, 2)]
    said = runs.out / f"{folder.name}.log"
    where = options[0] if options else folder
    with runs.jumping(clocks[0]):
        clocks[1].jump(-3600 * HOURS)
        # the bar of a run that stands still says for how long, and is not read
        first = runs.start(where, clock=clocks[0], log=runs.out / "first.txt")
        while first.poll() is None and not begun(folder):
            time.sleep(0.02)
        if not options:  # a lease is renewed, a lock is held by standing still
            os.kill(first.pid, signal.SIGSTOP)
        second = runs.start(where, clock=clocks[1], log=said)
        status = finished(second, patience)
        os.kill(first.pid, signal.SIGCONT)
        refusals = [line for line in said.read_text().splitlines() if "one in use" in line]
        was_refused = status == 1 and len(refusals) == 1
        return [finished(first, patience), 0 if was_refused else 1]


def begun(folder):
    return (folder / ".lock").exists() or any((folder / "running").glob("*"))


def store(runs, folder, patience):
    return refused(runs, folder, patience, f"file://{folder}")


def ray(runs, folder, patience):
    clock = JumpingClock(runs.clocks, "ray")
    process = runs.start(folder, "--ray", "auto", clock=clock, log=runs.out / "ray.log")
    end = time.monotonic() + patience
    while process.poll() is None and not recorded(folder) and time.monotonic() < end:
        time.sleep(0.1)
    with runs.jumping(clock, every=5.0):
        return [finished(process, patience)]


CASES = {f.__name__: f for f in (running, continued, parts, refused, store, ray)}


def bars(logs):
    """What progress bars showed: how often they were read, and seconds gone and left."""
    gone, left, negative, readings = [0], [0], 0, 0
    for log in logs:
        for made, total, passed, rest, rate in BAR.findall(log.read_text(errors="replace")):
            readings += 1
            negative += any(text.startswith("-") for text in (passed, rest, rate))
            gone.append(of(passed))
            if int(made) >= EARLY * int(total) and "?" not in rest:
                left.append(of(rest))
    return {
        "readings": readings,
        "negative": negative,
        "most_gone": max(gone),
        "most_left": max(left),
    }


def of(text):
    """Seconds of "1:02:03", without its sign."""
    total = 0
    for part in text.lstrip("-").split(":"):
        total = 60 * total + int(part)
    return total


def main():
    """Run the cases and write the report; 0 if nothing is wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("job", type=Path)
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--blender", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES), metavar="CASE")
    options = parser.parse_args()
    options.out = options.out.resolve()
    options.out.mkdir(parents=True)
    words = " ".join(map(shorten, sys.argv[1:]))
    made_by = provenance(f"PYTHONPATH=. python tests/endurance/clock_jumps.py {words}")
    runs = Runs(options.job.resolve(), options.out, options.blender, options.seed)
    whole = options.out / "whole"
    start = time.monotonic()
    if runs.start(whole, "--workers", "2", log=options.out / "whole.log").wait():
        raise SystemExit((options.out / "whole.log").read_text()[-300:])
    undisturbed = time.monotonic() - start
    rows = []
    for name in options.only:
        folder, before = options.out / name, runs.jumps
        start = time.monotonic()
        statuses = CASES[name](runs, folder, 4 * undisturbed + 60)
        seconds = time.monotonic() - start
        if not (folder / "dataset.json").exists():  # it hung before its first picture
            same = ["no data set"]
        else:
            same = compared(whole, folder) if options.blender else differing(whole, folder)
        rows.append(
            {
                "case": name,
                "jumps": runs.jumps - before,
                "statuses": statuses,
                "pictures": recorded(folder),
                "differences": same,  # faults are looked for where there are none
                # drafts of killed writes, which the next run into the folder removes
                "faults": [] if same else [fault.text for fault in faults_of(Store(folder))],
                "seconds": round(seconds, 1),
                "bars": bars(options.out.glob(f"{name}*.log")),
            }
        )
        print(rows[-1], flush=True)
    report = made_by | {"undisturbed_seconds": round(undisturbed, 1), "cases": rows}
    write_json(options.out / "report.json", report)
    return 1 if any(map(wrong, rows)) else 0


def differing(whole, folder):
    """Lines of records that differ or are there once in one of the folders alone."""
    ours, theirs = lines(whole, "records"), lines(folder, "records")
    return [] if ours == theirs else [f"{len(ours)} and {len(theirs)} records, not the same"]


def wrong(row):
    """Whether anything of a case is not as it must be."""
    times = row["bars"]
    return (
        any(row["statuses"])
        or None in row["statuses"]
        or row["differences"]
        or row["faults"]
        or times["negative"]
        or times["most_gone"] > row["seconds"]
        or times["most_left"] > 10 * row["seconds"]
    )


if __name__ == "__main__":
    sys.exit(main())
