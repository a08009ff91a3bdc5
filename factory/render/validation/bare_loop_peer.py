"""Renders saved scenes by a plain loop in Blender, for factory.render.validation.speed_accuracy.

PYTHON -m factory.render.validation.bare_loop_peer ORDER.json

PYTHON must have the package bpy; nothing of this project is imported. The order is that of
blenderproc_peer: it names .blend files, settings, threads and pictures per setting. Radiance is
written beside each scene, and processor seconds per picture are printed as JSON.

This is what somebody writes who knows Blender's Python module and no more. A new scene gets object,
materials, camera and light, and a loop renders it to EXR files, or to PNG files. What says which
picture it is comes with them: size, pixel filter, light paths, transparent background. Everything
else is as Cycles has it by default, unless the order's settings say otherwise.

settings  properties of Cycles by name, {"samples": 16, "use_denoising": False}; {}: its defaults
"""

import contextlib
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

# of the saved scene: what makes it the same picture
PICTURE = (
    "render.resolution_x",
    "render.resolution_y",
    "render.resolution_percentage",
    "render.film_transparent",
    "cycles.pixel_filter_type",
    "cycles.filter_width",
    "cycles.max_bounces",
    "cycles.diffuse_bounces",
    "cycles.glossy_bounces",
    "cycles.caustics_reflective",
)


def open_scene(blend: str) -> Any:
    """Return a new scene with the objects, the camera and the light of a saved one."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(blend) as (there, here):
        here.scenes = there.scenes
    saved = next(each for each in here.scenes if each.camera)
    scene = bpy.data.scenes.new("loop")
    for thing in saved.collection.all_objects:
        scene.collection.objects.link(thing)
    scene.camera, scene.world = saved.camera, saved.world
    scene.render.engine = "CYCLES"
    for path in PICTURE:
        owner, name = path.split(".")
        setattr(getattr(scene, owner), name, getattr(getattr(saved, owner), name))
    bpy.context.window.scene = scene
    for each in here.scenes:
        bpy.data.scenes.remove(each)
    return scene


def render(scene: Any, folder: Path, pictures: int) -> list[Path]:
    """Render pictures of seeds 0, 1, … into a folder, and return their files."""
    import bpy

    image = scene.render.image_settings
    image.file_format, image.color_depth = "OPEN_EXR", "32"
    files = []
    for seed in range(pictures):
        scene.cycles.seed = seed
        scene.render.filepath = str(folder / f"{seed}{scene.render.file_extension}")
        bpy.ops.render.render(write_still=True, scene=scene.name)
        files.append(Path(scene.render.filepath))
    return files


def radiance(file: Path) -> Any:
    """Return the radiance (height, width, 3) float32 of an EXR file; row 0 at the top."""
    import bpy
    import numpy as np

    image = bpy.data.images.load(str(file))
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return np.ascontiguousarray(pixels.reshape(height, width, 4)[::-1, :, :3])


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
    import numpy as np

    words = json.loads(order.read_text())
    seconds: dict[str, list[float]] = {}
    for blend in words["scenes"]:
        for name, settings in words["settings"].items():
            with contextlib.redirect_stdout(sys.stderr):
                scene = open_scene(blend)
                scene.render.threads_mode, scene.render.threads = "FIXED", words["threads"]
                for key, value in settings.items():
                    setattr(scene.cycles, key, value)
                folder = order.parent / name
                folder.mkdir(exist_ok=True)
                start = time.process_time()
                files = render(scene, folder, words["frames"])
                spent = (time.process_time() - start) / words["frames"]
            seconds.setdefault(name, []).append(spent)
            np.save(f"{blend}.{name}.npy", np.stack([radiance(each) for each in files]))
    print(json.dumps(seconds))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
