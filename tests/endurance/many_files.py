"""720,000 picture files in a data set's real layout: what do listing, status, verification, export
and a resumed run take, and what runs out first?

    PYTHONPATH=. python tests/endurance/many_files.py docs/jobs/many-files.json --out DIR
    [--pictures N] [--seconds 60] [--keep]

renders the first two pictures of JOB into DIR/data with the stand-in for Blender, and then writes
all others but the last three as if they had been rendered: true ids, seeds, paths and lines, each
picture and each view in a file of its own; what is in the files is the first picture and its
geometry, of 16 × 16 pixels. Files are not synced. Then it measures, each in a process of its own:

list      a walk through the folder that asks for the size of each file
status    `status`
verify --quick   `verify --quick`, which reads lines alone
verify    how many pictures `verify` has checked after --seconds, when it is killed
export    seconds until the first file of `export --to webdataset`, when it is killed
resume    `render`, which finds three pictures missing and makes them

seconds and processor seconds are those of the process and its children; memory is the largest
resident size of the process itself. The files are in the page cache. DIR/report.json is written,
and DIR/data deleted unless --keep is given.
"""

import argparse
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from itertools import islice
from pathlib import Path

import msgspec

from factory.execution.run import RunOptions, carry_out, make_plan
from factory.planning import jobs
from factory.planning.assets import resolve
from manifests.files import write_json
from manifests.provenance import provenance, shorten
from manifests.store import Store
from manifests.store_paths import geometry_path, image_path
from tests.support.tetrahedron import FAKE, ROOT

WORKERS, MISSING = 8, 3
WALK = """
import os, sys
def walk(folder):
    files = size = 0
    for each in os.scandir(folder):
        if each.is_dir(follow_symlinks=False):
            more = walk(each.path)
            files, size = files + more[0], size + more[1]
        else:
            files, size = files + 1, size + each.stat().st_size
    return files, size
print(*walk(sys.argv[1]))
"""


