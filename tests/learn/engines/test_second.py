"""The CPU engine's second derivatives against the reference's in float64, where sums of lobes are easy and where they break.

Error as in conftest.py, for the derivative by each argument on its own. The direction n', view', m', light' is random, each of the size of
what it belongs to, n' and view' tangential, as what comes through the scaling to unit length is.
"""

import numpy as np
import pytest
import torch

from learn.engines import cpu, distant, distant_second, general, general_second, second
from learn.methods import exact_second
from manifests import materials as catalogue
from shaders.dsbrdf import half_angles
from shaders.envmap import directions
from tests.learn.engines import conftest, test_adversarial
from tests.learn.engines.conftest import ROTATION, make_scene, material, random_material, tangential, unit

CAMERAS = pytest.mark.parametrize("perspective", [False, True], ids=["orthographic", "view per pixel"])
NAMES = "g", "n", "view", "m", "light"
TOLERANCE = 1e-5  # as of the first derivatives


def direction(rng, scene):
    """n', view' (or None), m', light'."""
    n, view = (None if x is None else tangential(rng.normal(size=x.shape), x).astype(np.float32) for x in (scene.n, scene.view))
    m, light = ((rng.normal(size=x.shape) * x).astype(np.float32) for x in (scene.m, scene.light))
    return n, view, m[None], light[None]


def reference(along, scene):
    """{name: derivative} in float64, those by n and view tangential."""
    n, view = (None if x is None else unit(x.astype(np.float64)) for x in (scene.n, scene.view))
    given = scene.g, n, view, scene.m[None], scene.light[None]
    tensors = [[None if x is None else torch.tensor(x, dtype=torch.float64) for x in group] for group in (along, given)]
    found = exact_second.of_groups(tensors[0], *tensors[1], ROTATION.flatten().tolist(), [len(n)], [0])
    return in_tangents(found, n, view)


def engine(along, scene, workers=1):
    found = second.gradients(along, scene.g, *scene.arguments(), workers)
    n, view = (None if x is None else unit(x.astype(np.float64)) for x in (scene.n, scene.view))
    return in_tangents(found, n, view)


def in_tangents(found, n, view):
    by = {name: np.asarray(x, dtype=np.float64) for name, x in zip(NAMES, found, strict=True) if x is not None}
    by["n"] = tangential(by["n"], n)
    return by | ({} if view is None else {"view": tangential(by["view"], view)})


def errors(rng, scene):
    along = direction(rng, scene)
    right, found = reference(along, scene), engine(along, scene)
    return {name: float(np.abs(found[name] - x).max() / max(np.abs(x).max(), 1e-30)) for name, x in right.items()}
