"""The experiment relighting: what it compares with what, on a small data set that is made here."""

from types import SimpleNamespace

import pytest
import torch

from learn.data.records import Records
from learn.experiments.editing import ladder_scenes, relighting
from learn.networks.prediction import Prediction
from manifests.errors import InputError
from tests.support import ladder_rungs
from tests.support.ladder_rungs import TURNS

SIZE = 32


@pytest.fixture(scope="module")
def records(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    ladder_rungs.written(folder, SIZE)
    return Records(folder)


@pytest.fixture(scope="module")
def pictures(records):
    return ladder_scenes.pictures_of(records)


def keys(lights=TURNS):
    """Keys of three shapes in two materials under several lights."""
    return sorted(
        ladder_scenes.Key(shape, 3, ("sky", turn), material)
        for shape in ("car:1", "car:2", "dish:0")
        for turn in lights
        for material in ("bright", "dark")
    )


def test_both_rungs_have_every_shape_light_and_material(pictures):
    assert tuple(pictures) == ladder_scenes.RUNGS
    assert set(pictures["direct"]) == set(pictures["8-bit"]) and len(pictures["direct"]) == 12
    for rung, pixel in zip(ladder_scenes.RUNGS, ("centre", "square"), strict=True):
        assert {record.camera.pixel for record in pictures[rung].values()} == {pixel}


def test_the_given_light_is_in_no_input_and_the_other_object_differs_in_everything():
    available = keys()
    cases = relighting.cases_of(available, 99, 0, "data")
    assert [case.task for case in cases] == ["relighting"] * 18 + ["transfer"] * 18
    for case in cases:
        assert case.truth in available
        assert case.truth.light not in (case.object.light, case.material.light)
        assert case.truth.material == case.material.material
        assert case.truth.shape == case.object.shape
        if case.task == "relighting":
            assert case.object == case.material
        else:
            pairs = zip(case.object, case.material, strict=True)
            assert [a == b for a, b in pairs] == [False, True, False, False]
    few = relighting.cases_of(available, 4, 0, "data")
    assert few == cases[:4] + cases[18:22] and len({case.material.shape for case in few[:3]}) == 3
    assert few != relighting.cases_of(available, 4, 1, "data")


def test_too_few_lights_and_other_data_sets_are_refused(tmp_path):
    with pytest.raises(InputError, match="transfer: two shapes, each in two materials under three"):
        relighting.cases_of(keys(TURNS[:2]), 1, 0, "data")
    with pytest.raises(InputError, match="pictures of the rungs direct and 8-bit"):
        ladder_scenes.pictures_of(SimpleNamespace(records=[], folder=tmp_path))


@pytest.mark.parametrize("rung", ladder_scenes.RUNGS)
def test_true_parts_give_the_truth_of_both_tasks(records, pictures, rung):
    """A network that knows the truth of its picture: each part must come from the right one."""

    def knowing(batch):
        return Prediction(batch.n, None, batch.label, None, batch.light)

    mean = torch.from_numpy(records.label("dark"))[None]
    bench = relighting.Bench(records, pictures, knowing, SIZE, mean)
    available = sorted(pictures[rung])
    for case in relighting.cases_of(available, 2, 0, "data"):
        row = bench.row(case, rung)
        errors = row["l2"]
        assert errors["predicted"] == errors["true"] == errors["normals"] == errors["material"]
        assert errors["true"] < 0.2 * min(errors["unchanged"], errors["facing"])
        assert all(row["one_factor"][key] <= errors[key] + 1e-6 for key in errors)
        assert row["to_light"] != row["from_light"] and row["material"] == case.material.material


def test_edits_are_of_one_view_and_light_and_shapes_take_turns(pictures):
    edits = ladder_scenes.edits_of(pictures, 99, 0)
    assert len(edits) == 6 and len({edit.shape for edit in edits[:2]}) == 2
    for edit in edits:
        for rung in ladder_scenes.RUNGS:
            source, truth = edit.source[rung], edit.truth[rung]
            assert source.materials != truth.materials
            same = ("shape", "viewpoint", "light", "rotation_texels", "tier")
            assert all(getattr(source, key) == getattr(truth, key) for key in same)
    few = ladder_scenes.edits_of(pictures, 3, 0)
    assert [edit.id for edit in few] == [edit.id for edit in edits[:3]]
    only = ladder_scenes.edits_of({"8-bit": pictures["8-bit"]}, 99, 0)
    assert len({edit.id for edit in only}) == 6 and not {e.id for e in only} & {e.id for e in edits}
    given = ladder_scenes.edits_of(pictures, 99, 0, ["dark"])
    assert len(given) == 6
    assert {each.source["direct"].materials for each in given} == {("dark",)}
    assert {each.truth["direct"].materials for each in given} == {("bright",)}
    # where the drawn picture is in one of the materials, the edit is the drawn one
    drawn = {edit.id for edit in edits if edit.source["direct"].materials == ("dark",)}
    assert drawn and drawn <= {each.id for each in given}
    with pytest.raises(InputError, match="one of them one of brass"):
        ladder_scenes.edits_of(pictures, 99, 0, ["brass"])
    one = {rung: {key: of[key] for key in sorted(of)[:1]} for rung, of in pictures.items()}
    with pytest.raises(InputError, match="pictures of a view in two materials on the rungs direct"):
        ladder_scenes.edits_of(one, 1, 0)
