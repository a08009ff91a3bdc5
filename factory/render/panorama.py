"""Light maps of planned rooms and skies, by Cycles' panorama camera.

A map is (height, 2·height, 3) linear radiance as a file stores it (factory.lights.light): row 0 at
the zenith, the centre column towards world +x, azimuth growing to the left.

The sun's disc covers a thirtieth of a texel: few samples would meet it, and the denoiser takes it
for noise. So the camera sees a sky without it, a second picture of the disc alone, through
whatever stands before it, gives its irradiance, and this is added to the texels that hold it.
"""

import functools
import math

import bpy
import numpy as np
from mathutils import Matrix, Vector

from factory.lights.interiors import Box, Furniture, Material, Scene, Sky
from factory.render import body, patterns, render_result
from factory.render.settings import ALWAYS, Setting, apply
from factory.shapes.catalogue import load
from factory.shapes.mesh import Mesh
from shaders import envmap

HEIGHT = 64
SAMPLES = 32
SKY_SIZE = 128  # columns of the sky's importance table; Cycles samples the sun by itself
KEPT_SHAPES = 128  # pieces of furniture that a process keeps for its next maps, about 2 MB each
SUN_PIXELS = 32  # of the picture of the sun's disc, which is as wide as SUN_VIEW
SUN_VIEW = math.radians(0.7)  # the disc has 0.545 degrees
BLUR = math.radians(12)  # the denoised map takes its energy over this angle from the noisy one

PANORAMA = (
    Setting("render.resolution_x", 2 * HEIGHT, "the layer's light maps"),
    Setting("render.resolution_y", HEIGHT, "the layer's light maps"),
    Setting("render.film_transparent", False, "the sky is part of the light"),
    Setting("render.use_persistent_data", False, "each panorama has a scene of its own"),
    Setting("cycles.device", "CPU", "small pictures"),
    Setting("cycles.samples", SAMPLES, "errors beside 4,096 samples: docs/rendering.md"),
    Setting("cycles.use_denoising", True, "a light map is an input, not a measured picture"),
    Setting("cycles.max_bounces", 8, "rooms are lit by what their walls reflect"),
    Setting("cycles.diffuse_bounces", 6, "as above"),
    Setting("cycles.glossy_bounces", 4, "as above"),
    Setting("cycles.use_light_tree", True, "many lamps"),
    Setting("cycles.sample_clamp_indirect", 50.0, "no single texel from one lucky path"),
    Setting("cycles.pixel_filter_type", "BOX", "a texel is the mean over its own square"),
    Setting("cycles.filter_width", 1.0, "a texel is the mean over its own square"),
)


SUN = (
    Setting("render.resolution_x", SUN_PIXELS, "the disc alone"),
    Setting("render.resolution_y", SUN_PIXELS, "the disc alone"),
    Setting("cycles.samples", 4, "an even disc; 4 samples smooth its edge"),
    Setting("cycles.use_denoising", False, "measured, not looked at"),
    Setting("cycles.max_bounces", 0, "only what lies straight ahead"),
)


def render(scene: Scene, seed: int = 0, samples: int = SAMPLES, denoise: bool = True) -> np.ndarray:
    """Return the light map (HEIGHT, 2·HEIGHT, 3) float32 that is seen from the origin.

    denoise  False, with many samples, gives a reference
    """
    stage, hide_sun = build(scene, PANORAMA)
    apply(stage, (Setting("cycles.seed", seed, "noise of its own"),))
    apply(stage, (Setting("cycles.samples", samples, "as the caller says"),))
    apply(stage, (Setting("cycles.use_denoising", denoise, "as the caller says"),))
    stage.view_layers[0].cycles.denoising_store_passes = denoise
    _camera(stage)
    passes = render_result.render_passes(stage)
    L = passes["Combined"][..., :3]
    if denoise:
        L = _with_energy_of(L, passes["Noisy Image"][..., :3])
    if scene.sky.with_sun and scene.sky.elevation > -SUN_VIEW:
        L += _sun(stage, scene.sky, hide_sun)
    return np.ascontiguousarray(L, np.float32)


