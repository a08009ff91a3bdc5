"""Varied surroundings: other surfaces on the same plan, from pale to dark, repeatably."""

import dataclasses

import numpy as np
import pytest

from factory.lights import interiors, surroundings
from shaders.tone import LUMINANCE


def _materials(scene):
    return [thing.material for thing in (*scene.boxes, *scene.furniture)]


def _without_materials(scene):
    things = (*scene.boxes, *scene.furniture)
    return [dataclasses.replace(thing, material=interiors.Material((0, 0, 0))) for thing in things]


@pytest.mark.parametrize("seed", range(12))
def test_only_surfaces_change_and_things_of_one_material_stay_alike(seed):
    plain = interiors.draw(seed)
    varied = surroundings.varied(plain, seed)
    assert varied == surroundings.varied(plain, seed)
    assert varied != surroundings.varied(plain, seed + 1)
    assert _without_materials(varied) == _without_materials(plain)
    assert (varied.sky, varied.bulbs) == (plain.sky, plain.bulbs)
    became = dict(zip(_materials(plain), _materials(varied), strict=True))
    for old, new in zip(_materials(plain), _materials(varied), strict=True):
        assert became[old] == new
        kept = old.emission > 0 or old.part == "ceiling"
        assert (new == old) == kept
        assert new.part == old.part


def test_surfaces_are_dark_and_pale_coloured_and_of_every_kind():
    rng = np.random.default_rng(0)
    drawn = [surroundings.surface(rng, part) for part in surroundings.PARTS for _ in range(150)]
    luminance = np.array([np.array(each.colour) @ LUMINANCE for each in drawn])
    assert (luminance < 0.06).mean() > 0.05 and (luminance > 0.5).mean() > 0.1
    assert luminance.min() > 0.02 and luminance.max() < 0.91
    ratio = np.array([max(each.colour) / min(each.colour) for each in drawn])
    assert (ratio > 5).mean() > 0.1 and (ratio < 1.5).mean() > 0.05
    kinds = {each.pattern.kind for each in drawn if each.pattern}
    assert kinds == set(surroundings.KINDS)
    polished = [each.roughness < 0.15 for each in drawn if each.part == "table"]
    assert 0.2 < np.mean(polished) < 0.6
    assert not any(each.roughness < 0.15 for each in drawn if each.part == "wall")


def test_a_colour_has_its_luminance_where_channels_allow_it():
    red, green, blue = surroundings.colour(0.07, 0.5, 0.2)
    assert red > green > blue
    assert np.array([red, green, blue]) @ LUMINANCE == pytest.approx(0.2)
    assert max(surroundings.colour(0.66, 1.0, 0.9)) == 0.95
