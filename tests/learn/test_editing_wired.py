"""The commands pass on their options, masks, refinement and truths.

Each test fails if one of them is dropped on the way.
"""

import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from learn.__main__ import COMMANDS
from learn.data.records import Records
from learn.editing import decomposition
from learn.figures import montage
from learn.layer import predictions
from learn.refinement import refine
from manifests import exr
from manifests.cli import main
from manifests.materials import load_catalogue
from shaders import tone
from tests.support.synthetic import entry, write_dataset


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """The sum for mirrors too, and the first steps of refinement alone: nothing here looks at how
    well they are done.
    """
    monkeypatch.setattr(predictions, "method_for", lambda label: "auto")
    monkeypatch.setattr(
        decomposition,
        "refine",
        lambda batch, start, settings, labels, watch=None: refine(
            batch, start, replace(settings, outer_iterations=1, levels=settings.levels[:1]), labels
        ),
    )


@pytest.fixture
def photo(tmp_path):
    """A shaded disc before a slope, and its mask's two halves."""
    y, x = np.mgrid[-1:1:40j, -1:1:40j]
    inside = x * x + y * y < 0.7
    shade = np.where(
        inside, 90 + 80 * np.sqrt(np.clip(0.7 - x * x - y * y, 0, 1)) - 60 * y, 30 + 20 * x
    )
    Image.fromarray(
        np.clip(np.dstack([shade, 0.8 * shade, 0.6 * shade]), 0, 255).astype(np.uint8)
    ).save(tmp_path / "photo.png")
    for name, mask in (("mask", inside), ("left", inside & (x < 0)), ("right", inside & (x >= 0))):
        Image.fromarray(255 * mask.astype(np.uint8)).save(tmp_path / f"{name}.png")
    return tmp_path


def done(*words):
    assert main("learn", "t", COMMANDS, [str(word) for word in words]) == 0


def edited(photo, name, *more, masks=("mask",), material="red-fabric"):
    """(picture, edit.json) of an edit."""
    given = [word for mask in masks for word in ("--mask", photo / f"{mask}.png")]
    done("edit", photo / "photo.png", *given, "--material", material, "--out", photo / name, *more)
    return np.asarray(Image.open(photo / name / "edited.png").convert("RGB"), float), json.loads(
        (photo / name / "edit.json").read_text()
    )


@pytest.fixture
def drawn(monkeypatch):
    """{caption: [display pictures]} of every sheet's tiles since."""
    result, contact_sheet = {}, montage.contact_sheet

    def kept(lines, size):
        for caption, picture in (pair for line in lines for pair in line):
            result.setdefault(caption, []).append(picture)
        return contact_sheet(lines, size)

    monkeypatch.setattr(montage, "contact_sheet", kept)
    return result


def test_an_edit_is_refined_unless_it_is_not_to_be(photo):
    refined, report = edited(photo, "refined")
    plain, not_refined = edited(photo, "plain", "--no-refine")
    assert report["refined"]["after"]["total"] < 0.9 * report["refined"]["before"]["total"]
    assert report["refinement"]["a"] == 0.05
    assert not_refined["refined"] is None and not_refined["refinement"] is None
    assert abs(refined - plain).mean() > 0.5


def test_exposure_and_white_balance_reach_the_network(photo):
    plain, report = edited(photo, "plain", "--no-refine")
    for name, words, key, expected in (
        ("bright", ("--exposure", 3 * report["exposure"]), "exposure", 3 * report["exposure"]),
        (
            "balanced",
            ("--white-balance", "1,1,2"),
            "white_balance",
            list(np.array([1, 1, 2]) / (1 + 0.0722)),
        ),
    ):
        other, also = edited(photo, name, "--no-refine", *words)
        np.testing.assert_allclose(also[key], expected, rtol=1e-5)
        assert abs(other - plain).mean() > 0.5


