"""A disk that runs out: is anything lost or damaged, and does the same command succeed once there
is room?

    PYTHONPATH=. python tests/endurance/full_disk.py records  --out DIR [--sizes 32] [--disks tmpfs
    ext4] PYTHONPATH=. python tests/endurance/full_disk.py commands --out DIR [--only NAME ...]
    [--disks tmpfs ext4]
    PYTHONPATH=. python tests/endurance/full_disk.py slow     --out DIR [--kills 6]
    PYTHONPATH=. python tests/endurance/full_disk.py pace     --out DIR [--rounds 5]

records    renders 24 small pictures with Cycles onto disks of as many sizes, so that each runs out
at another moment; then
           room is made and the same command repeated. Each record's files must be whole, `verify`
           clean, and the pixels those of an undisturbed run.
commands   every command that writes, on a disk that runs out after each of several shares of what
it writes: it must end
           with status 1 and one line, leave no draft and every earlier result as it was, and
           succeed when there is room.
slow       the same job on a disk on which every write and every sync takes a while, killed in the
midst of them.
pace       what syncing each file costs: the same job with and without it, in turn.

The first two mount small file systems and need root. Each writes a report, DIR/NAME.json, and
prints a table.
"""

import argparse
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from manifests.store import Store
from manifests.store_paths import readable_hash
from tests.endurance.full_disk_commands import COMMANDS, STEPS, prepared
from tests.endurance.kill_and_resume import compared

JOB = {
    "name": "small",
    "shapes": ["sphere:3"],
    "materials": ["white-diffuse-bball", "nickel"],
    "lights": ["city"],
    "views": list(range(12)),
    "tiers": ["direct"],
    "samples": 1,
    "camera": {"size": [16, 16]},
}
ROOM = 64 << 20  # bytes of a disk with room for everything