def build(
    scene: Scene, settings: tuple[Setting, ...]
) -> tuple[bpy.types.Scene, bpy.types.NodeSocket]:
    """Return Blender's scene, emptied before, with what is planned, but without a camera.

    settings  that replace those of ALWAYS
    Returns   the scene, and the input that hides the sun's disc from the camera (1) or not (0)
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    render_result.hook_cycles()
    stage = bpy.context.scene
    replaced = {setting.path for setting in settings}
    apply(stage, (*(s for s in ALWAYS if s.path not in replaced), *settings))
    hide_sun = _world(stage, scene.sky)
    for box in scene.boxes:
        _add(stage, _box_mesh(box), box.material)
    for bulb in scene.bulbs:
        mesh = body.build(_shape("sphere:3"))
        _add(stage, mesh, bulb.material, bulb.centre, bulb.radius)
    for piece in scene.furniture:
        _furnish(stage, piece)
    return stage, hide_sun


def _with_energy_of(smooth: np.ndarray, noisy: np.ndarray) -> np.ndarray:
    """Return the denoised map with the noisy one's energy over regions BLUR wide.

    The denoiser spreads light well, but dims lamps and windows. Both maps (H, 2H, 3).
    """
    smooth = np.maximum(smooth, 0)
    before, after = (_blur(L) for L in (noisy, smooth))
    return smooth * np.clip(before / np.maximum(after, 1e-9), 0.25, 4.0)


def _blur(L: np.ndarray) -> np.ndarray:
    """Return the mean of L (H, 2H, 3) about each texel, weighted by a lobe about BLUR wide."""
    w, solid_angle = _lobes(*L.shape[:2])
    flat = L.reshape(-1, 3) * solid_angle[:, None]
    return ((w @ flat) / (w @ solid_angle)[:, None]).reshape(L.shape)


@functools.cache
def _lobes(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    w, solid_angle = envmap.directions(height, width)
    flat = w.reshape(-1, 3).astype(np.float32)
    weights = flat @ flat.T
    weights -= 1
    weights /= BLUR**2
    np.exp(weights, out=weights)
    return weights, solid_angle.reshape(-1).astype(np.float32)


def _sun(stage: bpy.types.Scene, sky: Sky, hide_sun: bpy.types.NodeSocket) -> np.ndarray:
    """Return a map (HEIGHT, 2·HEIGHT, 3) of the sun's disc alone, as far as it is seen."""
    towards = Vector(_towards_sun(sky))
    camera = stage.camera
    camera.data.type, camera.data.angle = "PERSP", SUN_VIEW
    camera.matrix_world = towards.to_track_quat("Z", "Y").to_matrix().to_4x4()
    camera.matrix_world @= Matrix.Rotation(math.pi, 4, "Y")  # it looks along its own −z
    hide_sun.default_value = 0.0
    apply(stage, SUN)
    picture = render_result.render_passes(stage)["Combined"][..., :3]
    step = 2 * math.tan(SUN_VIEW / 2) / SUN_PIXELS
    offsets = (np.arange(SUN_PIXELS) + 0.5 - SUN_PIXELS / 2) * step
    frame = np.array(camera.matrix_world.to_3x3())
    across, down = np.meshgrid(offsets, -offsets)
    rays = np.stack([across, down, np.full_like(across, -1.0)], axis=-1) @ frame.T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    energy = picture * (step**2 * (rays @ np.array(towards))[..., None] ** 3)
    row = np.arccos(np.clip(rays[..., 2], -1, 1)) / np.pi * HEIGHT
    column = (0.5 - np.arctan2(rays[..., 1], rays[..., 0]) / (2 * np.pi)) * 2 * HEIGHT
    L = np.zeros((HEIGHT, 2 * HEIGHT, 3))
    place = np.minimum(row.astype(int), HEIGHT - 1), column.astype(int) % (2 * HEIGHT)
    np.add.at(L, place, np.where(energy > 0, energy, 0.0))
    return L / envmap.row_solid_angles(HEIGHT, 2 * HEIGHT)[:, None, None]


