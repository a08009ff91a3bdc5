"""The Python package: what it edits is what the command line edits, bit by bit, from files and
arrays; blends are exact; nothing heavy is imported before it is needed.
"""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

import brdfactory as bf
from manifests.errors import missing_package

torch = pytest.importorskip("torch", reason="torch is not installed")


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """A shaded ball with its mask and two regions, as files and as arrays."""
    folder = tmp_path_factory.mktemp("pictures")
    y, x = np.mgrid[-1:1:64j, -1:1:64j]
    inside = x * x + y * y < 0.6
    shade = np.where(inside, 80 + 90 * np.sqrt(np.clip(0.6 - x * x - y * y, 0, 1)) - 50 * y, 30)
    photo = np.stack([shade, 0.8 * shade, 0.6 * shade], -1).clip(0, 255).astype(np.uint8)
    mask = (255 * inside).astype(np.uint8)
    regions = np.where(x < 0, 1, 2).astype(np.uint8) * inside
    arrays = {"photo": photo, "mask": mask, "regions": regions}
    for name, array in arrays.items():
        Image.fromarray(array).save(folder / f"{name}.png")
    return folder, arrays


@pytest.fixture(scope="module")
def parts(pictures):
    folder, _ = pictures
    return bf.decompose(folder / "photo.png", folder / "mask.png", refine=False)


def test_an_edit_is_the_picture_that_the_command_writes(pictures, tmp_path):
    from learn.__main__ import COMMANDS
    from manifests import cli

    folder, _ = pictures
    edited = bf.edit(folder / "photo.png", folder / "mask.png", material="brass", refine=False)
    out = tmp_path / "edited"
    words = ["edit", str(folder / "photo.png"), "--mask", str(folder / "mask.png"), "--no-refine"]
    assert cli.main("learn", "", COMMANDS, [*words, "--material", "brass", "--out", str(out)]) == 0
    assert np.array_equal(np.asarray(Image.open(out / "edited.png")), edited.display)
    saved = edited.save(tmp_path / "deep" / "brass.png")
    assert saved.read_bytes() == (out / "edited.png").read_bytes()
    assert edited.material.name == "brass" and edited.decomposition.photograph.count == 1


def test_arrays_and_files_in_any_mixture_give_the_same_picture(pictures):
    folder, arrays = pictures
    results = [
        bf.edit(photo, mask, ["brass", None], regions=regions, refine=False).display
        for photo, mask, regions in (
            (folder / "photo.png", folder / "mask.png", folder / "regions.png"),
            (arrays["photo"], arrays["mask"] > 127, arrays["regions"]),
            (folder / "photo.png", arrays["mask"], str(folder / "regions.png")),
        )
    ]
    assert np.array_equal(results[0], results[1]) and np.array_equal(results[0], results[2])
    right = arrays["regions"] == 2
    interior = right & (np.mgrid[0:64, 0:64][1] > 36)
    assert abs(results[0].astype(int) - arrays["photo"])[interior].max() <= 1  # stays as it is
    assert abs(results[0].astype(int) - arrays["photo"])[arrays["regions"] == 1].mean() > 10


def test_paths_balances_and_devices_are_taken_in_all_their_forms(pictures, parts, tmp_path):
    _, arrays = pictures
    path = tmp_path / "material.json"
    label = bf.material("brass").label
    path.write_text(json.dumps({"label": label.tolist()}))
    photo, mask = arrays["photo"], arrays["mask"]
    options = {"refine": False, "device": "auto" if not torch.cuda.is_available() else "cpu"}
    expected = parts.paint(bf.material(path)).display
    # a file's material was read from a picture, and is rendered as bright as it was read
    assert parts.paint(bf.blend(path, path)).display == pytest.approx(expected, abs=1)
    assert not np.array_equal(parts.paint(label).display, expected)
    from learn.editing import mirror_correction

    named, read = (parts.relight("city", each).linear for each in (label, path))
    assert named.mean() / read.mean() == pytest.approx(mirror_correction.factor(label), rel=1e-3)
    assert np.array_equal(bf.edit(photo, mask, path, **options).display, expected)
    kept = bf.edit(photo, mask, None, **options).display
    assert np.array_equal(kept, photo)
    factors = (1.2, 1.0, 0.8)
    balanced = [
        bf.edit(photo, mask, label, white_balance=given, **options).display
        for given in (factors, np.array(factors), "1.2,1.0,0.8")
    ]
    assert not np.array_equal(balanced[0], expected)
    assert np.array_equal(balanced[0], balanced[1]) and np.array_equal(balanced[0], balanced[2])


