"""Time the first use of the layer in fresh processes, without and with kernels kept from before.

The times are what importing the layer adds to a program that has torch, its first picture and its
first derivatives, and both once more; medians over rounds, in seconds. "empty" starts without
compiled kernels, "kept" with those of the start before. Other work on the machine adds to all.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from learn.commands import options
from learn.experiments import runner

CASES = ("exact", "exact, view per pixel", "auto")
KERNELS = ("empty", "kept")
ROOT = Path(__file__).parents[3]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the cases, the number of rounds and the number of threads."""
    parser.add_argument(
        "--case",
        nargs="+",
        choices=CASES,
        default=CASES,
        metavar="CASE",
        help=f"of {'; '.join(CASES)} (default: all)",
    )
    options.add_count(parser, "--rounds", 3, "fresh starts of each kind")
    options.add_threads(parser, "torch's threads")


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"threads", "rounds", "seconds": {case: {"empty" | "kept": {what: median seconds}}}}.

    `what` is one of the keys that learn.experiments.layer.first_use prints.
    """
    import tempfile

    from manifests.progress import tqdm

    seconds_of: dict[str, dict[str, list]] = {
        case: {kernels: [] for kernels in KERNELS} for case in arguments.case
    }
    with tqdm(total=arguments.rounds * len(seconds_of), unit="start", desc="startup") as progress:
        for _ in range(arguments.rounds):
            for case, of_case in seconds_of.items():
                with tempfile.TemporaryDirectory() as folder:
                    for kernels in KERNELS:
                        of_case[kernels].append(start(case, arguments.threads, folder))
                progress.update()
    seconds = {
        case: {kernels: medians(times) for kernels, times in of_case.items()}
        for case, of_case in seconds_of.items()
    }
    return {"threads": arguments.threads, "rounds": arguments.rounds, "seconds": seconds}


def start(case: str, threads: int, folder: str) -> dict[str, float]:
    """Return the seconds that one fresh process reports; its kernels are kept in the folder."""
    import json
    import os
    import subprocess
    import sys

    from manifests.errors import InputError

    environment = os.environ | {
        "BRDFACTORY_CACHE": folder,
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
    }
    command = [sys.executable, "-m", "learn.experiments.layer.first_use", case, str(threads)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise InputError(
            " ".join(command[1:]),
            "a picture",
            done.stderr.strip().splitlines()[-1],
            "run it by hand to see the whole error",
        )
    return json.loads(done.stdout)


def medians(times: list[dict[str, float]]) -> dict[str, float]:
    """Return the median of each key."""
    import statistics

    return {what: statistics.median(each[what] for each in times) for what in times[0]}


def tables(report: runner.Report) -> str:
    """Return the median seconds of each case."""
    cases = report["seconds"]
    names = list(next(iter(cases.values()))["empty"])
    rows = [
        [case, kernels, *(f"{cases[case][kernels][name]:.2f}" for name in names)]
        for case in cases
        for kernels in KERNELS
    ]
    return (
        "# First use of the layer\n\n"
        f"Median seconds of {report['rounds']} fresh processes; {report['threads']} threads.\n\n"
        + runner.table(["method", "kernels", *names], rows)
    )
