"""The window: the part of the frame that may show the object, which alone is rendered.

A window is (top, bottom, left, right) in whole pixels, top and left inclusive, bottom and right
exclusive, row 0 at the top. Its pixels equal those of the whole frame, including their noise
(tests/render/test_film.py).
"""

import bpy
import numpy as np

from factory.render import camera
from factory.render.settings import assign
from manifests.schema import Camera

Window = tuple[int, int, int, int]

NEAREST = 0.01  # of the camera's distance: the near clipping plane (factory.render.camera)
MARGIN = 1  # pixels: a pixel's square reaches half a pixel beyond its centre, float32 a little


def around(vertices: np.ndarray, azimuth: float, lens: Camera) -> Window:
    """Return the window that holds all vertices.

    vertices  (V, 3), in the object's frame
    azimuth   of the view, radians
    """
    height, width = lens.size
    seen = camera.vertices_from_camera(vertices, azimuth, lens)
    x, y = seen[:, 0], seen[:, 1]
    if lens.fov_deg is not None:
        away = camera.distance(lens)
        # the camera is inside the object, which may then be visible anywhere
        if seen[:, 2].max() > (1 - NEAREST) * away:
            return 0, height, 0, width
        nearer = away / (away - seen[:, 2])
        x, y = x * nearer, y * nearer
    pixels = max(height, width) / (2 * lens.half_extent)  # a world unit at the object's centre
    top, bottom = _span(-y.max() * pixels, -y.min() * pixels, height)
    left, right = _span(x.min() * pixels, x.max() * pixels, width)
    return top, bottom, left, right


def _span(low: float, high: float, size: int) -> tuple[int, int]:
    """Return the whole pixels from low to high, measured from the middle; at least one."""
    first = int(np.clip(np.floor(low + size / 2) - MARGIN, 0, size - 1))
    return first, int(np.clip(np.ceil(high + size / 2) + MARGIN, first + 1, size))


def open_on(scene: bpy.types.Scene, window: Window) -> None:
    """Make the scene's camera render the window alone; its frame must have been set."""
    top, bottom, left, right = window
    height, width = scene.render.resolution_y, scene.render.resolution_x
    assign(scene, "render.use_border", True)
    assign(scene, "render.use_crop_to_border", True)
    # Blender truncates fractions of the frame to whole pixels; half a pixel more avoids that
    borders = {"min_x": (left + 0.5) / width, "max_x": (right + 0.5) / width}
    borders |= {"min_y": (height - bottom + 0.5) / height, "max_y": (height - top + 0.5) / height}
    for side in ("max_x", "max_y", "min_x", "min_y"):
        assign(scene, f"render.border_{side}", min(float(borders[side]), 1.0))


def paste(values: np.ndarray, window: Window, size: tuple[int, int]) -> np.ndarray:
    """Return a frame (height, width, …) with the window's values (rows, columns, …), else 0."""
    top, bottom, left, right = window
    if values.shape[:2] != (bottom - top, right - left):
        raise RuntimeError(
            f"Cycles: expected a window of {(bottom - top, right - left)} pixels, found"
            f" {values.shape[:2]} (render it again)"
        )
    frame = np.zeros((*size, *values.shape[2:]), values.dtype)
    frame[top:bottom, left:right] = values
    return frame
