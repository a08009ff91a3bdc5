"""Scenes of objects in furnished rooms: what is rendered of them, and which are refused."""

import dataclasses
import json

import numpy as np
import pytest
from PIL import Image

from manifests import exr

pytest.importorskip("bpy", reason="needs Blender as a module (pip install .[factory])")

from factory.lights import interiors
from factory.render.validation import objects_in_rooms, room_plans


def test_frames_differ_on_the_object_and_hardly_elsewhere(tmp_path):
    plan = room_plans.draw_plan(1, 0, 41, [])
    assert objects_in_rooms.rendered(plan, tmp_path / "a", size=32, samples=16)
    scene = json.loads((tmp_path / "a" / "scene.json").read_text())
    assert scene["shape"] == "dish:0" and tuple(scene["materials"]) == plan.materials
    assert scene["surroundings"] == "plain" and (scene["samples"], scene["size"]) == (16, 32)
    with Image.open(tmp_path / "a" / "mask.png") as picture:
        mask = np.array(picture) > 127
    row, column = np.nonzero(mask)
    assert mask.mean() > 0.05 and abs(row - 15.5).mean() < 12 and abs(column.mean() - 15.5) < 4
    one, other = (
        np.stack([exr.read(tmp_path / "a" / f"{name}.exr")[c] for c in "RGB"], -1)
        for name in plan.materials[:2]
    )
    change = abs(one - other).mean(-1) / (one + other).mean(-1)
    assert change[mask].mean() > 4 * change[~mask].mean()
    # a scene of before coverage was written gets the same
    before = coverage_is_that_of_the_pictures(tmp_path / "a", mask)
    (tmp_path / "a" / "coverage.png").unlink()
    objects_in_rooms.add_coverage([dataclasses.replace(plan, place=1), plan], tmp_path / "a")
    after = coverage_is_that_of_the_pictures(tmp_path / "a", mask)
    assert abs(after - before).max() < 0.1  # samples are others


def coverage_is_that_of_the_pictures(folder, mask):
    """Assert that coverage.png is like the mask, and soft; return it (N, N) in [0, 1]."""
    with Image.open(folder / "coverage.png") as picture:
        coverage = np.array(picture) / 255
    assert coverage.shape == mask.shape
    assert ((coverage > 0.5) != mask).sum() <= 0.05 * mask.sum()
    assert ((coverage > 0.1) & (coverage < 0.9)).sum() > 10  # soft along the edge
    return coverage


def test_a_wall_before_the_object_leaves_no_view(tmp_path, monkeypatch):
    plan = room_plans.draw_plan(0, 0, 41, [])
    shut = [
        interiors.Box((a, -5, -5), (a + 0.1, 5, 5), interiors.Material((0.5, 0.5, 0.5)))
        for a in (0.4, -0.5)
    ]
    shut += [
        interiors.Box((-5, a, -5), (5, a + 0.1, 5), interiors.Material((0.5, 0.5, 0.5)))
        for a in (0.4, -0.5)
    ]
    empty = interiors.draw(plan.place)
    walled = interiors.Scene(empty.sky, (empty.boxes[0], *shut))
    monkeypatch.setattr(interiors, "draw", lambda seed: walled)
    assert not objects_in_rooms.rendered(plan, tmp_path / "a", size=16, samples=1)
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(
    ("options", "look"),
    [((), ("plain", 48)), (("--surroundings", "varied", "--samples", "16"), ("varied", 16))],
)
def test_a_scene_without_a_free_view_is_named_and_the_others_are_rendered(
    tmp_path, monkeypatch, capsys, options, look
):
    places, looks = [], []

    def rendered(plan, folder, size, samples):
        places.append(folder.name)
        looks.append((plan.surroundings, samples))
        return folder.name != "0001"

    monkeypatch.setattr(objects_in_rooms, "rendered", rendered)
    monkeypatch.setattr(
        "sys.argv", ["rooms", "--scenes", "3", *options, "--out", str(tmp_path / "out")]
    )
    objects_in_rooms.main()
    assert places == ["0000", *["0001"] * objects_in_rooms.PLACES, "0002"]
    assert set(looks) == {look}
    (line,) = [each for each in capsys.readouterr().err.splitlines() if "left out" in each]
    assert str(tmp_path / "out" / "0001") in line


@pytest.mark.parametrize(
    ("options", "wrong"),
    [
        (("--surroundings", "varied"), "surroundings varied, found plain"),
        (("--seed", "42"), "materials"),
        (("--samples", "16"), "samples 16, found 48"),
        (("--size", "96"), "size 96, found 192"),
        ((), None),
    ],
)
def test_a_folder_of_other_options_is_refused(tmp_path, monkeypatch, capsys, options, wrong):
    plan = room_plans.draw_plan(0, 3, 41, [])
    scene = {"shape": plan.shape, "materials": plan.materials, "seed": plan.place}
    scene |= {"samples": 48, "size": 192}
    (tmp_path / "0000").mkdir()
    (tmp_path / "0000" / "scene.json").write_text(json.dumps(scene))
    monkeypatch.setattr(objects_in_rooms, "rendered", lambda *_: pytest.fail("rendered"))
    added = []
    monkeypatch.setattr(objects_in_rooms, "add_coverage", lambda _, folder: added.append(folder))
    monkeypatch.setattr("sys.argv", ["rooms", "--scenes", "1", *options, "--out", str(tmp_path)])
    if wrong is None:
        objects_in_rooms.main()
        assert added == [tmp_path / "0000"]
        (tmp_path / "0000" / "coverage.png").write_text("")
        objects_in_rooms.main()
        assert len(added) == 1
        return
    with pytest.raises(SystemExit, match="2"):
        objects_in_rooms.main()
    assert wrong in capsys.readouterr().err.splitlines()[-1]


def test_a_place_that_cannot_be_written_is_a_wrong_option(tmp_path, monkeypatch, capsys):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr("sys.argv", ["rooms", "--out", str(tmp_path / "file" / "new")])
    with pytest.raises(SystemExit, match="2"):
        objects_in_rooms.main()
    assert "found a file (check the path)" in capsys.readouterr().err.splitlines()[-1]