def _towards_sun(sky: Sky) -> tuple[float, float, float]:
    """Return the world direction of Cycles' sun: azimuth from north, clockwise from above."""
    flat = math.cos(sky.elevation)
    return (
        flat * math.sin(sky.azimuth),
        flat * math.cos(sky.azimuth),
        math.sin(sky.elevation),
    )


def _camera(stage: bpy.types.Scene) -> None:
    data = bpy.data.cameras.new("panorama")
    data.type = "PANO"
    data.panorama_type = "EQUIRECTANGULAR"
    camera = bpy.data.objects.new("panorama", data)
    # a camera looks along its −z with +y up: −z to world +x, +y to world +z
    camera.matrix_world = Matrix(((0, 0, -1, 0), (-1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 0, 1)))
    stage.collection.objects.link(camera)
    stage.camera = camera


def _world(stage: bpy.types.Scene, sky: Sky) -> bpy.types.NodeSocket:
    """Set the sky; return the input that hides the sun's disc from the camera (1) or not (0)."""
    world = bpy.data.worlds.new("sky")
    world.use_nodes = True
    tree = world.node_tree
    skies = []
    for with_sun in (sky.with_sun, False):
        node = tree.nodes.new("ShaderNodeTexSky")
        node.sky_type = "NISHITA"
        node.sun_elevation, node.sun_rotation = sky.elevation, sky.azimuth
        node.dust_density, node.sun_disc = sky.dust, with_sun
        skies.append(node)
    background = tree.nodes["Background"]
    background.inputs["Strength"].default_value = sky.strength
    path, hide, mix = (
        tree.nodes.new(f"ShaderNode{kind}") for kind in ("LightPath", "Math", "MixRGB")
    )
    hide.operation = "MULTIPLY"
    hide.inputs[1].default_value = 1.0
    tree.links.new(path.outputs["Is Camera Ray"], hide.inputs[0])
    tree.links.new(hide.outputs[0], mix.inputs["Fac"])
    tree.links.new(skies[0].outputs["Color"], mix.inputs["Color1"])
    tree.links.new(skies[1].outputs["Color"], mix.inputs["Color2"])
    tree.links.new(mix.outputs["Color"], background.inputs["Color"])
    world.cycles.sampling_method = "MANUAL"
    world.cycles.sample_map_resolution = SKY_SIZE
    stage.world = world
    return hide.inputs[1]


def _material(material: Material) -> bpy.types.Material:
    made = bpy.data.materials.new("material")
    made.use_nodes = True
    node = made.node_tree.nodes["Principled BSDF"]
    node.inputs["Base Color"].default_value = (*material.colour, 1.0)
    node.inputs["Roughness"].default_value = material.roughness
    node.inputs["Metallic"].default_value = material.metallic
    if material.pattern:
        shown = patterns.colour(made.node_tree, material, material.pattern)
        made.node_tree.links.new(shown, node.inputs["Base Color"])
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
    if material.pattern:
        patterns.add_coordinates(mesh, scale)
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
    shape = _shape(piece.spec)
    mesh = body.build(shape)
    for _ in range(shape.segments - 1):  # `_add` brings the last slot
        mesh.materials.append(_material(piece.material))
    lowest = float(shape.vertices[:, 2].min()) * piece.radius
    x, y, z = piece.place
    _add(stage, mesh, piece.material, (x, y, z - lowest), piece.radius, piece.azimuth)


@functools.lru_cache(maxsize=KEPT_SHAPES)
def _shape(spec: str) -> Mesh:
    return load(spec)
