"""Whose materials a run learns from: the data set's own, or the built-in ones where the run or an
option asks for them.
"""

import json

import msgspec
import numpy as np
import pytest
import torch

from learn.baselines import priors
from learn.commands.options import TABLE_WEIGHTS
from learn.data import lights, settings, sources
from learn.data.records import Records
from learn.data.settings import Data
from learn.experiments.editing import refinement_initialisations
from learn.networks import weights
from learn.training import loop
from manifests import JOBS, RUNS, reading
from manifests import materials as catalogue
from manifests.cli import main
from manifests.errors import InputError
from manifests.schema import Dataset, MaterialEntry
from manifests.store import Store
from tests.support import synthetic

SIZE = 32
METALS = ("chrome", "nickel", "steel")  # of the training side
BUILT_IN = {"train": 116, "validation": 8, "test": 27}
RUN = {
    "name": "relit",
    "size": SIZE,
    "parts": ["normals"],
    "data": {"sharing": 1},
    "losses": {"normals": 1, "material": 0},
    "schedule": {"steps": 3, "batch": 8, "warm_up": 1},
}


@pytest.fixture(scope="module")
def entries():
    """{name: Entry} of the built-in catalogue."""
    return {
        entry.name: entry
        for path in catalogue.BUILT_IN
        for entry in catalogue.read_catalogue(path).materials
    }


@pytest.fixture
def metals(tmp_path, entries):
    """A data set of three metals, with shapes for training, for validation and for testing."""
    chosen = [entries[name] for name in METALS]
    store = synthetic.write_dataset(
        tmp_path / "data",
        chosen,
        np.random.default_rng(1),
        size=SIZE,
        seeds=1,
        rotations=(0,),
        method="auto",
        category="sphere",
    )
    synthetic.add_sides(store)
    return store


def with_materials(folder, entries):
    """The Records of a data set that holds these materials and nothing else."""
    known = {
        e.name: MaterialEntry(hash=e.hash, side=e.split, licence=e.licence, source=e.source)
        for e in entries
    }
    Store(folder).write_json("dataset.json", Dataset(materials=known))
    catalogue.write(
        catalogue.Catalogue(title="test", credit="none", materials=tuple(entries)),
        folder / "materials.json",
    )
    return Records(folder)


def named(result):
    return {side: [m.name for m in of_side] for side, of_side in result.items()}


def test_a_data_set_of_three_metals_trains_on_exactly_these_three_metals(
    metals, entries, tmp_path, monkeypatch
):
    shown = set()
    one_step = loop.Training._make_step

    def watched(self, batch):
        shown.update(name.split(" ")[-1] for name in batch.names)
        return one_step(self, batch)

    monkeypatch.setattr(loop.Training, "_make_step", watched)
    (tmp_path / "run.json").write_text(json.dumps(RUN))
    words = [
        "train",
        str(tmp_path / "run.json"),
        "--data",
        str(metals.folder),
        "--out",
        str(tmp_path / "out"),
        "--workers",
        "0",
    ]
    assert main("learn", "", ("train",), words) == 0
    assert shown == set(METALS)  # 24 draws of three: the same ones on every machine
    assert json.loads((tmp_path / "out" / "run.json").read_text())["data"]["materials"] == "dataset"
    data_splits = sources.load_data_splits(Data(), metals.folder, progress=False)
    for data_split in data_splits.values():  # none is held out, so few are there
        assert set(data_split.labels) == set(METALS)
        for name, label in data_split.labels.items():
            assert np.array_equal(label, np.asarray(entries[name].label, np.float32))


def test_the_built_in_materials_are_taken_where_the_run_says_so(metals):
    data_splits = sources.load_data_splits(
        Data(materials="built-in"), metals.folder, progress=False
    )
    assert {side: len(data_split.labels) for side, data_split in data_splits.items()} == BUILT_IN


def test_an_option_chooses_the_materials_over_the_run(tmp_path):
    (tmp_path / "run.json").write_text(json.dumps(RUN))
    assert settings.read_run(tmp_path / "run.json").data.materials == "dataset"
    assert (
        settings.read_run(tmp_path / "run.json", materials="built-in").data.materials == "built-in"
    )
    assert settings.read_run("joint-compact", materials="dataset").data.materials == "dataset"


def test_the_run_of_the_shipped_weights_and_every_run_of_version_1_take_the_built_in_materials(
    root,
):
    assert settings.read_run("joint-compact").data.materials == "built-in"
    path = root / "docs" / "results" / "presets" / "report.json"
    trained = json.loads(path.read_text(encoding="utf-8"))
    assert trained
    for each in trained.values():
        run = settings.decode_run(json.dumps(each["run"]).encode(), path)
        assert (run.version, run.data.materials) == (settings.VERSION, "built-in")
        assert settings.decode_run(msgspec.json.encode(run), path) == run


def test_a_checkpoint_of_a_run_of_version_1_is_the_same_run_today():
    today = settings.read_run("joint-compact")
    old = msgspec.to_builtins(today) | {"version": 1}
    del old["data"]["materials"]
    assert settings.decode_run(json.dumps(old).encode(), "checkpoint") == today


