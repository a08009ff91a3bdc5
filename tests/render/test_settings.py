"""Settings are refused where Blender would accept them in silence, and written down as Blender
holds them.
"""

import json

import pytest

pytestmark = pytest.mark.blender


def test_a_misspelt_property_is_refused_with_the_closest_names(studio):
    from factory.render.settings import assign

    with pytest.raises(AttributeError, match="did you mean samples"):
        assign(studio._scene, "cycles.sampels", 16)


def test_a_value_that_blender_clamps_is_refused(studio):
    from factory.render.settings import assign

    with pytest.raises(ValueError, match="outside the property's range"):
        assign(studio._scene, "cycles.samples", 0)


def test_an_enum_item_that_blender_does_not_have_is_refused(studio):
    from factory.render.settings import assign

    with pytest.raises(ValueError, match="'GAUSS' is not accepted"):
        assign(studio._scene, "cycles.pixel_filter_type", "GAUSS")


def test_the_effective_settings_are_json_and_each_has_its_reason(studio):
    from factory.render.settings import ALWAYS, GEOMETRY, PICTURE
    from factory.render.validation import reference

    studio.set_light(reference.soft_light())
    settings = json.loads(json.dumps(studio.settings))
    for scene, own in (("picture", PICTURE), ("geometry", GEOMETRY)):
        for setting in (*ALWAYS, *own):
            held = settings[scene][setting.path]
            assert held["value"] == setting.value or abs(held["value"] - setting.value) < 1e-6
            assert held["reason"]
    assert settings["picture"]["cycles.device"]["value"] == "CPU"
    assert settings["picture"]["world.cycles.sampling_method"]["value"] == "MANUAL"


def test_an_unknown_device_and_a_missing_gpu_are_one_line_each(studio):
    from factory.render import device
    from manifests.errors import InputError

    with pytest.raises(InputError, match="--device: expected one of auto, cpu"):
        device.choose("gpu")
    with pytest.raises(
        InputError, match="expected a GPU that Cycles can use through metal, found none"
    ):
        device.choose("metal")  # no Linux build has it
