"""kill -9 at random moments, then resume: is anything lost, anything twice, and is the end the same
as of an undisturbed run?

    PYTHONPATH=. python tests/endurance/kill_and_resume.py JOB --kills 20 --out DIR [--workers 2]
    [--window 2 12]

renders JOB into DIR/whole undisturbed and into DIR/killed with kills, compares the two, verifies
both, and writes DIR/report.json. Every other kill hits the parent alone, whose workers must then
stop by themselves; the rest hit the whole process group.
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

import msgspec
import numpy as np

from manifests.picture_files import read_picture
from manifests.provenance import provenance, shorten
from manifests.store import Store

# relative to the picture's largest value: two steps of a half, where Cycles' 2e-6 tips a rounding
SAME_PICTURE = 2e-3
SAME_ERROR = 1e-3  # of a job's limit: what the same does to an error
# of a record: what Cycles' repeatability leaves open, and what _same_accuracy compares
VARYING = {"image_hash", "geometry_hash", "seconds", "statistics", "accuracy"}


def disturbed(command, folder, kills, window, seed, environment=None, working=False):
    """Start the command again and again, kill it at random moments, let the last one end; returns
    how many kills hit a living run.

    window   seconds within which a kill comes, counted from the start
    working  count them from the moment at which the run has written a record of its own: no kill
    then falls into its imports
    """
    moments = random.Random(seed)
    hit = 0
    for number in range(kills):
        before = _written(folder)
        process = subprocess.Popen(
            command,
            start_new_session=True,
            env={**os.environ, **(environment or {})},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        while working and process.poll() is None and _written(folder) <= before:
            time.sleep(0.01)
        time.sleep(moments.uniform(*window))
        if process.poll() is None:
            hit += 1
            if number % 2:
                os.kill(process.pid, signal.SIGKILL)
            else:
                os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    subprocess.run(
        command, check=True, env={**os.environ, **(environment or {})}, stdout=subprocess.DEVNULL
    )
    return hit


def _written(folder):
    """Bytes of a dataset's records."""
    return sum(path.stat().st_size for path in Store(folder).record_files())


def compared(whole, killed):
    """What differs between two datasets of one job, a line each: ids, inputs, pixels beyond Cycles'
    repeatability.
    """
    ours, theirs = ({r.id: r for r in Store(folder).records()} for folder in (whole, killed))
    lines = [f"{id_}: in one dataset only" for id_ in ours.keys() ^ theirs.keys()]
    count = sum(1 for _ in Store(killed).records())
    if count != len(theirs):
        lines.append(f"{count - len(theirs)} records twice")
    for id_ in ours.keys() & theirs.keys():
        a, b = (msgspec.to_builtins(r[id_]) for r in (ours, theirs))
        lines += [
            f"{id_}: {key} {a[key]} and {b[key]}" for key in a.keys() - VARYING if a[key] != b[key]
        ]
        accuracies = a.get("accuracy"), b.get("accuracy")
        if not _same_accuracy(*accuracies):
            lines.append(f"{id_}: accuracy {accuracies[0]} and {accuracies[1]}")
        first, second = (
            read_picture(Path(whole) / a["image"]),
            read_picture(Path(killed) / b["image"]),
        )
        apart = np.abs(first - second).max() / max(first.max(), 1e-9)
        if not apart <= SAME_PICTURE:
            lines.append(f"{id_}: pixels {apart:.2g} of the largest apart")
    return lines


def recorded(folder):
    """How many pictures there are."""
    return sum(path.read_bytes().count(b"\n") for path in Store(folder).record_files())


def _same_accuracy(one, other):
    """Whether two records of one shot had the same estimator and errors, in whatever time."""
    if one is None or other is None:
        return one is other
    errors, most = ("predicted", "estimated", "standard_error"), SAME_ERROR * one["requested"]
    return all(
        abs(one[key] - other[key]) <= most if key in errors else one[key] == other[key]
        for key in one.keys() - {"seconds"}
    )


def main():
    """Run it and write the report; 0 if nothing was lost, nothing twice and both folders are
    clean.
    """
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("job")
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--window", type=float, nargs=2, default=(1.0, 12.0))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--catalogue", action="append", default=[])
    options = parser.parse_args()
    words = " ".join(map(shorten, sys.argv[1:]))
    made_by = provenance(f"PYTHONPATH=. python tests/endurance/kill_and_resume.py {words}")
    extra = [word for path in options.catalogue for word in ("--catalogue", path)]

    def render(folder):
        return [
            sys.executable,
            "-m",
            "factory",
            "render",
            options.job,
            "--out",
            str(folder),
            "--workers",
            str(options.workers),
            *extra,
        ]

    start = time.monotonic()
    hit = disturbed(
        render(options.out / "killed"),
        options.out / "killed",
        options.kills,
        options.window,
        options.seed,
    )
    subprocess.run(render(options.out / "whole"), check=True)
    differences = compared(options.out / "whole", options.out / "killed")
    verified = [
        subprocess.run(
            [sys.executable, "-m", "factory", "verify", str(options.out / name)]
        ).returncode
        for name in ("whole", "killed")
    ]
    report = {
        "made_by": made_by,
        "kills": hit,
        "records": sum(1 for _ in Store(options.out / "killed").records()),
        "differences": differences,
        "verify": verified,
        "seconds": round(time.monotonic() - start),
    }
    (options.out / "report.json").write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))
    return 0 if hit and not differences and not any(verified) else 1


if __name__ == "__main__":
    sys.exit(main())
