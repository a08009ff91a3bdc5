"""Threads and processes: two callers at once, a child forked after use, DataLoader workers of both
kinds, memory.
"""

import threading
import tracemalloc

import numpy as np
import pytest
import torch

from learn.engines import cpu, threads
from learn.layer import render
from tests.support.engine_scenes import make_scene, material, random_material


def small():
    """A picture of 16 pixels, forward and backward, as one number."""
    n = torch.zeros(1, 4, 4, 3)
    n[..., 2] = 1.0
    m = torch.full((1, 108), 0.4, requires_grad=True)
    seen = render(n, m, torch.ones(1, 8, 16, 3), method="exact")
    seen.sum().backward()
    return seen.sum().item() + m.grad.sum().item()


class Rendered(torch.utils.data.Dataset):
    def __len__(self):
        return 4

    def __getitem__(self, index):
        return small()


@pytest.mark.parametrize("method", ["fork", "spawn"])
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_dataloader_workers_render_after_the_parent_has(method):
    torch.set_num_threads(2)
    expected = small()
    loader = torch.utils.data.DataLoader(
        Rendered(), num_workers=2, multiprocessing_context=method, timeout=120
    )
    assert [value.item() for value in loader] == [expected] * 4


def test_two_callers_at_once(rng):
    scene = make_scene(rng, random_material(rng), pixels=400, size=(16, 32))
    expected = cpu.radiance(*scene.arguments(), 1)
    expected_by = cpu.gradients(scene.g, *scene.arguments(), 1)
    wrong = []

    def caller():
        for _ in range(5):
            if not np.array_equal(cpu.radiance(*scene.arguments(), 2), expected):
                wrong.append("radiance")
            if not np.array_equal(cpu.gradients(scene.g, *scene.arguments(), 2)[2], expected_by[2]):
                wrong.append("gradient")

    callers = [threading.Thread(target=caller) for _ in range(3)]
    for each in callers:
        each.start()
    for each in callers:
        each.join()
    assert not wrong


def test_an_error_in_a_slice_reaches_the_caller():
    def fail(first, last):
        if first:
            raise RuntimeError("slice")

    with pytest.raises(RuntimeError, match="slice"):
        threads.run(fail, [(0, 1), (1, 2)], 2)


def test_bounds_cover_everything_once():
    for count in (0, 1, 5, 16, 33):
        assert [i for a, b in threads.split(count, 16) for i in range(a, b)] == list(range(count))


@pytest.mark.parametrize("perspective", [False, True])
def test_memory_beyond_inputs_and_outputs_stays_below_64_mib(rng, perspective):
    """For a batch of 120,000 pixels, four images with lights and materials of their own; sharp
    lobes, because they are quick.
    """
    images, pixels = 4, 30_000
    scene = make_scene(
        rng, material(1.0, 3e4), pixels=images * pixels, size=(64, 128), perspective=perspective
    )
    counts = [len(scene.n) // images] * (images - 1)
    counts.append(len(scene.n) - sum(counts))
    m = np.stack([scene.m * (1 + 0.1 * i) for i in range(images)])
    light = np.stack([scene.light] * images)
    arguments = scene.n, scene.view, m, light, scene.arguments()[4], counts, list(range(images))
    cpu.radiance(*arguments, 2)  # the map's geometry, kept for all calls, is not counted
    for work in (
        lambda: cpu.radiance(*arguments, 2),
        lambda: cpu.gradients(scene.g, *arguments, 2),
    ):
        tracemalloc.start()
        results = work()
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        outputs = sum(
            a.nbytes
            for a in (results if isinstance(results, tuple) else (results,))
            if a is not None
        )
        assert peak - outputs <= 64 * 2**20


def test_a_large_map_is_summed_in_slabs(rng):
    """200 × 400 texels, five slabs: the same as the sum of what each half of the light gives."""
    scene = make_scene(rng, random_material(rng), pixels=40, size=(200, 400))
    whole = cpu.radiance(*scene.arguments(), 1)
    halves = []
    for rows in (slice(0, 100), slice(100, 200)):
        light = np.zeros_like(scene.light)
        light[rows] = scene.light[rows]
        halves.append(cpu.radiance(*scene.arguments()[:3], light[None], *scene.arguments()[4:], 1))
    np.testing.assert_allclose(whole, halves[0] + halves[1], rtol=3e-6)
