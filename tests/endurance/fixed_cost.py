"""What a picture costs besides its samples: 24 views at 1 sample, 256², records written, against a
bare bpy loop in the same run.

    PYTHONPATH=. python tests/endurance/fixed_cost.py --catalogue FILE --material NAME [--rounds 3]

Each round runs both, one after the other, each in a process of its own: a bare loop (the same mesh,
material, light and settings, persistent data on, each view written as EXR by Blender), and the
factory's pipeline, first with geometry still to be made, then relit with another light, which is
what all but the first of a shape's pictures cost. Rates in pictures a second; ratios are what
counts on a shared machine.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

VIEWS = tuple(range(24))


def bare(options, folder):
    """Seconds for 24 views by bpy alone, after one picture to warm up."""
    import bpy
    import numpy as np

    from factory.lights import load
    from factory.render import body, camera, light, materials, settings
    from factory.shapes.catalogue import load as load_shape
    from manifests.materials import load_catalogue
    from manifests.schema import Camera
    from shaders import nodes

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    settings.apply(scene, (*settings.ALWAYS, *settings.PICTURE))
    scene.cycles.samples, scene.cycles.max_bounces = 1, 0
    source = load_shape(options.shape)
    mesh = body.build(source)
    entry = load_catalogue(*([options.catalogue] if options.catalogue else []))[options.material]
    group = materials.build(nodes.graph(entry.mixture))
    for number in range(source.segments):
        mesh.materials.append(materials.new(f"surface {number}"))
        materials.show(mesh.materials[number], group)
    each = bpy.data.objects.new("shape", mesh)
    scene.collection.objects.link(each)
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    camera.place(scene, Camera())
    light.build(scene, light.as_seen(load("city").L64, 0), True)
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = (
        "OPEN_EXR",
        "16",
    )
    start = None
    for view in (0, *VIEWS):
        each.rotation_euler = (0.0, 0.0, -np.radians(15.0 * view))
        scene.render.filepath = str(folder / f"{view}.exr")
        bpy.ops.render.render(write_still=True)
        start = start or time.perf_counter()
    return [time.perf_counter() - start]


def ours(options, folder):
    """Seconds for 24 views by the pipeline: geometry still to be made, then relit; after one
    picture to warm up.
    """
    from factory.execution.pipeline import Pipeline
    from factory.execution.registration import register_job
    from factory.execution.run import make_assignment, make_plan, shape_sources
    from factory.planning.assets import resolve
    from factory.render.studio import Studio
    from manifests.line_files import Lines
    from manifests.materials import load_catalogue
    from manifests.schema import Job
    from manifests.store import Store

    job = Job(
        shapes=(options.shape,),
        materials=(options.material,),
        lights=("city", "interior"),
        views=VIEWS,
        tiers=("direct",),
        samples=1,
    )
    catalogues = [options.catalogue] if options.catalogue else []
    plan = make_plan(job, resolve(job, catalogues=catalogues))
    store = Store(folder)
    register_job(store, plan, len(plan))
    mixtures = {name: m.mixture for name, m in load_catalogue(folder / "materials.json").items()}
    lines = Lines(folder / "records" / "worker-00.jsonl")
    pipeline = Pipeline(
        Studio("cpu", None), make_assignment(plan), store, "worker-00", lines.append, mixtures
    )
    shots, seconds = list(plan), []
    pipeline.shapes = shape_sources(plan.assets.shapes)
    pipeline.make(shots[0])
    (folder / "geometry").rename(folder / "warm")
    pipeline._geometries.clear()
    for first in (0, 24):
        if first:
            pipeline.make(shots[first])  # the change of light is no part of a view's fixed cost
        start = time.perf_counter()
        for shot in shots[first : first + 24]:
            pipeline.make(shot)
        seconds.append(time.perf_counter() - start)
    assert len(store.ids()) == 48
    return seconds


def main():
    """Run the rounds and print the rates."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--shape", default="chair:0")
    parser.add_argument("--material", default="white-diffuse-bball")
    parser.add_argument("--catalogue")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--part", choices=("bare", "ours"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.part:
        with tempfile.TemporaryDirectory() as folder:
            print(
                json.dumps(
                    {"seconds": {"bare": bare, "ours": ours}[options.part](options, Path(folder))}
                )
            )
        return 0
    rounds = []
    for _ in range(options.rounds):
        result = {}
        for part in ("bare", "ours"):
            done = subprocess.run(
                [sys.executable, *sys.argv, "--part", part], capture_output=True, text=True
            )
            result[part] = json.loads(
                next(line for line in done.stdout.splitlines() if line.startswith('{"seconds"'))
            )["seconds"]
        rates = {
            "bare": 24 / result["bare"][0],
            "with geometry": 24 / result["ours"][0],
            "relit": 24 / result["ours"][1],
        }
        rounds.append(rates)
        print({name: round(rate, 2) for name, rate in rates.items()}, flush=True)
    for name in ("with geometry", "relit"):
        print(f"{name} / bare: median {statistics.median(r[name] / r['bare'] for r in rounds):.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