def test_brightness_reaches_the_edit(photo):
    plain, _ = edited(photo, "plain", "--no-refine")
    darker, report = edited(photo, "darker", "--no-refine", "--brightness", "-1.5")
    assert report["brightness_stops"] == -1.5
    assert darker[20, 20].mean() < plain[20, 20].mean() - 10
    np.testing.assert_array_equal(darker[0, 0], plain[0, 0])


def test_every_mask_is_a_region_with_its_own_material(photo):
    both, report = edited(
        photo, "both", "--no-refine", masks=("left", "right"), material="gold-paint+keep"
    )
    assert report["regions"] == 2
    before = np.asarray(Image.open(photo / "photo.png"), float)
    right = np.asarray(Image.open(photo / "right.png")) > 0
    left = np.asarray(Image.open(photo / "left.png")) > 0
    assert abs(both - before)[right][:, 0].max() <= 1 < 5 < abs(both - before)[left].mean()


def test_an_edit_of_a_record_is_compared_with_its_truth_over_the_object_and_shown_beside_it(
    tmp_path, rng, drawn
):
    catalogue = load_catalogue()
    materials = [
        entry(name, catalogue[name].m.reshape(3, 3, 2, 6), catalogue[name].mixture)
        for name in ("red-fabric", "delrin")
    ]
    write_dataset(tmp_path / "data", materials, rng, size=32, seeds=1, rotations=(0,))
    records = Records(tmp_path / "data")
    by = {r.materials: r for r in records.records}
    out = tmp_path / "out"
    done(
        "edit",
        tmp_path / "data",
        "--record",
        by["red-fabric",].id,
        "--material",
        "delrin",
        "--no-refine",
        "--out",
        out,
    )
    report = json.loads((out / "edit.json").read_text())["display_l2"]["delrin"]
    channels, true = exr.read(out / "edited.exr"), records.image(by["delrin",])
    picture, mask = (
        np.stack([channels[c] for c in "RGB"], -1),
        records.geometry(by["delrin",])[2] > 0,
    )
    level = tone.auto_exposure(true, mask)
    assert report["mask"] == pytest.approx(tone.display_l2(picture, true, level, mask), rel=1e-4)
    assert report["frame"] == pytest.approx(tone.display_l2(picture, true, level), rel=1e-4)
    # the background, the same in both, is part of the frame
    assert report["frame"] < 0.95 * report["mask"]
    np.testing.assert_allclose(drawn["truth"][0][mask], tone.display(true, level)[mask])
    np.testing.assert_allclose(
        drawn["|difference|"][0],
        abs(tone.display(picture, level) - tone.display(true, level)),
        atol=0.1,
    )


def test_materials_given_one_by_one_are_all_made(photo):
    words = [
        "edit",
        photo / "photo.png",
        "--mask",
        photo / "mask.png",
        "--no-refine",
        "--out",
        photo / "many",
    ]
    done(*words, "--material", "brass", "red-fabric", "--material", "blue-rubber")
    assert json.loads((photo / "many" / "edit.json").read_text())["materials"] == [
        "brass",
        "red-fabric",
        "blue-rubber",
    ]


def test_files_of_one_name_make_pictures_of_their_own_and_a_plus_may_be_part_of_a_name(photo):
    label = {"label": [float(x) for x in load_catalogue()["brass"].label.reshape(-1)]}
    for folder in ("c++", "b"):
        (photo / folder).mkdir()
        (photo / folder / "material.json").write_text(json.dumps(label))
    words = [
        "edit",
        photo / "photo.png",
        "--mask",
        photo / "mask.png",
        "--no-refine",
        "--out",
        photo / "two",
    ]
    done(*words, "--material", photo / "c++" / "material.json", photo / "b" / "material.json")
    pictures = [np.asarray(Image.open(photo / "two" / f"edited-material-{k}.png")) for k in (1, 2)]
    np.testing.assert_array_equal(*pictures)


