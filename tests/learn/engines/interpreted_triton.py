"""The Triton kernels' logic, run by Triton's interpreter on the CPU against the CPU engine: values
and gradients.

Run by test_triton.py in a process of its own: triton reads TRITON_INTERPRET when it is first
imported. The interpreter uses numpy's exp2 and log2; how fast and how right the kernels are on a
GPU is not shown by these tests.
"""

import numpy as np
import pytest
import torch

from learn.engines import cpu, cuda
from manifests import materials as catalogue
from tests.support.engine_scenes import (
    ROTATION,
    TOLERANCE,
    make_scene,
    material,
    random_material,
    tangential,
    unit,
)


def relative(a, b):
    return float(np.abs(a - b).max() / max(np.abs(b).max(), 1e-30))


def compare(scene):
    n, view, m, light, rotation, counts, light_of = scene.arguments()
    tensors = [None if a is None else torch.as_tensor(a) for a in (n, view, m, light)]
    seen = cuda.radiance(*tensors, rotation, counts, light_of)
    result = cuda.gradients(torch.as_tensor(scene.g), *tensors, rotation, counts, light_of)
    right = cpu.gradients(scene.g, *scene.arguments(), 1)
    assert relative(seen.numpy(), cpu.radiance(*scene.arguments(), 1)) <= TOLERANCE
    for name, x, by, expected in zip(
        ("n", "view", "m", "light"), (n, view, None, None), result, right, strict=True
    ):
        if expected is None:
            assert by is None
            continue
        pair = by.numpy().astype(np.float64), expected.astype(np.float64)
        if x is not None:
            pair = [tangential(each, unit(x.astype(np.float64))) for each in pair]
        assert relative(*pair) <= TOLERANCE, name


CAMERAS = pytest.mark.parametrize(
    "perspective", [False, True], ids=["orthographic", "view per pixel"]
)


@CAMERAS
def test_values_and_gradients_equal_the_cpu_engine(rng, perspective):
    compare(make_scene(rng, random_material(rng), pixels=75, size=(5, 7), perspective=perspective))


@CAMERAS
@pytest.mark.parametrize("kappa, gamma", [(1e-5, 0.5), (30.0, 1e3)])
def test_heights_and_widths_of_lobes(rng, perspective, kappa, gamma):
    compare(
        make_scene(rng, material(kappa, gamma), pixels=32, size=(8, 16), perspective=perspective)
    )


@CAMERAS
def test_a_measured_metal(rng, perspective):
    compare(
        make_scene(
            rng, catalogue.find("chrome").m, pixels=32, size=(8, 16), perspective=perspective
        )
    )


def compare_groups(g, arrays, constants):
    """Values, and gradients by material and light; the gradients by n of both are returned."""
    tensors = [None if a is None else torch.as_tensor(a) for a in arrays]
    assert (
        relative(cuda.radiance(*tensors, *constants).numpy(), cpu.radiance(*arrays, *constants, 1))
        <= TOLERANCE
    )
    right = cpu.gradients(g, *arrays, *constants, 1)
    result = cuda.gradients(torch.as_tensor(g), *tensors, *constants)
    for by, expected in zip(result[2:], right[2:], strict=True):
        assert relative(by.numpy(), expected) <= TOLERANCE
    return result[0], right[0]


@CAMERAS
def test_groups_with_lights_of_their_own(rng, perspective):
    scene = make_scene(rng, random_material(rng), pixels=50, size=(8, 16), perspective=perspective)
    m = np.stack([scene.m, random_material(rng), scene.m])
    light = rng.random((2, 8, 16, 3)).astype(np.float32)
    constants = tuple(ROTATION.flatten().tolist()), (20, 5, len(scene.n) - 25), (0, 0, 1)
    arrays = scene.n, scene.view, m, light
    compare_groups(scene.g, arrays, constants)


@pytest.mark.parametrize("groups_per_launch", [1, 2, 5])
def test_groups_of_few_pixels_share_a_launch(rng, groups_per_launch, monkeypatch):
    """Five groups, one of them without pixels and two under one light, in launches of that many."""
    counts = (3, 0, 40, 33, 7)
    scene = make_scene(rng, random_material(rng), pixels=sum(counts), size=(4, 8))
    monkeypatch.setattr(cuda, "_most", lambda *_: groups_per_launch)
    m = np.stack([random_material(rng) for _ in counts])
    light = rng.random((4, 4, 8, 3)).astype(np.float32)
    constants = tuple(ROTATION.flatten().tolist()), counts, (2, 0, 1, 3, 1)
    arrays = scene.n, None, m, light
    by_n, by_n_on_cpu = compare_groups(scene.g, arrays, constants)
    normals = scene.n.astype(np.float64)
    pair = [tangential(a.astype(np.float64), unit(normals)) for a in (by_n.numpy(), by_n_on_cpu)]
    assert relative(*pair) <= TOLERANCE
