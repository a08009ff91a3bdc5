"""A new Blender scene with a camera, and objects put into it."""

from collections.abc import Iterable

import bpy

from factory.render.settings import Setting, apply, assign


def new(settings: Iterable[Setting]) -> bpy.types.Scene:
    """Return a new scene with a camera."""
    scene = bpy.data.scenes.new("studio")
    apply(scene, settings)
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    return scene


def put(scene: bpy.types.Scene, mesh: bpy.types.Mesh) -> bpy.types.Object:
    """Return a new object of `mesh` in `scene`."""
    each = bpy.data.objects.new("object", mesh)
    scene.collection.objects.link(each)
    return each


def put_unseen(scene: bpy.types.Scene, mesh: bpy.types.Mesh) -> bpy.types.Object:
    """Return a second object of the same mesh that no ray sees.

    If a mesh has one object, Cycles bakes the object's transform into the vertices: each turn would
    transfer them again and rebuild their tree (33 ms of work for 80,000 triangles). If a mesh has
    two objects, Cycles changes a matrix, provided that materials belong to the mesh.
    """
    unseen = put(scene, mesh)
    unseen.location = (0.0, 0.0, -10.0)
    # visible to volume scattering, which does not occur: Cycles drops an object that no ray can see
    for ray in ("camera", "shadow", "diffuse", "glossy", "transmission"):
        assign(unseen, f"visible_{ray}", False)
    return unseen
