"""How long 720,000 records take to list, to filter, to resume from and to verify; and how long the shots of such a job take to plan.

    PYTHONPATH=. python tests/endurance/manifest_scale.py DATASET --out DIR

A small dataset's first record is written again and again under other ids into DIR, whose records alone are then read.
"""

import argparse
import hashlib
import resource
import shutil
import sys
import time
from collections import deque
from pathlib import Path

import msgspec

from manifests.store import Store, image_path
from manifests.verification import faults_in_records

WORKERS, EACH = 8, 90_000


def grown(source, folder):
    """A Store of 720,000 records like the first of another."""
    store = Store(source)
    record = next(store.records())
    (folder / "records").mkdir(parents=True, exist_ok=True)
    for name in ("dataset.json", "materials.json"):
        shutil.copyfile(store.folder / name, folder / name)
    line = msgspec.json.encode(record).decode()
    for worker in range(WORKERS):
        with open(folder / "records" / f"worker-{worker:02d}.jsonl", "w") as file:
            for k in range(EACH):
                id_ = hashlib.sha256(f"{worker} {k}".encode()).hexdigest()[:24]
                file.write(line.replace(record.image, image_path(id_)).replace(record.id, id_) + "\n")
    return Store(folder)


def timed(name, work):
    """Run it and print wall and processor seconds, and the largest memory so far."""
    wall, processor = time.perf_counter(), time.process_time()
    found = work()
    megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"{name}: {time.perf_counter() - wall:.1f} s, {time.process_time() - processor:.1f} s CPU, peak {megabytes:.0f} MB ({found})",
        flush=True,
    )


def main():
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset")
    parser.add_argument("--out", required=True, type=Path)
    options = parser.parse_args()
    store = grown(options.dataset, options.out)
    print(f"{sum(p.stat().st_size for p in store.record_files()) / 1e6:.0f} MB of records")
    timed("list", lambda: sum(1 for _ in store.records()))
    timed("filter", lambda: sum(1 for _ in store.records(lambda record: record.id.startswith("ab"))))
    timed("resume (ids)", lambda: len(store.ids()))
    timed("verify --quick", lambda: len(deque(faults_in_records(store), maxlen=3)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
