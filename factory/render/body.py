"""A Mesh as a Blender mesh with exactly the same float32 normals.

Blender's split normals are 16-bit numbers relative to the face. The free attribute `custom_normal`
(Blender 4.5) holds float32 vertex normals, which are used without change, so each vertex is
duplicated where its corners' normals differ.
"""

import bpy
import numpy as np

from factory.shapes.mesh import Mesh


def split_by_normal(
    vertices: np.ndarray, faces: np.ndarray, corner_normals: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return vertices, normals and faces with vertices duplicated so that each has one normal.

    vertices (V, 3), faces (F, 3), corner_normals (F, 3, 3)
    Returns  vertices (U, 3) float32, normals (U, 3) float32, faces (F, 3) int32
    """
    corners = np.empty((faces.size, 4), np.int32)
    corners[:, 0] = faces.ravel()
    corners[:, 1:] = np.ascontiguousarray(corner_normals, np.float32).reshape(-1, 3).view(np.int32)
    rows = np.ascontiguousarray(corners).view(np.dtype((np.void, 16))).ravel()
    _, first, index = np.unique(rows, return_index=True, return_inverse=True)
    normals = corner_normals.reshape(-1, 3)[first]
    return (
        vertices[faces.ravel()[first]].astype(np.float32),
        normals.astype(np.float32),
        index.reshape(-1, 3).astype(np.int32),
    )


def build(mesh: Mesh) -> bpy.types.Mesh:
    """Return a new Blender mesh; face i has the material index segment − 1."""
    vertices, normals, faces = split_by_normal(mesh.vertices, mesh.faces, mesh.corner_normals)
    body = bpy.data.meshes.new("shape")
    body.vertices.add(len(vertices))
    body.vertices.foreach_set("co", vertices.ravel())
    body.loops.add(faces.size)
    body.loops.foreach_set("vertex_index", faces.ravel())
    body.polygons.add(len(faces))
    body.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    body.polygons.foreach_set("material_index", mesh.segment.astype(np.int32) - 1)
    body.update(calc_edges=True)
    body.attributes.new("custom_normal", "FLOAT_VECTOR", "POINT").data.foreach_set(
        "vector", normals.ravel()
    )
    return body