def test_a_transparent_photograph_stays_so_under_a_mask_and_on_the_sheet(photo, drawn):
    picture, alpha = np.asarray(Image.open(photo / "photo.png")), np.full((40, 40), 255, np.uint8)
    alpha[:, :6] = 0
    Image.fromarray(np.dstack([picture, alpha])).save(photo / "half.png")
    words = [
        "edit",
        photo / "half.png",
        "--mask",
        photo / "mask.png",
        "--material",
        "brass",
        "--no-refine",
        "--out",
        photo / "half",
    ]
    done(*words)
    np.testing.assert_array_equal(
        np.asarray(Image.open(photo / "half" / "edited.png"))[..., 3], alpha
    )
    for caption in ("photograph", "rendered again", "brass"):
        np.testing.assert_allclose(drawn[caption][0][:, :6], montage.GROUND)


def test_every_ball_is_called_by_its_own_material(photo, drawn):
    edited(photo, "both", "--no-refine", masks=("left", "right"), material="gold-paint+red-fabric")
    assert {"gold-paint+red-fabric", "gold-paint", "red-fabric", "material 1", "material 2"} <= set(
        drawn
    )
    assert abs(drawn["gold-paint"][0] - drawn["red-fabric"][0]).mean() > 5


@pytest.mark.parametrize("name", ["a-in-b.png", "grid.png", "transfer.json"])
def test_a_transfer_overwrites_nothing_unless_asked(photo, name, capsys):
    words = cut_outs(photo)
    (photo / "swap").mkdir()
    (photo / "swap" / name).write_text("mine")
    assert main("learn", "t", COMMANDS, words) == 1
    assert (
        "--overwrite" in capsys.readouterr().err and (photo / "swap" / name).read_text() == "mine"
    )


def test_pictures_of_an_earlier_edit_go_with_overwrite_and_a_users_own_stay(photo, capsys):
    out = photo / "out"
    words = ("edit", photo / "photo.png", "--mask", photo / "mask.png", "--no-refine", "--out", out)
    white, grey, black = (f"lambert(#{level * 6})" for level in "f83")
    done(*words, "--material", white, grey, black)
    (out / "edited-mine.png").write_text("mine")
    (out / "edited-lambert-333333.png").write_text("retouched")
    capsys.readouterr()
    done(*words, "--material", grey, "--overwrite")
    kept = {"edited.png", "edited-mine.png", "edited-lambert-333333.png"}
    assert {path.name for path in out.glob("edited*")} == kept
    line = f"{out}: edited-lambert-333333.png stayed beside the new results"
    assert line in capsys.readouterr().err
    assert (out / "edited-lambert-333333.png").read_text() == "retouched"
    # a picture that is read is not removed
    again = ("edit", out / "edited.png", "--mask", photo / "mask.png", "--no-refine", "--out", out)
    done(*again, "--material", white, black, "--overwrite")
    assert {"edited.png", "edited-lambert-ffffff.png"} <= {path.name for path in out.iterdir()}


def test_a_material_file_of_one_region_is_not_written_over(photo, capsys):
    out = photo / "out"
    words = ("edit", photo / "photo.png", "--mask", photo / "mask.png", "--no-refine")
    done(*words, "--material", "lambert(#ffffff)", "--out", out)
    before = (out / "material.json").read_bytes()
    masks = ("--mask", photo / "left.png", "--mask", photo / "right.png")
    words = ("edit", photo / "photo.png", *masks, "--material", f"keep+{out / 'material.json'}")
    words = [*map(str, words), "--out", str(out), "--overwrite"]
    assert main("learn", "t", COMMANDS, words) == 1
    assert "found this input" in capsys.readouterr().err
    assert (out / "material.json").read_bytes() == before


def test_pictures_of_an_earlier_transfer_go_with_overwrite(photo, capsys):
    words = [*cut_outs(photo), "--light", "computed:1"]
    done(*words)
    (photo / "swap" / "me-in-rome.png").write_text("mine")
    done(*cut_outs(photo), "--overwrite")
    own = {"a-in-b.png", "b-in-a.png", "grid.png", "transfer.json"}
    assert {path.name for path in (photo / "swap").iterdir()} == own | {"me-in-rome.png"}
    assert "stayed" not in capsys.readouterr().err


