"""Rooms and skies: drawn from seeds, with nothing at the eye, rendered where they lie."""

import argparse
import os
import subprocess
import sys
import time
from concurrent import futures
from concurrent.futures import process

import numpy as np
import pytest

from factory.commands import lights
from factory.lights import interiors, library, load
from factory.lights.interiors import Bulb, Material, Scene, Sky
from manifests.errors import InputError


@pytest.mark.parametrize("seed", range(40))
def test_a_scene_repeats_leaves_the_eye_free_and_has_light(seed):
    scene = interiors.draw(seed)
    assert scene == interiors.draw(seed)
    for box in scene.boxes:
        inside = all(a < 0 < b for a, b in zip(box.low, box.high, strict=True))
        assert not inside and all(a < b for a, b in zip(box.low, box.high, strict=True))
    for bulb in scene.bulbs:
        assert np.linalg.norm(bulb.centre) > bulb.radius + 0.4
    lamps = [thing for thing in (*scene.boxes, *scene.bulbs) if thing.material.emission]
    assert lamps or scene.sky.strength > 0


def test_seeds_give_both_rooms_and_open_skies():
    scenes = [interiors.draw(seed) for seed in range(60)]
    open_skies = sum(scene.sky.strength == 1.0 and not scene.bulbs for scene in scenes)
    assert 5 < open_skies < 40  # a third of 60, three standard deviations either way


@pytest.mark.blender
def test_a_panorama_shows_a_lamp_where_it_hangs():
    from factory.render import panorama

    direction = np.array([0.6, 0.5, 0.3])
    direction /= np.linalg.norm(direction)
    x, y, z = 5 * direction
    lamp = Bulb((float(x), float(y), float(z)), 0.2, Material((1.0, 1.0, 1.0), emission=100.0))
    light = panorama.render(Scene(Sky(0.5, 0.0, 0.0, 0.0, False), bulbs=(lamp,)))
    row, column = np.unravel_index(light[..., 0].argmax(), light.shape[:2])
    # a file's columns and rows (factory.lights.light): within a texel
    assert (
        abs(column + 0.5 - 128 * (0.5 - np.arctan2(direction[1], direction[0]) / (2 * np.pi))) < 1
    )
    assert abs(row + 0.5 - 64 * (0.5 - np.arcsin(direction[2]) / np.pi)) < 1
    assert light.max() > 1 and (light < 1e-3).mean() > 0.95


@pytest.mark.blender
def test_the_command_makes_what_the_library_lacks_and_nothing_twice(tmp_path, root):
    command = [sys.executable, "-m", "factory", "lights", "make"]
    command += ["--first", "7", "--count", "1", "--library", str(tmp_path / "lights")]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    first, second = (
        subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        for _ in range(2)
    )
    assert "1 map made, 0 were there" in first.stdout
    assert "seconds of processor time per map" in first.stdout
    assert "0 maps made, 1 was there" in second.stdout
    light = load("interior-7", tmp_path / "lights")
    assert light.L64.shape == (64, 128, 3) and light.licence == "Apache-2.0"


@pytest.mark.blender
def test_the_suns_disc_is_as_bright_as_the_light_that_it_sends():
    from factory.lights.interiors import Box
    from factory.render import panorama
    from shaders import envmap

    sky = Sky(0.9, 1.0, 0.0, 1.0, True)
    light = panorama.render(Scene(sky))
    energy = light * envmap.row_solid_angles(*light.shape[:2])[:, None, None]
    row, column = np.unravel_index(light[..., 1].argmax(), light.shape[:2])
    assert (row, column) == (int((0.5 - 0.9 / np.pi) * 64), int((0.25 + 1 / (2 * np.pi)) * 128))
    # a white floor (albedo 0.8) under the same sky shows the irradiance of sun and sky together
    floor = Box((-300.0, -300.0, -2.0), (300.0, 300.0, -1.0), Material((0.8, 0.8, 0.8), 1.0))
    below = panorama.render(Scene(sky, (floor,)))[56:].mean((0, 1))
    up = np.maximum(np.cos(np.pi * (np.arange(64) + 0.5) / 64), 0)[:, None, None]
    np.testing.assert_allclose((energy * up).sum((0, 1)) * 0.8 / np.pi, below, rtol=0.12)
    # what stands before the sun hides it
    wall = Box((2.0, -20.0, -20.0), (3.0, 20.0, 20.0), Material((0.1, 0.1, 0.1)))
    east = Sky(0.3, float(np.pi / 2), 0.0, 1.0, True)
    assert panorama.render(Scene(east, (wall,))).max() < 0.01 * panorama.render(Scene(east)).max()


def test_a_map_that_fails_keeps_those_before_it_and_begins_none_after_it(tmp_path, monkeypatch):
    """Processes end where memory does; hours of further maps must not be waited for."""
    begun = []

    def rendered(seed):
        begun.append(seed)
        if seed == 2:
            raise process.BrokenProcessPool("a process was ended")
        time.sleep(0.05)  # so that the command sees each before the next is done
        return np.ones((8, 16, 3), np.float32), 0.1

    def pool(workers, *_):
        return futures.ThreadPoolExecutor(workers)

    monkeypatch.setattr(lights, "_render", rendered)
    monkeypatch.setattr(futures, "ProcessPoolExecutor", pool)
    options = argparse.Namespace(first=0, count=40, library=tmp_path, workers=1)
    with pytest.raises(InputError, match=r"expected processes that live.* maps that are missing"):
        lights.run_make(options)
    assert list(library.read_list(tmp_path)) == ["interior-0", "interior-1"]
    assert len(begun) < 40


def test_plans_are_those_of_the_published_lights_and_rooms():
    numbers = [
        value
        for scene in map(interiors.draw, range(10))
        for thing in (*scene.boxes, *scene.furniture)
        for value in (*thing.material.colour, thing.material.roughness)
    ]
    assert len(numbers) == 636
    assert sum(numbers) == pytest.approx(328.749245, abs=1e-6)
