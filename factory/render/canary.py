"""The canary: the light map rendered back through Cycles, to check that it is the one in use.

With persistent data, Cycles may go on using an old light or show a missing one as magenta, and it
still reports FINISHED. After each change of light, the scene is therefore rendered with one sample
per pixel by a panorama camera far above the object. The pixels are the map's texels, so each has a
known radiance. (A matte sphere would reveal a wrong light too, but each of its pixels is a noisy
sum over the whole map.)
"""

import bpy
import numpy as np

from factory.render import render_result
from factory.render.settings import Setting, apply, assign
from shaders import envmap

# world units above the object, which then fills 1e-3 rad around the nadir, between texel centres
FAR = 1000.0
NEAREST_TOLERANCE = 1e-5  # relative: the same float32 numbers, through one multiplication or two
# relative L1: rays pass up to 0.005 pixels from the pixel's centre, and a sun's edge is steep
BILINEAR_TOLERANCE = 2e-2

LOOK = (
    Setting("render.film_transparent", False, ""),
    Setting("render.use_border", False, ""),
    Setting("cycles.filter_width", 0.01, ""),
    Setting("cycles.samples", 1, ""),
    Setting("render.resolution_x", 128, ""),
    Setting("render.resolution_y", 64, ""),
)


def expected_map(seen: np.ndarray, nearest: bool) -> np.ndarray:
    """Return the radiance (64, 128, 3) that Cycles should show at the texels of a 64×128 map.

    seen     (height, width, 3), the map that was set
    nearest  True: nearest look-up; False: bilinear
    """
    height, width = seen.shape[:2]
    if nearest and (height, width) == (64, 128):
        return seen
    row = (np.arange(64) + 0.5) * height / 64 - 0.5
    column = (np.arange(128) + 0.5) * width / 128 - 0.5
    r0, c0 = np.floor(row).astype(int), np.floor(column).astype(int)
    fr, fc = (row - r0)[:, None, None], (column - c0)[None, :, None]
    rows = np.clip(r0, 0, height - 1), np.clip(r0 + 1, 0, height - 1)
    columns = c0 % width, (c0 + 1) % width
    corner = [[seen[r][:, c] for c in columns] for r in rows]
    return (1 - fr) * ((1 - fc) * corner[0][0] + fc * corner[0][1]) + fr * (
        (1 - fc) * corner[1][0] + fc * corner[1][1]
    )


def look(scene: bpy.types.Scene) -> np.ndarray:
    """Return the radiance (64, 128, 3) of the scene's world as Cycles shows it, stored layout."""
    earlier = {setting.path: scene.path_resolve(setting.path) for setting in LOOK}
    panorama_camera = bpy.data.objects.get("canary") or _panorama_camera()
    earlier_camera, scene.camera = scene.camera, panorama_camera
    if panorama_camera.name not in scene.collection.objects:
        scene.collection.objects.link(panorama_camera)
    try:
        apply(scene, LOOK)
        panorama = render_result.render_passes(scene)["Combined"][..., :3]
    finally:
        scene.camera = earlier_camera
        for path, value in earlier.items():
            assign(scene, path, value)
    return envmap.roll(panorama, -128 // 4)


def _panorama_camera() -> bpy.types.Object:
    """Return a new camera whose picture is the whole sphere in Blender's layout."""
    lens = bpy.data.cameras.new("canary")
    lens.type = "PANO"
    assign(lens, "panorama_type", "EQUIRECTANGULAR")
    camera = bpy.data.objects.new("canary", lens)
    camera.location, camera.rotation_euler = (0.0, 0.0, FAR), (np.pi / 2, 0.0, -np.pi / 2)
    return camera


def check(scene: bpy.types.Scene, seen: np.ndarray, nearest: bool) -> None:
    """Raise RuntimeError unless the scene's world shows the map `seen` (height, width, 3)."""
    requested, result = expected_map(seen, nearest), look(scene)
    difference = np.abs(result - requested).sum() / max(np.abs(requested).sum(), 1e-12)
    if not difference <= (NEAREST_TOLERANCE if nearest else BILINEAR_TOLERANCE):
        raise RuntimeError(
            "light: expected the map that was set, found that Cycles shows one that differs by"
            f" {difference:.2g} (render in a new process)"
        )
