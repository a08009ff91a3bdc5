"""Ten thousand pictures in one run: rate, memory, open files and temporary files along the way.

    PYTHONPATH=. python tests/endurance/many_pictures.py docs/jobs/many-pictures.json --out DIR
    [--workers 1] [--pictures N] [--most-growth 0.03]

renders JOB into DIR/data, looks at the run and its workers once per second, and writes
DIR/report.json, DIR/report.md and DIR/chart.png. Each run begins with a new folder. It fails if the
job does, or if memory grows by more than the limit after the first hundred pictures: the medians
of the tenth of the pictures after them and of the last tenth are compared.

memory   resident, of all processes together
files    open file handles of all processes together
temporary   files in the run's own TMPDIR
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil

from manifests.files import write_figure, write_json, write_text
from manifests.provenance import provenance, shorten

FIRST = 100  # pictures after which memory should not grow
COLUMNS = ("seconds", "pictures", "memory_mb", "handles", "temporary")


def looked(process, folder, temporary, start):
    """One row of COLUMNS, or None once the run has ended."""
    try:
        family = [process, *process.children(recursive=True)]
        memory = sum(each.memory_info().rss for each in family)
        handles = sum(each.num_fds() for each in family)
    except psutil.NoSuchProcess:
        return None
    pictures = sum(1 for _ in (folder / "images").rglob("*.exr"))
    return (
        round(time.monotonic() - start, 2),
        pictures,
        memory / 2**20,
        handles,
        sum(1 for each in temporary.rglob("*") if each.is_file()),
    )


def watched(command, folder, temporary, log):
    """Run a command and look at it once per second; (exit status, rows of COLUMNS).

    folder     the data set that it makes
    temporary  its TMPDIR
    log        file for what it says
    """
    start = time.monotonic()
    with open(log, "w") as said:
        run = subprocess.Popen(
            command,
            stdout=said,
            stderr=subprocess.STDOUT,
            env={**os.environ, "TMPDIR": str(temporary)},
        )
        process, rows = psutil.Process(run.pid), []
        while run.poll() is None:
            if row := looked(process, folder, temporary, start):
                rows.append(row)
            time.sleep(1)
    return run.returncode, rows


def growth(rows, column):
    """How much a column's median grows, relative, from the tenth after FIRST to the last tenth."""
    pictures = rows[:, 1]
    tenth = max((pictures[-1] - FIRST) / 10, 1)
    early = (pictures >= FIRST) & (pictures <= FIRST + tenth)
    late = pictures >= pictures[-1] - tenth
    if not early.any() or FIRST + tenth >= pictures[-1]:
        raise SystemExit(f"expected far more than {FIRST} pictures, found {int(pictures[-1])}")
    first, last = (np.median(rows[part, column]) for part in (early, late))
    return float(last / first - 1)


def chart(rows):
    """A figure of all columns over the number of pictures."""
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(10, 6), layout="constrained")
    axes = drawing.subplots(2, 2, sharex=True).ravel()
    pictures = rows[:, 1]
    steps = np.linspace(0, len(rows) - 1, min(len(rows), 60)).astype(int)
    passed = np.diff(rows[steps], axis=0)
    rate = passed[:, 1] / np.maximum(passed[:, 0], 1e-9)
    axes[0].plot(pictures[steps][1:], rate, lw=1)
    for each, k, title in zip(
        axes[1:], (2, 3, 4), ("memory (MB)", "open files", "temporary files"), strict=True
    ):
        each.plot(pictures, rows[:, k], lw=1)
        each.set_title(title)
    axes[0].set_title("pictures per second")
    for each in axes:
        each.set_ylim(bottom=0)
        each.grid(alpha=0.3)
    for each in axes[2:]:
        each.set_xlabel("pictures")
    return drawing


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("job", metavar="JOB")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--workers", type=int, default=1, metavar="N")
    parser.add_argument("--pictures", type=int, metavar="N", help="at most so many")
    parser.add_argument("--most-growth", type=float, default=0.03, metavar="SHARE")
    options = parser.parse_args()
    data, temporary = options.out / "data", options.out / "temporary"
    if data.exists():
        raise SystemExit(f"{data}: expected a new folder, found one (name another --out)")
    temporary.mkdir(parents=True)
    command = [sys.executable, "-m", "factory", "render", options.job, "--out", str(data)]
    command += ["--workers", str(options.workers)]
    command += ["--limit", str(options.pictures)] if options.pictures else []
    status, rows = watched(command, data, temporary, options.out / "run.log")
    table = np.array(rows)
    grown = growth(table, 2)
    result = {
        **provenance(
            "PYTHONPATH=. python tests/endurance/many_pictures.py "
            + " ".join(map(shorten, sys.argv[1:]))
        ),
        "exit_status": status,
        "pictures": sum(1 for _ in (data / "images").rglob("*.exr")),  # the last look is earlier
        "seconds": float(table[-1, 0]),
        "memory_growth": grown,
        "handles_growth": growth(table, 3),
        "most_memory_mb": float(table[:, 2].max()),
        "most_temporary": int(table[:, 4].max()),
        "left_temporary": sum(1 for each in temporary.rglob("*") if each.is_file()),
        "columns": COLUMNS,
        "rows": [list(row) for row in rows[:: max(1, len(rows) // 400)]],
    }
    write_json(options.out / "report.json", result)
    write_figure(options.out / "chart.png", chart(table), dpi=100)
    lines = [
        "# Many pictures in one run",
        "",
        f"    {result['command']}",
        "",
        f"Commit {result['commit']}, {result['date']}, {result['machine']}.",
        "",
        "![chart](chart.png)",
        "",
        "| | |",
        "|---|---|",
        f"| pictures | {result['pictures']} |",
        f"| seconds | {result['seconds']:.0f} |",
        f"| growth of memory after the first {FIRST} pictures | {grown:+.1%} |",
        f"| growth of open files | {result['handles_growth']:+.1%} |",
        f"| most memory | {result['most_memory_mb']:.0f} MB |",
        f"| most temporary files, and left | {result['most_temporary']},"
        f" {result['left_temporary']} |",
    ]
    write_text(options.out / "report.md", "\n".join(lines) + "\n")
    print("\n".join(lines[-7:]))
    return 0 if status == 0 and grown <= options.most_growth else 1


if __name__ == "__main__":
    sys.exit(main())
