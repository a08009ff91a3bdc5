"""Draw the picture of docs/conventions.md: the three frames about an object, and a light map.

python docs/frames_picture.py docs/results/frames.png
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np

from manifests import files
from shaders import envmap
from shaders.frames import ELEVATION, camera_from_world, world_from_light

AZIMUTH = np.radians(30.0)
AXES = "xyz"
COLOURS = {"world": "#555555", "light": "#d98200", "camera": "#0060c0"}
AWAY = 2.4  # of the camera, in radii of the object


def axes_of_frames() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return {frame: (its origin in the picture (3,), its axes in the world as columns (3, 3))}."""
    world_from_camera = camera_from_world(AZIMUTH).T
    return {
        "world": (np.zeros(3), np.eye(3)),
        "light": (np.array([0.0, 0.0, 1.7]), world_from_light(AZIMUTH)),
        "camera": (AWAY * world_from_camera[:, 2], world_from_camera),
    }


def draw_frames(axes: Any) -> None:
    """Draw an object with its front, the camera on its ring, and the axes of all three frames."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 40), np.linspace(0, np.pi, 20))
    ball = 0.55 * np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
    axes.plot_surface(*ball, color="#cccccc", alpha=0.35, linewidth=0)
    ring = np.linspace(0, 2 * np.pi, 25)
    height, radius = AWAY * np.sin(ELEVATION), AWAY * np.cos(ELEVATION)
    axes.plot(radius * np.cos(ring), radius * np.sin(ring), height, ".-", color="#bbbbbb", lw=0.8)
    for name, (origin, columns) in axes_of_frames().items():
        for axis, direction in zip(AXES, columns.T, strict=True):
            axes.quiver(*origin, *direction, color=COLOURS[name], arrow_length_ratio=0.12, lw=2)
            axes.text(*(origin + 1.15 * direction), axis, color=COLOURS[name], fontsize=11)
        axes.text(
            *(origin - [0, 0, 0.8 if name == "world" else 0.35]),
            name,
            color=COLOURS[name],
            fontsize=10,
            ha="center",
        )
    origin = axes_of_frames()["camera"][0]
    axes.plot(*np.stack([np.zeros(3), origin], axis=1), ":", color=COLOURS["camera"], lw=1)
    axes.text(1.3, 0, -0.3, "the object's front", fontsize=8, color=COLOURS["world"])
    axes.set_box_aspect((1, 1, 0.75), zoom=1.3)
    axes.set(xlim=(-2.2, 3), ylim=(-2.6, 2.6), zlim=(-1.4, 2.5))
    axes.view_init(elev=24, azim=-38)
    axes.set_axis_off()
    axes.set_title("World, light and camera frame, azimuth 30°, elevation 20°", fontsize=11)


def draw_map(axes: Any) -> None:
    """Draw where the directions of the light frame lie in a map of 64 × 128 texels."""
    height, width = 64, 128
    w, _ = envmap.directions(height, width)
    axes.imshow(0.35 + 0.3 * (w[..., 1:2] + 1) / 2 * np.ones(3), extent=(0, width, height, 0))
    for direction, caption in {
        (1, 0, 0): "+x\nright",
        (0, 0, 1): "+z\ntowards the viewer",
        (-1, 0, 0): "−x\nleft",
        (0, 0, -1): "−z\naway from the viewer",
    }.items():
        row, column = envmap.texel(np.array(direction, float), height, width)
        column = column + 0.5
        axes.plot([column], [row], "o", color=COLOURS["light"])
        axes.text(column + 2, row - 3, caption, fontsize=8, color="white")
    axes.text(64, 3, "+y, zenith: row 0", fontsize=8, color="white", ha="center", va="top")
    axes.text(64, 61, "−y, nadir: row 63", fontsize=8, color="white", ha="center")
    axes.set(xlabel="column", ylabel="row", xticks=range(0, 129, 32), yticks=range(0, 65, 16))
    axes.set_title("An environment map as it is stored, in the light frame", fontsize=11)


def draw(path: Path) -> None:
    """Write the picture."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 5), layout="constrained")
    left, right = figure.subplot_mosaic(
        [["frames", "map"]], per_subplot_kw={"frames": {"projection": "3d"}}
    ).values()
    draw_frames(left)
    draw_map(right)
    files.write_figure(path, figure, dpi=90)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