@pytest.mark.parametrize("method", [None, "auto", "quadrature"])
def test_refinement_renders_by_the_method_that_is_named(pictures, monkeypatch, tmp_path, method):
    """From Python and from the command line, which writes the settings into edit.json."""
    from learn.__main__ import COMMANDS
    from learn.editing import decomposition
    from learn.refinement import PHOTOGRAPHS
    from manifests import cli

    folder, _ = pictures
    seen, decompose = [], decomposition.decompose

    def noted(opened, network, size, settings, shape=None):
        seen.append(settings)
        return decompose(opened, network, size, None)

    monkeypatch.setattr(decomposition, "decompose", noted)
    files = [folder / "photo.png", folder / "mask.png"]
    bf.decompose(*files, refinement_method=method)
    words = ["edit", str(files[0]), "--mask", str(files[1]), "--material", "red-fabric"]
    words += [] if method is None else ["--refinement-method", method]
    assert cli.main("learn", "", COMMANDS, [*words, "--out", str(tmp_path / "out")]) == 0
    assert seen == 2 * [PHOTOGRAPHS.with_method(method or "auto")]
    report = json.loads((tmp_path / "out" / "edit.json").read_text())
    assert report["refinement"]["method"] == (method or "auto")
    assert {level["method"] for level in report["refinement"]["levels"]} == {method or "auto"}


def test_a_blends_picture_is_the_weighted_sum(parts):
    first, second = parts.paint("brass").linear, parts.paint("red-fabric").linear
    blended = parts.paint(bf.blend("brass", "red-fabric", 0.25))
    np.testing.assert_allclose(blended.linear, 0.75 * first + 0.25 * second, rtol=1e-5, atol=1e-7)
    assert abs(first - second).max() > 0.01
    assert parts.paint(bf.blend("brass", "red-fabric", 0)).linear == pytest.approx(first)


def test_what_a_decomposition_tells(pictures):
    folder, _ = pictures
    parts = bf.decompose(folder / "photo.png", folder / "mask.png", refine=False, detail=0)
    n = parts.normals
    inside = np.linalg.norm(n, axis=-1) > 0
    np.testing.assert_allclose(np.linalg.norm(n[inside], axis=-1), 1, atol=1e-5)
    assert parts.light.shape == (64, 128, 3) and (parts.light >= 0).all()
    assert parts.material.label.shape == (108,)
    again = parts.paint(parts.material)
    np.testing.assert_allclose(again.linear, parts.rendering.linear, atol=1e-6, rtol=1e-4)
    assert 0 < parts.error < 20_000
    relit = parts.relight("city", "brass")
    assert relit.display.shape[-1] == 4 and relit.display[0, 0, 3] == 0
    assert abs(relit.linear - parts.relight("city").linear).max() > 0.01
    mirrored = bf.light("city")[:, ::-1]  # a view, of negative strides
    turned = parts.relight(mirrored, "brass").linear
    np.testing.assert_array_equal(turned, parts.relight(mirrored.copy(), "brass").linear)


def test_a_stop_of_brightness_doubles_the_new_material(pictures):
    folder, _ = pictures
    files = folder / "photo.png", folder / "mask.png"
    parts = bf.decompose(*files, refine=False)
    plain, brighter = parts.paint("red-fabric").linear, parts.paint("red-fabric", brightness=1)
    inside = parts.photograph.coverage == 1
    np.testing.assert_allclose(brighter.linear[inside], 2 * plain[inside], rtol=1e-5)
    edited = bf.edit(*files, "red-fabric", brightness=1, refine=False)
    np.testing.assert_array_equal(edited.linear, brighter.linear)


def test_an_exr_has_the_pictures_transparency(parts, tmp_path):
    from learn.data import photographs

    relit = parts.relight("city", "red-fabric")
    radiance, alpha = photographs.read_pixels(relit.save(tmp_path / "relit.exr"))
    np.testing.assert_array_equal(alpha, relit.opacity)
    np.testing.assert_allclose(radiance, relit.linear, rtol=1e-5)
    _, opaque = photographs.read_pixels(parts.rendering.save(tmp_path / "whole.exr"))
    assert (opaque == 1).all()


