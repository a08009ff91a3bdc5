"""Cost and accuracy of rendering: `python -m factory.render.validation.benchmark NAME`.

cost      24 views, 1 sample, 256²: plain bpy loops that write files, and the studio with checks,
          hashes and files, in turn
memory    resident memory over 200 different meshes, each with its own light and material
geometry, texel, lambert, closures, perspective, materials   see
factory.render.validation.closed_forms
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manifests.outputs import try_file
from manifests.provenance import provenance

if TYPE_CHECKING:
    from factory.render.geometry import Geometry
    from factory.render.studio import Studio
    from factory.shapes.mesh import Mesh

VIEWS = 24
SIZE = 256


def cost(options: argparse.Namespace) -> dict[str, Any]:
    """Return images per second and per CPU second of four loops, and ratios of them.

    The loops are run in turn; figures are medians over rounds, and ratios are taken within a round.

    bare              pictures alone
    bare_with_passes  pictures with the render passes of normals, depth and segments, antialiased
    studio            geometry and picture of each view
    studio_again      another picture of views whose geometry exists already
    """
    from factory.shapes.catalogue import load

    mesh = load(options.shape)
    with tempfile.TemporaryDirectory(dir=options.scratch) as folder:
        studio = _studio(options)
        in_studio = _StudioLoop(studio, mesh, folder)
        loops = {
            "bare": _BareLoop(mesh, folder, options.threads).run,
            "bare_with_passes": _BareLoop(mesh, folder, options.threads, passes=True).run,
            "studio": lambda: in_studio.run(geometry=True),
            "studio_again": lambda: in_studio.run(geometry=False),
        }
        for loop in loops.values():  # once to warm up
            loop()
        clock: dict[str, list[float]] = {name: [] for name in loops}
        processor: dict[str, list[float]] = {name: [] for name in loops}
        for _ in range(options.rounds):
            for name, loop in loops.items():
                start = time.perf_counter(), time.process_time()
                loop()
                clock[name].append(VIEWS / (time.perf_counter() - start[0]))
                processor[name].append(VIEWS / (time.process_time() - start[1]))

    def ratio(rates: dict[str, list[float]], ours: str, theirs: str) -> float:
        return round(float(np.median(np.array(rates[ours]) / rates[theirs])), 3)

    pairs = (("studio", "bare_with_passes"), ("studio", "bare"), ("studio_again", "bare"))
    return {
        "shape": f"{options.shape}, {len(mesh.faces)} triangles",
        "threads": options.threads,
        "rounds": options.rounds,
        "images_per_s": {name: round(float(np.median(rates)), 2) for name, rates in clock.items()},
        "images_per_cpu_s": {
            name: round(float(np.median(rates)), 2) for name, rates in processor.items()
        },
        "ratios": {f"{a} / {b}": ratio(clock, a, b) for a, b in pairs},
        "cpu_ratios": {f"{a} / {b}": ratio(processor, a, b) for a, b in pairs},
    }


class _BareLoop:
    """A plain loop: persistent data, a moving camera, and a file per view that Blender writes."""

    def __init__(self, mesh: Mesh, folder: str, threads: int, passes: bool = False):
        import bpy

        from factory.render import body, camera, light, materials
        from factory.render.settings import ALWAYS, PICTURE, apply
        from factory.render.validation import reference
        from manifests.schema import Camera
        from shaders import nodes
        from shaders.mixture import Mixture

        self.scene = scene = bpy.data.scenes.new("bare")
        apply(scene, (*ALWAYS, *PICTURE))
        scene.render.threads_mode, scene.render.threads = "FIXED", threads
        scene.cycles.samples, scene.cycles.max_bounces = 1, 0
        scene.camera = bpy.data.objects.new("bare", bpy.data.cameras.new("bare"))
        camera.place(scene, Camera(size=(SIZE, SIZE)))
        self.pose = scene.camera.matrix_world.copy()
        shown = bpy.data.objects.new("bare object", body.build(mesh))
        surface = materials.new("bare")
        materials.show(surface, materials.build(nodes.graph(Mixture.lambert([0.5] * 3))))
        for _ in range(mesh.segments):
            shown.data.materials.append(surface)
        scene.collection.objects.link(shown)
        light.build(scene, reference.soft_light(), nearest=True)
        scene.render.image_settings.file_format = "OPEN_EXR_MULTILAYER" if passes else "OPEN_EXR"
        scene.render.image_settings.color_depth = "32" if passes else "16"
        layer = scene.view_layers[0]
        layer.use_pass_normal = layer.use_pass_z = layer.use_pass_material_index = passes
        self.folder = folder

    def run(self) -> None:
        """Render all views."""
        import bpy
        import mathutils

        from factory.render import render_result
        from manifests.quiet import silenced

        for view in range(VIEWS):
            angle = 2 * np.pi * view / VIEWS
            self.scene.camera.matrix_world = mathutils.Matrix.Rotation(angle, 4, "Z") @ self.pose
            self.scene.render.filepath = f"{self.folder}/bare{view:02}.exr"
            with silenced(1), render_result.without_copies():
                bpy.ops.render.render(scene=self.scene.name, write_still=True)


class _StudioLoop:
    """The same views by the studio: geometry, picture, checks, files, hashes and a record each."""

    def __init__(self, studio: Studio, mesh: Mesh, folder: str):
        from factory.render.validation import reference
        from manifests.schema import Camera
        from shaders.mixture import Mixture

        self.studio, self.folder = studio, folder
        self.shots: dict[int, Geometry] = {}
        studio.set_camera(Camera(size=(SIZE, SIZE)))
        studio.set_shape(mesh)
        studio.set_light(reference.soft_light())
        studio.set_materials([Mixture.lambert([0.5] * 3)] * mesh.segments)
        self.segments = mesh.segments

    def run(self, geometry: bool) -> None:
        """Render all views; geometry: whether to render their geometry, too."""
        from manifests.line_files import Lines

        with contextlib.closing(Lines(f"{self.folder}/records.jsonl")) as records:
            for view in range(VIEWS):
                self.studio.set_view(2 * np.pi * view / VIEWS)
                records.append({"view": view} | self._record(view, geometry))

    def _record(self, view: int, geometry: bool) -> dict[str, Any]:
        from factory.render import checks
        from manifests.files import write_bytes
        from manifests.picture_files import encode_geometry, encode_picture

        faults: list[str] = []
        paths = [f"{self.folder}/picture{view:02}.exr"]
        if geometry:
            self.shots[view] = shot = self.studio.geometry()
            faults += checks.geometry_faults(shot, self.segments)
            paths.append(f"{self.folder}/geometry{view:02}.exr")
            write_bytes(paths[1], encode_geometry(shot))
        radiance, alpha = self.studio.picture(1, view, "direct")
        faults += checks.picture_faults(radiance, float(self.shots[view].mask.mean()), alpha)
        write_bytes(paths[0], encode_picture(radiance))
        return {
            "faults": faults,
            "hashes": [hashlib.sha256(Path(path).read_bytes()).hexdigest() for path in paths],
        }


def memory(options: argparse.Namespace) -> dict[str, Any]:
    """Return resident memory (MiB) after each mesh, and its growth after the tenth."""
    import psutil

    from factory.render.validation import reference
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


def _studio(options: argparse.Namespace) -> Studio:
    from factory.render.blender_threads import importing_blender

    with importing_blender(options.threads):
        from factory.render.studio import Studio
    return Studio(options.device, options.threads)


def _accuracy(name: str) -> Callable[[argparse.Namespace], dict[str, Any]]:
    """Return a function that measures one of factory.render.validation.closed_forms."""

    def run(options: argparse.Namespace) -> dict[str, Any]:
        from factory.render.validation import closed_forms, reference

        studio = _studio(options)
        if name == "texel":
            figures = closed_forms.lit_texel(
                studio, np.random.default_rng(np.random.SeedSequence(options.seed))
            )
            return {key: figures[key] for key in ("max_deg", "median_deg")}
        if name == "lambert":
            return closed_forms.lambert(studio, reference.soft_light())
        if name == "closures":
            return {
                kind: closed_forms.closed_form(studio, mixture)
                for kind, mixture in closed_forms.SINGLE.items()
            }
        if name == "materials":
            from manifests.materials import load_catalogue

            catalogue = load_catalogue()
            return {
                material: closed_forms.closed_form(
                    studio, catalogue[material].mixture, pattern=options.pattern
                )
                for material in options.material
            }
        return getattr(closed_forms, name)(studio)

    return run


MEASURES = {"cost": cost, "memory": memory} | {
    name: _accuracy(name)
    for name in ("geometry", "texel", "lambert", "closures", "perspective", "materials")
}


def main(arguments: Sequence[str]) -> int:
    """Measure what the arguments name, print the figures, and return 0."""
    parser = argparse.ArgumentParser(
        prog="python -m factory.render.validation.benchmark",
        description=__doc__,
        formatter_class=argparse.RawTextHelpFormatter,
    )
    parser.add_argument("measure", choices=MEASURES, help="what to measure")
    parser.add_argument(
        "--device",
        default="cpu",
        help="where Cycles renders: cpu, cuda, optix, hip, metal, oneapi or auto (default: cpu)",
    )
    parser.add_argument("--threads", type=int, default=2, help="number of CPU threads (default: 2)")
    parser.add_argument(
        "--rounds",
        type=int,
        default=5,
        help="cost: number of times that each loop runs (default: 5)",
    )
    parser.add_argument("--shape", default="car:1", help="cost: the shape (default: car:1)")
    parser.add_argument(
        "--meshes", type=int, default=200, help="memory: number of meshes (default: 200)"
    )
    parser.add_argument(
        "--material",
        action="append",
        default=[],
        help="materials: a name in the catalogue; repeat the option for several",
    )
    parser.add_argument(
        "--pattern",
        default="TABULATED_SOBOL",
        choices=("TABULATED_SOBOL", "BLUE_NOISE"),
        help="materials: Cycles' sampling pattern (default: that of pictures, TABULATED_SOBOL)",
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=20170801,
        help="texel: random seed of the directions (default: %(default)s)",
    )
    parser.add_argument(
        "--scratch",
        default=None,
        help="cost: folder for the files (default: the system's temporary folder)",
    )
    parser.add_argument("--out", help="a JSON file to which the figures are also written")
    options = parser.parse_args(arguments)
    if options.out:
        try_file(options.out)
    result = {"figures": MEASURES[options.measure](options), **provenance()}
    text = json.dumps(result, indent=2, ensure_ascii=False)
    print(text)
    if options.out:
        from manifests.files import write_text

        Path(options.out).parent.mkdir(parents=True, exist_ok=True)
        write_text(options.out, text + "\n")
    return 0


if __name__ == "__main__":
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(encoding="utf-8")
    sys.exit(main(sys.argv[1:]))
