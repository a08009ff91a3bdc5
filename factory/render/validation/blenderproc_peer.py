"""Renders saved scenes by BlenderProc, for factory.render.validation.speed_accuracy.

PYTHON -m factory.render.validation.blenderproc_peer ORDER.json
PYTHON -m factory.render.validation.blenderproc_peer --check

The second form says whether the packages are there, and renders nothing.
PYTHON must have the packages blenderproc and bpy; nothing of this project is imported. The order
names .blend files, settings, threads and pictures per setting; their radiance is written beside
each scene, and processor seconds per picture are printed as JSON. Seeds differ between pictures.
A setting may have a number of pictures of its own, "frames".

BlenderProc usually starts Blender itself. Here its modules are called in Blender's Python module,
by the path of the package, because its own entrance would install packages.
"""

import contextlib
import importlib.util
import json
import os
import sys
import time
import types
from pathlib import Path
from typing import Any


def blenderproc() -> Any:
    """Return BlenderProc's modules (RendererUtility, CameraUtility, SetupUtility)."""
    os.environ["OPENCV_IO_ENABLE_OPENEXR"] = "1"
    spec = importlib.util.find_spec("blenderproc")
    if spec is None or not spec.submodule_search_locations:
        raise SystemExit("blenderproc_peer: the package blenderproc is missing")
    package = types.ModuleType("blenderproc")
    package.__path__ = list(spec.submodule_search_locations)
    sys.modules["blenderproc"] = package
    names = ("renderer.RendererUtility", "camera.CameraUtility")
    modules = [importlib.import_module(f"blenderproc.python.{name}") for name in names]
    setup = importlib.import_module("blenderproc.python.utility.SetupUtility").SetupUtility
    return *modules, setup


def check() -> None:
    """Import everything that rendering needs."""
    import bpy  # noqa: F401, brings mathutils
    import numpy  # noqa: F401

    with contextlib.redirect_stdout(sys.stderr):
        blenderproc()


def import_on_one_core() -> None:
    """Import bpy so that it starts no threads that wait: Cycles is given one thread.

    factory.render.blender_threads says why, and is not imported here.
    """
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    if cores:
        os.sched_setaffinity(0, {min(cores)})
    import bpy  # noqa: F401

    if cores:
        os.sched_setaffinity(0, cores)


def main(order: Path) -> None:
    """Render every scene of an order under each of its settings."""
    import_on_one_core()
    import bpy
    import numpy as np

    with contextlib.redirect_stdout(sys.stderr):
        renderer, camera, setup = blenderproc()
        words = json.loads(order.read_text())
        temporary = order.parent / "temporary"
        setup.setup_utility_paths(str(temporary))
    seconds: dict[str, list[float]] = {}
    for blend in words["scenes"]:
        for name, settings in words["settings"].items():
            with contextlib.redirect_stdout(sys.stderr):
                bpy.ops.wm.open_mainfile(filepath=blend)
                scene = next(each for each in bpy.data.scenes if each.camera)
                bpy.context.window.scene = scene
                scene.render.use_compositing, scene.render.use_border = True, False
                renderer.render_init()
                renderer.set_max_amount_of_samples(settings["samples"])
                renderer.set_noise_threshold(settings["threshold"])
                renderer.set_denoiser(settings["denoiser"])
                renderer.toggle_light_tree(False)
                renderer.set_cpu_threads(words["threads"])
                renderer.set_output_format("OPEN_EXR", 32, True, view_transform="Raw")
                scene.frame_start = scene.frame_end = 0
                scene.cycles.use_animated_seed = True
                frames = settings.get("frames", words["frames"])
                for _ in range(frames):
                    camera.add_camera_pose(np.array(scene.camera.matrix_basis))
                start = time.process_time()
                # verbose: its progress bar waits for ever where standard output is a pipe
                data = renderer.render(str(temporary), load_keys={"colors"}, verbose=True)
                spent = (time.process_time() - start) / frames
            seconds.setdefault(name, []).append(spent)
            np.save(f"{blend}.{name}.npy", np.asarray(data["colors"], np.float32)[..., :3])
    print(json.dumps(seconds))


if __name__ == "__main__":
    if sys.argv[1] == "--check":
        check()
    else:
        main(Path(sys.argv[1]))
