"""What rendering costs and how true it is: `python -m factory.render.benchmark NAME …` prints figures, `--out` writes them down.

cost      24 views, 1 sample, 256²: a bare bpy loop that writes files, and the studio with geometry, checks, hashes and files, turn about
memory    resident memory over 200 different meshes, each with its own light and material
geometry, texel, lambert, closures, perspective, materials   see factory.render.proof
"""

import argparse
import hashlib
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from datetime import date
from pathlib import Path

import numpy as np

VIEWS = 24
SIZE = 256


def cost(options):
    """Images a second of both loops, medians over rounds taken in turn, and their ratio."""
    from factory.shapes.primitives import blob

    with tempfile.TemporaryDirectory(dir=options.scratch) as folder:
        studio = _studio(options)
        bare = _BareLoop(studio, blob(0, level=6), folder, options.threads)
        ours = _StudioLoop(studio, blob(0, level=6), folder)
        rounds = {"bare": [], "studio": []}
        for loop in (bare, ours):  # once to warm up
            loop.run()
        for _ in range(options.rounds):
            for name, loop in (("bare", bare), ("studio", ours)):
                start = time.perf_counter()
                loop.run()
                rounds[name].append(VIEWS / (time.perf_counter() - start))
    ratios = np.array(rounds["studio"]) / rounds["bare"]
    return {
        "bare_images_per_s": round(float(np.median(rounds["bare"])), 2),
        "studio_images_per_s": round(float(np.median(rounds["studio"])), 2),
        "ratio_median": round(float(np.median(ratios)), 3),
        "ratio_least": round(float(ratios.min()), 3),
        "ratio_largest": round(float(ratios.max()), 3),
        "rounds": options.rounds,
    }


class _BareLoop:
    """What one writes first: persistent data, the camera set and a file written by Blender, view after view."""

    def __init__(self, studio, mesh, folder, threads):
        import bpy

        from factory.render import body, camera, light, materials, reference
        from factory.render.settings import ALWAYS, PICTURE, apply
        from manifests.schema import Camera
        from shaders import nodes
        from shaders.mixture import Mixture

        self.scene = scene = bpy.data.scenes.new("bare")
        apply(scene, (*ALWAYS, *PICTURE))
        scene.render.threads_mode, scene.render.threads = "FIXED", threads
        scene.cycles.samples, scene.cycles.max_bounces = 1, 0
        scene.camera = bpy.data.objects.new("bare", bpy.data.cameras.new("bare"))
        camera.place(scene, Camera(size=(SIZE, SIZE)))
        self.turning = bpy.data.objects.new("bare object", body.build(mesh))
        surface = materials.new("bare")
        materials.draw(surface, nodes.graph(Mixture.lambert([0.5] * 3)))
        self.turning.data.materials.append(surface)
        scene.collection.objects.link(self.turning)
        light.build(scene, reference.soft_light(), nearest=True)
        scene.render.image_settings.file_format = "OPEN_EXR"
        scene.render.image_settings.color_depth = "16"
        self.folder = folder

    def run(self):
        import bpy

        from factory.quiet import silenced

        for view in range(VIEWS):
            self.turning.rotation_euler[2] = -2 * np.pi * view / VIEWS
            self.scene.render.filepath = f"{self.folder}/bare{view:02}.exr"
            with silenced(1):
                bpy.ops.render.render(scene=self.scene.name, write_still=True)


class _StudioLoop:
    """The same views by the studio: geometry, picture, checks, two files, two hashes and a line for each."""

    def __init__(self, studio, mesh, folder):
        from factory.render import reference
        from manifests.schema import Camera
        from shaders.mixture import Mixture

        self.studio, self.folder, self.round = studio, folder, 0
        studio.set_camera(Camera(size=(SIZE, SIZE)))
        studio.set_shape(mesh)
        studio.set_light(reference.soft_light())
        studio.set_materials([Mixture.lambert([0.5] * 3)])

    def run(self):
        from factory import exr
        from factory.render import checks

        self.round += 1
        with open(f"{self.folder}/records.jsonl", "a") as records:
            for view in range(VIEWS):
                self.studio.set_view(2 * np.pi * view / VIEWS)
                shot = self.studio.geometry()
                radiance, alpha = self.studio.picture(1, view, "direct")
                faults = checks.geometry(shot, 1) + checks.picture(radiance, float(shot.mask.mean()), alpha)
                geometry, picture = (f"{self.folder}/{kind}{view:02}.exr" for kind in ("geometry", "picture"))
                exr.write_geometry(geometry, shot)
                exr.write_picture(picture, radiance)
                hashes = [hashlib.sha256(Path(path).read_bytes()).hexdigest() for path in (geometry, picture)]
                records.write(json.dumps({"view": view, "faults": faults, "hashes": hashes}) + "\n")
                records.flush()


