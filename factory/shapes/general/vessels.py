"""Turned forms: vessels with handles and spouts, plates and bowls."""

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.closed_surface import Surface, close_surface, grid_faces
from factory.shapes.curves import smooth_path
from factory.shapes.general import fields
from factory.shapes.general.draws import Generator, about_z, log_uniform, profile
from factory.shapes.general.isosurface import Field, surface_of
from factory.shapes.lofts import ellipsoid, revolve

BODY, TRIM = 1, 2
FINE_CELLS, CUP_CELLS = 104, 72  # along a vessel: its wall is about four cells thick


def vessel(a: Assembly, rng: Generator) -> None:
    """A vase, jug, mug, pot, bottle or kettle; some have handles, a spout or a lid."""
    height = log_uniform(rng, 0.5, 2.0)
    draw_profile = _mug_profile if rng.random() < 0.35 else profile
    outer = draw_profile(rng, height)
    wall = rng.uniform(0.07, 0.12)
    field, inside = _pot(outer, wall)
    radius = float(np.interp(0.6 * height, outer[:, 1], outer[:, 0]))
    additions: list[Field] = []
    handles = int(rng.choice([0, 1, 2], p=[0.3, 0.5, 0.2]))
    for number in range(handles):
        turn = about_z(np.pi * number)
        additions.append(fields.turned(_handle(rng, outer, height), turn))
    if rng.random() < 0.3:
        additions.append(_spout(rng, outer, height))
    if rng.random() < 0.3:
        foot = rng.uniform(0.03, 0.08)
        additions.append(
            fields.moved(
                fields.torus(max(float(outer[0, 0]) - foot, foot), foot), (0, 0, foot * 0.4)
            )
        )
    if additions:
        field = fields.union([field, *additions], rng.uniform(0.02, 0.1))
        field = fields.cut(field, [inside], 0.02)
    extent = 0.62 * max(height, 2.4 * radius) + 0.75
    centred = fields.moved(field, (0, 0, -height / 2))
    a.add("body", surface_of(centred, extent, FINE_CELLS).moved(z=height / 2), BODY)
    if rng.random() < 0.3:
        _lid(a, rng, float(outer[-1, 0]), height)


def _mug_profile(rng, height):
    top, bottom, belly = rng.uniform(0.4, 0.75), rng.uniform(0.3, 0.7), rng.uniform(-0.08, 0.12)
    t = np.linspace(0, 1, 48)
    radius = bottom + (top - bottom) * t + belly * np.sin(np.pi * t)
    corner = rng.uniform(0.03, 0.15)
    radius *= np.minimum(1, (t / corner + 0.25) ** 0.5) if rng.random() < 0.5 else 1.0
    return np.stack([np.maximum(radius, 0.1), t * height], 1)


def _pot(outer, wall):
    """The fields of a pot and of what it holds, from radii and heights (N, 2) of its outside."""
    low, high = outer[0, 1], outer[-1, 1]
    closed_outer = np.concatenate([[[-0.2, low]], outer, [[-0.2, high]]])
    solid = fields.revolved(fields.Outline([closed_outer]))
    top = outer[outer[:, 1] > high - 2.5 * wall]  # a wider opening would cut off a narrow neck
    mouth = max(float(top[:, 0].min()) - wall, 0.03)
    opening = fields.cylinder(mouth, 1.0, 0.01)

    def cavity(p: np.ndarray) -> np.ndarray:
        return solid(p) + wall

    inside = fields.union(
        [cavity, fields.moved(opening, (0, 0, high - 1.5 * wall + 1.0))], 0.3 * wall
    )
    return fields.cut(solid, [inside], 0.5 * wall), inside


def _handle(rng, outer, height):
    low, high = np.sort(rng.uniform(0.12, 0.95, 2)) * height
    if high - low < 0.3 * height:
        low, high = 0.25 * height, 0.8 * height
    reach = rng.uniform(0.2, 0.55)
    radii = np.interp([low, high], outer[:, 1], outer[:, 0])
    bow = [
        [radii[0] - 0.03, 0, low],
        [radii.max() + reach * rng.uniform(0.6, 1), 0, low + 0.2 * (high - low)],
        [radii.max() + reach, 0, low + rng.uniform(0.5, 0.9) * (high - low)],
        [radii[1] - 0.03, 0, high],
    ]
    return fields.path(smooth_path(bow, 14), rng.uniform(0.05, 0.1))


