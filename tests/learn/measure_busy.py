"""Time an edit alone and beside busy processes, in turn: wall clock and processor seconds.

PYTHONPATH=. python tests/learn/measure_busy.py [PHOTO MASK] [--busy 4] [--rounds 2] [--out DIR]

Without a photograph it edits the example. Each row says how many processes ran or waited for a core
before the edit began: figures "alone" need a machine where this is near 0. OPENBLAS_NUM_THREADS=2
measures what a second thread of OpenBLAS costs. DIR/report.json has the rows and the ratios.
"""

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from manifests.files import write_json
from manifests.provenance import provenance, shorten

SPIN = "while True: pass"


@contextlib.contextmanager
def busy(count: int) -> Iterator[None]:
    """Keep `count` processes busy meanwhile."""
    processes = [subprocess.Popen([sys.executable, "-c", SPIN]) for _ in range(count)]
    try:
        yield
    finally:
        for each in processes:
            each.kill()
            each.wait()


def running() -> int:
    """Return how many threads of other processes run or wait for a core."""
    return int(Path("/proc/loadavg").read_text().split()[3].partition("/")[0]) - 1


def edit(photo: str, mask: Path | None) -> tuple[float, float]:
    """Return wall-clock and processor seconds of one edit, the program's start included."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["edit", photo, "--material", "brass+keep" if mask is None else "brass"]
        words += ["--out", folder, *(() if mask is None else ("--mask", str(mask)))]
        before, start = os.times(), time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "learn", *words, "--overwrite"], check=True, capture_output=True
        )
        wall, after = time.perf_counter() - start, os.times()
    children = after.children_user + after.children_system
    return wall, children - before.children_user - before.children_system


def main() -> None:
    """Print a row for each round, and the ratios of the least times."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("photo", nargs="?", default="example:espresso-cup")
    parser.add_argument("mask", type=Path, nargs="?")
    parser.add_argument("--busy", type=int, default=4)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--out", type=Path, metavar="DIR")
    options = parser.parse_args()
    given = " ".join(map(shorten, sys.argv[1:]))
    report = provenance(f"PYTHONPATH=. python tests/learn/measure_busy.py {given}".rstrip())
    rows: list[dict[str, object]] = []
    ratios: dict[str, float] = {}
    alone: list[tuple[float, float]] = []
    beside: list[tuple[float, float]] = []
    for _ in range(options.rounds):
        for name, count, times in (("alone", 0, alone), ("beside", options.busy, beside)):
            load = running()
            with busy(count):
                times.append(edit(options.photo, options.mask))
            wall, processor = times[-1]
            rows.append(
                {
                    "busy": count,
                    "seconds": round(wall, 2),
                    "processor_seconds": round(processor, 2),
                    "others_at_the_start": load,
                }
            )
            print(
                f"{name:8}{wall:7.1f} s wall clock {processor:7.1f} s processor; {load} others",
                flush=True,
            )
    for k, name in enumerate(("wall clock", "processor")):
        ratio = min(each[k] for each in beside) / min(each[k] for each in alone)
        print(f"ratio, {name}: {ratio:.2f}")
        ratios[name] = round(ratio, 3)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        write_json(options.out / "report.json", report | {"rows": rows, "ratios": ratios})


if __name__ == "__main__":
    main()
