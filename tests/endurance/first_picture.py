"""When does a job of thousands of mesh files show its first picture, and when a resumed run?

    PYTHONPATH=. python tests/endurance/first_picture.py --meshes 3000 --out DIR [--resumed]

writes OBJ files of 30,000 triangles, each another torus, into DIR/meshes unless they are there, and
renders three pictures of 32 × 32 of a job of all of them into a new folder, in a process of its
own; seconds are from the start of that process to the first picture. With --resumed all files are
read first, as earlier runs would have done (half a second each), three pictures are made, and then
a run is timed that makes three more. With --resumed --kept the folder of an earlier --resumed is
resumed once more, without reading. DIR/report.json, or DIR/resumed.json, has the result.
"""

import argparse
import json
import shutil
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import numpy as np

from factory.planning import jobs
from factory.planning.assets import resolve_unread
from factory.planning.facts import Memory
from factory.planning.reading import Reading
from manifests.files import write_json
from manifests.provenance import provenance, shorten
from manifests.subprocesses import processors

ROUND, ALONG = 100, 150  # vertices; there are two triangles for each

TIMED = """
import sys, time
import psutil
from factory.execution.run import RunOptions, carry_out, make_plan
from factory.planning import jobs
from factory.planning.assets import resolve_unread
begun = psutil.Process().create_time()
job, folder = jobs.load(sys.argv[1])
plan = make_plan(job, resolve_unread(job, folder))
def watch(event, value):
    if event == "made":
        print(time.time() - begun, flush=True)
carry_out(plan, sys.argv[2], RunOptions(workers=int(sys.argv[3]), limit=3), watch)
"""


def write_meshes(folder, count):
    """Write the tori that are not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    u, v = np.meshgrid(
        np.arange(ALONG) / ALONG * 2 * np.pi, np.arange(ROUND) / ROUND * 2 * np.pi, indexing="ij"
    )
    i, j = np.meshgrid(np.arange(ALONG), np.arange(ROUND), indexing="ij")
    a, b, c, d = (
        (k % ALONG) * ROUND + n % ROUND for k, n in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1))
    )
    corners = [np.stack(each, -1).reshape(-1, 3) + 1 for each in ((a, b, c), (a, c, d))]
    faces = "".join(f"f {x} {y} {z}\n" for x, y, z in np.concatenate(corners))
    for number in range(count):
        path = folder / f"torus-{number:04d}.obj"
        if path.exists():
            continue
        draw = np.random.default_rng(number)
        waves, ripples = draw.integers(2, 9, 2)
        r = 0.4 * (1 + draw.uniform(0.02, 0.1) * np.sin(waves * u) * np.cos(ripples * v))
        out = 1 + r * np.cos(v)
        places = np.stack([out * np.cos(u), out * np.sin(u), r * np.sin(v)], -1).reshape(-1, 3)
        text = "".join(f"v {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in places)
        path.write_text(text + faces)


def first_picture(job, folder, workers):
    """Seconds from the start of a process that renders a job to its first picture."""
    words = [sys.executable, "-c", TIMED, str(job), str(folder), str(workers)]
    done = subprocess.run(words, check=True, capture_output=True, text=True)
    return round(float(done.stdout.splitlines()[0]), 1)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--meshes", type=int, default=3000)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--resumed", action="store_true")
    parser.add_argument("--kept", action="store_true", help="resume what --resumed has made")
    options = parser.parse_args()
    write_meshes(options.out / "meshes", options.meshes)
    path = options.out / "job.json"
    names = [f"meshes/torus-{number:04d}.obj" for number in range(options.meshes)]
    words = {"name": "many", "shapes": names, "materials": ["white-diffuse-bball"]}
    words |= {"lights": ["city"], "views": [0], "tiers": ["direct"], "samples": 1}
    path.write_text(json.dumps(words | {"camera": {"size": [32, 32]}}))
    folder = options.out / "data"
    if not (options.resumed and options.kept):
        shutil.rmtree(folder, ignore_errors=True)
    given = " ".join(map(shorten, sys.argv[1:]))
    report = provenance(f"PYTHONPATH=. python tests/endurance/first_picture.py {given}")
    report |= {"meshes": options.meshes, "workers": options.workers}
    if options.resumed and not options.kept:
        begun = time.monotonic()
        job, assets = jobs.load(path)
        unread = resolve_unread(job, assets).unread
        with closing(Reading(unread, processors(), Memory(folder, "earlier"))) as reading:
            for _ in reading.each():
                pass
        report["seconds_of_reading"] = round(time.monotonic() - begun)
        first_picture(path, folder, options.workers)
    report["first_picture_seconds"] = first_picture(path, folder, options.workers)
    write_json(options.out / ("resumed.json" if options.resumed else "report.json"), report)
    print(json.dumps(report))


if __name__ == "__main__":
    main()