def test_rendering_of_own_normals_under_lights_by_name():
    n = np.zeros((8, 8, 3), np.float32)
    n[2:6, 2:6, 2] = 1
    gold = bf.render(n, bf.light("city"), "gold-metallic-paint3")
    turned = bf.render(n, bf.light("city", rotation_deg=90), "gold-metallic-paint3")
    assert gold[3, 3, 0] > gold[3, 3, 2] > 0 and not gold[0, 0].any()
    assert abs(gold - turned).max() > 1e-3
    half = bf.render(n, bf.light("city"), bf.blend("brass", "gold-metallic-paint3"))
    both = (gold + bf.render(n, bf.light("city"), "brass")) / 2
    np.testing.assert_allclose(half, both, rtol=1e-5)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda f, a: bf.material("bras"), "did you mean brass"),
        (lambda f, a: bf.material(f / "photo.png"), "a picture"),
        (lambda f, a: bf.material(np.zeros(3)), r"shape \(3,\)"),
        (lambda f, a: bf.blend("brass", "red-fabric", 2), "from 0 to 1, found 2"),
        (lambda f, a: bf.light("citty"), "did you mean city"),
        (lambda f, a: bf.edit(a["photo"][..., 0]), r"\(H, W, 3\) or \(H, W, 4\)"),
        (lambda f, a: bf.edit(a["photo"]), "a mask, or transparency"),
        (lambda f, a: bf.edit(a["photo"].astype(float) - 200, a["mask"]), "radiance from 0"),
        (lambda f, a: bf.edit(a["photo"], a["mask"][:9]), "picture's height and width"),
        (lambda f, a: bf.edit(a["photo"], a["mask"] * 0), "16 pixels or more"),
        (lambda f, a: bf.edit(a["photo"], a["mask"].astype(float)), "divide it by 255"),
        (lambda f, a: bf.edit(a["photo"], regions=a["mask"] / 2.0), "whole numbers"),
        (lambda f, a: bf.edit(f / "no.png"), "no such file"),
        (lambda f, a: bf.decompose(a["photo"], a["mask"], detail=2), "from 0 to 1"),
        (lambda f, a: bf.edit(a["photo"], a["mask"], brightness=4, refine=False), "from -3 to 3"),
        (lambda f, a: bf.decompose(a["photo"], a["mask"], exposure=-1), "above 0"),
        (lambda f, a: bf.decompose(a["photo"], a["mask"], shape="cone"), "found cone"),
        (lambda f, a: bf.decompose(a["photo"], a["mask"], white_balance="gray"), "found gray"),
        (lambda f, a: bf.decompose(a["photo"], a["mask"], white_balance=(1, 1)), "three factors"),
        (lambda f, a: bf.decompose(a["photo"], a["mask"], white_balance=(0, 1, 1)), "from 0.01"),
        (lambda f, a: bf.decompose(a["photo"], a["mask"], white_balance=None), "found None"),
        (lambda f, a: bf.decompose(a["photo"], a["mask"], device="gpu"), "auto, cpu or cuda"),
        (
            lambda f, a: bf.decompose(a["photo"], a["mask"], refinement_method="quadratur"),
            "one of auto, quadrature, found 'quadratur'",
        ),
        (
            lambda f, a: bf.edit(a["photo"], a["mask"], refine=False, refinement_method="auto"),
            "nothing is refined",
        ),
        (lambda f, a: bf.material(np.full(108, 90.0)), "natural logarithms"),
        (lambda f, a: bf.light("city", rotation_deg=float("nan")), "a number of degrees"),
        (lambda f, a: bf.light(f / "no.exr"), "no such file"),
        (lambda f, a: bf.render(np.ones((4, 4)), bf.light("city")), "height, width, 3"),
        (lambda f, a: bf.render(np.ones((4, 4, 3)), bf.light("city")), "unit"),
        (lambda f, a: bf.load_job("demos"), "did you mean demo"),
        (lambda f, a: bf.load_job({"shapes": 3}), "expected array"),
        (lambda f, a: bf.load_job({"shapes": {3}, "seed": print}), "builtin_function_or_method"),
        (lambda f, a: bf.generate("smallest", f / "data", workers=0), "1 or more"),
        (lambda f, a: bf.generate("smallest", f / "data", limit=-1), "0 or more"),
    ],
)
def test_mistakes_are_told_in_one_line(pictures, call, words):
    with pytest.raises(bf.InputError, match=words) as caught:
        call(*pictures)
    assert "\n" not in str(caught.value)


def test_mistakes_with_a_decomposition(parts, tmp_path):
    with pytest.raises(bf.InputError, match="expected one material, found 2"):
        parts.paint("brass", "red-fabric")
    with pytest.raises(bf.InputError, match=r"\(64, 128, 3\)"):
        parts.relight(np.ones((4, 8, 3)))
    for value in (np.nan, -1.0):
        with pytest.raises(bf.InputError, match="finite and not negative"):
            parts.relight(np.full((64, 128, 3), value))
    with pytest.raises(bf.InputError, match=r"\.png or \.exr, found \.gif"):
        parts.paint("brass").save(tmp_path / "x.gif")
    with pytest.raises(bf.InputError, match="a blend of 2"):
        _ = bf.blend("brass", "red-fabric").label