def grown(plan, folder, count):
    """Write the files and lines of the first `count` pictures of a plan that are not there yet."""
    store = Store(folder)
    first, *_ = store.records()
    picture = (folder / first.image).read_bytes()
    geometry = (folder / first.geometry).read_bytes()
    done, dataset = store.ids(), store.dataset()
    made, folders = {first.geometry}, set()
    names = [folder / "records" / f"worker-{number:02d}.jsonl" for number in range(WORKERS)]
    lines = [open(name, "ab") for name in names]  # noqa: SIM115 (all are closed below)

    def write(path, data):
        if path.parent not in folders:
            path.parent.mkdir(parents=True, exist_ok=True)
            folders.add(path.parent)
        with open(path, "wb", buffering=0) as file:
            file.write(data)

    for number, shot in enumerate(islice(plan, count)):
        if shot.id in done:
            continue
        record = msgspec.structs.replace(
            first,
            **shot.repeated_in(type(first)),
            shape_hash=dataset.shapes[shot.shape].hash,
            category=dataset.shapes[shot.shape].category,
            light_hash=dataset.lights[shot.light].hash,
            azimuth_deg=15.0 * shot.viewpoint,
            image=image_path(shot.id),
            geometry=geometry_path(shot.geometry),
        )
        write(folder / record.image, picture)
        if record.geometry not in made:
            made.add(record.geometry)
            write(folder / record.geometry, geometry)
        lines[number * WORKERS // count].write(msgspec.json.encode(record) + b"\n")
    for file in lines:
        file.close()


def _shortened(line, out):
    """A line as it is published: without the path of this machine."""
    return line.replace(str(out.resolve()), "…")


def timed(words, environment=None, until=None, seconds=None, log=os.devnull):
    """What a process takes; it is killed when `until` says so or after some seconds."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    with open(log, "wb") as said:
        process = subprocess.Popen(
            words,
            stdout=said,
            stderr=said,
            env=os.environ | (environment or {}),
            start_new_session=True,
        )
    memory = 0
    while True:
        memory = max(memory, _peak_of(process.pid))
        pid, status, _ = os.wait4(process.pid, os.WNOHANG)
        took = time.monotonic() - start
        if pid:
            break
        if (until and until()) or (seconds and took > seconds):
            os.killpg(process.pid, signal.SIGKILL)
            status = os.wait4(process.pid, 0)[1]
            break
        time.sleep(0.05)
    process.returncode = os.waitstatus_to_exitcode(status)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = sum(getattr(after, k) - getattr(before, k) for k in ("ru_utime", "ru_stime"))
    return {
        "status": process.returncode,
        "seconds": round(took, 1),
        "processor_seconds": round(spent, 1),
        "memory_mb": round(memory / 1024),
    }


def _peak_of(pid):
    """KB of the largest resident size of a process so far, 0 once it has ended.

    ru_maxrss would count the parent's memory before exec.
    """
    found = re.search(r"VmHWM:\s+(\d+)", Path(f"/proc/{pid}/status").read_text())
    return int(found[1]) if found else 0


def main():
    """Make the files, measure, delete them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("job", type=Path)
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--pictures", type=int, help="so many alone (default: all of the job)")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--keep", action="store_true", help="do not delete DIR/data")
    options = parser.parse_args()
    data = options.out.resolve() / "data"
    options.out.mkdir(parents=True)
    words = " ".join(map(shorten, sys.argv[1:]))
    report = provenance(f"PYTHONPATH=. python tests/endurance/many_files.py {words}")
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    environment = {"PYTHONPATH": paths}
    render = [sys.executable, "-m", "tests.support.fake_command", "render", str(options.job)]
    render += ["--out", str(data)]
    job, folder = jobs.load(options.job)
    # all shapes are read first, so that dataset.json has them all
    plan = make_plan(job, resolve(job, folder))
    os.environ |= environment  # of workers
    carry_out(plan, data, RunOptions(studio=FAKE, limit=2))
    count = (options.pictures or len(plan)) - MISSING
    room, start = os.statvfs(data), time.monotonic()
    processor = time.process_time()
    grown(plan, data, count)
    os.sync()
    now = os.statvfs(data)
    report |= {
        "pictures": count,
        "planned": len(plan),
        "written": {
            "seconds": round(time.monotonic() - start, 1),
            "processor_seconds": round(time.process_time() - processor, 1),
            "inodes": room.f_ffree - now.f_ffree,
            "bytes_on_disk": (room.f_bfree - now.f_bfree) * now.f_frsize,
            "bytes_of_records": sum(p.stat().st_size for p in Store(data).record_files()),
            "largest_folder": max(
                sum(1 for _ in os.scandir(each)) for each in os.scandir(data / "images")
            ),
        },
        "measured": {},
    }
    log, exported = options.out / "log.txt", options.out / "exported"
    program = [sys.executable, "-m", "factory"]

    def note(name, **found):
        report["measured"][name] = found
        print(name, found, flush=True)

    row = timed([sys.executable, "-c", WALK, str(data)], log=log)
    files, size = map(int, log.read_text().split())
    note("list", **row, files=files, bytes=size)
    note("status", **timed([*program, "status", str(data)], log=log))
    note("verify --quick", **timed([*program, "verify", "--quick", str(data)], log=log))
    row = timed([*program, "verify", str(data)], seconds=options.seconds, log=log)
    checked = [int(made) for made, _ in re.findall(r"(\d+)/(\d+) \[", log.read_text())]
    note("verify", **row, pictures_checked=max(checked, default=0))
    export = [*program, "export", str(data), "--to", "webdataset", "--out", str(exported)]
    row = timed(
        export, until=lambda: any(exported.rglob("*.tar")) if exported.exists() else False, log=log
    )
    note("export", **row)
    row = timed([*render, "--limit", str(MISSING)], environment, log=log)
    note("resume", **row, said=_shortened(log.read_text().splitlines()[-1], options.out))
    write_json(options.out / "report.json", report)
    shutil.rmtree(exported, ignore_errors=True)
    if not options.keep:
        shutil.rmtree(data)
    return 0


if __name__ == "__main__":
    sys.exit(main())
