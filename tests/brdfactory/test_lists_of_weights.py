"""The committed weights hold the lists that docs/list_what_weights_saw.py makes."""

import runpy

import pytest

from learn.networks import built_in_weights

weights = pytest.importorskip("learn.networks.weights", reason="torch is not installed")


@pytest.fixture(scope="module")
def script(root):
    return runpy.run_path(str(root / "docs" / "list_what_weights_saw.py"), run_name="script")


def test_shapes_materials_and_lights_are_those_of_the_file(script):
    stored = weights.seen_by(built_in_weights.FOLDER / "joint-compact.safetensors")
    # the whole job takes minutes: two chairs of training, and two that were held out
    names = ("chair:0", "chair:41", "chair:29", "chair:40")
    made = script["lists"](names)
    assert set(script["shape_hashes"](names)) == {"chair:0", "chair:41"}
    assert len(made.shapes) == 2 and set(made.shapes) < set(stored.shapes)
    assert made.materials == stored.materials and len(made.materials) == 124
    assert made.lights == stored.lights and made.reconstructed == stored.reconstructed
    assert set(names) < set(script["shapes"]()) and len(set(script["shapes"]())) == 330


def test_weights_that_began_with_these_hold_their_lists_too(script):
    first = weights.seen_by(built_in_weights.FOLDER / "joint-compact.safetensors")
    for name, lists in script["lists_of_all"](first).items():
        assert weights.seen_by(built_in_weights.FOLDER / f"{name}.safetensors") == lists
        for kind in ("shapes", "materials", "lights"):
            assert set(getattr(first, kind)) <= set(getattr(lists, kind))
