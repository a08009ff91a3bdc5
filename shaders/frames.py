"""The three frames and the rotations between them.

world   Blender's: x forward (the object's front), y left, z up; metres
light   gravity-aligned, rotated with the camera's azimuth: x right, y up, z horizontally towards
        the viewer. The paper's frame for environment maps: w = (cos φ sin θ, cos θ, sin φ sin θ)
camera  x right in the picture, y up in the picture, z towards the viewer. Normals are given in it

A matrix is named by its target and its source: `n_camera = camera_from_world @ n_world`.

azimuth    radians about world z, 0 in front of the object (the camera on +x), counter-clockwise
           seen from above
elevation  radians above the horizon
roll       radians by which the camera's contents turn counter-clockwise in the picture about its
           middle: the camera itself is turned clockwise about its optical axis. The light frame
           stays upright
"""

import numpy as np

ELEVATION = np.radians(20.0)  # our choice: the paper says "fixed elevation" and gives no number
ORTHOGRAPHIC_DISTANCE = 4.0  # outside the unit sphere, near enough for float32 depths good to 5e-7


def world_from_light(azimuth: float) -> np.ndarray:
    """Return the rotation (3, 3) from the light frame of a camera at `azimuth` to the world."""
    s, c = np.sin(azimuth), np.cos(azimuth)
    right, up, towards_viewer = (-s, c, 0.0), (0.0, 0.0, 1.0), (c, s, 0.0)
    return np.stack([right, up, towards_viewer], axis=-1)


def camera_from_light(elevation: float = ELEVATION, roll: float = 0.0) -> np.ndarray:
    """Return the rotation (3, 3) from the light frame to the frame of a camera at `elevation`.

    The camera looks down by `elevation`: the light frame's (0, sin e, cos e) is the camera's +z.
    """
    s, c = np.sin(elevation), np.cos(elevation)
    upright = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return camera_from_upright(roll) @ upright if roll else upright


def camera_from_upright(roll: float) -> np.ndarray:
    """Return the rotation (3, 3) from the frame of the same camera without roll.

    What depends on normals, views and light alone, as the layer's radiance does, is the same in
    both frames: `v @ camera_from_upright(roll)` takes vectors (…, 3) of a rolled camera to the
    upright one, for which elevation alone gives the light.
    """
    s, c = np.sin(roll), np.cos(roll)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def camera_from_world(
    azimuth: float, elevation: float = ELEVATION, roll: float = 0.0
) -> np.ndarray:
    """Return the rotation (3, 3) that takes world vectors to the camera frame."""
    return camera_from_light(elevation, roll) @ world_from_light(azimuth).T


def camera_distance(half_extent: float, fov_deg: float | None = None) -> float:
    """Return the distance from the camera's plane to the object's centre, in world units.

    It is arbitrary for an orthographic camera (fov_deg None). For a perspective one the frame spans
    2 half_extent at the object's centre.
    """
    if fov_deg is None:
        return ORTHOGRAPHIC_DISTANCE
    return half_extent / np.tan(np.radians(fov_deg) / 2)


def pixel_grid(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Return picture-plane coordinates x, y (height, width) of pixel centres.

    x points right and y up; both lie in [-1, 1] over the longer side.
    """
    longer = max(height, width)
    x = (2.0 * np.arange(width) + 1.0 - width) / longer
    y = (height - 1.0 - 2.0 * np.arange(height)) / longer
    return np.broadcast_to(x, (height, width)), np.broadcast_to(y[:, None], (height, width))


def view_vectors(
    height: int, width: int, fov: float | None = None, focus: tuple[float, float] = (0.0, 0.0)
) -> np.ndarray:
    """Return the unit vector from the surface to the camera per pixel, camera frame.

    height, width  pixels
    fov            radians across the longer side; None: orthographic, (0, 0, 1) everywhere
    focus          (x, y) of the optical axis in the coordinates of `pixel_grid`
    """
    v = np.zeros((height, width, 3))
    v[..., 2] = 1.0
    if fov is not None:
        x, y = pixel_grid(height, width)
        v[..., 0] = -(x - focus[0]) * np.tan(fov / 2)
        v[..., 1] = -(y - focus[1]) * np.tan(fov / 2)
        v /= np.linalg.norm(v, axis=-1, keepdims=True)
    return v


def turned_to_viewer(n: np.ndarray, v: np.ndarray, back: bool = False) -> np.ndarray:
    """Return vectors n (..., 3), camera frame, in the frame of the ray of each pixel.

    The rotation is the smallest one that takes the direction to the viewer v (..., 3), unit length,
    v_z > −1, to +z. A distant viewer's n_z is the cosine between normal and viewer; so is that of
    the result in perspective. For v = (0, 0, 1) it is n.

    back  whether to rotate from the frame of the ray to the camera frame instead
    """
    x, y, z = (v[..., i : i + 1] for i in range(3))
    if back:
        x, y = -x, -y

    def cross(a: np.ndarray) -> np.ndarray:
        """Return (v × z) × a; v × z is (y, −x, 0), as long as the sine of the angle."""
        return np.concatenate(
            [-x * a[..., 2:], -y * a[..., 2:], x * a[..., :1] + y * a[..., 1:2]], -1
        )

    first = cross(n)
    return n + first + cross(first) / (1.0 + z)
