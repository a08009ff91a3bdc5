"""Outlines (C, 2) of polygons with many corners, and a fan of thin triangles."""

import numpy as np


def star(count, least, rng):
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    radius = rng.uniform(least, 1, count)
    return np.c_[radius * np.cos(angle), radius * np.sin(angle)]


def comb(teeth):
    x = np.repeat(2.0 * np.arange(teeth), 4) + np.tile([0, 0, 1, 1], teeth)
    y = np.tile([1.0, 2 * teeth, 2 * teeth, 1.0], teeth)
    return np.concatenate([[(0, 0), (2 * teeth, 0)], np.c_[x, y][::-1]])


def spiral(count):
    angle = np.linspace(0, 20 * np.pi, count // 2)
    inner, outer = (
        (radius + angle / 6)[:, None] * np.c_[np.cos(angle), np.sin(angle)] for radius in (1.0, 1.4)
    )
    return np.concatenate([outer, inner[::-1]])


def fan_of_slivers(count):
    angle = np.linspace(0, 2 * np.pi, count)
    vertices = np.concatenate([[(-1, 0, 0)], np.c_[np.cos(angle), np.sin(angle), np.zeros(count)]])
    step = np.arange(1, count)
    return vertices, np.stack([np.zeros(count - 1, int), step, step + 1], axis=1)


def obj_of(xy):
    """The text of an OBJ file with one polygon."""
    corners = "".join(f"v {x!r} {y!r} 0\n" for x, y in xy.tolist())
    return f"{corners}f {' '.join(map(str, range(1, len(xy) + 1)))}\n"
