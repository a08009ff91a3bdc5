"""A job on a slow disk: what is its rate, what waits in memory, and is anything lost when it is
killed or the disk is full?

    PYTHONPATH=. python tests/endurance/slow_disk.py [JOB] --out DIR [--blender] [--writes 25]
    [--bytes 200000] [--kills 12] [--sizes 4] [--seed 0]

A file system (ext4) on a loop device is slow because the kernel's block layer lets at most so many
writes and bytes per second through to this device (cgroup v1, blkio.throttle): the program, its
syncs and the file system's own journal all wait, as on a slow disk. It needs root.

rate    the job undisturbed on the disk without and with the limit: pictures per second, and the
        most memory of all processes together
kills   the run is killed while it writes, and started again; after each kill no record may name a
        bad file
full    the slow disk has room for a part of the job; the run must end with one line, and succeed
        when there is room

The stand-in for Blender takes 20 ms for a picture; --blender renders with Blender. The results are
compared with the undisturbed run's and verified. DIR/report.json is written; exit status 0 if
nothing is lost.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil

from manifests.files import write_json
from manifests.provenance import provenance, shorten
from manifests.store import Store
from manifests.verification import faults_of
from tests.endurance.full_disk import Disk, bad_records, drafts
from tests.endurance.kill_and_resume import compared, recorded
from tests.support.tetrahedron import ROOT, lines

JOB = {
    "name": "slow disk",
    "shapes": ["sphere:3", "cube"],
    "materials": ["white-diffuse-bball", "nickel", "brass"],
    "lights": ["city"],
    "views": list(range(16)),
    "tiers": ["direct"],
    "samples": 1,
    "camera": {"size": [64, 64]},
}
THROTTLE = Path("/sys/fs/cgroup/blkio")  # of version 1; its root group limits everybody's writes


class SlowDisk(Disk):
    """A Disk of ext4 that lets few writes through while `limit` says so."""

    def __init__(self, out):
        super().__init__("ext4", out)

    def __enter__(self):
        if not (THROTTLE / "blkio.throttle.write_iops_device").exists():
            sys.exit(f"slow_disk.py: expected {THROTTLE} with throttles, found none")
        super().__enter__()
        device = os.stat(self.folder).st_dev
        self._device = f"{os.major(device)}:{os.minor(device)}"
        return self

    def __exit__(self, *words):
        self.limit(0, 0)
        super().__exit__(*words)

    def limit(self, writes, size):
        """Let so many writes and bytes per second through; 0: all."""
        for name, value in (("iops", writes), ("bps", size)):
            path = THROTTLE / f"blkio.throttle.write_{name}_device"
            path.write_text(f"{self._device} {value}\n")


class Command:
    """The command that renders the job into a folder."""

    def __init__(self, job, blender):
        module = "factory" if blender else "tests.support.fake_command"
        self._words = [sys.executable, "-m", module, "render", str(job), "--workers", "2"]
        paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
        self._environment = os.environ | {"PYTHONPATH": paths, "FAKE_STUDIO": "slow"}

    def start(self, folder):
        """A process of it, whose last words can be read from stderr."""
        return subprocess.Popen(
            [*self._words, "--out", str(folder)],
            env=self._environment | {"TQDM_DISABLE": "1"},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )

    def timed(self, folder):
        """Let it end; {pictures, seconds, pictures per second from the first one on, memory}."""
        start, first, most = time.monotonic(), None, 0
        process = self.start(folder)
        looked = psutil.Process(process.pid)
        while process.poll() is None:
            try:
                family = [looked, *looked.children(recursive=True)]
                most = max(most, sum(each.memory_info().rss for each in family))
            except psutil.NoSuchProcess:
                pass
            if first is None and recorded(folder):
                first = time.monotonic(), recorded(folder)
            time.sleep(0.05)
        if process.wait():
            raise SystemExit(process.stderr.read().decode()[-300:])
        now, made = time.monotonic(), recorded(folder)
        return {
            "pictures": made,
            "seconds": round(now - start, 1),
            "pictures_per_second": round((made - first[1]) / (now - first[0]), 2),
            "most_memory_mb": round(most / 2**20),
        }


def killed(command, folder, kills, pictures, draw):
    """Kill it again and again and let it end; (kills that hit, records of bad files after one)."""
    hit = bad = 0
    for number in range(kills):
        process = command.start(folder)
        enough = (number + 0.5) * pictures / kills
        while process.poll() is None and recorded(folder) < enough:
            time.sleep(0.02)
        time.sleep(draw.uniform(0.0, 0.5))
        if process.poll() is None:
            hit += 1
            if number % 2:
                os.kill(process.pid, signal.SIGKILL)
            else:
                os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        process.stderr.close()
        bad += bad_records(folder)
    process = command.start(folder)
    said = process.communicate()[1].decode()
    if process.returncode:
        raise SystemExit(said[-300:])
    return hit, bad


def filled(disk, limit, command, folder, room):
    """Run it on a slow disk with so many bytes of room, then make room; a row of the report."""
    disk.limit(0, 0)
    disk.empty()
    disk.fill(room)
    disk.limit(*limit)
    process = command.start(folder)
    said = process.communicate()[1].decode()
    row = {
        "room_kib": room // 1024,
        "status": process.returncode,
        "lines": [
            line.replace(str(folder.parent), "…")  # without the path of this machine
            for line in said.splitlines()
            if line.startswith("factory: ")
        ],
        "pictures": recorded(folder) if folder.exists() else 0,
        "bad": bad_records(folder),
        "drafts": [path.name for path in drafts(folder)] if folder.exists() else [],
    }
    disk.make_room()
    process = command.start(folder)
    process.communicate()
    return row | {"again": process.returncode, "pictures_again": recorded(folder)}


def differing(whole, folder, blender):
    """Lines of what differs between two data sets of the job, and of what `verify` finds."""
    if blender:
        result = compared(whole, folder)
    else:
        same = lines(whole, "records") == lines(folder, "records")
        result = [] if same else ["records differ"]
    return result + [fault.text for fault in faults_of(Store(folder))]


def main():
    """Run it and write the report; 0 if nothing was lost."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("job", nargs="?", type=Path, help="default: 96 pictures of 64 × 64")
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--blender", action="store_true")
    parser.add_argument("--writes", type=int, default=25, help="per second (default 25)")
    parser.add_argument("--bytes", type=int, default=200_000, help="per second (default 200000)")
    parser.add_argument("--kills", type=int, default=12)
    parser.add_argument("--sizes", type=int, default=4, help="of disks that run out (default 4)")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    options.out = options.out.resolve()
    options.out.mkdir(parents=True)
    words = " ".join(map(shorten, sys.argv[1:]))
    made_by = provenance(f"PYTHONPATH=. python tests/endurance/slow_disk.py {words}")
    job = options.job or options.out / "job.json"
    if options.job is None:
        job.write_text(json.dumps(JOB))
    command, draw = Command(job.resolve(), options.blender), random.Random(options.seed)
    whole = options.out / "whole"
    limit = options.writes, options.bytes
    with SlowDisk(options.out) as disk:
        before = disk.room()
        fast = command.timed(disk.folder / "data")
        os.sync()
        needed = before - disk.room()
        command.timed(whole)
        report = made_by | {"writes_per_second": limit[0], "bytes_per_second": limit[1]}
        report |= {"bytes_of_the_job": needed, "without_limit": fast}
        disk.empty()
        disk.limit(*limit)
        report["with_limit"] = command.timed(disk.folder / "data")
        report["with_limit"]["differences"] = differing(
            whole, disk.folder / "data", options.blender
        )
        print(report, flush=True)
        disk.limit(0, 0)
        disk.empty()
        disk.limit(*limit)
        start, folder = time.monotonic(), disk.folder / "data"
        hit, bad = killed(command, folder, options.kills, fast["pictures"], draw)
        report["kills"] = {
            "kills": hit,
            "bad_records": bad,
            "pictures": recorded(folder),
            "differences": differing(whole, folder, options.blender),
            "drafts": [path.name for path in drafts(folder)],
            "seconds": round(time.monotonic() - start),
        }
        print(report["kills"], flush=True)
        report["full"] = []
        for number in range(options.sizes):
            room = needed * (number + 1) // (options.sizes + 1)
            row = filled(disk, limit, command, folder, room)
            row["differences"] = differing(whole, folder, options.blender)
            report["full"].append(row)
            print(row, flush=True)
    write_json(options.out / "report.json", report)
    return 1 if is_wrong(report) else 0


def is_wrong(report):
    """Whether anything was lost or badly said."""
    kills = report["kills"]
    return bool(
        report["with_limit"]["differences"]
        or not kills["kills"]
        or kills["bad_records"]
        or kills["differences"]
        or kills["drafts"]
        or any(
            row["status"] != 1
            or len(row["lines"]) != 1
            or row["bad"]
            or row["drafts"]
            or row["again"]
            or row["differences"]
            for row in report["full"]
        )
    )


if __name__ == "__main__":
    sys.exit(main())
