"""What scenes of objects in rooms show: shapes in turn, tables, and things beside the object."""

import dataclasses
import math
from pathlib import Path

import pytest

from factory.lights import interiors
from factory.render.validation import room_plans
from factory.shapes.catalogue import load


def test_shapes_take_turns_and_an_attempt_changes_the_place_alone():
    shapes = [room_plans.draw_plan(k, 0, 1, []).shape.split(":")[0] for k in range(4)]
    assert shapes == ["chair", "dish", "sofa", "knot"]
    files = [Path("a.obj"), Path("b.obj")]
    alone = [room_plans.draw_plan(k, 0, 1, files, only_meshes=True).shape for k in range(3)]
    assert alone == ["a.obj", "b.obj", "a.obj"]
    first, second = (room_plans.draw_plan(3, attempt, 1, []) for attempt in (0, 1))
    assert (first.shape, first.materials) == (second.shape, second.materials)
    assert first.place != second.place and first.azimuths != second.azimuths
    assert first == room_plans.draw_plan(3, 0, 1, [])


def test_the_table_ends_where_the_object_begins_and_stands_on_the_floor():
    plan = room_plans.draw_plan(1, 0, 1, [])
    mesh = load(plan.shape)
    *others, table = room_plans.with_table(plan, mesh).boxes
    assert table.high[2] == pytest.approx(mesh.vertices[:, 2].min() * plan.radius)
    assert table.low[2] == others[0].high[2] < -0.4
    assert tuple(others) == interiors.draw(plan.place).boxes


def test_varied_surroundings_change_surfaces_and_add_things_beside_the_object():
    added = 0
    for number in range(12):
        plain = room_plans.draw_plan(number, 0, 1, [])
        plan = room_plans.draw_plan(number, 0, 1, [], "varied")
        assert plain.surroundings == "plain"
        assert plan == dataclasses.replace(plain, surroundings="varied")
        mesh = load("sphere:3")
        bare, dressed = (room_plans.with_table(each, mesh) for each in (plain, plan))
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
    assert 6 < added <= 12 * room_plans.MOST_BESIDE
