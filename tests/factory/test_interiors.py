"""Rooms and skies: drawn from seeds, with nothing at the eye, rendered where they lie."""

import numpy as np
import pytest

from factory.lights import interiors
from factory.lights.interiors import Ball, Material, Scene, Sky


@pytest.mark.parametrize("seed", range(40))
def test_a_scene_repeats_leaves_the_eye_free_and_has_light(seed):
    scene = interiors.draw(seed)
    assert scene == interiors.draw(seed)
    for box in scene.boxes:
        inside = all(a < 0 < b for a, b in zip(box.low, box.high, strict=True))
        assert not inside and all(a < b for a, b in zip(box.low, box.high, strict=True))
    for ball in scene.balls:
        assert np.linalg.norm(ball.centre) > ball.radius + 0.4
    lamps = [thing for thing in (*scene.boxes, *scene.balls) if thing.material.emission]
    assert lamps or scene.sky.strength > 0


def test_seeds_give_both_rooms_and_open_skies():
    scenes = [interiors.draw(seed) for seed in range(60)]
    open_skies = sum(scene.sky.strength == 1.0 and not scene.balls for scene in scenes)
    assert 5 < open_skies < 40  # a third of 60, three standard deviations either way


@pytest.mark.blender
def test_a_panorama_shows_a_lamp_where_it_hangs():
    from factory.render import panorama

    direction = np.array([0.6, 0.5, 0.3])
    direction /= np.linalg.norm(direction)
    x, y, z = 5 * direction
    lamp = Ball((float(x), float(y), float(z)), 0.2, Material((1.0, 1.0, 1.0), emission=100.0))
    light = panorama.render(Scene(Sky(0.5, 0.0, 0.0, 0.0, False), balls=(lamp,)))
    row, column = np.unravel_index(light[..., 0].argmax(), light.shape[:2])
    # a file's columns and rows (factory.lights.light): within a texel
    assert (
        abs(column + 0.5 - 128 * (0.5 - np.arctan2(direction[1], direction[0]) / (2 * np.pi))) < 1
    )
    assert abs(row + 0.5 - 64 * (0.5 - np.arcsin(direction[2]) / np.pi)) < 1
    assert light.max() > 1 and (light < 1e-3).mean() > 0.95
