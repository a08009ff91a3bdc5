"""The evaluation on a small dataset whose pictures are computed here: what is true must come out as
true, and nothing twice.
"""

import contextlib
import json
import re
import shutil
from dataclasses import replace
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import torch

from learn.__main__ import COMMANDS
from learn.data import pairs
from learn.data.records import Records
from learn.evaluation import edit_evaluator, methods, page, run
from learn.layer import render
from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from learn.networks.prediction import Prediction
from learn.networks.weights import save_weights
from learn.refinement import RefinementSettings
from manifests import cli, exr, outputs, subprocesses
from manifests.errors import InputError
from manifests.line_files import Lines
from shaders import tone
from shaders.mixture import Mixture
from tests.support.synthetic import add_shape, matte, named, with_picture, write_dataset

SIZE = 32
ALBEDOS = {"dark": 0.1, "middle": 0.4, "bright": 0.8}
# display L2: pictures are stored with 11 bits, and rendered by two tolerances of the quadrature
HALF_FLOATS = 0.05


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A compact network that knows nothing."""
    torch.manual_seed(3)
    labels = torch.stack(
        [torch.tensor(matte("a", albedo).label) for albedo in ALBEDOS.values()]
    ).float()
    network, path = (
        Compact(Ranges.of(labels)),
        tmp_path_factory.mktemp("weights") / "weights.safetensors",
    )
    save_weights(path, network, network.state_dict(), "{}", SIZE)
    return path


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Three matte materials on a sphere, under one light in two turns, twice each: twelve pictures,
    six different ones.
    """
    folder = tmp_path_factory.mktemp("data")
    entries = [matte(name, albedo) for name, albedo in ALBEDOS.items()]
    write_dataset(
        folder,
        entries,
        np.random.default_rng(1),
        size=SIZE,
        noise=0.0,
        rotations=(0, 40),
        method="quadrature",
    )
    return folder


@pytest.fixture(autouse=True)
def few_pixels(monkeypatch):
    """Label and nodes are the same matte surface here: few pixels show it, and 8,192 texels at each
    take their time.
    """
    monkeypatch.setattr(edit_evaluator, "FIT_PIXELS", 8)


@pytest.fixture
def options(data, weights, tmp_path):
    return run.Options(data, weights, tmp_path / "out", edits=4, refine=False, gallery=1)


