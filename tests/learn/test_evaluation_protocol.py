"""Who is compared with whom, on what terms, and that the report says what the figures say."""

import argparse
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
import torch

import learn.refinement
from learn.commands import evaluate
from learn.data import pairs
from learn.data.records import Records
from learn.evaluation import edit_evaluator, gallery, methods, page, report, run
from learn.evaluation.methods import OURS, OURS_REFINED
from learn.metrics import pictures as metrics
from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from learn.networks.encoder_decoder import EncoderDecoder
from learn.networks.prediction import Prediction
from learn.networks.separate import Separate
from learn.networks.weights import save_weights
from learn.refinement import RefinementResult, RefinementSettings
from learn.refinement.coordinates import disk_from_normals, normals_from_disk
from learn.refinement.settings import Level
from manifests import outputs
from manifests.errors import InputError
from shaders import tone
from tests.support.synthetic import matte, write_dataset

SIZE = 32
QUICK = replace(
    RefinementSettings(),
    outer_iterations=1,
    levels=(Level(pixels=60, light=(16, 32), method="exact", rounds=1, iterations=2),),
)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Two matte spheres under one light: two pictures, each the truth of the other's edit; at this
    turn the bright one is first.
    """
    folder = tmp_path_factory.mktemp("data")
    entries = [matte("dark", 0.1), matte("bright", 0.8)]
    write_dataset(
        folder,
        entries,
        np.random.default_rng(1),
        size=SIZE,
        seeds=1,
        noise=0.0,
        rotations=(2,),
        method="quadrature",
    )
    return folder


def untrained(kind, path, seed):
    """Weights of a network that knows nothing but the range of labels."""
    torch.manual_seed(seed)
    network = kind(
        Ranges.of(torch.tensor([matte("a", albedo).label for albedo in (0.05, 0.9)]).float())
    )
    save_weights(path, network, network.state_dict(), "{}", SIZE)
    return path


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return untrained(Compact, tmp_path_factory.mktemp("weights") / "weights.safetensors", 3)


@pytest.fixture(scope="module")
def others(tmp_path_factory):
    """Two of the three baselines."""
    folder = tmp_path_factory.mktemp("baselines")
    untrained(EncoderDecoder, folder / "baseline-1.safetensors", 4)
    untrained(Separate, folder / "baseline-2.safetensors", 5)
    return folder


@pytest.fixture
def options(data, weights, tmp_path):
    return run.Options(data, weights, tmp_path / "out", edits=2, refine=False, gallery=0)


@pytest.fixture
def batch(data):
    """What methods see of one picture."""
    records = Records(data)
    return pairs.make_source_batch(records, pairs.choose_edits(records.records, 1, 0)[0])


class Finished(NamedTuple):
    """Options, the row of the picture, the row of its edit, and (batch, start, RefinementResult) of
    each refinement in turn.
    """

    options: run.Options
    picture: dict
    edit: dict
    refined: list


@pytest.fixture(scope="module")
def finished(data, weights, others, tmp_path_factory):
    """One edit by all there are, refined a little."""
    options, calls = (
        run.Options(
            data, weights, tmp_path_factory.mktemp("out"), edits=1, baselines=others, gallery=0
        ),
        [],
    )
    refine, threads = learn.refinement.refine, torch.get_num_threads()

    def noted(batch, prediction, settings=QUICK, labels=None):
        quick = replace(QUICK, order=settings.order)
        calls.append((batch, prediction, refine(batch, prediction, quick, labels)))
        return calls[-1][-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learn.refinement, "refine", noted)
        torch.set_num_threads(1)  # as in the tests, which compare to the last bit
        try:
            run.evaluate(options)
        finally:
            torch.set_num_threads(threads)
    (picture,), (edit,) = (
        outputs.read_lines(options.out / name) for name in ("pictures.jsonl", "edits.jsonl")
    )
    return Finished(options, picture, edit, calls)


def figures(n, label, light, batch):
    return metrics.compare(
        methods.render_by_layer(n, label, light, batch),
        batch.image[0].movedim(0, -1).numpy(),
        batch.segments[0].numpy() > 0,
    )


def test_everyone_who_is_there_has_a_row_and_of_the_baselines_the_second_alone_is_refined_too(
    finished,
):
    trivial = [
        "input unchanged",
        "mean material, true normals and light",
        "constant light, true normals",
    ]
    networks = ["Baseline 1", "Baseline 2", "Baseline 2, refined", OURS, OURS_REFINED]
    networks += [f"{OURS_REFINED}, as edited"]
    networks += [f"{OURS}, true normals", f"{OURS}, true normals, refined"]
    assert list(finished.edit["methods"]) == [
        *trivial,
        f"constant light, normals of {OURS}",
        *networks,
        "the layer alone",
    ]
    assert len(finished.refined) == 3  # once each, for parts and edit alike


def test_a_refinement_that_is_given_true_normals_keeps_them(finished):
    batch, start, refined = finished.refined[2]
    assert torch.equal(start.n, batch.n)
    inside = batch.segments > 0
    kept = normals_from_disk(
        disk_from_normals(batch.n, inside)
    )  # off the rim, as all of refinement's normals are
    np.testing.assert_allclose(
        refined.prediction.n.movedim(1, -1)[inside], kept.movedim(1, -1)[inside], atol=1e-6
    )
    assert not torch.equal(refined.prediction.light, start.light)


@pytest.mark.parametrize(("at", "name"), [(0, "Baseline 2"), (1, OURS)])
def test_a_refined_row_is_what_refinement_makes_of_that_methods_prediction(finished, at, name):
    batch, start, refined = finished.refined[at]
    plain, moved = (finished.picture["methods"][key] for key in (name, f"{name}, refined"))
    assert plain["rendered_all"] == figures(start.n, start.label, start.light, batch)
    p = refined.prediction
    assert moved["rendered_all"] == figures(p.n, p.label, p.light, batch)
    assert moved["rendered_all"]["l2"] != plain["rendered_all"]["l2"]
    records = Records(finished.options.data)
    (edit,) = pairs.choose_edits(records.records, 1, 0)
    mask = batch.segments[0].numpy() > 0
    picture = methods.render_by_layer(p.n, pairs.target_label(records, edit), p.light, batch)
    expected = metrics.compare(picture, records.image(edit.truth) * mask[..., None], mask)
    message = finished.edit["methods"]
    assert {key: message[f"{name}, refined"][key] for key in expected} == expected
    assert message[f"{name}, refined"]["l2"] != message[name]["l2"]


@pytest.mark.parametrize(("at", "name"), [(0, "Baseline 2"), (1, OURS)])
def test_energies_and_seconds_of_a_refinement_are_those_it_told(finished, at, name):
    *_, refined = finished.refined[at]
    assert 0 < refined.after["total"] < refined.before["total"]
    expected = {
        "before": refined.before["total"],
        "after": refined.after["total"],
        "seconds": refined.seconds,
        "finite": True,
    }
    assert finished.picture["methods"][f"{name}, refined"]["refinement"] == expected


@pytest.mark.parametrize("part", ["n", "label", "light"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_refinement_with_one_value_that_is_not_finite_is_told_as_such(part, value):
    p = Prediction(
        torch.ones(1, 3, 2, 2), None, torch.ones(1, 1, 108), None, torch.ones(1, 3, 64, 128)
    )
    getattr(p, part).flatten()[-1] = value
    message = edit_evaluator.summarise_refinement(
        RefinementResult(p, {"total": 2.0}, {"total": 1.0}, [], 3.0)
    )
    assert message == {"before": 2.0, "after": 1.0, "seconds": 3.0, "finite": False}


def test_each_part_is_rendered_again_with_all_else_true(finished):
    batch, p, _ = finished.refined[1]
    message = finished.picture["methods"][OURS]
    assert message["rendered_normals"] == figures(p.n, batch.label, batch.light, batch)
    assert message["rendered_material"] == figures(batch.n, p.label, batch.light, batch)
    assert message["rendered_light"] == figures(batch.n, batch.label, p.light, batch)
    assert message["rendered_all_true_light"] == figures(p.n, p.label, batch.light, batch)
    assert (
        len(
            {
                message[f"rendered_{name}"]["l2"]
                for name in ("normals", "material", "light", "all", "all_true_light")
            }
        )
        == 5
    )


def test_figures_of_other_weights_or_baselines_are_not_gone_on_with(finished, weights, tmp_path):
    same = tmp_path / "same.safetensors"
    same.write_bytes(weights.read_bytes())
    # by bytes, not by name
    assert run.settings(replace(finished.options, weights=same)) == run.settings(finished.options)
    with pytest.raises(InputError, match="other weights"):
        run.evaluate(
            replace(
                finished.options, weights=untrained(Compact, tmp_path / "weights.safetensors", 6)
            )
        )
    (tmp_path / "fewer").mkdir()
    untrained(Separate, tmp_path / "fewer" / "baseline-2.safetensors", 5)
    for baselines in (tmp_path / "fewer", None):
        with pytest.raises(InputError, match="other baselines"):
            run.evaluate(replace(finished.options, baselines=baselines))


def test_two_processes_find_what_one_finds(options, monkeypatch, tmp_path):
    # a thread each, as here: figures are compared to the last bit
    monkeypatch.setattr(run.subprocesses, "processors", lambda: 2)
    alone, together = (
        run.evaluate(options),
        run.evaluate(replace(options, out=tmp_path / "two", processes=2)),
    )
    assert len(alone["tables"]["edits"]["rows"]) == 8
    assert together["tables"] == alone["tables"]
    for name in ("edits.jsonl", "pictures.jsonl"):
        one, two = (run.rows_of(out / name) for out in (options.out, tmp_path / "two"))
        assert one == two and len(one) == 2


def test_the_input_unchanged_is_the_picture_itself(data, batch):
    records = Records(data)
    (edit,) = pairs.choose_edits(records.records, 1, 0)
    picture = methods.Unchanged().edit(batch, pairs.target_label(records, edit))
    np.testing.assert_array_equal(
        picture, records.image(edit.source) * records.load(edit.source).mask.numpy()[..., None]
    )
    assert picture.max() > 0.01


def test_the_mean_material_is_of_training_materials_alone(monkeypatch):
    known = {
        "a": (1.0, "train"),
        "b": (3.0, "train"),
        "far off": (1000.0, "test"),
        "farther": (1e6, "validation"),
    }
    entries = {
        name: SimpleNamespace(label=np.full((3, 3, 2, 6), value), split=split)
        for name, (value, split) in known.items()
    }
    monkeypatch.setattr(methods, "load_catalogue", lambda: entries)
    assert (
        methods.MeanMaterial(methods.training_labels(None, "built-in")).label.tolist()
        == [2.0] * 108
    )


def test_the_mean_material_is_of_the_data_sets_own_unless_the_built_in_ones_are_asked_for(data):
    records = Records(data)
    own = [records.label(name) for name in records.materials if records.side(name) == "train"]
    assert own
    mean = methods.MeanMaterial(methods.training_labels(records, "dataset")).label
    np.testing.assert_allclose(mean, np.mean(own, 0), rtol=1e-6)  # float32
    assert len(methods.training_labels(records, "built-in")) == 124


def test_without_materials_for_training_the_mean_material_is_left_out_and_the_reason_told():
    result = methods.list_methods(None, None, [])
    assert not any(
        isinstance(each, methods.MeanMaterial) for each in (*result.edits, *result.parts)
    )
    assert "--materials built-in" in result.left_out["mean material"]


def test_constant_light_takes_normals_as_its_name_says(batch):
    false = batch.n.flip(-1)
    ours = methods.Layered(OURS, lambda b: Prediction(false, None, b.label, None, b.light))
    assert torch.equal(methods.constant_light(ours).parts(batch).n, false)
    assert torch.equal(methods.constant_light().parts(batch).n, batch.n)
    assert not torch.equal(false, batch.n)


def of(name, **cells):
    return {"name": name, "cells": cells}


def test_the_headline_says_what_the_tables_say():
    edits = [
        of("input unchanged", l2=[900.0, 800.0, 1000.0]),
        of(OURS, l2=[200.0, 150.0, 260.0], l2_one_factor=[1.0] * 3, l2_three_factors=[1.0] * 3),
        of(
            OURS_REFINED,
            l2=[150.0, 110.0, 190.0],
            l2_one_factor=[90.0, 80.0, 99.0],
            l2_three_factors=[60.0, 50.0, 70.0],
        ),
    ]
    given = [
        of(OURS, l2_true_light=[120.0, 90.0, 140.0], l2_true_normals=[80.0, 60.0, 100.0]),
        of(OURS_REFINED, l2_true_light=[70.0, 60.0, 80.0], l2_true_normals=[50.0, 40.0, 60.0]),
    ]
    verdicts = {
        "input unchanged": "better",
        "Baseline 1": "better",
        "Baseline 2": "worse",
        OURS: "undecided: 0 is inside",
    }
    differences = [
        of(f"{OURS} − Baseline 1", verdict="worse"),
        of(f"{OURS_REFINED} − the layer alone", verdict="worse"),
    ]
    differences += [
        of(f"{OURS_REFINED} − {name}", verdict=verdict) for name, verdict in verdicts.items()
    ]
    results = {
        "edits": {"rows": edits},
        "differences": {"rows": differences},
        "given": {"rows": given},
        "gains": {"rows": [of("all edits", edits=500, worse=74)]},
    }
    assert report.headline(results) == [
        (
            "An edit differs from its truth by a display L2 of 200 [150, 260] over the mask; after"
            " refinement by 150 [110, 190]: -25 %."
        ),
        (
            "After one factor on the brightness of each edit it is 90, after three on its colour"
            " 60; the brightness of a light cannot be determined from one picture."
        ),
        "With true light instead of predicted it would be 120.",
        "With true normals instead of predicted it would be 80.",
        "Refinement made 74 of 500 edits worse.",
        (
            "By 95 % intervals of the difference on the same edits, “ours, refined” is better than"
            " “input unchanged”, “Baseline 1”; worse than “Baseline 2”; not separable from “ours”."
        ),
    ]


@pytest.mark.parametrize(("label", "best"), [("L2 ↓", "low"), ("SSIM ↑", "high"), ("edits", None)])
def test_the_best_of_a_column_is_where_its_arrow_points(label, best):
    rows = [
        of(name, x=[value, value, value])
        for name, value in (("low", 1.0), ("middle", 2.0), ("high", 3.0))
    ]
    column = {"key": "x", "label": label, "digits": 1, "interval": False}
    assert page._best(rows, column) == best
    marked = re.findall(
        r"<td>(\w+)</td><td class='best'>", page.web_table({"columns": [column], "rows": rows})
    )
    assert marked == ([best] if best else [])


def radiance(display):
    """Of a display value above the curve's straight part, at exposure 1."""
    return ((display / 255 + 0.055) / 1.055) ** 2.4


