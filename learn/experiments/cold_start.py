"""How long the first use of the layer takes: fresh processes, the kernels' folder empty, and then
again with what the first has kept.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from tqdm import tqdm

from manifests.errors import InputError

CASES = ("exact", "exact, view per pixel", "auto")
ROOT = Path(__file__).parents[2]


def measure(rounds, threads):
    """{case: {"empty" | "kept": {what: median seconds}}}, what as in
    learn.experiments.first_use.
    """
    result = {case: {"empty": [], "kept": []} for case in CASES}
    with tqdm(total=rounds * len(CASES), unit="start", desc="startup") as progress:
        for _ in range(rounds):
            for case in CASES:
                with tempfile.TemporaryDirectory() as folder:
                    for kernels in ("empty", "kept"):
                        result[case][kernels].append(start(case, threads, folder))
                progress.update()
    return {
        case: {kernels: medians(times) for kernels, times in both.items()}
        for case, both in result.items()
    }


def start(case, threads, folder):
    """What one fresh process says of itself; its kernels are kept in the folder."""
    environment = os.environ | {
        "BRDFACTORY_CACHE": folder,
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
    }
    command = [sys.executable, "-m", "learn.experiments.first_use", case, str(threads)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise InputError(
            " ".join(command[1:]),
            "a picture",
            done.stderr.strip().splitlines()[-1],
            "run it by hand to see the whole error",
        )
    return json.loads(done.stdout)


def medians(times):
    return {what: statistics.median(each[what] for each in times) for what in times[0]}