def test_the_materials_of_the_geometry_job_are_the_built_in_ones_side_by_side(tmp_path, entries):
    job = reading.read(JOBS / "geometry.json", dict)
    assert job["materials"] == ["merl", "rgl"]  # all there are, so this data set holds every entry
    records = with_materials(tmp_path, list(entries.values()))
    own, _ = sources.split_materials(Data(), records)
    built_in, _ = sources.split_materials(Data(materials="built-in"), records)
    assert named(own) == named(built_in)
    assert {side: len(of_side) for side, of_side in own.items()} == BUILT_IN
    for side in own:
        for mine, theirs in zip(own[side], built_in[side], strict=True):
            assert np.array_equal(mine.label, theirs.label)


@pytest.mark.parametrize("count, held_out", [(9, 0), (10, 1), (29, 2), (95, 8)])
def test_one_training_material_in_ten_is_for_validation_and_eight_at_most(
    tmp_path, entries, count, held_out
):
    training = [e for e in entries.values() if e.split == "train"][:count]
    result, _ = sources.split_materials(Data(), with_materials(tmp_path, training))
    assert [len(result[side]) for side in ("train", "validation", "test")] == [
        count - held_out,
        held_out,
        0,
    ]


def test_a_data_set_without_materials_for_training_is_refused_with_the_remedy(tmp_path, entries):
    records = with_materials(tmp_path, [e for e in entries.values() if e.split == "test"][:2])
    with pytest.raises(
        InputError,
        match=r'expected materials for training, found 2, all of them for testing \(.*"built-in"',
    ):
        sources.split_materials(Data(), records)


def test_a_damaged_material_stops_a_run_or_is_left_out_and_told(tmp_path, entries):
    steel, chrome = entries["steel"], entries["chrome"]
    records = with_materials(tmp_path, [msgspec.structs.replace(steel, hash="0" * 16), chrome])
    with pytest.raises(InputError, match=r"steel.*--skip-bad"):
        sources.split_materials(Data(), records)
    result, bad = sources.split_materials(Data(), records, skip_bad=True)
    assert [m.name for m in result["train"]] == ["chrome"]
    assert set(bad) == {"steel"}


def test_priors_of_one_grey_material_hold_that_material_alone(rng):
    # the three channels alike: nothing spreads
    grey = np.tile(np.linspace(-1.0, 0.0, 36, dtype=np.float32), 3)
    fitted = priors.fit([grey], [lights.draw_computed(rng).astype(np.float32)])
    assert all(part.isfinite().all() for part in vars(fitted).values())
    z = torch.ones(1, len(fitted.directions), dtype=torch.float64)
    np.testing.assert_allclose(fitted.label(z)[0], grey, atol=1e-12)  # float64


def test_bad_starts_of_refinement_are_drawn_from_the_data_sets_own_materials(metals):
    records = Records(metals.folder)
    own = refinement_initialisations.labels_of(records, "dataset")
    assert sorted(map(tuple, own)) == sorted(tuple(records.label(name)) for name in METALS)
    assert len(refinement_initialisations.labels_of(records, "built-in")) == sum(BUILT_IN.values())


def test_a_run_takes_the_measured_maps_beside_the_data_sets_own(metals):
    own = sources.load_data_splits(Data(), metals.folder, progress=False)
    held = Data(
        measured_lights=True, validation_lights=("pmndrs_hall",), test_lights=("pmndrs_lab",)
    )
    data_splits = sources.load_data_splits(held, metals.folder, progress=False)
    assert data_splits["validation"].map_names == ("pmndrs_hall",)
    assert data_splits["test"].map_names == ("pmndrs_lab",)
    training = set(data_splits["train"].map_names)
    assert {"blender_city", "drei_lebombo"} <= training and not training & {"pmndrs_lab"}
    assert len(training) >= 24
    assert not any("pmndrs" in name for name in own["train"].map_names)


def test_a_run_of_all_materials_and_lights_holds_out_shapes_alone(metals):
    every = Data(materials="built-in", measured_lights=True, all_materials_and_lights=True)
    data_splits = sources.load_data_splits(every, metals.folder, progress=False)
    train = data_splits["train"]
    assert len(train.labels) == sum(BUILT_IN.values())
    assert {"pmndrs_lab", "blender_city", "blender_courtyard"} <= set(train.map_names)
    assert set(data_splits["test"].map_names) == set(train.map_names)
    shapes = {side: {s.geometry.views[v].hash for v in s.views} for side, s in data_splits.items()}
    assert not shapes["train"] & (shapes["test"] | shapes["validation"])


def test_a_run_of_all_materials_and_lights_cannot_hold_out_lights(tmp_path):
    run = json.loads((RUNS / "photographs-compact.json").read_text())
    run["data"]["test_lights"] = ["pmndrs_lab"]
    path = tmp_path / "run.json"
    path.write_text(json.dumps(run))
    with pytest.raises(InputError, match=r"expected no held-out lights .* found pmndrs_lab"):
        settings.read_run(path)


def test_a_misspelt_preset_is_neither_file_nor_preset():
    with pytest.raises(InputError, match=r"run 'joint-compakt': .*did you mean joint-compact,"):
        settings.read_run("joint-compakt")


def test_two_region_chairs_hold_out_the_lights_that_joint_compact_held_out():
    """Otherwise evaluations would refuse what the preset makes of these weights."""
    run = settings.read_run("two-region-chairs-compact")
    assert run.data.regions == 2
    metadata = weights.load_full_network(TABLE_WEIGHTS)[1]
    before = settings.decode_run(json.dumps(metadata["run"]).encode(), "joint-compact")
    for name in ("validation_lights", "test_lights"):
        held_out = {light.removeprefix("blender_") for light in getattr(before.data, name)}
        assert set(getattr(run.data, name)) == held_out
