"""Where the camera stands: fixed at azimuth 0, above the horizon by the elevation; the object turns
instead.

distance  from the camera to the object's centre, world units. A matter of choice for an
orthographic camera; for a perspective
          one it follows from fov and half_extent: the frame spans 2 half_extent at the object's
          centre.
"""

import mathutils
import numpy as np

from factory.render.settings import assign
from shaders import frames

ORTHOGRAPHIC_DISTANCE = 4.0  # outside the unit sphere, near enough for float32 depths good to 5e-7


def distance(camera):
    """From the camera to the object's centre; camera: manifests.schema.Camera."""
    if camera.fov_deg is None:
        return ORTHOGRAPHIC_DISTANCE
    return camera.half_extent / np.tan(np.radians(camera.fov_deg) / 2)


def camera_from_fixed_world(camera):
    """Rotation (3, 3) from the world in which the camera stands at azimuth 0 to the camera
    frame.
    """
    return frames.camera_from_world(0.0, np.radians(camera.elevation_deg))


def view_vectors(camera):
    """Unit vectors (height, width, 3) from surface to camera, camera frame."""
    fov = None if camera.fov_deg is None else np.radians(camera.fov_deg)
    return frames.view_vectors(*camera.size, fov=fov)


def place(scene, camera):
    """Gives the scene's camera object the place, lens and frame that `camera` describes."""
    away, world_from_camera = distance(camera), camera_from_fixed_world(camera).T
    pose = np.eye(4)
    pose[:3, :3] = world_from_camera
    pose[:3, 3] = away * world_from_camera[:, 2]
    scene.camera.matrix_world = mathutils.Matrix(pose.tolist())
    lens = scene.camera.data
    assign(lens, "sensor_fit", "AUTO")  # angle and scale belong to the frame's longer side
    assign(lens, "clip_start", float(0.01 * away))
    assign(lens, "clip_end", float(100.0 + away))
    if camera.fov_deg is None:
        assign(lens, "type", "ORTHO")
        assign(lens, "ortho_scale", 2.0 * camera.half_extent)
    else:
        assign(lens, "type", "PERSP")
        assign(lens, "angle", float(np.radians(camera.fov_deg)))
    height, width = camera.size
    assign(scene, "render.resolution_x", width)
    assign(scene, "render.resolution_y", height)
