"""An environment map as a Blender world, turned so that the camera at azimuth 0 sees it as the
layer does.

L  (height, width, 3) float32, the stored layout of shaders.envmap: row 0 at the zenith, light frame
u  Blender's texture coordinate, ½ − atan2(y, x)/2π: at azimuth 0 the light frame's x is the world's
y, hence u_blender = u_ours + ¼.
   A whole-column roll of the pixels, so that texels stay where importance sampling and nearest
   look-up have their cells: turning the world's Mapping by 15° instead puts a sun astride two cells
   and raises noise 28-fold (docs/rendering.md).
"""

import bpy
import numpy as np

from factory.render.settings import Setting, apply
from shaders import envmap

# rotation_texels counts columns of the 64×128 map, whatever the size of the map that is rendered
TEXELS = 128


def as_seen(L, rotation_texels):
    """The map as the camera at azimuth 0 sees it: rolled by rotation_texels/128 of a turn.

    Raises  ValueError for a width in which that is no whole number of columns
    """
    width = L.shape[1]
    if width % TEXELS:
        raise ValueError(
            f"light: expected a width that is a multiple of {TEXELS}, found {width} (resize it with"
            " shaders.envmap.resize)"
        )
    return envmap.roll(L, rotation_texels * (width // TEXELS))


def blender_pixels(seen):
    """RGBA float32 (height, width, 4) in Blender's order: bottom row first, columns from u = 0."""
    height, width = seen.shape[:2]
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = envmap.roll(seen, width // 4)[::-1]
    return pixels


def settings(width):
    """World settings, by path from the scene, for a map of that width."""
    return (
        Setting(
            "world.cycles.sampling_method",
            "MANUAL",
            "AUTOMATIC builds its own map size, 1.2 s a time",
        ),
        Setting(
            "world.cycles.sample_map_resolution",
            min(width, 2048),
            "one importance cell a texel: exact for nearest look-up",
        ),
        Setting("world.cycles.is_caustics_light", False, "no manifold caustics"),
        Setting("world.cycles.max_bounces", 1024, "the light is seen after every bounce"),
    )


def build(scene, seen, nearest):
    """A new world with a new image datablock (persistent data never notices edited pixels); the old
    world and image are removed.

    seen     (height, width, 3) from `as_seen`
    nearest  True: nearest look-up, what the layer sees; False: bilinear
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
    texture.image, texture.interpolation, texture.projection = (
        image,
        "Closest" if nearest else "Linear",
        "EQUIRECTANGULAR",
    )
    background, output = (
        tree.nodes.new("ShaderNodeBackground"),
        tree.nodes.new("ShaderNodeOutputWorld"),
    )
    tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    tree.links.new(background.outputs["Background"], output.inputs["Surface"])
    old, scene.world = scene.world, world
    apply(scene, settings(width))
    if old is not None:
        images = [n.image for n in old.node_tree.nodes if n.type == "TEX_ENVIRONMENT" and n.image]
        bpy.data.worlds.remove(old)
        for each in images:
            bpy.data.images.remove(each)