class Disk:
    """A file system that can be filled and emptied. kind: "tmpfs" or "ext4"; folder: where it is
    mounted.
    """

    def __init__(self, kind, out):
        self.kind, self.folder, self._image = (
            kind,
            Path(out) / f"disk-{kind}",
            Path(out) / f"{kind}.image",
        )

    def __enter__(self):
        self.folder.mkdir(parents=True, exist_ok=True)
        # of a run that was killed
        subprocess.run(["umount", str(self.folder)], capture_output=True)
        if self.kind == "tmpfs":
            command = ["mount", "-t", "tmpfs", "-o", f"size={ROOM}", "tmpfs", str(self.folder)]
        else:
            with open(self._image, "wb") as file:
                file.truncate(ROOM)
            subprocess.run(
                ["mkfs.ext4", "-q", "-F", "-m", "0", "-b", "1024", str(self._image)], check=True
            )
            command = ["mount", "-o", "loop", str(self._image), str(self.folder)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            sys.exit(
                f"full_disk.py: needs root, to mount small file systems: {done.stderr.strip()}"
            )
        return self

    def __exit__(self, *_):
        subprocess.run(["umount", str(self.folder)], check=True)
        self._image.unlink(missing_ok=True)

    def room(self):
        """Bytes that can still be written."""
        now = os.statvfs(self.folder)
        return now.f_bavail * now.f_frsize

    def fill(self, left):
        """Write a file that leaves about so many bytes."""
        os.sync()
        descriptor = os.open(self.folder / ".filler", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        size = 0
        for block in (1 << 20, 1 << 16, 1 << 12, 1 << 10):
            while self.room() - left >= block:
                try:
                    os.posix_fallocate(descriptor, size, block)
                except OSError:
                    break
                size += block
        os.close(descriptor)

    def make_room(self):
        """Take the filling file away."""
        (self.folder / ".filler").unlink()

    def empty(self):
        """Take everything away."""
        for path in self.folder.iterdir():
            if path.name != "lost+found":
                shutil.rmtree(path) if path.is_dir() else path.unlink()


@dataclass
class Ended:
    """How a command ended: its status, its last words to the user, and all it said on stderr."""

    status: int
    words: list[str]
    stderr: str

    def failed_in_one_line(self):
        """ "" if it did, or what was wrong instead."""
        if self.status != 1:
            return f"status {self.status}: {self.stderr[-300:]}"
        if "Traceback" in self.stderr or len(self.words) != 1:
            return f"{len(self.words)} lines: {self.stderr[-600:]}"
        return ""


def run(words, environment=None, timeout=600):
    """Run `python -m WORDS`."""
    done = subprocess.run(
        [sys.executable, "-m", *map(str, words)],
        env=os.environ | {"TQDM_DISABLE": "1"} | (environment or {}),
        capture_output=True,
        text=True,
        timeout=timeout,
    )
    said = [
        line
        for line in done.stderr.replace("\r", "\n").splitlines()
        if line.startswith(("factory: ", "learn: ", "learn.agreement.demo_page: "))
    ]
    return Ended(done.returncode, said, done.stderr)


def drafts(folder):
    """Unfinished files anywhere in a folder, and whatever lies in a data set's partial/."""
    return [
        path
        for path in Path(folder).rglob("*")
        if path.is_file()
        and (
            path.suffix in (".part", ".partial", ".writing", ".new", ".whole")
            or path.parent.name == "partial"
            or ".part" in path.name
        )
    ]


def contents(folder):
    """{path: sha256} of the files of a folder, but for locks and the filler."""
    return {
        path.relative_to(folder).as_posix(): readable_hash(path)
        for path in sorted(Path(folder).rglob("*"))
        if path.is_file()
        and not path.name.startswith((".lock", ".filler"))
        and "lost+found" not in path.parts
    }


def bad_records(folder):
    """Records of which a file is missing, empty, or another than the record says."""
    bad = 0
    for record in Store(folder).records() if Path(folder).exists() else ():
        for relative, digest in (
            (record.image, record.image_hash),
            (record.geometry, record.geometry_hash),
        ):
            path = Path(folder) / relative
            if not path.is_file() or not path.stat().st_size or readable_hash(path) != digest:
                bad += 1
                break
    return bad


# records


def records(options):
    """The table of disk sizes; 0 if no record names a bad file, before or after room was made."""
    job = options.out / "job.json"
    job.write_text(json.dumps(JOB))
    whole = options.out / "whole"
    if run(["factory", "render", job, "--out", whole, "--device", "cpu"]).status:
        sys.exit("full_disk.py: the undisturbed run failed")
    rows = []
    for kind in options.disks:
        with Disk(kind, options.out) as disk:
            before = disk.room()
            run(["factory", "render", job, "--out", disk.folder / "data", "--device", "cpu"])
            os.sync()
            needed = before - disk.room()
            disk.empty()
            sizes = [
                round(needed * (k + 1) / (options.sizes + 1) / 1024) * 1024
                for k in range(options.sizes)
            ]
            for size in sizes:
                rows.append(one_size(disk, size, job, whole))
                print(line_of(rows[-1]), flush=True)
                disk.empty()
    (options.out / "records.json").write_text(json.dumps(rows, indent=1) + "\n")
    wrong = [row for row in rows if row["bad"] or row["bad_after"] or row["faults"]]
    for kind in options.disks:
        mine = [row for row in rows if row["disk"] == kind]
        bad = sum(bool(row["bad"] or row["bad_after"] or row["different"]) for row in mine)
        others = sum(bool(row["faults"]) for row in mine)
        print(
            f"{kind}: {bad} of {len(mine)} sizes after which a record names a bad file; {others}"
            " other faults"
        )
    return 1 if wrong else 0


def one_size(disk, size, job, whole):
    """A row of the table."""
    folder = disk.folder / "data"
    disk.fill(size)
    left = disk.room()
    command = ["factory", "render", job, "--out", folder, "--device", "cpu"]
    first = run(command)
    faults = []
    if first.status:
        faults += [first.failed_in_one_line()]
    made = sum(1 for _ in Store(folder).records()) if folder.exists() else 0
    bad = bad_records(folder)
    faults += [f"draft {path}" for path in drafts(folder)]
    disk.make_room()
    second = run(command)
    faults += [] if second.status == 0 else [f"repeated: {second.stderr[-300:]}"]
    verified = run(["factory", "verify", folder])
    faults += [] if verified.status == 0 else [f"verify: {verified.stderr[-300:]}"]
    faults += [f"draft {path}" for path in drafts(folder)]
    different = compared(whole, folder) if not second.status else ["not comparable"]
    named = (
        re.search(rf"{re.escape(str(folder))}/([^':]+)", first.words[0]) if first.words else None
    )
    where = named[1] if named else "it had room"
    return {
        "disk": disk.kind,
        "left_kib": left // 1024,
        "status": first.status,
        "stopped_at": where[:60],
        "records": made,
        "bad": bad,
        "records_after": sum(1 for _ in Store(folder).records()),
        "bad_after": bad_records(folder),
        "different": different,
        "same_bits": same_bits(whole, folder),
        "faults": [fault for fault in faults if fault],
    }


def same_bits(whole, folder):
    """How many pictures and geometry files have the very bits of the undisturbed run's."""
    ours, theirs = contents(folder), contents(whole)
    return sum(
        ours.get(path) == digest
        for path, digest in theirs.items()
        if path.startswith(("images/", "geometry/"))
    )


def line_of(row):
    """A row as a line of a Markdown table."""
    cells = (
        row["disk"],
        row["left_kib"],
        row["stopped_at"],
        row["records"],
        row["bad"],
        row["records_after"],
        row["bad_after"],
    )
    return (
        "| "
        + " | ".join(
            map(
                str,
                (
                    *cells,
                    len(row["different"]),
                    row["same_bits"],
                    "; ".join(row["faults"]) or "none",
                ),
            )
        )
        + " |"
    )


# commands


@dataclass
class Result:
    """What a command came to on one kind of disk."""

    name: str
    disk: str
    written: int = 0
    full: int = 0
    tolerated: int = 0
    faults: list[str] = field(default_factory=list)
    said: set[str] = field(default_factory=set)


def commands(options):
    """Each command on full disks; 0 if all end as they must."""
    room = prepared(options.out / "room", run)
    results = []
    for kind in options.disks:
        with Disk(kind, options.out) as disk:
            for command in COMMANDS:
                if options.only and command.name not in options.only:
                    continue
                results.append(one_command(disk, command, room, options.shares))
                disk.empty()
                mine = results[-1]
                end = "; ".join(mine.faults) or "none"
                report = (
                    f"| {mine.name} | {kind} | {mine.written} | {mine.full} | {mine.tolerated} |"
                    f" {end} |"
                )
                print(report, flush=True)
    report = [{**vars(result), "said": sorted(result.said)} for result in results]
    (options.out / f"commands-{'-'.join(options.disks)}.json").write_text(
        json.dumps(report, indent=1) + "\n"
    )
    return 1 if any(result.faults for result in results) else 0


def one_command(disk, command, room, shares):
    """A command on disks that run out after several shares of what it writes, first into nothing,
    then over an earlier result.
    """
    result = Result(command.name, disk.kind)

    def again(over=False):
        return run(command.words(room, disk.folder, over), command.environment(disk.folder))

    def begin():
        disk.empty()
        for name in command.copies:
            shutil.copytree(room / name, disk.folder / name)
        command.damage(disk.folder)

    begin()
    os.sync()
    before = disk.room()
    first = again()
    os.sync()
    result.written = before - disk.room()
    if first.status not in (0, *command.statuses):
        result.faults.append(f"undisturbed: status {first.status}: {first.stderr[-300:]}")
        return result
    for share in shares:
        begin()
        disk.fill(int(result.written * share) // 1024 * 1024)
        earlier = contents(disk.folder)
        judge(result, command, share, again(), disk, earlier)
        disk.make_room()
        second = again()
        if second.status not in (0, *command.statuses):
            result.faults.append(
                f"{share}: repeated: status {second.status}: {second.stderr[-300:]}"
            )
        if not command.overwrites:
            continue
        disk.fill(int(result.written * share) // 1024 * 1024)
        earlier = contents(disk.folder)
        judge(result, command, share, again(over=True), disk, earlier)
        disk.make_room()
        second = again(over=True)
        if second.status not in (0, *command.statuses):
            result.faults.append(
                f"{share}: repeated over it: status {second.status}: {second.stderr[-300:]}"
            )
    return result


def judge(result, command, share, ended, disk, earlier):
    """Whether a command ended on a full disk as it must."""
    left = contents(disk.folder)
    if ended.status == 0 and command.tolerates:
        result.tolerated += 1
    elif wrong := ended.failed_in_one_line():
        result.faults.append(f"{share}: {wrong}")
    else:
        result.full += 1
        result.said.add(ended.words[0][-160:])
    result.faults += [f"{share}: draft {path}" for path in drafts(disk.folder)]
    lost = [
        path
        for path, digest in earlier.items()
        if left.get(path) != digest and not command.may_change(path)
    ]
    result.faults += [f"{share}: {path} lost or changed" for path in lost]
    result.faults += [
        f"{share}: {path} is empty"
        for path in left
        if not (disk.folder / path).stat().st_size and not command.may_be_empty(path)
    ]


# slow


SLOW = """
import os, time
write, sync = os.write, os.fsync
def slow_write(descriptor, data):
    time.sleep(0.03)
    return write(descriptor, data)
def slow_sync(descriptor):
    time.sleep(0.1)
    return sync(descriptor)
os.write, os.fsync = slow_write, slow_sync
"""


def slow(options):
    """Kills on a slow disk; 0 if nothing is lost."""
    site = options.out / "site"
    site.mkdir(exist_ok=True)
    (site / "sitecustomize.py").write_text(SLOW)
    paths = os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")])
    job = options.out / "job.json"
    job.write_text(json.dumps(JOB))
    whole, killed = options.out / "whole", options.out / "killed"
    command = [sys.executable, "-m", "factory", "render", str(job), "--device", "cpu", "--out"]
    subprocess.run([*command, str(whole)], check=True, capture_output=True)
    moments, hit, bad = random.Random(options.seed), 0, 0
    start = time.monotonic()
    subprocess.run(
        [*command, str(options.out / "slow")],
        check=True,
        env=os.environ | {"PYTHONPATH": paths},
        capture_output=True,
    )
    taken = time.monotonic() - start
    for number in range(options.kills):
        process = subprocess.Popen(
            [*command, str(killed)],
            env=os.environ | {"PYTHONPATH": paths},
            start_new_session=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        # pictures, so that each kill finds the run at work
        enough = round((number + 0.5) * 24 / options.kills)
        while process.poll() is None and sum(1 for _ in Store(killed).records()) < enough:
            time.sleep(0.02)
        time.sleep(moments.uniform(0.0, 0.15))
        if process.poll() is None:
            hit += 1
            (
                os.kill(process.pid, signal.SIGKILL)
                if number % 2
                else os.killpg(process.pid, signal.SIGKILL)
            )
        process.wait()
        bad += bad_records(killed)
    last = run(["factory", "render", job, "--device", "cpu", "--out", killed])
    verified = run(["factory", "verify", killed])
    report = {
        "kills": hit,
        "bad": bad,
        "last": last.status,
        "verify": verified.status,
        "different": compared(whole, killed),
        "drafts": [str(path) for path in drafts(killed)],
        "seconds_slow": round(taken, 1),
    }
    (options.out / "slow.json").write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))
    return (
        1
        if bad
        or report["different"]
        or report["drafts"]
        or last.status
        or verified.status
        or not hit
        else 0
    )


# pace

UNSYNCED = "import os\nos.fsync = lambda descriptor: None\n"


def pace(options):
    """What syncing costs, in ms a record and as a ratio."""
    site = options.out / "unsynced"
    site.mkdir(exist_ok=True)
    (site / "sitecustomize.py").write_text(UNSYNCED)
    job = options.out / "pace-job.json"
    job.write_text(
        json.dumps(JOB | {"materials": ["merl/test"], "camera": {"size": [128, 128]}, "samples": 4})
    )
    plain = os.environ.get("PYTHONPATH", "")
    seconds = {"synced": [], "not synced": []}
    for number in range(options.rounds):
        for name, paths in (("synced", plain), ("not synced", os.pathsep.join([str(site), plain]))):
            folder = options.out / f"pace-{name.replace(' ', '-')}"
            shutil.rmtree(folder, ignore_errors=True)
            command = ["factory", "render", job, "--out", folder, "--device", "cpu"]
            if (ended := run(command, {"PYTHONPATH": paths})).status:
                sys.exit(f"full_disk.py: {ended.stderr[-300:]}")
            result = [record.seconds for record in Store(folder).records()]
            seconds[name].append(sum(result) / len(result))
            print(
                f"round {number}, {name}: {1e3 * seconds[name][-1]:.2f} ms a record of"
                f" {len(result)}",
                flush=True,
            )
    ratios = sorted(a / b for a, b in zip(seconds["synced"], seconds["not synced"], strict=True))
    report = {
        "ms": {name: [round(1e3 * s, 3) for s in result] for name, result in seconds.items()},
        "ratio": round(ratios[len(ratios) // 2], 4),
    }
    (options.out / "pace.json").write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))
    return 0


def main():
    """Run one part and write its report."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", choices=("records", "commands", "slow", "pace"))
    parser.add_argument(
        "--out",
        required=True,
        type=Path,
        metavar="DIR",
        help="where reports go, and what is made on the way",
    )
    parser.add_argument(
        "--sizes", type=int, default=32, metavar="N", help="disk sizes of `records` (default 32)"
    )
    parser.add_argument("--disks", nargs="+", default=("tmpfs", "ext4"), choices=("tmpfs", "ext4"))
    parser.add_argument(
        "--only", nargs="+", default=(), metavar="NAME", help="of `commands`: these alone"
    )
    parser.add_argument(
        "--shares",
        type=float,
        nargs="+",
        default=STEPS,
        metavar="X",
        help=f"of `commands` (default {STEPS})",
    )
    parser.add_argument("--kills", type=int, default=6, metavar="N", help="of `slow` (default 6)")
    parser.add_argument("--rounds", type=int, default=5, metavar="N", help="of `pace` (default 5)")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    options.out = options.out.resolve()
    if options.part in ("records", "commands") and os.geteuid():
        sys.exit("full_disk.py: needs root, to mount small file systems")
    options.out.mkdir(parents=True, exist_ok=True)
    return {"records": records, "commands": commands, "slow": slow, "pace": pace}[options.part](
        options
    )


if __name__ == "__main__":
    sys.exit(main())
