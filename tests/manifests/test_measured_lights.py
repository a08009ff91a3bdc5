"""The measured light maps that come with the program, and runs that use them."""

import msgspec
import numpy as np
import pytest

from factory.lights import load
from factory.lights.catalogue import names, wheel_maps
from learn.data.light_copies import without_duplicates
from learn.data.lights import read_maps
from learn.data.seen import map_hash
from learn.data.sources import _held_out_maps
from manifests import measured_lights
from manifests.errors import InputError
from manifests.training_runs import Data
from shaders import envmap

# those of the committed weights' own run
HELD = Data(
    measured_lights=True,
    validation_lights=("blender_courtyard", "pmndrs_hall", "drei_lebombo"),
    test_lights=(
        "blender_city",
        "blender_interior",
        "pmndrs_sunset",
        "pmndrs_lab",
        "drei_forest_slope",
        "drei_studio_small_03",
    ),
)


def test_there_are_26_different_credited_maps_of_unit_mean():
    maps = measured_lights.load_all()
    assert len(maps) == 26 and len(without_duplicates(maps, ())) == 26
    with np.load(measured_lights.MAPS) as stored:
        assert stored.files == list(maps)
    for name, L in maps.items():
        credit = measured_lights.credits()[name]
        assert credit.licence == "CC0" and credit.author and credit.source
        assert envmap.unit_mean(L)[1] == pytest.approx(1, abs=1e-5)
        assert L.shape == (64, 128, 3) and not L.flags.writeable


def test_they_repeat_the_split_of_the_committed_weights():
    held = list(_held_out_maps(HELD, measured_lights.load_all(), {}).values())
    assert (26 - len(held), held.count("validation"), held.count("test")) == (17, 3, 6)


@pytest.mark.skipif(not wheel_maps(), reason="needs the bpy wheel")
def test_the_wheels_maps_are_the_same_in_both_columns_orders():
    for name in wheel_maps():
        measured, wheel = load(f"blender_{name}").L64, load(name).L64
        assert np.abs(measured - wheel).sum() < 1e-3 * wheel.sum()
        assert f"blender_{name}" not in names()


def test_the_factory_and_learn_mean_the_same_map_by_a_name():
    for name in ("pmndrs_lab", "pmndrs-lab"):
        light = load(name)
        assert light.name == name and light.licence == "CC0"
        assert map_hash(light.L64) == map_hash(measured_lights.load("pmndrs_lab"))
    assert "pmndrs_lab" in names()


def test_a_folder_of_made_maps_is_read_in_the_light_frame(tmp_path):
    L = np.ones((64, 128, 3), np.float32)
    L[20, 64] = 9  # the centre column
    np.savez(tmp_path / "interior-3.npz", L=L)
    (tmp_path / "lights.json").write_text("{}")
    (name,) = maps = read_maps(tmp_path)
    assert name == "interior-3" and maps[name][20].argmax() // 3 == 32
    light = load("interior-3", tmp_path)
    np.testing.assert_allclose(maps[name], light.L64, rtol=1e-6)
    (tmp_path / "mine.hdr").write_bytes(b"")
    with pytest.raises(InputError, match=r"an \.npz light map"):
        read_maps(tmp_path)


def test_the_key_is_off_unless_a_run_says_so():
    assert not Data().measured_lights
    assert msgspec.json.decode(b'{"measured_lights": true}', type=Data).measured_lights
