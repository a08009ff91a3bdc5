"""The camera's pose: at azimuth 0, at its elevation and roll; the object turns."""

import bpy
import mathutils
import numpy as np

from factory.render.settings import assign
from manifests.schema import Camera
from shaders import frames


def distance(camera: Camera) -> float:
    """Return the distance from the camera to the object's centre."""
    return frames.camera_distance(camera.half_extent, camera.fov_deg)


def camera_from_fixed_world(camera: Camera) -> np.ndarray:
    """Return the rotation (3, 3) from the world, where the camera is at azimuth 0, to its frame."""
    return frames.camera_from_world(
        0.0, np.radians(camera.elevation_deg), np.radians(camera.roll_deg)
    )


def vertices_from_camera(vertices: np.ndarray, azimuth: float, camera: Camera) -> np.ndarray:
    """Return an object's vertices (V, 3), as it stands before the camera, in the camera frame.

    vertices  (V, 3), in the object's frame
    azimuth   of the view, radians
    """
    return vertices @ camera_from_object(azimuth, camera).T.astype(vertices.dtype)


def camera_from_object(azimuth: float, camera: Camera) -> np.ndarray:
    """Return the rotation (3, 3) from the object's frame to the camera's; azimuth in radians."""
    s, c = np.sin(azimuth), np.cos(azimuth)
    turned = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return camera_from_fixed_world(camera) @ turned


def view_vectors(camera: Camera) -> np.ndarray:
    """Return the unit vectors (height, width, 3) from surface to camera, in the camera frame."""
    height, width = camera.size
    fov = None if camera.fov_deg is None else np.radians(camera.fov_deg)
    return frames.view_vectors(height, width, fov=fov)


def points(camera: Camera, mask: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return where the rays through pixels' centres meet the surface: (P, 3), camera frame.

    The origin is the object's centre.

    mask   (height, width) bool: pixels whose rays meet it
    depth  (P,) behind the plane through the object's centre, along the optical axis
    """
    x, y = (grid[mask] * camera.half_extent for grid in frames.pixel_grid(*camera.size))
    if camera.fov_deg is not None:
        spread = 1 + depth / distance(camera)  # of the rays: 1 at the object's centre
        x, y = x * spread, y * spread
    return np.stack([x, y, -depth], axis=-1)


def place(scene: bpy.types.Scene, camera: Camera) -> None:
    """Give the scene's camera object the pose, lens and frame that `camera` describes."""
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


def shift(scene: bpy.types.Scene, camera: Camera, rightwards: float, upwards: float) -> None:
    """Shift the frame of the scene's camera by fractions of a pixel from where `place` left it."""
    longer = max(camera.size)
    assign(scene.camera.data, "shift_x", rightwards / longer)
    assign(scene.camera.data, "shift_y", upwards / longer)
