"""Light maps of planned rooms and skies, by Cycles' panorama camera.

A map is (height, 2·height, 3) linear radiance as a file stores it (factory.lights.light): row 0 at
the zenith, the centre column towards world +x, azimuth growing to the left.
"""

import bpy
import numpy as np
from mathutils import Matrix

from factory.lights.interiors import Box, Furniture, Material, Scene, Sky
from factory.render import body, render_result
from factory.render.settings import ALWAYS, Setting, apply
from factory.shapes.catalogue import load

HEIGHT = 64
SAMPLES = 192
SKY_SIZE = 512  # columns of the sky's importance table

PANORAMA = (
    Setting("render.resolution_x", 2 * HEIGHT, "the layer's light maps"),
    Setting("render.resolution_y", HEIGHT, "the layer's light maps"),
    Setting("render.film_transparent", False, "the sky is part of the light"),
    Setting("render.use_persistent_data", False, "each panorama has a scene of its own"),
    Setting("cycles.device", "CPU", "small pictures"),
    Setting("cycles.samples", SAMPLES, "a number that leaves no visible noise after the denoiser"),
    Setting("cycles.use_denoising", True, "a light map is an input, not a measured picture"),
    Setting("cycles.max_bounces", 8, "rooms are lit by what their walls reflect"),
    Setting("cycles.diffuse_bounces", 6, "as above"),
    Setting("cycles.glossy_bounces", 4, "as above"),
    Setting("cycles.use_light_tree", True, "many lamps"),
    Setting("cycles.sample_clamp_indirect", 50.0, "no single texel from one lucky path"),
    Setting("cycles.pixel_filter_type", "BOX", "a texel is the mean over its own square"),
    Setting("cycles.filter_width", 1.0, "a texel is the mean over its own square"),
)


def render(scene: Scene, seed: int = 0) -> np.ndarray:
    """Return the light map (HEIGHT, 2·HEIGHT, 3) float32 that is seen from the origin."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    render_result.hook_cycles()
    stage = bpy.context.scene
    apply(stage, (*(s for s in ALWAYS if s.path not in {p.path for p in PANORAMA}), *PANORAMA))
    apply(stage, (Setting("cycles.seed", seed, "noise of its own"),))
    _camera(stage)
    _world(stage, scene.sky)
    for box in scene.boxes:
        _add(stage, _box_mesh(box), box.material)
    for bulb in scene.bulbs:
        mesh = body.build(load("sphere:3"))
        _add(stage, mesh, bulb.material, bulb.centre, bulb.radius)
    for piece in scene.furniture:
        _furnish(stage, piece)
    return np.ascontiguousarray(render_result.render_passes(stage)["Combined"][..., :3])


def _camera(stage: bpy.types.Scene) -> None:
    data = bpy.data.cameras.new("panorama")
    data.type = "PANO"
    data.panorama_type = "EQUIRECTANGULAR"
    camera = bpy.data.objects.new("panorama", data)
    # a camera looks along its −z with +y up: −z to world +x, +y to world +z
    camera.matrix_world = Matrix(((0, 0, -1, 0), (-1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 0, 1)))
    stage.collection.objects.link(camera)
    stage.camera = camera


def _world(stage: bpy.types.Scene, sky: Sky) -> None:
    world = bpy.data.worlds.new("sky")
    world.use_nodes = True
    tree = world.node_tree
    node = tree.nodes.new("ShaderNodeTexSky")
    node.sky_type = "NISHITA"
    node.sun_elevation, node.sun_rotation = sky.elevation, sky.azimuth
    node.dust_density, node.sun_disc = sky.dust, sky.with_sun
    background = tree.nodes["Background"]
    background.inputs["Strength"].default_value = sky.strength
    tree.links.new(node.outputs["Color"], background.inputs["Color"])
    world.cycles.sampling_method = "MANUAL"
    world.cycles.sample_map_resolution = SKY_SIZE
    stage.world = world


def _material(material: Material) -> bpy.types.Material:
    made = bpy.data.materials.new("material")
    made.use_nodes = True
    node = made.node_tree.nodes["Principled BSDF"]
    node.inputs["Base Color"].default_value = (*material.colour, 1.0)
    node.inputs["Roughness"].default_value = material.roughness
    node.inputs["Metallic"].default_value = material.metallic
    if material.emission:
        node.inputs["Emission Color"].default_value = (*material.colour, 1.0)
        node.inputs["Emission Strength"].default_value = material.emission
    return made


def _add(
    stage: bpy.types.Scene,
    mesh: bpy.types.Mesh,
    material: Material,
    place: tuple[float, float, float] = (0.0, 0.0, 0.0),
    scale: float = 1.0,
    azimuth: float = 0.0,
) -> None:
    mesh.materials.append(_material(material))
    thing = bpy.data.objects.new("thing", mesh)
    thing.location, thing.scale, thing.rotation_euler = place, (scale,) * 3, (0, 0, azimuth)
    stage.collection.objects.link(thing)


def _box_mesh(box: Box) -> bpy.types.Mesh:
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    points = [tuple((box.low, box.high)[c[k]][k] for k in range(3)) for c in corners]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    mesh = bpy.data.meshes.new("box")
    mesh.from_pydata(points, [], faces)
    return mesh


def _furnish(stage: bpy.types.Scene, piece: Furniture) -> None:
    shape = load(piece.spec)
    mesh = body.build(shape)
    for _ in range(shape.segments - 1):  # `_add` brings the last slot
        mesh.materials.append(_material(piece.material))
    lowest = float(shape.vertices[:, 2].min()) * piece.radius
    x, y, z = piece.place
    _add(stage, mesh, piece.material, (x, y, z - lowest), piece.radius, piece.azimuth)
