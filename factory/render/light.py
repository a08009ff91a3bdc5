"""An environment map as a Blender world, turned so that the camera sees it as the layer does.

L  (height, width, 3) float32, the stored layout of shaders.envmap: row 0 at the zenith, light frame
u  Blender's texture coordinate, ½ − atan2(y, x)/2π. At azimuth 0 the light frame's x axis is the
   world's y axis, hence u_blender = u_ours + ¼.

The pixels are rolled by whole columns, so that texels coincide with the cells of importance
sampling and of nearest look-up. Turning the world's Mapping by 15° instead would put a sun on the
border of two cells, which raises the noise 28-fold (docs/rendering.md).
"""

import bpy
import numpy as np

from factory.render.settings import Setting, apply
from shaders import envmap

# rotation_texels counts columns of the 64×128 map, whatever the size of the map that is rendered
TEXELS = 128


def as_seen(L: np.ndarray, rotation_texels: int) -> np.ndarray:
    """Return the map as the camera at azimuth 0 sees it: rolled by rotation_texels/128 of a turn.

    Raises  ValueError if the width is no multiple of 128
    """
    width = L.shape[1]
    if width % TEXELS:
        raise ValueError(
            f"light: expected a width that is a multiple of {TEXELS}, found {width} (resize it with"
            " shaders.envmap.resize)"
        )
    return envmap.roll(L, rotation_texels * (width // TEXELS))


def blender_pixels(seen: np.ndarray) -> np.ndarray:
    """Return RGBA (height, width, 4) in Blender's order: bottom row first, columns from u = 0."""
    height, width = seen.shape[:2]
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = envmap.roll(seen, width // 4)[::-1]
    return pixels


def settings(width: int) -> tuple[Setting, ...]:
    """Return the world's settings, by path from the scene, for a map of that width."""
    return (
        Setting(
            "world.cycles.sampling_method",
            "MANUAL",
            "AUTOMATIC chooses the size itself, which takes 1.2 s each time",
        ),
        Setting(
            "world.cycles.sample_map_resolution",
            min(width, 2048),
            "one importance cell per texel: exact for nearest look-up",
        ),
        Setting("world.cycles.is_caustics_light", False, "no manifold caustics"),
        Setting("world.cycles.max_bounces", 1024, "the light is visible after every bounce"),
    )


def build(scene: bpy.types.Scene, seen: np.ndarray, nearest: bool) -> None:
    """Give the scene a new world with a new image; the old world and image are removed.

    The image is new because persistent data does not notice edited pixels.

    seen     (height, width, 3) from `as_seen`
    nearest  True: nearest look-up, as in the layer; False: bilinear
    """
    height, width = seen.shape[:2]
    image = bpy.data.images.new("light", width, height, float_buffer=True, is_data=True)
    image.pixels.foreach_set(blender_pixels(seen).ravel())
    image.update()
    world = bpy.data.worlds.new("world")
    world.use_nodes = True
    tree = world.node_tree
    tree.nodes.clear()
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image, texture.projection = image, "EQUIRECTANGULAR"
    texture.interpolation = "Closest" if nearest else "Linear"
    background = tree.nodes.new("ShaderNodeBackground")
    output = tree.nodes.new("ShaderNodeOutputWorld")
    tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    tree.links.new(background.outputs["Background"], output.inputs["Surface"])
    old, scene.world = scene.world, world
    apply(scene, settings(width))
    if old is not None:
        images = [n.image for n in old.node_tree.nodes if n.type == "TEX_ENVIRONMENT" and n.image]
        bpy.data.worlds.remove(old)
        for each in images:
            bpy.data.images.remove(each)