def test_a_sheet_shows_each_edit_and_its_error_beneath(tmp_path):
    mask = np.zeros((SIZE, SIZE), bool)
    mask[6:26, 6:26] = True
    white = mask & (np.arange(SIZE) < 8)[:, None]  # a tenth: their luminance is the 99th percentile

    def picture(display):
        return np.where(white, 1.0, mask * radiance(display))[..., None].repeat(3, -1)

    truth, pictures = (
        picture(160),
        {name: picture(value) for name, value in (("right", 160), ("off", 128), ("far off", 80))},
    )
    seen = SimpleNamespace(image=torch.from_numpy(0.1 * picture(200)).movedim(-1, 0)[None])
    assert tone.auto_exposure(truth, mask) == pytest.approx(1)
    gallery.write(tmp_path / "sheet.png", seen, truth, pictures, mask)
    inside = (mask & ~white)[gallery.around(mask)]
    colours = [
        [{tuple(map(int, c)) for c in cell[inside]} for cell in both]
        for both in gallery.cells(tmp_path / "sheet.png", 5)
    ]
    above, below = zip(*colours, strict=True)
    # the input under its own exposure
    assert above == tuple({(value,) * 3} for value in (200, 160, 160, 128, 80))
    ground, black, halfway, bright = {(32, 32, 32)}, {(0, 0, 0)}, {(180, 50, 90)}, {(252, 255, 200)}
    # errors of 0, 32 and 80, of 64 that are shown as white
    assert below == (ground, ground, black, halfway, bright)


def test_an_evaluation_refines_unless_told_otherwise(monkeypatch):
    asked = []
    monkeypatch.setattr(
        run, "evaluate", lambda options: asked.append(options) or {"headline": ["done"]}
    )
    parser = argparse.ArgumentParser()
    evaluate.register(parser.add_subparsers())
    for flags in ([], ["--refine"], ["--no-refine"]):
        options = parser.parse_args(
            ["evaluate", "--data", "pictures", "--out", "evaluation", *flags]
        )
        options.run(options)
    assert [options.refine for options in asked] == [True, True, False]
    assert asked[0].data == Path("pictures") and asked[0].edits == 100
