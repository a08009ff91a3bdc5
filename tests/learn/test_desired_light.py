"""`learn transfer --light`: objects in each other's materials under a light that a user names."""

import json

import numpy as np
import pytest
import torch
from PIL import Image

from learn.__main__ import COMMANDS
from learn.data import lights, photographs
from learn.editing import decomposition
from learn.editing.compositor import Compositor
from learn.editing.desired_light import resolve_light
from learn.editing.transfer_grids import light_names
from learn.layer import render
from manifests.cli import main
from manifests.errors import InputError
from shaders import envmap, tone
from tests.support.known_ball import NETWORK, SIZE, Knowing, ball, label_of, lit, opened


def no_picture(path):
    raise AssertionError(path)


@pytest.fixture
def pictures(tmp_path):
    for name, material in (("a", "blue-rubber"), ("b", "gold-paint")):
        radiance, inside = lit(label_of(material), 1.0)
        shown = tone.display(radiance, 1.0)
        Image.fromarray(np.dstack([shown, 255.0 * inside]).astype(np.uint8)).save(
            tmp_path / f"{name}.png"
        )
    return tmp_path


def lamp(column):
    """A dim map with a lamp at a column of row 20."""
    L = np.full((64, 128, 3), 0.05, np.float32)
    L[16:24, column : column + 8] = 20
    return L


def test_lights_come_from_maps_seeds_and_pictures_at_unit_mean(tmp_path):
    photographs.write_exr(tmp_path / "big.exr", np.repeat(np.repeat(lamp(40), 2, 0), 2, 1))
    np.savez(tmp_path / "maps.npz", left=lamp(90), right=lamp(10))
    expected = envmap.unit_mean(lamp(40))[0]
    np.testing.assert_allclose(
        resolve_light(str(tmp_path / "big.exr"), no_picture), expected, rtol=1e-4
    )
    right = resolve_light(f"{tmp_path / 'maps.npz'}#right", no_picture)
    np.testing.assert_allclose(right, envmap.unit_mean(lamp(10))[0], rtol=1e-5)
    computed = resolve_light("computed:7", no_picture)
    np.testing.assert_array_equal(computed, resolve_light("computed:7", no_picture))
    assert np.abs(computed - resolve_light("computed:8", no_picture)).max() > 0.1
    np.testing.assert_allclose(
        resolve_light("room.jpg", lambda path: lamp(40) * 9), expected, rtol=1e-5
    )
    for L in (right, computed):
        assert envmap.mean_radiance(L) @ tone.LUMINANCE == pytest.approx(1, abs=1e-4)
    quarter = resolve_light(f"{tmp_path / 'maps.npz'}#right", no_picture, 90)
    np.testing.assert_array_equal(quarter, envmap.roll(right, 32))


def test_a_mark_in_a_folder_s_name_is_no_map_s_name(tmp_path):
    place = tmp_path / "room #1"
    place.mkdir()
    np.savez(place / "maps.npz", **{"left": lamp(90), "right #2": lamp(10)})
    right = resolve_light(f"{place}/maps.npz#right #2", no_picture)
    np.testing.assert_allclose(right, envmap.unit_mean(lamp(10))[0], rtol=1e-5)
    texts = [f"{place}/maps.npz#left", f"{place}/other.exr", "computed:3"]
    (place / "other.exr").touch()
    assert light_names(texts) == ["left", "other", "computed-3"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("computed:x", "a whole number after computed:"),
        ("maps.npz#lft", "did you mean left"),
        ("maps.npz", "no name, and 2 maps"),
        ("none.npz#a", "no such file"),
        ("square.exr", "twice as wide as high"),
        ("black.exr", "a black map"),
        ("none.exr", "no such file"),
    ],
)
def test_lights_that_are_none_are_refused(text, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savez("maps.npz", left=lamp(90), right=lamp(10))
    photographs.write_exr("square.exr", np.ones((64, 64, 3), np.float32))
    photographs.write_exr("black.exr", np.zeros((64, 128, 3), np.float32))
    with pytest.raises(InputError, match=said):
        resolve_light(text, no_picture)


def test_a_transfer_under_a_light_shows_every_object_in_every_material(pictures, capsys):
    np.savez(pictures / "maps.npz", left=lamp(90), right=lamp(10))
    out = pictures / "lit"
    words = ["transfer", str(pictures / "a.png"), str(pictures / "b.png"), "--no-refine"]
    maps = [f"{pictures / 'maps.npz'}#{name}" for name in ("left", "right")]
    words += ["--light", maps[0], "--light", maps[1], "--out", str(out)]
    assert main("learn", "t", COMMANDS, words) == 0
    names = {
        f"{shape}-in-{material}-under-{light}.png"
        for shape in "ab"
        for material in "ab"
        for light in ("left", "right")
    }
    grids = {"grid-under-left.png", "grid-under-right.png"}
    assert {path.name for path in out.iterdir()} == names | grids | {"transfer.json"}
    report = json.loads((out / "transfer.json").read_text())
    assert report["lights"] == maps and len(report["pictures"]) == 2

    def shown(name):
        with Image.open(out / name) as picture:
            assert (picture.size, picture.mode) == ((SIZE, SIZE), "RGBA")
            return np.asarray(picture).astype(float)

    left, right = (shown(f"a-in-a-under-{light}.png") for light in ("left", "right"))
    assert left[0, 0, 3] == 0 and left[SIZE // 2, SIZE // 2, 3] == 255
    half = SIZE // 2
    brighter = [each[:, half:, :3].sum() / each[:, :half, :3].sum() for each in (left, right)]
    assert brighter[1] > 1.2 * brighter[0]  # a lamp on the right lights the right half
    assert abs(left - shown("b-in-a-under-left.png"))[..., :3].mean() > 0
    assert abs(left - shown("a-in-b-under-left.png"))[..., :3].mean() > 3
    assert main("learn", "t", COMMANDS, words) == 1
    assert "--overwrite" in capsys.readouterr().err
    twice = [*words[:-4], "--light", maps[0], "--out", str(pictures / "again")]
    assert main("learn", "t", COMMANDS, twice) == 1
    assert "lights of different names" in capsys.readouterr().err


def test_relighting_by_true_parts_is_the_layers_picture():
    """The compositor adds no error of its own under another light."""
    label = label_of("blue-rubber")
    radiance, inside = lit(label, 1.0)
    photo = opened(radiance, inside.astype(np.int64), 1.0)
    result = decomposition.decompose(photo, Knowing(label), NETWORK)
    L = envmap.unit_mean(lamp(20))[0].astype(np.float32)
    again = Compositor(result, 1e-3).relight(label, L)
    n, inside = ball(SIZE, 30)
    maps, m = torch.from_numpy(L)[None], torch.from_numpy(label).exp()
    truth = render(torch.from_numpy(n)[None], m, maps, method="exact")[0].numpy()
    core = n[..., 2] > 0.4  # at the rim 64² normals, enlarged, are a pixel off
    assert abs(again - truth)[core].mean() < 0.03 * truth[core].mean()
    assert abs(again - radiance)[core].mean() > 0.1 * truth[core].mean()
    assert (again[~inside] == 0).mean() > 0.98


def test_computed_lights_are_those_of_training():
    L = lights.draw_computed(np.random.default_rng(7))
    np.testing.assert_allclose(
        resolve_light("computed:7", no_picture),
        envmap.unit_mean(L.astype(np.float32))[0],
        rtol=1e-5,
    )
