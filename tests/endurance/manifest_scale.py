"""How long 720,000 records take to list, to filter, to resume from and to verify.

    PYTHONPATH=. python tests/endurance/manifest_scale.py --out DIR

The records of a job of 150 shapes, 60 materials, eight lights and ten views are written into DIR as
if they had been rendered: ids, seeds and views are true, the files that they name are not there.
Only the lines are read.
"""

import argparse
import hashlib
import resource
import sys
import time
from collections import deque
from itertools import islice
from pathlib import Path

import msgspec

from factory.planning.assets import Assets, Light, resolve
from factory.planning.job_shapes import Shape
from factory.planning.plan import Plan
from factory.planning.shape_names import Source
from manifests.materials import Catalogue, encode
from manifests.schema import (
    Camera,
    Dataset,
    Draw,
    Job,
    LightEntry,
    MaterialEntry,
    Order,
    Record,
    ShapeEntry,
    Statistics,
)
from manifests.splits import SIDES, light_side, role_of
from manifests.store import Store
from manifests.store_paths import geometry_path, image_path, light_path
from manifests.verification import Verification
from manifests.viewpoints import azimuths_deg

SHAPES, WORKERS = 150, 8
JOB = Job(
    shapes=(f"chair:0-{SHAPES - 1}",),
    materials=("merl/paper-train",),
    lights=("city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset"),
    views=Draw(random=10),
    rotations=Draw(random=1),
    camera=Camera(size=(128, 128)),
)


def hash_of(name):
    """A stand-in hash of a name."""
    return hashlib.sha256(name.encode()).hexdigest()


def planned():
    """The Plan of JOB over true materials, and shapes and lights that are only names and hashes."""
    sphere = msgspec.structs.replace(JOB, shapes=("sphere",), lights=("city",))
    shapes = []
    for name in (f"chair:{k}" for k in range(SHAPES)):
        role = role_of(name, "chair", hash_of(name), JOB.split)
        words = {
            "name": name,
            "category": "chair",
            "hash": hash_of(name),
            "role": role,
            "side": SIDES[role],
        }
        shapes.append(Shape(**words, source=Source(name), segments=1, licence="", report=""))
    lights = {name: Light(name, name, hash_of(name), 1.0, "CC0", "", None) for name in JOB.lights}
    return Plan(JOB, Assets(shapes, resolve(sphere).materials, lights), "render")


def described(plan):
    """The Dataset of a plan."""
    assets = plan.assets
    return Dataset(
        orders=(Order(job=plan.job, shots=len(plan), begun=""),),
        settings={plan.fingerprint: {}},
        shapes={
            s.name: ShapeEntry(
                hash=s.hash, category=s.category, side=s.side, role=s.role, segments=1, licence=""
            )
            for s in assets.shapes
        },
        materials={
            m.name: MaterialEntry(hash=m.hash, side=m.side, licence=m.licence, source=m.source)
            for m in assets.materials
        },
        lights={
            name: LightEntry(
                hash=light.hash,
                file=light_path(name, light.hash),
                file_hash=light.hash,
                scale=1.0,
                licence="CC0",
                side=light_side(light.hash),
            )
            for name, light in assets.lights.items()
        },
    )


def record_of(shot, plan, dataset):
    """The Record of a shot, its files unseen."""
    shape, light = dataset.shapes[shot.shape], dataset.lights[shot.light]
    return Record(
        id=shot.id,
        shape=shot.shape,
        shape_hash=shape.hash,
        category=shape.category,
        viewpoint=shot.viewpoint,
        azimuth_deg=azimuths_deg()[shot.viewpoint],
        camera=plan.job.camera,
        materials=shot.materials,
        light=shot.light,
        light_hash=light.hash,
        rotation_texels=shot.rotation_texels,
        tier=shot.tier,
        light_resolution=shot.light_resolution,
        samples=plan.job.samples,
        seed=shot.seed,
        image=image_path(shot.id),
        image_hash=hash_of(shot.id),
        geometry=geometry_path(shot.geometry),
        geometry_hash=hash_of(shot.geometry),
        split=shot.split,
        statistics=Statistics(coverage=0.412345, mean=0.512345, max=12.123456),
        seconds=0.1234,
    )


def grown(folder):
    """A Store of the 720,000 records."""
    plan, store = planned(), Store(folder)
    dataset = described(plan)
    store.write_json("dataset.json", dataset)
    materials = tuple(m.entry for m in plan.assets.materials)
    store.place("materials.json", encode(Catalogue(title="", credit="", materials=materials)), "t")
    (folder / "records").mkdir()
    shots, each = iter(plan), -(-len(plan) // WORKERS)
    for worker in range(WORKERS):
        with open(folder / "records" / f"worker-{worker:02d}.jsonl", "wb") as file:
            for shot in islice(shots, each):
                file.write(msgspec.json.encode(record_of(shot, plan, dataset)) + b"\n")
    return store


def timed(name, work):
    """Run it and print wall and processor seconds, and the largest memory so far."""
    wall, processor = time.perf_counter(), time.process_time()
    result = work()
    megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    print(
        f"{name}: {wall:.1f} s, {processor:.1f} s CPU, peak {megabytes:.0f} MB ({result})",
        flush=True,
    )


def main():
    """Print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", required=True, type=Path)
    options = parser.parse_args()
    store = Store(options.out) if (options.out / "records").is_dir() else grown(options.out)
    print(f"{sum(p.stat().st_size for p in store.record_files()) / 1e6:.0f} MB of records")
    timed("list", lambda: sum(1 for _ in store.records()))
    timed(
        "filter", lambda: sum(1 for _ in store.records(lambda record: record.id.startswith("ab")))
    )
    timed("resume (ids)", lambda: len(store.ids()))
    timed("verify --quick", lambda: list(deque(Verification(store).in_records(), maxlen=3)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