def _spout(rng, outer, height):
    low, high = rng.uniform(0.2, 0.5) * height, rng.uniform(0.8, 1.1) * height
    start = float(np.interp(low, outer[:, 1], outer[:, 0]))
    reach = rng.uniform(0.3, 0.6)
    bow = [
        [-(start - 0.05), 0, low],
        [-(start + 0.5 * reach), 0, low + rng.uniform(0.1, 0.5) * (high - low)],
        [-(start + reach), 0, high],
    ]
    thick = rng.uniform(0.07, 0.14)
    return fields.path(smooth_path(bow, 12), np.linspace(thick * 1.5, thick * 0.7, 12))


def _lid(a, rng, radius, height):
    rise, knob = rng.uniform(0.05, 0.4) * radius, rng.uniform(0.08, 0.2) * radius
    t = np.linspace(0, 1, 16)
    dome = np.stack([radius * np.cos(t * np.pi / 2), height + rise * np.sin(t * np.pi / 2)], 1)
    dome[-1, 0] = 0.0
    under = [[0.0, height - 0.03], [radius * 0.97, height - 0.03]]
    a.add("lid", revolve(np.concatenate([under, dome]), 64), BODY)
    a.add("knob", ellipsoid([2 * knob] * 3).moved(z=height + rise + 0.6 * knob), TRIM)


def dish(a: Assembly, rng: Generator) -> None:
    """A plate, saucer, tray or bowl, or several stacked; a cup may stand on the saucer."""
    depth = log_uniform(rng, 0.05, 0.7)
    wall = rng.uniform(0.025, 0.06)
    steep = rng.uniform(1.5, 6.0)
    well = rng.uniform(0.25, 0.7)
    t = np.linspace(0, 1, 40)
    rise = depth * np.clip((t - well) / (1 - well), 0, 1) ** min(steep, 0.7 / depth)
    rise = rise + rng.uniform(0, 0.04) * np.clip((t - 0.8) / 0.2, 0, 1) ** 2
    upper = np.stack([t[::-1], rise[::-1] + wall], 1)
    lower = np.stack([t, rise], 1)
    rim = np.array([[1.0 + 0.4 * wall, rise[-1] + 0.5 * wall]])
    section = np.concatenate([lower, rim, upper])
    section[[0, -1], 0] = 0.0
    count = int(rng.choice([1, 2, 4], p=[0.7, 0.2, 0.1]))
    around = int(rng.choice([72, 6, 8, 12], p=[0.85, 0.05, 0.05, 0.05]))
    for number in range(count):
        a.add("dish", revolve(section, around).moved(z=number * (wall * 1.6 + 0.12 * depth)), BODY)
    foot = rng.uniform(0.3, 0.6)
    ring = np.array([[foot, 0.02], [foot + 0.05, 0.02], [foot + 0.05, -0.05], [foot, -0.05]])
    level = float(np.interp(foot, t, rise))
    a.add("foot", turned_ring(ring).moved(z=level), BODY)
    if count == 1 and rng.random() < 0.3:
        height = rng.uniform(0.4, 0.9)
        outer = _mug_profile(rng, height) * [rng.uniform(0.7, 1.0), 1.0]
        field, inside = _pot(outer, 0.07)
        field = fields.cut(fields.union([field, _handle(rng, outer, height)], 0.05), [inside], 0.02)
        cup = surface_of(fields.moved(field, (0, 0, -height / 2)), 1.3, CUP_CELLS)
        a.add("cup", cup.moved(z=height / 2 + wall + 0.01), BODY)


def turned_ring(section: np.ndarray, around: int = 96) -> Surface:
    """Return a closed section (N, 2) of (radius, z), away from the axis, turned about z."""
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    points = np.stack(
        [
            section[None, :, 0] * np.cos(angle)[:, None],
            section[None, :, 0] * np.sin(angle)[:, None],
            np.broadcast_to(section[None, :, 1], (around, len(section))),
        ],
        -1,
    )
    return close_surface(points.reshape(-1, 3), grid_faces(around, len(section), True, True))
