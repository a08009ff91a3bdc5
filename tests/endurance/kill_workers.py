"""Single workers of a run are killed while the run goes on: is anything lost, twice, or different?

    PYTHONPATH=. python tests/endurance/kill_workers.py JOB --kills 20 --out DIR [--workers 2]
    [--most 16]

renders JOB with Blender into DIR/whole undisturbed, and into DIR/killed while a random worker is
killed by SIGKILL, again and again: each time between one and `--most` pictures after the last kill,
at a random moment of the picture in hand. The run itself lives and replaces its workers. A picture
whose worker dies twice is given up and written to failures.jsonl; the same command, which is
run once more at the end, makes it. The two folders are then compared as kill_and_resume.py does,
and DIR/report.json is written.
"""

import argparse
import random
import subprocess
import sys
import time
from pathlib import Path

import psutil

from manifests.files import write_json
from manifests.provenance import provenance, shorten
from tests.endurance.kill_and_resume import compared, recorded


def workers_of(run):
    """The run's processes that render."""
    found = []
    for each in run.children():
        try:
            if "factory.execution.worker" in each.cmdline():
                found.append(each)
        except psutil.Error:  # it has just ended
            continue
    return found


def disturbed(command, folder, kills, most, seed):
    """Run the command and kill its workers; (exit status, number of kills, seconds)."""
    draw, hit, start = random.Random(seed), 0, time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    run = psutil.Process(process.pid)
    enough = draw.randint(1, most)
    while process.poll() is None:
        if hit < kills and recorded(folder) >= enough:
            time.sleep(draw.uniform(0.0, 0.3))
            try:
                living = workers_of(run)
            except psutil.NoSuchProcess:
                break
            if living:
                draw.choice(living).kill()
                hit += 1
                enough = recorded(folder) + draw.randint(1, most)
        time.sleep(0.02)
    return process.wait(), hit, time.monotonic() - start


def main():
    """Run it and write the report; 0 if nothing was lost, nothing twice and nothing different."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("job")
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--most", type=int, default=16, help="pictures between two kills")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    def render(name):
        words = ["render", options.job, "--out", str(options.out / name)]
        return [sys.executable, "-m", "factory", *words, "--workers", str(options.workers)]

    words = " ".join(map(shorten, sys.argv[1:]))
    made_by = provenance(f"PYTHONPATH=. python tests/endurance/kill_workers.py {words}")
    killed = options.out / "killed"
    status, hit, seconds = disturbed(
        render("killed"), killed, options.kills, options.most, options.seed
    )
    before = recorded(killed)
    if status:  # some were given up
        subprocess.run(render("killed"), check=True, stdout=subprocess.DEVNULL)
    start = time.monotonic()
    subprocess.run(render("whole"), check=True, stdout=subprocess.DEVNULL)
    undisturbed = time.monotonic() - start
    report = made_by | {
        "kills": hit,
        "status": status,
        "given_up": sum(f.read_bytes().count(b"\n") for f in killed.glob("failures*.jsonl")),
        "made_again": recorded(killed) - before,
        "pictures": recorded(killed),
        "differences": compared(options.out / "whole", killed),
        "verify": [
            subprocess.run(
                [sys.executable, "-m", "factory", "verify", str(options.out / name)],
                stdout=subprocess.DEVNULL,
            ).returncode
            for name in ("whole", "killed")
        ],
        "seconds": {"killed": round(seconds), "undisturbed": round(undisturbed)},
    }
    write_json(options.out / "report.json", report)
    print((options.out / "report.json").read_text())
    return 0 if hit and not report["differences"] and not any(report["verify"]) else 1


if __name__ == "__main__":
    sys.exit(main())
