"""What people look at looks as it did: contact sheets and pictures of commands, and the layer.

A change that alters a picture on purpose replaces its file in tests/goldens: a failed test names
the new picture, which tests/support/goldens.py has saved.
"""

import numpy as np
import pytest
import torch
from PIL import Image

from learn.layer import render
from manifests.cli import main
from shaders import tone
from tests.support import goldens
from tests.support.card_scenes import LIGHTS, MATERIALS, light, material, sphere
from tests.support.synthetic import matte, write_dataset


def carried_out(program, *words):
    words = [str(word) for word in words]
    assert main(program, "", (words[0],), words) == 0


def read(path):
    return np.asarray(Image.open(path).convert("RGB"))


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """Two matte materials under one light at two rotations: four pictures of 64²."""
    both = [matte("dark", 0.2), matte("light", 0.8)]
    folder = tmp_path_factory.mktemp("pictures")
    return write_dataset(
        folder, both, np.random.default_rng(3), size=64, seeds=1, noise=0.0, category="sphere"
    )


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """A shaded disc before a slope, warm.png and cold.png, with a mask beside each."""
    folder = tmp_path_factory.mktemp("photographs")
    y, x = np.mgrid[-1:1:64j, -1:1:64j]
    inside = x * x + y * y < 0.7
    shade = 90 + 80 * np.sqrt(np.clip(0.7 - x * x - y * y, 0, 1)) - 60 * y
    for name, colour in (("warm", (1, 0.8, 0.6)), ("cold", (0.5, 0.7, 1))):
        values = np.where(inside, shade, 30 + 20 * x)[..., None] * colour
        Image.fromarray(np.clip(values, 0, 255).astype(np.uint8)).save(folder / f"{name}.png")
        Image.fromarray(255 * inside.astype(np.uint8)).save(folder / f"{name}.mask.png")
    return folder


@pytest.fixture(scope="module")
def predicted(photographs, tmp_path_factory):
    out = tmp_path_factory.mktemp("prediction") / "out"
    words = (photographs / "warm.png", "--mask", photographs / "warm.mask.png")
    carried_out("learn", "predict", *words, "--out", out)
    return out


@pytest.fixture(scope="module")
def edited(photographs, tmp_path_factory):
    out = tmp_path_factory.mktemp("edit") / "out"
    words = ("--mask", photographs / "warm.mask.png", "--material", "red-fabric", "--no-refine")
    carried_out("learn", "edit", photographs / "warm.png", *words, "--out", out)
    return out


def test_the_preview_of_a_data_set(store, tmp_path):
    words = ("--count", 1, "--size", 64, "--out", tmp_path / "out")
    carried_out("factory", "preview", store.folder, *words)
    goldens.check("data-set-preview", read(tmp_path / "out" / "sheet.png"))


def test_the_preview_of_shapes(tmp_path):
    words = ("chair:3", "car:1", "sphere:2", "--size", 64, "--out", tmp_path / "sheet.png")
    carried_out("factory", "shapes", "preview", *words)
    goldens.check("shapes", read(tmp_path / "sheet.png"))


def test_the_preview_of_light_maps(tmp_path):
    words = ("sun-and-sky-1", "softboxes-2", "--size", 32, "--out", tmp_path / "sheet.png")
    carried_out("factory", "lights", "preview", *words)
    goldens.check("lights", read(tmp_path / "sheet.png"))


@pytest.mark.parametrize("of", ["label", "nodes"])
def test_the_preview_of_materials(of, tmp_path):
    words = ("brass", "blue-rubber", "gold-paint", "--of", of, "--size", 64)
    carried_out(
        "factory", "materials", "preview", *words, "--light", "softboxes-1",
        "--out", tmp_path / "sheet.png",
    )  # fmt: skip
    goldens.check(f"materials-{of}", read(tmp_path / "sheet.png"))


@pytest.mark.parametrize("name", ["sheet", "normals", "light", "rendering"])
def test_a_prediction(name, predicted):
    goldens.check(f"prediction-{name}", read(predicted / f"{name}.png"))


@pytest.mark.parametrize("name", ["sheet", "edited"])
def test_an_edit(name, edited):
    goldens.check(f"edit-{name}", read(edited / f"{name}.png"))


def test_a_transfer(photographs, tmp_path):
    pair = [photographs / f"{name}.png" for name in ("warm", "cold")]
    carried_out(
        "learn", "transfer", *pair, "--no-refine", "--tolerance", 0.05, "--out", tmp_path / "out"
    )
    goldens.check(
        "transfer-grid",
        read(tmp_path / "out" / "grid.png"),
    )


def test_the_layers_pictures():
    """Three materials, from matte to glossy, under three lights."""
    n = sphere(64)
    rows = [
        np.hstack([tone.display(render(n, material(*lobes), light(name))[0].numpy(), 0.5)
                   for name in LIGHTS])
        for lobes in MATERIALS.values()
    ]  # fmt: skip
    goldens.check("layer", np.vstack(rows).astype(np.uint8))


# The goldens themselves


def test_a_picture_a_tenth_brighter_a_shift_and_a_missing_caption_are_seen(monkeypatch, tmp_path):
    monkeypatch.setenv("BRDFACTORY_FAILED_PICTURES", str(tmp_path))
    picture = np.asarray(Image.open(goldens.FOLDER / "materials-label.png"))
    goldens.check("materials-label", picture)
    brighter = np.clip(picture * 1.1, 0, 255).astype(np.uint8)
    without = picture.copy()
    without[64:] = picture[-1, -1]
    for changed in (brighter, np.roll(picture, 2, 1), without, picture[:-1]):
        with pytest.raises(AssertionError, match=str(tmp_path / "materials-label.png")):
            goldens.check("materials-label", changed)
        assert (read(tmp_path / "materials-label.png") == changed).all()
    noise = np.random.default_rng(0).integers(-1, 2, picture.shape)
    goldens.check("materials-label", np.clip(picture + noise, 0, 255).astype(np.uint8))


def test_every_golden_is_compared_and_all_of_them_are_small(root):
    files = sorted((root / "tests" / "goldens").iterdir())
    text = (root / "tests" / "test_goldens.py").read_text()
    assert all(file.stem.split("-")[0] in text for file in files)
    assert len(files) >= 12
    assert sum(file.stat().st_size for file in files) < 200_000
