"""The canary: the light read back through Cycles, to prove that what shines is what was asked for.

With persistent data Cycles may go on showing an old light, and a lost one as magenta, and says
FINISHED. So after each change of light the same scene is seen for one sample a pixel through a
panorama camera, far above the object, whose pixels are the map's own texels: each must have its
known radiance. (A matte ball would do it too, but its pixels are sums over the whole sky with noise
on top.)
"""

import bpy
import numpy as np

from factory.render import render_result
from factory.render.settings import Setting, apply, assign
from shaders import envmap

# world units above: the unit object fills 1e-3 rad around the nadir, between the lowest texels'
# centres
FAR = 1000.0
NEAREST_TOLERANCE = 1e-5  # relative: the same float32 numbers, through one multiplication or two
# L1, relative: rays go .005 px beside the pixel's centre, where a sun's slope is steep
BILINEAR_TOLERANCE = 2e-2

LOOK = (
    Setting("render.film_transparent", False, ""),
    Setting("render.use_border", False, ""),
    Setting("cycles.filter_width", 0.01, ""),
    Setting("cycles.samples", 1, ""),
    Setting("render.resolution_x", 128, ""),
    Setting("render.resolution_y", 64, ""),
)


def expected(seen, nearest):
    """Radiance (64, 128, 3) of the directions of the 64×128 map's texels, by the look-up that
    Cycles uses.
    """
    height, width = seen.shape[:2]
    if nearest and (height, width) == (64, 128):
        return seen
    row, column = (
        (np.arange(64) + 0.5) * height / 64 - 0.5,
        (np.arange(128) + 0.5) * width / 128 - 0.5,
    )
    r0, c0 = np.floor(row).astype(int), np.floor(column).astype(int)
    fr, fc = (row - r0)[:, None, None], (column - c0)[None, :, None]
    rows, columns = (
        (np.clip(r0, 0, height - 1), np.clip(r0 + 1, 0, height - 1)),
        (
            c0 % width,
            (c0 + 1) % width,
        ),
    )
    corner = [[seen[r][:, c] for c in columns] for r in rows]
    return (1 - fr) * ((1 - fc) * corner[0][0] + fc * corner[0][1]) + fr * (
        (1 - fc) * corner[1][0] + fc * corner[1][1]
    )


def look(scene):
    """Radiance (64, 128, 3), stored layout, of the scene's world, as Cycles shows it."""
    kept = {setting.path: scene.path_resolve(setting.path) for setting in LOOK}
    eye = bpy.data.objects.get("canary") or _eye()
    lens, scene.camera = scene.camera, eye
    if eye.name not in scene.collection.objects:
        scene.collection.objects.link(eye)
    try:
        apply(scene, LOOK)
        panorama = render_result.render_passes(scene)["Combined"][..., :3]
    finally:
        scene.camera = lens
        for path, value in kept.items():
            assign(scene, path, value)
    return envmap.roll(panorama, -128 // 4)


def _eye():
    """A panorama camera whose picture is the sphere in Blender's own layout."""
    lens = bpy.data.cameras.new("canary")
    lens.type = "PANO"
    assign(lens, "panorama_type", "EQUIRECTANGULAR")
    eye = bpy.data.objects.new("canary", lens)
    eye.location, eye.rotation_euler = (0.0, 0.0, FAR), (np.pi / 2, 0.0, -np.pi / 2)
    return eye


def check(scene, seen, nearest):
    """Raises RuntimeError unless the scene's world shows the map `seen` (height, width, 3)."""
    requested, result = expected(seen, nearest), look(scene)
    difference = np.abs(result - requested).sum() / max(np.abs(requested).sum(), 1e-12)
    if not difference <= (NEAREST_TOLERANCE if nearest else BILINEAR_TOLERANCE):
        raise RuntimeError(
            f"light: expected the map that was set, found Cycles showing one {difference:.2g} away"
            " (render in a new process)"
        )
