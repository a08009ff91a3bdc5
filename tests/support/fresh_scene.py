"""A program of plain Blender that appends materials of a library and renders a sphere of each.

    python fresh_scene.py SCENE.npz SETTINGS.json LIBRARY.blend OUT NAME …

It imports nothing of this repository: it stands for a user's own scene. SCENE.npz has vertices,
normals and faces of the mesh, pixels (height, width, 4) of the light in Blender's order, and the
camera's pose; OUT/NAME.exr is written for each material.
"""

import json
import sys

import bpy
import mathutils
import numpy as np


def assign(owner, path, value):
    *steps, name = path.split(".")
    for step in steps:
        owner = getattr(owner, step)
    setattr(owner, name, value)


def sphere(scene, arrays):
    """The mesh as an object of the scene, which neither shadows itself nor shows in itself."""
    mesh = bpy.data.meshes.new("own mesh")
    mesh.from_pydata(arrays["vertices"].tolist(), [], arrays["faces"].tolist(), shade_flat=False)
    mesh.attributes.new("custom_normal", "FLOAT_VECTOR", "POINT").data.foreach_set(
        "vector", arrays["normals"].ravel()
    )
    each = bpy.data.objects.new("own object", mesh)
    scene.collection.objects.link(each)
    for ray in ("shadow", "diffuse", "glossy", "transmission"):
        setattr(each, f"visible_{ray}", False)
    return mesh


def world(scene, pixels):
    height, width = pixels.shape[:2]
    image = bpy.data.images.new("own light", width, height, float_buffer=True, is_data=True)
    image.pixels.foreach_set(pixels.ravel())
    scene.world = bpy.data.worlds.new("own world")
    scene.world.use_nodes = True
    tree = scene.world.node_tree
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image, texture.interpolation = image, "Closest"
    tree.links.new(texture.outputs["Color"], tree.nodes["Background"].inputs["Color"])


def main(scene_file, settings_file, library, out, *names):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    arrays = np.load(scene_file)
    mesh = sphere(scene, arrays)
    world(scene, arrays["pixels"])
    scene.camera = bpy.data.objects.new("own camera", bpy.data.cameras.new("own camera"))
    scene.collection.objects.link(scene.camera)
    scene.camera.matrix_world = mathutils.Matrix(arrays["pose"].tolist())
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", float(arrays["scale"])
    with open(settings_file, encoding="utf-8") as file:
        for path, value in json.load(file).items():
            assign(scene, path, value)
    output = scene.render.image_settings
    output.file_format, output.color_depth, output.color_mode = "OPEN_EXR", "32", "RGBA"
    output.exr_codec = "ZIP"
    with bpy.data.libraries.load(library, link=False) as (_, into):
        into.materials = list(names)
    for material in into.materials:
        mesh.materials.clear()
        mesh.materials.append(material)
        scene.render.filepath = f"{out}/{material.name}.exr"
        bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
