"""How long a few things take that a user waits for, beside the limit that is set for each.

    PYTHONPATH=. python tests/endurance/timings.py [NAME …] [--rounds 3]

Processor time in seconds, the least of the rounds, on one thread. The exit status is 1 if a limit
is exceeded. Run it on an idle machine: the tests themselves count work and measure no time.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

LAYER = """
import time, torch
start = time.process_time()
from learn.layer import render
imported = time.process_time() - start
torch.set_num_threads(1)
n = torch.zeros(1, 2, 2, 3); n[..., 2] = 1.0
start = time.process_time()
render(n, torch.full((1, 108), 0.3), torch.ones(1, 8, 16, 3), method="exact")
print(imported, time.process_time() - start)
"""


def polygon(kind):
    """Cut a polygon of 4,000 corners into triangles."""
    from factory.shapes.polygons import triangulate
    from tests.support import polygon_outlines

    rng = np.random.default_rng(1)
    xy = {
        "star": lambda: polygon_outlines.star(4000, 0.3, rng),
        "comb": lambda: polygon_outlines.comb(1000),
        "spiral": lambda: polygon_outlines.spiral(4000),
        "random": lambda: rng.random((4000, 2)),
    }[kind]()
    vertices = np.c_[xy, np.zeros(len(xy))]
    return lambda: triangulate(vertices, np.arange(len(xy)), np.array([len(xy)]))


def polygon_file(folder):
    """Read a mesh file with one polygon of 4,000 corners."""
    from factory.shapes.mesh_import import open_mesh
    from tests.support import polygon_outlines

    path = folder / "polygon.obj"
    path.write_text(
        polygon_outlines.obj_of(polygon_outlines.star(4000, 0.5, np.random.default_rng(1)))
    )
    return lambda: open_mesh(path)


def slivers(folder):
    """Find the back faces of a fan of 4,000 slivers."""
    from factory.shapes.raster import back_faces
    from tests.support.polygon_outlines import fan_of_slivers

    return lambda: back_faces(*fan_of_slivers(4000))


def shapes(folder):
    """Make four shapes of the slowest family."""
    from factory.shapes.catalogue import load

    return lambda: [load(f"car:{seed}") for seed in range(20, 24)]


def shots(folder):
    """Make the ids of 12,000 shots, those of the smallest job again and again."""
    from factory.execution.run import make_plan
    from factory.planning import jobs
    from factory.planning.assets import resolve

    job = jobs.load("smallest")[0]
    plan = make_plan(job, resolve(job))
    return lambda: [sum(1 for _ in plan) for _ in range(12_000 // len(plan))]


def record_ids(folder):
    """Read the ids of 20,000 records."""
    import json

    from manifests.store import Store
    from tests.support.whole_dataset import JOB, write_dataset

    write_dataset(folder / "data", JOB, 1)
    (path,) = Store(folder / "data").record_files()
    line = path.read_bytes().splitlines()[0]
    known = json.loads(line)
    with open(path, "wb") as file:
        for k in range(20_000):
            file.write(json.dumps(known | {"id": f"{k:024x}"}).encode() + b"\n")
    return lambda: Store(folder / "data").ids()


def of_a_process(column):
    def prepare(folder):
        environment = os.environ | {"BRDFACTORY_CACHE": str(folder)}
        command = [sys.executable, "-c", LAYER]

        def run():
            done = subprocess.run(
                command, env=environment, capture_output=True, text=True, check=True
            )
            return float(done.stdout.split()[column])

        run()  # compiles
        return run

    return prepare


TIMINGS = {  # name: (what prepares a call that may return its own seconds, limit in seconds)
    **{
        f"a polygon of 4,000 corners: {kind}": (lambda folder, kind=kind: polygon(kind), 10.0)
        for kind in ("star", "comb", "spiral", "random")
    },
    "a mesh file with such a polygon": (polygon_file, 5.0),
    "back faces of 4,000 slivers": (slivers, 4.0),
    "four cars": (shapes, 2.0),
    "12,000 shots": (shots, 2.4),
    "ids of 20,000 records": (record_ids, 0.6),
    "import learn.layer": (of_a_process(0), 0.3),
    "the first call with kernels kept": (of_a_process(1), 0.3),
}


def seconds(function, rounds):
    """The least processor time of some rounds, or the least that the function itself returns."""
    measured = []
    for _ in range(rounds):
        start = time.process_time()
        own = function()
        measured.append(own if isinstance(own, float) else time.process_time() - start)
    return min(measured)


def main(words=None):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", help="parts of the names of what to measure")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args(words)
    exceeded = 0
    for name, (prepare, limit) in TIMINGS.items():
        if options.names and not any(part in name for part in options.names):
            continue
        with tempfile.TemporaryDirectory() as folder:
            spent = seconds(prepare(Path(folder)), options.rounds)
        exceeded += spent > limit
        print(f"{name:45} {spent:8.3f} s of {limit:g}{' EXCEEDED' if spent > limit else ''}")
    return 1 if exceeded else 0


if __name__ == "__main__":
    sys.exit(main())
