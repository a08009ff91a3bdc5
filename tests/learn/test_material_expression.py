"""Materials written as text: what they mean, what is refused and how, and an edit into one."""

import json

import numpy as np
import pytest
from PIL import Image

from learn.__main__ import COMMANDS
from learn.editing import edit, material_expression, targets
from learn.editing.material_expression import parse_expression
from manifests.cli import main
from manifests.errors import InputError
from shaders import principled_fit
from shaders.principled import PrincipledMaterial, ggx, lambert


@pytest.mark.parametrize(
    ("text", "material"),
    [
        ("principled()", PrincipledMaterial()),
        (
            "principled(base_color=#ff0000, roughness=.35, metallic=0)",
            PrincipledMaterial((1.0, 0.0, 0.0), roughness=0.35, metallic=0.0),
        ),
        (
            " principled( 0.25 ,coat = 1,coat_roughness=1e-1 ) ",
            PrincipledMaterial((0.25,) * 3, coat=1.0, coat_roughness=0.1),
        ),
        ("lambert(#fff)", lambert((1.0, 1.0, 1.0))),
        ("lambert(color=.5)", lambert((0.5, 0.5, 0.5))),
        ("ggx(f0=.9, roughness=.2)", ggx(0.9, 0.2)),
        ("ggx(#FFFFFF, roughness=+.2)", ggx(1.0, 0.2)),
    ],
)
def test_an_expression_is_the_material_it_says(text, material):
    assert parse_expression(text) == material


def test_colours_are_srgb():
    # IEC 61966-2-1: 0x80 is .2159 of white, 0xc0 .5271
    np.testing.assert_allclose(
        parse_expression("lambert(#80c000)").base_color, [0.2159, 0.5271, 0], atol=1e-4
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("principle(roughness=.3)", "did you mean principled"),
        ("__import__(os)", "lambert"),
        ("principled(roughness=.3", "parentheses"),
        ("principled(roughness=(.3))", "parentheses"),
        ("principled(roughness=.3) gold", "parentheses"),
        ("principled(rough=.3)", "did you mean roughness"),
        ("principled(.3, .2)", "which has no key"),
        ("principled(roughness=.3,)", "which has no key"),
        ("principled(roughness=.3, roughness=.4)", "roughness twice"),
        ("principled(roughness=red)", "roughness as a number, found 'red'"),
        ("principled(roughness=#333)", "roughness as a number"),
        ("principled(roughness=nan)", "roughness as a number"),
        ("principled(roughness=٣)", "roughness as a number"),
        ("principled(roughness=)", "roughness as a number, found ''"),
        ("principled(roughness=1e999)", "inf"),
        ("principled(roughness=3)", "number in \\[0, 1\\] expected, found 3"),
        ("principled(base_color=#12345)", "base_color as #rrggbb or a number"),
        ("lambert()", "a value of color, found none"),
        ("ggx(f0=.9)", "a value of roughness, found none"),
        ("ggx(roughness=.9)", "a value of f0, found none"),
        ("principled(roughness=" + "1" * 300 + ")", "at most 240 characters"),
    ],
)
def test_what_is_no_material_is_refused_in_one_line_with_the_usage(text, words):
    with pytest.raises(InputError, match=words) as raised:
        targets.resolve_labels(text, None)
    assert "\n" not in str(raised.value) and len(str(raised.value)) < 500
    if not text.startswith(("principle(", "__")):
        assert "as in: " in str(raised.value)


def test_a_plus_within_parentheses_is_none_between_regions():
    assert targets.split_by_region("ggx(.9, roughness=2e+0)+keep") == [
        "ggx(.9, roughness=2e+0)",
        "keep",
    ]
    assert targets.split_by_region("a+b+c") == ["a", "b", "c"]


def test_files_that_look_like_expressions_are_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lambert(1)").write_bytes(b"")
    seen = []
    targets.resolve_labels("lambert(1)", lambda path: seen.append(path.name))
    targets.resolve_labels("photo(1).png", lambda path: seen.append(path.name))
    assert seen == ["lambert(1)", "photo(1).png"]


def test_names_of_files_are_short_and_tell_expressions_from_each_other():
    text = "principled(base_color=#a03020, roughness=.35, metallic=0)"
    assert targets.file_name(text) == "principled-base_color-a03020-roughness-35-metallic-0"
    assert len(targets.file_name("principled(" + "1" * 5000 + ")")) < 100
    assert targets.caption_of(text) == text


def test_a_label_is_fitted_once(monkeypatch):
    material_expression.fit_expression.cache_clear()
    count = []
    fit = principled_fit.fit
    monkeypatch.setattr(principled_fit, "fit", lambda m: count.append(m) or fit(m))
    both = edit.labels_by_region("lambert(#abc)+keep", 2, None)
    targets.fit_errors(["lambert(#abc)+keep"])
    assert len(count) == 1 and both[0].shape == (108,) and both[1] is None


def test_an_edit_into_an_expression_states_the_error_of_its_label(tmp_path, capsys):
    y, x = np.mgrid[-1:1:40j, -1:1:40j]
    inside = x * x + y * y < 0.7
    shade = np.where(inside, 90 + 80 * np.sqrt(np.clip(0.7 - x * x - y * y, 0, 1)) - 60 * y, 30)
    rgba = np.dstack([shade, shade, shade, 255.0 * inside]).astype(np.uint8)
    Image.fromarray(rgba).save(tmp_path / "photo.png")
    words = ["edit", str(tmp_path / "photo.png"), "--no-refine", "--material"]
    red, grey = "principled(base_color=#ff0000, roughness=.6)", "lambert(#c0c0c0)"
    assert main("learn", "t", COMMANDS, [*words, red, grey, "--out", str(tmp_path / "out")]) == 0
    report = json.loads((tmp_path / "out/edit.json").read_text())
    assert report["materials"] == [red, grey]
    errors = report["fit_relative_l1"]
    assert set(errors) == {red, grey} and 0 < errors[grey] < 0.01 and 0 < errors[red] < 0.1
    name = "edited-principled-base_color-ff0000-roughness-6.png"
    picture = np.asarray(Image.open(tmp_path / "out" / name), float)[inside]
    assert picture[:, 0].mean() > 2 * picture[:, 1].mean()
    wrong = main("learn", "t", COMMANDS, [*words, "ggx(f0=.9)", "--out", str(tmp_path / "no")])
    assert wrong == 1 and "ggx(f0=.9, roughness=.2)" in capsys.readouterr().err
