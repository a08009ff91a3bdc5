"""The Triton kernels' logic, run by Triton's interpreter on the CPU against the CPU engine: values and gradients.

Run by test_triton.py in a process of its own: triton reads TRITON_INTERPRET when it is first imported. The interpreter uses numpy's exp2
and log2; how fast and how right the kernels are on a GPU is not shown by these tests.
"""

import numpy as np
import pytest
import torch

from learn.engines import cpu, cuda
from manifests import materials as catalogue
from tests.learn.engines.conftest import ROTATION, TOLERANCE, make_scene, material, random_material, tangential, unit


def relative(a, b):
    return float(np.abs(a - b).max() / max(np.abs(b).max(), 1e-30))


def compare(scene):
    n, _, m, light, rotation, counts, light_of = scene.arguments()
    tensors = [torch.as_tensor(a) for a in (n, m, light)]
    seen = cuda.radiance(*tensors, rotation, counts, light_of).numpy()
    by_n, by_m, by_light = (a.numpy() for a in cuda.gradients(torch.as_tensor(scene.g), *tensors, rotation, counts, light_of))
    right = cpu.radiance(*scene.arguments(), 1)
    right_n, _, right_m, right_light = cpu.gradients(scene.g, *scene.arguments(), 1)
    n64 = unit(n.astype(np.float64))
    assert relative(seen, right) <= TOLERANCE
    assert relative(tangential(by_n.astype(np.float64), n64), tangential(right_n.astype(np.float64), n64)) <= TOLERANCE
    assert relative(by_m, right_m) <= TOLERANCE
    assert relative(by_light, right_light) <= TOLERANCE


@pytest.mark.parametrize("size", [(8, 16), (5, 7)])
def test_values_and_gradients_equal_the_cpu_engine(rng, size):
    compare(make_scene(rng, random_material(rng), pixels=75, size=size))


@pytest.mark.parametrize("kappa, gamma", [(1e-5, 0.5), (30.0, 100.0), (5.0, 1e3), (0.3, 1e-3)])
def test_heights_and_widths_of_lobes(rng, kappa, gamma):
    compare(make_scene(rng, material(kappa, gamma), pixels=40, size=(8, 16)))


def test_a_measured_metal(rng):
    compare(make_scene(rng, catalogue.find("chrome").m, pixels=40, size=(8, 16)))


def test_groups_with_lights_of_their_own(rng):
    scene = make_scene(rng, random_material(rng), pixels=50, size=(8, 16))
    m = torch.as_tensor(np.stack([scene.m, random_material(rng), scene.m]))
    light = torch.as_tensor(rng.random((2, 8, 16, 3)).astype(np.float32))
    counts, light_of, rotation = (20, 5, 25), (0, 0, 1), tuple(ROTATION.flatten().tolist())
    n = torch.as_tensor(scene.n)
    right = cpu.radiance(scene.n, None, m.numpy(), light.numpy(), rotation, counts, light_of, 1)
    assert relative(cuda.radiance(n, m, light, rotation, counts, light_of).numpy(), right) <= TOLERANCE
    right = cpu.gradients(scene.g, scene.n, None, m.numpy(), light.numpy(), rotation, counts, light_of, 1)
    _, by_m, by_light = cuda.gradients(torch.as_tensor(scene.g), n, m, light, rotation, counts, light_of)
    assert relative(by_m.numpy(), right[2]) <= TOLERANCE and relative(by_light.numpy(), right[3]) <= TOLERANCE
