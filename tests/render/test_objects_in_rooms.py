"""Scenes of objects in furnished rooms: what is planned, and what is rendered of it."""

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from manifests import exr

pytest.importorskip("bpy", reason="needs Blender as a module (pip install .[factory])")

from factory.lights import interiors
from factory.render.validation import objects_in_rooms
from factory.shapes.catalogue import load


def test_shapes_take_turns_and_an_attempt_changes_the_place_alone():
    shapes = [objects_in_rooms.planned(k, 0, 1, []).shape.split(":")[0] for k in range(4)]
    assert shapes == ["chair", "dish", "sofa", "knot"]
    files = [Path("a.obj"), Path("b.obj")]
    alone = [objects_in_rooms.planned(k, 0, 1, files, only_meshes=True).shape for k in range(3)]
    assert alone == ["a.obj", "b.obj", "a.obj"]
    first, second = (objects_in_rooms.planned(3, attempt, 1, []) for attempt in (0, 1))
    assert (first.shape, first.materials) == (second.shape, second.materials)
    assert first.place != second.place and first.azimuths != second.azimuths
    assert first == objects_in_rooms.planned(3, 0, 1, [])


def test_the_table_ends_where_the_object_begins_and_stands_on_the_floor():
    plan = objects_in_rooms.planned(1, 0, 1, [])
    mesh = load(plan.shape)
    *others, table = objects_in_rooms.with_table(plan, mesh).boxes
    assert table.high[2] == pytest.approx(mesh.vertices[:, 2].min() * plan.radius)
    assert table.low[2] == others[0].high[2] < -0.4
    assert tuple(others) == interiors.draw(plan.place).boxes


def test_varied_surroundings_change_surfaces_and_add_things_beside_the_object():
    added = 0
    for number in range(12):
        plain = objects_in_rooms.planned(number, 0, 1, [])
        plan = objects_in_rooms.planned(number, 0, 1, [], "varied")
        assert plain.surroundings == "plain"
        assert plan == dataclasses.replace(plain, surroundings="varied")
        mesh = load("sphere:3")
        bare, dressed = (objects_in_rooms.with_table(each, mesh) for each in (plain, plan))
        table = dressed.boxes[-1]
        assert (table.low, table.high) == (bare.boxes[-1].low, bare.boxes[-1].high)
        assert table.material.part == "table"
        assert bare.boxes[:-1] == interiors.draw(plan.place).boxes != dressed.boxes[:-1]
        beside = dressed.furniture[len(bare.furniture) :]
        added += len(beside)
        for thing in beside:
            assert thing.place[2] == pytest.approx(table.high[2])
            assert math.hypot(*thing.place[:2]) > plan.radius + thing.radius
            assert all(abs(thing.place[k]) < table.high[k] for k in (0, 1))
    assert 6 < added <= 12 * objects_in_rooms.MOST_BESIDE


def test_frames_differ_on_the_object_and_hardly_elsewhere(tmp_path):
    plan = objects_in_rooms.planned(1, 0, 41, [])
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
    plan = objects_in_rooms.planned(0, 0, 41, [])
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
    plan = objects_in_rooms.planned(0, 3, 41, [])
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