def memory(options):
    """Resident memory (MiB) of this process after each mesh, and its growth after the tenth."""
    import psutil

    from factory.render import reference
    from factory.shapes.primitives import blob
    from manifests.schema import Camera
    from shaders.mixture import Mixture

    studio, process, resident = _studio(options), psutil.Process(), []
    studio.set_camera(Camera(size=(64, 64)))
    light = reference.soft_light()
    for number in range(options.meshes):
        studio.set_shape(blob(number, level=5))
        studio.set_light(light, number % 128)
        studio.set_materials([Mixture.constant("ggx", 0.1 + 0.4 * (number % 7) / 7, [0.5] * 3)])
        for view in range(2):
            studio.set_view(view)
            studio.geometry()
            studio.render(1, number)
        resident.append(process.memory_info().rss / 2**20)
    later = resident[10:]
    return {
        "meshes": options.meshes,
        "after_10_MiB": round(resident[9], 1),
        "largest_later_MiB": round(max(later), 1),
        "growth": round(max(later) / resident[9] - 1, 4),
        "every_20th_MiB": [round(r, 1) for r in resident[9::20]],
    }


def _studio(options):
    from factory.render.studio import Studio

    return Studio(options.device, options.threads)


def _proof(name):
    def run(options):
        from factory.render import proof, reference

        studio = _studio(options)
        if name == "texel":
            figures = proof.lit_texel(studio, np.random.default_rng(np.random.SeedSequence(options.seed)))
            return {key: figures[key] for key in ("max_deg", "median_deg")}
        if name == "lambert":
            return proof.lambert(studio, reference.soft_light())
        if name == "closures":
            return {kind: proof.closed_form(studio, mixture) for kind, mixture in proof.SINGLE.items()}
        if name == "materials":
            from manifests.materials import load_catalogue

            catalogue = load_catalogue()
            return {material: proof.closed_form(studio, catalogue[material].mixture) for material in options.material}
        return getattr(proof, name)(studio)

    return run


MEASURES = {"cost": cost, "memory": memory} | {
    name: _proof(name) for name in ("geometry", "texel", "lambert", "closures", "perspective", "materials")
}


def provenance(arguments):
    """The command, commit, machine and date that made a result."""
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False).stdout.strip()
    return {
        "command": "python -m factory.render.benchmark " + " ".join(arguments),
        "commit": commit or "unknown",
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "load": round(os.getloadavg()[0], 2),
        "date": date.today().isoformat(),
    }


def main(arguments):
    parser = argparse.ArgumentParser(prog="python -m factory.render.benchmark", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("measure", choices=MEASURES, help="what to measure")
    parser.add_argument("--device", default="cpu", help="cpu, cuda, optix, hip, metal, oneapi or auto (default: cpu)")
    parser.add_argument("--threads", type=int, default=2, help="CPU threads (default: 2)")
    parser.add_argument("--rounds", type=int, default=5, help="cost: how often each loop runs, in turn (default: 5)")
    parser.add_argument("--meshes", type=int, default=200, help="memory: how many meshes (default: 200)")
    parser.add_argument("--material", action="append", default=[], help="materials: a name of the catalogue; repeatable")
    parser.add_argument("--seed", type=int, default=20170801, help="texel: of the directions")
    parser.add_argument("--scratch", default=None, help="cost: folder for the files (default: the system's)")
    parser.add_argument("--out", help="a JSON file to write besides printing")
    options = parser.parse_args(arguments)
    result = {"figures": MEASURES[options.measure](options), **provenance(arguments)}
    text = json.dumps(result, indent=2, ensure_ascii=False)
    print(text)
    if options.out:
        Path(options.out).write_text(text + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.stdout.reconfigure(encoding="utf-8")
    sys.exit(main(sys.argv[1:]))