@pytest.fixture(scope="module")
def measured(data, weights, tmp_path_factory):
    """What `options` leave in an empty folder, and the edits in the order of their measurement."""
    options = run.Options(
        data, weights, tmp_path_factory.mktemp("measured") / "out", edits=4, refine=False, gallery=1
    )
    made, work, threads = [], edit_evaluator.EditEvaluator.measure_picture, torch.get_num_threads()

    def noted(self, first, edits, *rest):
        made.extend(edit.id for edit in edits)
        return work(self, first, edits, *rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(edit_evaluator, "FIT_PIXELS", 8)
        patch.setattr(edit_evaluator.EditEvaluator, "measure_picture", noted)
        torch.set_num_threads(1)  # as in the tests, which compare to the last bit
        try:
            report = run.evaluate(options)
        finally:
            torch.set_num_threads(threads)
    return SimpleNamespace(out=options.out, report=report, made=made)


@pytest.fixture
def continued(options, measured):
    """`options` of a folder in which they are already measured."""
    shutil.copytree(measured.out, options.out)
    return options


@pytest.fixture
def few_methods(monkeypatch):
    """Two trivial methods and the network's, whose edits are the input picture: for tests in which
    no figure of them counts.
    """
    list_methods = methods.list_methods

    def few(*arguments):
        all_ = list_methods(*arguments)
        edits = [each for each in all_.edits if each.name in ("input unchanged", "ours")]
        return replace(all_, edits=(*edits, all_.edits[-1]), parts=())

    def unchanged(n, label, light, batch):
        return methods.Unchanged().edit(batch, label)

    monkeypatch.setattr(methods, "list_methods", few)
    monkeypatch.setattr(methods, "render_by_layer", unchanged)


def stop_at(given):
    raise InputError("the test", "nothing more", f"{given}", "none")


def test_there_are_as_many_processes_as_cpus_that_this_process_may_use(
    options, monkeypatch, capsys
):
    monkeypatch.setattr("os.cpu_count", lambda: 64)
    monkeypatch.setattr(subprocesses, "processors", lambda: 6)
    monkeypatch.setattr(run, "evaluate", lambda options: stop_at(options.processes))
    words = ["evaluate", "--data", options.data, "--weights", options.weights, "--out", options.out]
    assert cli.main("learn", "", ("evaluate",), list(map(str, words))) == 1
    assert "found 6 (" in capsys.readouterr().err


def test_processes_share_the_cpus_that_this_process_may_use(options, monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 64)
    monkeypatch.setattr(subprocesses, "processors", lambda: 6)
    monkeypatch.setattr(
        run,
        "ProcessPoolExecutor",
        lambda processes, context, begin, arguments: stop_at((processes, arguments[1])),
    )
    with pytest.raises(InputError, match=r"found \(2, 3\)"):
        run.evaluate(replace(options, processes=2))


def test_pairs_differ_in_nothing_but_the_material(data):
    records = Records(data).records
    edits = [edit for group in pairs.edits_between(records).values() for edit in group]
    # two turns of the light, three materials, two others for each; no pair of two seeds
    assert len(edits) == 2 * 3 * 2
    for edit in edits:
        a, b = edit.source, edit.truth
        assert a.materials != b.materials
        same = [
            r.id
            for r in records
            if pairs.scene_key(r) == pairs.scene_key(b) and r.materials == b.materials
        ]
        assert b.id == min(same)  # of two seeds always the same one
        assert (a.geometry, a.light, a.rotation_texels, a.tier, a.camera) == (
            b.geometry,
            b.light,
            b.rotation_texels,
            b.tier,
            b.camera,
        )


def test_more_edits_begin_with_the_same_ones(data):
    records = Records(data).records
    few, many = (pairs.choose_edits(records, count, 5) for count in (3, 9))
    assert few == many[:3] and len(many) == 9
    assert pairs.choose_edits(records, 9, 6) != many  # a seed is heard


def test_shapes_come_in_turn_and_one_of_few_pictures_costs_the_others_none(data):
    once = [r for r in Records(data).records if r.seed == 0]
    few = [r for r in once if r.rotation_texels == 0]
    records = [
        msgspec.structs.replace(r, id=f"{shape}-{r.id}", shape=shape, geometry_hash=shape)
        for shape, of in (("a", once), ("b", few), ("c", once))
        for r in of
    ]
    order = list(dict.fromkeys(edit.source.id for edit in pairs.choose_edits(records, 1000, 5)))
    shapes = [id_[0] for id_ in order]
    assert len(order) == len(records) == 15
    assert all(set(shapes[i : i + 3]) == set("abc") for i in (0, 3, 6))  # b has three pictures
    assert set(shapes[9:]) == set("ac")


def test_pictures_of_more_samples_alter_no_edit_and_show_the_noise(data):
    records = Records(data).records
    edited = pairs.choose_edits(records, 12, 5)
    truth = edited[0].truth
    # first by id, were it for that
    finer = [
        msgspec.structs.replace(truth, id=f"0{seed}", samples=512, seed=seed) for seed in (5, 6)
    ]
    key = pairs.scene_key(truth), truth.materials
    for added in (finer, finer[:1]):
        assert pairs.choose_edits([*added, *records], 12, 5) == edited
    assert pairs.find_repeats([*records, *finer])[key] == finer
    # of one alone no noise is known
    assert {r.samples for r in pairs.find_repeats([*records, *finer[:1]])[key]} == {1}
    assert len(pairs.find_repeats([*records, *finer[:1]])[key]) == 2


def test_pictures_without_a_partner_are_refused(tmp_path):
    write_dataset(tmp_path, [matte()], np.random.default_rng(1), size=SIZE, rotations=(0,), seeds=2)
    with pytest.raises(InputError, match="differ in nothing but the material"):
        pairs.choose_edits(Records(tmp_path).records, 5, 0)


def told_the_truth(net):
    """A network's place taken by the truth."""

    def predict(batch):
        return Prediction(batch.n.clone(), None, batch.label.clone(), None, batch.light.clone())

    return predict


def test_truth_in_the_tables_say_so(options, monkeypatch):
    monkeypatch.setattr(methods, "make_predictor", told_the_truth)
    tables = run.evaluate(options)["tables"]
    edits = {row["name"]: row["cells"] for row in tables["edits"]["rows"]}
    displayed = {row["name"]: row["cells"] for row in tables["displayed"]["rows"]}
    assert edits["ours"]["l2"][0] < HALF_FLOATS and displayed["ours"]["ssim"][0] > 0.999
    assert edits["ours"]["l2"] == edits["the layer alone"]["l2"]
    for trivial in ("input unchanged", "mean material, true normals and light"):
        assert edits[trivial]["l2"][0] > 20
    parts = {
        key: {row["name"]: row["cells"] for row in tables[key]["rows"]}["ours"]
        for key in ("normals", "material", "light", "rerendered")
    }
    given = {
        "the layer alone",
        "mean material, true normals and light",
        "constant light, true normals",
    }  # who is given a part has no row of it
    assert not given & {row["name"] for row in tables["normals"]["rows"]}
    assert not {"the layer alone", "constant light, true normals"} & {
        row["name"] for row in tables["material"]["rows"]
    }
    assert parts["normals"]["mean_deg"][0] < 0.1  # arccos of 1 − 6e-8 is 0.02°
    assert parts["material"]["brdf_log"][0] == 0 and parts["light"]["spheres_l2"][0] == 0
    assert parts["rerendered"]["l2"][0] < HALF_FLOATS
    layer = tables["layer"]["rows"][-1]["cells"]
    # every truth has a second seed here
    assert layer["l2_inner"] < HALF_FLOATS and layer["judged"] == layer["truths"] > 1


def test_a_false_light_is_told_from_false_normals(data, weights):
    """With the truth but for its light, giving the light takes all error off and giving the normals
    none.
    """
    work = edit_evaluator.EditEvaluator(data, weights, refine=False)
    edit = pairs.choose_edits(work.records.records, 1, 0)[0]
    batch, label = (
        pairs.make_source_batch(work.records, edit),
        pairs.target_label(work.records, edit),
    )
    wrong = methods.Layered(
        "wrong light", lambda b: Prediction(b.n.clone(), None, None, None, b.light * 0.5)
    )
    truth, mask = work.records.image(edit.truth), (batch.segments[0] > 0).numpy()
    l2 = edit_evaluator.metrics.display_l2(wrong.edit(batch, label), truth, mask)
    result = edit_evaluator.measure_with_truth(wrong, batch, label, truth, mask, l2)
    assert (
        l2 > 20
        and result["l2_true_light"] < HALF_FLOATS
        and result["l2_true_normals"] == pytest.approx(l2, rel=1e-4)
    )


def test_false_normals_are_told_from_a_false_light(data, weights):
    work = edit_evaluator.EditEvaluator(data, weights, refine=False)
    edits = pairs.choose_edits(work.records.records, 12, 0)
    # the brightest shows the error best
    edit = max(edits, key=lambda each: float(work.records.image(each.truth).mean()))
    batch, label = (
        pairs.make_source_batch(work.records, edit),
        pairs.target_label(work.records, edit),
    )
    wrong = methods.Layered(
        "wrong normals",
        lambda b: Prediction(
            b.n * torch.tensor([-1.0, 1, 1])[:, None, None], None, None, None, b.light + 0
        ),
    )
    truth, mask = work.records.image(edit.truth), (batch.segments[0] > 0).numpy()
    l2 = edit_evaluator.metrics.display_l2(wrong.edit(batch, label), truth, mask)
    result = edit_evaluator.measure_with_truth(wrong, batch, label, truth, mask, l2)
    # light is even
    assert (
        l2 > 2
        and result["l2_true_normals"] < HALF_FLOATS
        and result["l2_true_light"] == pytest.approx(l2, rel=1e-4)
    )


def test_what_stands_behind_the_object_is_neither_shown_nor_compared(data, weights, monkeypatch):
    work = edit_evaluator.EditEvaluator(data, weights, refine=False)
    edit = pairs.choose_edits(work.records.records, 1, 0)[0]
    mask = (pairs.make_source_batch(work.records, edit).segments[0] > 0).numpy()[..., None]
    image = Records.image
    monkeypatch.setattr(
        Records, "image", lambda self, record: np.where(mask, image(self, record), np.float32(0.5))
    )
    batch = pairs.make_source_batch(work.records, edit)
    assert (batch.image[0].movedim(0, -1).numpy() * ~mask).max() == 0
    _, (row,) = work.measure_picture(edit, [edit], False)
    assert row["methods"]["the layer alone"]["l2_frame"] < HALF_FLOATS


def test_methods_that_are_compared_render_no_scene_twice(data, weights, monkeypatch):
    """And each still has the figures of its own scene."""
    work, scenes = edit_evaluator.EditEvaluator(data, weights, refine=False), []

    def noted(*scene):
        scenes.append(tuple(x.numpy().tobytes() for x in scene[:3]))
        return picture(*scene)

    picture = methods.predictions.picture
    monkeypatch.setattr(methods, "predictions", SimpleNamespace(picture=noted))
    edit = pairs.choose_edits(work.records.records, 1, 0)[0]
    once, made = work.measure_picture(edit, [edit], False), list(scenes)
    monkeypatch.setattr(methods, "rendered_once", contextlib.nullcontext)
    assert once == work.measure_picture(edit, [edit], False)
    again = scenes[len(made) :]
    assert len(made) == len(set(made)) == len(set(again)) < len(again)
    assert set(made) == set(again)


def test_the_layer_inside_is_not_blamed_for_what_is_wrong_at_silhouettes(data, weights):
    work = edit_evaluator.EditEvaluator(data, weights, refine=False)
    edit = pairs.choose_edits(work.records.records, 1, 0)[0]
    batch, truth = pairs.make_source_batch(work.records, edit), work.records.image(edit.truth)
    mask = (batch.segments[0] > 0).numpy()
    rim = mask & (batch.n[0, 2] < 0.5).numpy()
    result = work._measure_layer(edit, np.where(rim[..., None], 0, truth), mask)
    assert result["l2"] > 100
    assert result["l2_inner"] < HALF_FLOATS


def test_what_the_nodes_explain_is_not_put_down_to_the_loop(data, weights, monkeypatch):
    """The label reflects 0.4, nodes and Cycles 0.36: all of the difference is the fit's, but for a
    twentieth that Cycles is brighter.
    """
    monkeypatch.setattr(edit_evaluator, "FIT_PIXELS", 64)
    work = edit_evaluator.EditEvaluator(data, weights, refine=False)
    (record,) = [r for r in work.records.records if r.materials == ("middle",)][:1]
    sample, rng = work.records.load(record), np.random.default_rng(2)
    inner, mixtures = sample.n.numpy()[..., 2] > 0.4, [Mixture.lambert([0.36] * 3)]
    exposure = tone.auto_exposure(sample.image.numpy(), inner) / 2  # nothing is clipped
    result = []
    for brighter in (1, 1.05):
        nodes = sample.image.numpy() * 0.9 * brighter
        pictures = np.stack(
            [nodes * (1 + 0.05 * rng.standard_normal(nodes.shape)) for _ in range(2)]
        )
        result.append(
            edit_evaluator.against_nodes(
                sample, pictures, sample.image.numpy(), inner, mixtures, exposure
            )
        )
    true, other = result
    plain = [
        edit_evaluator.squared_difference(
            tone.display(sample.image.numpy(), exposure), tone.display(x, exposure)
        )[inner].mean()
        for x in pictures
    ]
    # noise: 5 % of 130 display values over 2.2, squared, is 9; its products over 600 pixels × 3
    # channels scatter by 0.2, over 256 by 0.35
    assert true["fit_here"] == pytest.approx(other["fit_here"], rel=0.01) and true["fit_here"] > 20
    assert (
        true["net_inner"] == pytest.approx(true["fit_here"], abs=1.5)
        and min(plain) > other["net_inner"] + 5
    )
    assert 0.05 < true["net_error"] < 2
    assert abs(true["rest"]) < 1.5 < 4 < other["rest"]


def test_a_truth_of_two_edits_is_taken_apart_once(data, weights, monkeypatch, few_methods):
    asked = []
    monkeypatch.setattr(
        edit_evaluator,
        "against_nodes",
        lambda sample, *_: asked.append(sample.record.id) or {"net_inner": 1.0},
    )
    work = edit_evaluator.EditEvaluator(data, weights, refine=False)
    edits = [edit for group in pairs.edits_between(work.records.records).values() for edit in group]
    rows = [row for edit in edits for row in work.measure_picture(edit, [edit], False)[1]]
    assert len(edits) == 12 and len(asked) == len(set(asked)) == 6
    assert all(row["layer"]["net_inner"] == 1 and row["layer"]["seeds"] == 2 for row in rows)


def test_a_smaller_evaluation_in_the_same_folder_reports_its_own_edits_alone(continued):
    report = run.evaluate(replace(continued, edits=1))
    assert report["tables"]["layer"]["rows"][-1]["cells"]["truths"] == 1


@pytest.fixture
def both_sides(tmp_path):
    """A function of a number: a data set of six training pictures and that many of a shape and
    materials held out.
    """

    def written(held_out):
        entries = [
            matte(f"{name}{mark}", albedo, split)
            for mark, split in (("", "train"), ("'", "test"))
            for name, albedo in ALBEDOS.items()
        ]
        words = {
            "size": SIZE,
            "noise": 0.0,
            "rotations": (0, 40),
            "seeds": 1,
            "method": "quadrature",
        }
        store = write_dataset(tmp_path / "split", entries, np.random.default_rng(1), **words)
        add_shape(store, "held out", "test")
        train, test = (
            [r for r in store.records() if r.split == split] for split in ("train", "test")
        )
        kept = [*train, *test[:held_out]]
        store.record_files()[0].write_bytes(b"".join(msgspec.json.encode(r) + b"\n" for r in kept))
        return store.folder

    return written


def test_where_pictures_are_held_out_only_those_are_edited(both_sides, options, few_methods):
    run.evaluate(replace(options, data=both_sides(6), edits=100))
    edits = outputs.read_lines(options.out / "edits.jsonl")
    assert len(edits) == 12  # of 24
    assert {row["split"] for row in edits} == {"test"}


def without_seconds(rows):
    return [
        json.loads(re.sub(r'"seconds": [\d.e-]+', '"seconds": 0', json.dumps(row)))
        for row in sorted(rows, key=lambda r: r["id"])
    ]


def test_it_goes_on_where_it_was_torn_and_repeats_nothing(options, measured, monkeypatch, tmp_path):
    calls, work = [], edit_evaluator.EditEvaluator.measure_picture
    monkeypatch.setattr(
        edit_evaluator.EditEvaluator,
        "measure_picture",
        lambda self, first, edits, *rest: calls.append(edits) or work(self, first, edits, *rest),
    )
    made = measured.made
    assert len(made) == len(set(made)) == 4
    out = tmp_path / "torn"
    run.evaluate(replace(options, out=out, edits=3))
    with open(out / "edits.jsonl", "r+b") as file:
        file.truncate(file.seek(0, 2) - 20)  # as a kill leaves it
    calls.clear()
    again = run.evaluate(replace(options, out=out))
    # the torn one and the new one
    assert sorted(edit.id for edits in calls for edit in edits) == sorted(made[2:])
    for name in ("edits.jsonl", "pictures.jsonl"):
        assert without_seconds(outputs.read_lines(out / name)) == without_seconds(
            outputs.read_lines(measured.out / name)
        )
    assert again["tables"]["edits"] == measured.report["tables"]["edits"]
    calls.clear()
    run.evaluate(replace(options, out=out))
    assert not calls


def test_pictures_asked_for_later_are_drawn_and_nothing_else_is_made_again(options, monkeypatch):
    calls, work = [], edit_evaluator.EditEvaluator.measure_picture
    report = run.evaluate(replace(options, edits=2, gallery=0))
    assert not (options.out / "gallery").exists()
    monkeypatch.setattr(
        edit_evaluator.EditEvaluator,
        "measure_picture",
        lambda self, first, edits, *rest: calls.append(edits) or work(self, first, edits, *rest),
    )
    again = run.evaluate(replace(options, edits=2, gallery=1))
    drawn = [path.stem for path in (options.out / "gallery").iterdir()]
    assert [edit.id for edits in calls for edit in edits] == drawn and len(drawn) == 1
    assert again["tables"]["edits"] == report["tables"]["edits"]


def test_a_truth_that_was_rendered_again_since_is_judged(data, options, tmp_path, few_methods):
    folder = tmp_path / "grown"
    shutil.copytree(data, folder)
    lines = folder / "records" / "worker-00.jsonl"
    whole = lines.read_bytes()
    # of two pictures that differ in the seed alone, the one that edits are compared with
    alike = {}
    for record in Records(folder).records:
        alike.setdefault((pairs.scene_key(record), record.materials), record)
    seeds = list(alike.values())
    lines.write_bytes(b"".join(msgspec.json.encode(r) + b"\n" for r in seeds))
    run.evaluate(replace(options, data=folder))
    assert {
        row["layer"].get("seeds") for row in run.rows_of(options.out / "edits.jsonl").values()
    } == {None}
    lines.write_bytes(whole)
    run.evaluate(replace(options, data=folder))
    assert {
        row["layer"].get("seeds") for row in run.rows_of(options.out / "edits.jsonl").values()
    } == {2}
    assert len(outputs.read_lines(options.out / "edits.jsonl")) == 8  # the later of two lines holds


def test_weights_that_are_not_there_leave_no_settings_behind(options, tmp_path):
    with pytest.raises(InputError, match=r"weights in a \.safetensors file"):
        run.evaluate(replace(options, weights=tmp_path / "typo.safetensors"))
    run.evaluate(replace(options, edits=1))


def test_a_test_side_without_edits_is_told_as_such(both_sides, options):
    with pytest.raises(InputError, match=r"pictures of the test side .* none among its 1 of 7"):
        run.evaluate(replace(options, data=both_sides(1)))


def test_a_folder_of_baselines_that_is_not_there_is_refused(options, tmp_path):
    with pytest.raises(InputError, match="--baselines"):
        run.evaluate(replace(options, baselines=tmp_path / "typo"))


def test_one_shape_and_material_decide_nothing(continued):
    report = run.evaluate(replace(continued, edits=1))
    assert {row["cells"]["verdict"] for row in report["tables"]["differences"]["rows"]} == {
        "undecided: two shapes and two materials are needed"
    }


def test_the_best_of_a_column_was_given_no_truth():
    column = {"key": "l2", "label": "L2 ↓"}
    rows = [
        ("the layer alone", 1.0),
        ("constant light, true normals", 2.0),
        ("Lombardi-like, true normals", 3.0),
        ("ours", 4.0),
        ("Baseline 1", 5.0),
    ]
    rows = [{"name": name, "cells": {"l2": [value, value, value]}} for name, value in rows]
    assert page._best(rows, column) == "ours"


def test_an_evaluation_of_other_settings_is_not_gone_on_with(continued, monkeypatch):
    run.evaluate(replace(continued, edits=1))
    with pytest.raises(InputError, match="other seed"):
        run.evaluate(replace(continued, edits=1, seed=1))
    monkeypatch.setattr(run, "MEASURED", run.MEASURED._replace(tolerance=0.5))
    with pytest.raises(InputError, match="other tolerance"):
        run.evaluate(continued)


def test_refinements_settings_are_part_of_an_evaluations(options, monkeypatch, tmp_path):
    refined = run.settings(replace(options, refine=True))
    outputs.pin_settings(tmp_path / "settings.json", refined)
    # what a file gives back is the same
    outputs.pin_settings(tmp_path / "settings.json", run.settings(replace(options, refine=True)))
    monkeypatch.setattr(run, "RefinementSettings", lambda: replace(RefinementSettings(), a=0.5))
    with pytest.raises(InputError, match="other refine"):
        outputs.pin_settings(
            tmp_path / "settings.json", run.settings(replace(options, refine=True))
        )
    assert run.settings(options)["refine"] is False


def test_the_method_of_refinement_is_part_of_an_evaluations_settings(options, tmp_path):
    by = {
        method: run.settings(replace(options, refine=True, refinement_method=method))
        for method in (None, "auto", "quadrature")
    }
    assert by[None] == by["auto"] and by["quadrature"]["refine"]["method"] == "quadrature"
    outputs.pin_settings(tmp_path / "settings.json", by["auto"])
    with pytest.raises(InputError, match="other refine"):
        outputs.pin_settings(tmp_path / "settings.json", by["quadrature"])


def test_a_method_without_refinement_is_refused(options, capsys, tmp_path):
    words = ["evaluate", "--data", str(options.data), "--out", str(tmp_path / "out")]
    words += ["--no-refine", "--refinement-method", "quadrature"]
    assert cli.main("learn", "", COMMANDS, words) == 1
    assert "--refinement-method" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_an_evaluation_refines_by_the_method_that_is_named(options, monkeypatch):
    """Every method that is refined, those with true normals included."""
    seen = []

    def refined(batch, prediction, settings, labels):
        seen.append(settings)
        raise InputError("here", "nothing", "enough", "stop")

    monkeypatch.setattr("learn.refinement.refine", refined)
    named = replace(options, refine=True, refinement_method="quadrature", processes=1)
    measuring = edit_evaluator.EditEvaluator(**run.evaluator_arguments(named))
    for method in measuring.methods.edits:
        if isinstance(method, methods.Refined):
            with pytest.raises(InputError):
                method._work(None, None)
    assert {settings.method for settings in seen} == {"quadrature"} and len(seen) == 2
    assert [settings.order for settings in seen] == [
        ("material", "light", "normals"),
        ("material", "light"),
    ]


def test_what_is_missing_is_left_out_by_name(options, tmp_path):
    (tmp_path / "none").mkdir()
    report = run.evaluate(replace(options, edits=1, baselines=tmp_path / "none"))
    assert {"Baseline 1", "Baseline 2", "LPIPS", "refined rows"} <= set(report["about"]["missing"])
    assert not any(
        "Baseline" in row["name"] or "refined" in row["name"]
        for row in report["tables"]["edits"]["rows"]
    )
    assert "lpips" not in [column["key"] for column in report["tables"]["displayed"]["columns"]]
    text = (options.out / "report.md").read_text()
    assert "Left out: Baseline 2: no baseline-2.safetensors" in text and "Left out: LPIPS" in text


def test_the_page_stands_alone(options, measured):
    text = (measured.out / "index.html").read_text()
    assert (
        len(re.findall("<figure>", text)) == options.gallery == 1 and "src='data:image/png" in text
    )
    assert not re.search(r"(src|href)=['\"](?!data:)", text)
    assert json.loads((measured.out / "report.json").read_text())["tables"].keys() >= {
        "edits",
        "differences",
        "layer",
    }


def test_weights_of_another_size_are_refused(data, options, weights, tmp_path):
    network = Compact(Ranges(torch.zeros(108), torch.ones(108)))
    save_weights(tmp_path / "other.safetensors", network, network.state_dict(), "{}", 64)
    with pytest.raises(InputError, match="64 × 64 pixels, as the weights were trained"):
        run.evaluate(replace(options, weights=tmp_path / "other.safetensors"))


@pytest.fixture
def two_regions(data, tmp_path):
    """The sphere's left half in one material and its right in another: three pictures of it under
    one light.
    """
    records = Records(data)
    record = records.records[0]
    normals, depth, segments = records.geometry(record)
    segments = segments * np.where(np.arange(SIZE) < SIZE // 2, 1, 2)
    store = write_dataset(
        tmp_path / "two",
        [matte(n, a) for n, a in ALBEDOS.items()],
        np.random.default_rng(1),
        size=SIZE,
        rotations=(0,),
    )
    dataset = store.dataset()
    shapes = {"sphere": msgspec.structs.replace(dataset.shapes["sphere"], segments=2)}
    store.write_json("dataset.json", msgspec.structs.replace(dataset, shapes=shapes))
    channels = {f"normal.{axis}": normals[..., k] for k, axis in enumerate("XYZ")}
    encoded = exr.encode(channels | {"depth.Z": depth, "segment": segments.astype(np.uint32)})
    record = msgspec.structs.replace(
        record, rotation_texels=0, geometry_hash=store.place(record.geometry, encoded, "test")
    )
    L = torch.from_numpy(Records(store.folder, lambda _: False).light("sky"))[None]
    (store.folder / "records" / "worker-00.jsonl").unlink()
    lines = Lines(store.folder / "records" / "worker-00.jsonl")
    for names in (("dark", "bright"), ("bright", "middle"), ("middle", "middle")):
        m = torch.from_numpy(np.stack([records.label(name) for name in names]))[None].exp()
        seen = render(
            torch.from_numpy(normals)[None],
            m,
            L,
            segments=torch.from_numpy(segments)[None],
            method="quadrature",
        )[0].numpy()
        lines.append(
            with_picture(
                store, named(msgspec.structs.replace(record, materials=names), dataset), seen
            )
        )
    lines.close()
    return store.folder


def test_each_region_gets_its_own_material(two_regions, weights):
    work = edit_evaluator.EditEvaluator(two_regions, weights, refine=False)
    looked_at = ("input unchanged", "ours", "the layer alone")
    compared = tuple(each for each in work.methods.edits if each.name in looked_at)
    work.methods = replace(work.methods, edits=compared)
    edits = pairs.choose_edits(work.records.records, 6, 0)
    assert len(edits) == 6 and all(edit.per_segment for edit in edits)
    for edit in edits:
        assert (
            pairs.make_source_batch(work.records, edit).label.shape
            == (1, 2, 108)
            == (1, *pairs.target_label(work.records, edit).shape)
        )
        _, (row,) = work.measure_picture(edit, [edit], False)
        assert (
            row["methods"]["the layer alone"]["l2"]
            < HALF_FLOATS
            < 1
            < row["methods"]["input unchanged"]["l2"]
        )  # bright clips: 4, not 1000
        assert np.isfinite(row["methods"]["ours"]["l2"])