def test_mirrored_arrays_are_rendered():
    """They run backwards in memory, which torch does not read."""
    slope = np.linspace(-0.6, 0.6, 8)[None].repeat(8, 0)
    n = np.stack([slope, 0 * slope, np.sqrt(1 - slope**2)], -1).astype(np.float32)
    light = bf.light("city")
    for normals, L in ((n[:, ::-1], light), (n, light[::-1, ::-1]), (n[::-1], light[..., ::-1])):
        picture = bf.render(normals, L, "brass")
        np.testing.assert_array_equal(picture, bf.render(normals.copy(), L.copy(), "brass"))


def test_a_job_may_have_paths_and_numbers_of_numpy(tmp_path):
    job = {"shapes": [tmp_path / "a.obj"], "materials": ["brass"], "lights": ["city"]}
    loaded = bf.load_job(job | {"samples": np.int64(4), "views": np.arange(3)})
    assert loaded.shapes == (str(tmp_path / "a.obj"),)
    assert (loaded.samples, loaded.views) == (4, (0, 1, 2))


def test_importing_the_package_loads_nothing_heavy_and_lists_its_names():
    code = (
        "import sys, brdfactory as bf\n"
        "assert not {'numpy', 'torch', 'bpy', 'learn', 'factory'} & set(sys.modules)\n"
        "assert set(bf.__all__) <= set(dir(bf)) and 'edit' in dir(bf)\n"
        "try: bf.no_such_name\n"
        "except AttributeError: pass\n"
        "else: raise SystemExit('a name that is not there was found')\n"
        "for name in bf.__all__: getattr(bf, name)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.blender
def test_a_job_is_rendered_and_continued(tmp_path):
    job = {
        "name": "one",
        "shapes": ["sphere"],
        "materials": ["green-latex"],
        "lights": ["city"],
        "views": [0, 6],
        "tiers": ["direct"],
        "samples": 4,
        "camera": {"size": [24, 24]},
    }
    assert bf.generate(job, tmp_path, limit=1, progress=False)["made"] == 1
    assert bf.generate(job, tmp_path, progress=False) == {
        "made": 1,
        "already_there": 1,
        "failed": 0,
    }
    assert len(bf.Records(tmp_path)) == 2


def test_weights_that_were_trained_again_are_read_again(pictures, tmp_path, monkeypatch):
    from brdfactory import editing

    folder, _ = pictures
    read = []
    monkeypatch.setattr(
        editing.checkpoint, "load_full_network", lambda *given: (read.append(given), {"size": 64})
    )
    monkeypatch.setattr(editing.decomposing, "decompose", lambda *given, shape: given)
    monkeypatch.setattr(editing, "Decomposition", lambda *given: given)
    weights = tmp_path / "weights.safetensors"
    for modified, count in ((1, 1), (1, 1), (2, 2)):
        weights.write_bytes(b"")
        os.utime(weights, ns=(modified, modified))
        bf.decompose(folder / "photo.png", folder / "mask.png", refine=False, weights=weights)
        assert len(read) == count


WITHOUT = """
import sys
sys.modules["torch"] = None  # as if it were not installed
"""


def test_a_missing_extra_is_one_line_with_the_remedy_in_python_and_on_the_command_line(tmp_path):
    script = WITHOUT + "import brdfactory as bf\nbf.edit"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.strip().splitlines()[-1] == (
        "ImportError: brdfactory.edit needs torch: expected a package of the extra learn, found"
        " that it is not installed (pip install 'brdfactory[learn]', or '.[learn]' in a checkout)"
    )
    words = ["brdfactory", "edit", "photo.png", "--material", "brass", "--out", str(tmp_path)]
    script = WITHOUT + f"sys.argv = {words}\nfrom brdfactory.__main__ import main\nsys.exit(main())"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 1 and len(done.stderr.strip().splitlines()) == 1
    assert "torch: expected a package of the extra learn" in done.stderr


def test_a_module_that_no_extra_brings_is_an_error_of_the_program():
    assert missing_package(ModuleNotFoundError("no module", name="nothing.at.all")) is None
    assert missing_package(ModuleNotFoundError("no module", name="bpy")).where == "bpy"