def cut_outs(photo):
    """Arguments of a transfer between the photograph and a dark one of the same shape."""
    picture, mask = (
        np.asarray(Image.open(photo / "photo.png")),
        np.asarray(Image.open(photo / "mask.png")),
    )
    for name, factor in (("a", 1.0), ("b", 0.3)):
        Image.fromarray(np.dstack([(picture * factor).astype(np.uint8), mask])).save(
            photo / f"{name}.png"
        )
    return [
        str(word)
        for word in (
            "transfer",
            photo / "a.png",
            photo / "b.png",
            "--no-refine",
            "--out",
            photo / "swap",
        )
    ]


def test_a_grid_shows_the_edits_it_is_of(photo, drawn):
    done(*cut_outs(photo))
    # "": the empty corner, the diagonal's picture, a in b's material, …
    own, (_, same, in_other, *_) = drawn["a"][1], drawn[""]
    np.testing.assert_array_equal(own, same)
    written = np.asarray(Image.open(photo / "swap" / "a-in-b.png").convert("RGB"), float)
    from_written, from_own = (
        abs(middle(in_other) - middle(picture)).mean() for picture in (written, own)
    )
    assert from_written < 10 and 3 * from_written < from_own


def middle(picture):
    """Eight pixels square: a grid's tile is the object's own square, a written picture has the
    photograph's size.
    """
    H, W = picture.shape[:2]
    return picture[H // 2 - 4 : H // 2 + 4, W // 2 - 4 : W // 2 + 4]


@pytest.mark.parametrize("command", ["edit", "predict", "transfer", "app"])
@pytest.mark.parametrize(
    "variable, before, after",
    [
        ("OMP_WAIT_POLICY", None, "passive"),
        ("OMP_WAIT_POLICY", "active", "active"),
        ("OPENBLAS_NUM_THREADS", None, "1"),
        ("OPENBLAS_NUM_THREADS", "2", "2"),
    ],
)
def test_threads_that_wait_sleep_unless_the_user_says_otherwise(
    command, variable, before, after, monkeypatch, tmp_path
):
    monkeypatch.setenv(variable, before or "")
    if before is None:
        monkeypatch.delenv(variable)
    words = {
        "edit": ["none.png", "--material", "brass"],
        "predict": ["none.png"],
        "transfer": ["none.png", "none2.png"],
        "app": ["--port", "0"],
    }[command]
    out = [] if command == "app" else ["--out", str(tmp_path / "out")]
    assert main("learn", "", COMMANDS, [command, *words, *out]) in (1, 2)
    assert os.environ[variable] == after


# prints how many threads the process has once a command has run and scipy is loaded
COUNT_THREADS = """
import os
from learn.__main__ import COMMANDS, main, prepare

main("learn", "", COMMANDS, ["edit", "none.png", "--material", "brass", "--out", "x"],
     prepare=prepare)
import scipy.optimize

print(len(os.listdir("/proc/self/task")))
"""


@pytest.mark.skipif(
    sys.platform != "linux" or (os.cpu_count() or 1) < 2, reason="counts a second core's threads"
)
def test_openblas_starts_no_threads_in_commands(tmp_path):
    """It reads the variable when numpy is loaded, which no command may have done before."""

    def count(variables):
        others = {k: v for k, v in os.environ.items() if k != "OPENBLAS_NUM_THREADS"}
        done = subprocess.run(
            [sys.executable, "-c", COUNT_THREADS],
            capture_output=True,
            text=True,
            check=True,
            cwd=tmp_path,
            env=others | {"PYTHONPATH": os.pathsep.join(sys.path)} | variables,
        )
        return int(done.stdout.split()[-1])

    assert count({}) == count({"OPENBLAS_NUM_THREADS": "1"}) < count({"OPENBLAS_NUM_THREADS": "2"})
