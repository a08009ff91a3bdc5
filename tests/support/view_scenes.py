"""A dented sphere near the camera, as the strategies for a view per pixel see it."""

import numpy as np

from learn.experiments.layer import chart_cases, near_shapes
from learn.methods import planned_views
from shaders.frames import camera_from_light
from tests.support.card_scenes import MATERIALS, light, material

ROTATION = tuple(camera_from_light().flatten().tolist())


def seen(fov=60, depth=0.15, size=48):
    """Normals and views (P, 3) of a dented sphere near the camera."""
    n, view = near_shapes.near(size, np.radians(fov), depth, 1)
    inside = (n != 0).any(-1)
    return n[inside].numpy(), view[inside].numpy()


def scene(kind="satin", name="sky", fov=60, **options):
    """A scene of a material of tests.support.card_scenes.

    name  of one of its lights, or "lamps of 64 rows"
    """
    n, view = seen(fov)
    m = material(*MATERIALS[kind]).double().reshape(3, 3, 2, 6).numpy()
    if name == "lamps of 64 rows":
        given_light = chart_cases.computed_lights()["lamps"].astype(np.float32)
    else:
        given_light = light(name)[0].numpy()
    given = {"tolerance": 1e-2, "material_gradient": True} | options
    return planned_views.Scene(n, view, m, given_light, ROTATION, **given)
