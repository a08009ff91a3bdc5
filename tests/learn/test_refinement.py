"""Refinement: it goes down, never up, stays in the domain, and finds what is known where it can be
known.
"""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from scipy.optimize import OptimizeResult, minimize

from learn.data.batch import ExampleBatch
from learn.experiments.__main__ import COMMANDS
from learn.experiments.editing import (
    refinement_chart,
    refinement_initialisations,
    refinement_sweep,
)
from learn.layer import render
from learn.metrics.radiometry import log_albedo
from learn.networks.prediction import Prediction
from learn.refinement import RefinementSettings, descent, refine
from learn.refinement.coordinates import (
    LightCoordinates,
    MaterialCoordinates,
    NormalCoordinates,
    principal_directions,
    spherical_harmonics,
)
from learn.refinement.energy import Energy, State
from learn.refinement.settings import Level
from manifests.cli import main
from manifests.errors import InputError
from manifests.materials import load_catalogue
from shaders import envmap, tone
from tests.support.synthetic import entry, write_dataset

SIZE, ELEVATION = 24, 0.349
LEVELS = (Level(pixels=120, light=(16, 32), method="exact", rounds=1, iterations=4),)
QUICK = replace(RefinementSettings(), levels=LEVELS)


def sky(seed=0):
    """A smooth light with a bright side, of unit mean luminance."""
    w, _ = envmap.directions(64, 128)
    side = torch.nn.functional.normalize(
        torch.randn(3, generator=torch.Generator().manual_seed(seed)), dim=0
    ).numpy()
    L = np.exp(1.2 * (w @ side))[..., None] * [1.1, 1.0, 0.8]
    return torch.from_numpy(envmap.unit_mean(L)[0]).movedim(-1, 0)[None]


LABELS = [material.label.reshape(108) for material in load_catalogue().values()]


def label_of(name):
    return torch.from_numpy(load_catalogue()[name].label.reshape(1, 1, 108).astype(np.float32))


@pytest.fixture
def scene():
    """A ball's picture with its truth as a Prediction."""
    at = (torch.arange(SIZE) + 0.5) / SIZE * 2.2 - 1.1
    x, y = torch.meshgrid(at, -at, indexing="xy")
    inside = x * x + y * y < 0.95
    z = (1 - x * x - y * y).clamp(min=0.01).sqrt()
    n = F.normalize(torch.stack([x, y, z]), dim=0)[None] * inside
    label, light = label_of("blue-rubber"), sky()
    picture = render(
        n.movedim(1, -1).contiguous(),
        label[:, 0].exp(),
        light.movedim(1, -1).contiguous(),
        mask=inside[None],
        method="exact",
    )
    image, mask = picture.movedim(-1, 1).contiguous(), inside[None, None].float()
    batch = ExampleBatch(
        image, mask, n, inside[None].long(), label, light, label, ("ball",), ELEVATION
    )
    return batch, Prediction(n, None, label, None, light)


def perturbed(prediction, seed):
    """A start that may be anything: random material, a wild light, normals that point
    everywhere.
    """
    rng = torch.Generator().manual_seed(seed)
    names = sorted(load_catalogue())
    label = (
        label_of(names[int(torch.randint(len(names), (1,), generator=rng))])
        + torch.randn(1, 1, 108, generator=rng) * (seed % 3) * 0.2
    )
    n = prediction.n + torch.randn(prediction.n.shape, generator=rng) * 0.5
    n[:, 2] = n[:, 2].abs() * (1 if seed % 2 else 1e-3)
    light = [torch.ones_like(prediction.light), sky(seed) ** 4, torch.zeros_like(prediction.light)][
        seed % 3
    ]
    return Prediction(F.normalize(n, dim=1), None, label, None, light)


@pytest.mark.parametrize("seed", range(6))
def test_no_start_however_bad_ends_above_itself_or_leaves_the_domain(scene, seed):
    batch, truth = scene
    result = refine(batch, perturbed(truth, seed), QUICK)
    assert result.after["total"] <= result.before["total"]
    n, inside = result.prediction.n[0], batch.segments[0] > 0
    assert all(
        torch.isfinite(part).all()
        for part in (result.prediction.label, result.prediction.light, n[:, inside])
    )
    assert (result.prediction.light > 0).all()
    np.testing.assert_allclose(n[:, inside].norm(dim=0), 1, atol=1e-5)  # float32
    assert (n[2, inside] > 0).all()


def test_a_stride_to_where_the_layer_cannot_follow_is_turned_back(scene, monkeypatch):
    batch, truth = scene
    strides = []

    def far_first(value_and_slope, x, **options):
        for far in (1e4, -1e4, np.nan):
            value, slope = value_and_slope(x + far)
            assert value == descent.NOWHERE and not slope.any()
        strides.append(len(x))
        return minimize(value_and_slope, x, **options)

    monkeypatch.setattr(descent, "minimize", far_first)
    result = refine(
        batch, perturbed(truth, 1), replace(QUICK, order=("material",), outer_iterations=1)
    )
    assert strides and result.after["total"] < result.before["total"]


def test_a_step_that_ends_there_is_taken_back(scene, monkeypatch):
    batch, truth = scene
    monkeypatch.setattr(
        descent, "minimize", lambda value_and_slope, x, **options: OptimizeResult(x=x + 1e4)
    )
    result = refine(batch, truth, replace(QUICK, order=("material",), outer_iterations=1))
    assert not result.history and result.after == result.before


def test_a_prediction_that_is_not_finite_is_refused(scene):
    batch, truth = scene
    for label in (truth.label + 100, truth.label * np.nan):
        with pytest.raises(ValueError, match="weights"):
            refine(batch, truth._replace(label=label), QUICK)


def test_what_is_accepted_lowers_the_energy_each_time(scene):
    batch, truth = scene
    result = refine(batch, perturbed(truth, 1), replace(QUICK, a=0.05, b=0.05, outer_iterations=1))
    totals = [result.before["total"]] + [
        step["total"] for step in result.history if step["accepted"]
    ]
    assert len(totals) > 2
    assert all(b < a for a, b in pairwise(totals))
    assert totals[-1] == result.after["total"]


def test_a_second_pass_comes_nearer_to_the_picture_and_stays_below_the_start(scene):
    batch, truth = scene
    start = perturbed(truth, 1)
    once, twice = (refine(batch, start, replace(QUICK, outer_iterations=count)) for count in (1, 2))
    assert {line["pass"] for line in twice.history} == {0, 1}
    assert twice.after["image"] < 0.9 * once.after["image"]
    assert twice.after["total"] < twice.before["total"] == once.before["total"]


def test_a_second_pass_that_ends_above_the_start_counts_for_nothing(scene, monkeypatch):
    batch, truth = scene
    start = perturbed(truth, 1)
    once = refine(batch, start, replace(QUICK, outer_iterations=1))
    plain, calls = descent.run_outer_iteration, []

    def lost(*arguments):
        calls.append(arguments)
        result, *rest = plain(*arguments)
        if len(calls) == 2:
            result = replace(result, light=result.light.roll(64, -1) ** 4)
        return result, *rest

    monkeypatch.setattr(descent, "run_outer_iteration", lost)
    result = refine(batch, start, replace(QUICK, outer_iterations=2))
    assert len(calls) == 2
    assert (
        torch.equal(result.prediction.light, once.prediction.light) and result.after == once.after
    )


def test_all_pixels_are_rendered_as_a_frame_and_some_as_a_list_to_the_same_picture(scene):
    batch, truth = scene
    half = batch.segments.clone()
    half[:, :, SIZE // 2 :] *= 2
    two = State(
        truth.label.repeat(1, 2, 1).double(), truth.light, truth.n, {"material": torch.zeros(2, 3)}
    )
    two.label[:, 1] += 0.2
    for scene_of, state in (
        (batch, replace(two, label=two.label[:, :1])),
        (replace(batch, segments=half), two),
    ):
        energy = Energy(scene_of, state, RefinementSettings())
        frame = energy.image(state, energy.inside, (64, 128), "exact", 1e-3)
        parts = [
            energy.image(state, where, (64, 128), "exact", 1e-3) * len(where)
            for where in energy.inside.chunk(2)
        ]
        assert float(frame) == pytest.approx(float(sum(parts)) / len(energy.inside), rel=1e-4)


def test_the_truth_is_left_where_it_is(scene):
    batch, truth = scene
    result = refine(batch, truth, QUICK)
    assert result.before["image"] < 1e-4  # auto at 5e-3 against the exact picture
    assert (result.prediction.label - truth.label).abs().max() < 0.1


def test_a_wrong_albedo_is_found_again_when_only_the_material_may_move(scene):
    batch, truth = scene
    dark = truth._replace(
        label=truth.label - torch.tensor([0.5, 0.0]).repeat_interleave(6).repeat(9)
    )
    level = Level(pixels=0, light=(64, 128), method="exact", rounds=1, iterations=15)
    result = refine(
        batch,
        dark,
        replace(
            RefinementSettings(), order=("material",), c=0.0, outer_iterations=1, levels=(level,)
        ),
    )
    assert result.after["image"] < 0.02 * result.before["image"]
    assert torch.equal(
        result.prediction.light,
        refine(
            batch, dark, replace(RefinementSettings(), order=(), outer_iterations=1)
        ).prediction.light,
    )


def test_the_energy_does_not_grow_with_the_picture_or_the_map(scene):
    batch, truth = scene
    start = State(truth.label.double(), truth.light, truth.n, {"material": torch.zeros(1, 3)})
    n = F.normalize(truth.n + 0.1, dim=1)
    moved = State(truth.label.double() + 0.3, truth.light * 1.5, n, {"material": torch.ones(1, 3)})
    energy = Energy(batch, start, RefinementSettings())
    whole, part = (
        energy.terms(moved, energy.inside),
        energy.terms(moved, energy.pixels(100), (32, 64), "exact"),
    )
    for name in whole:
        # a hundred of 350 pixels
        assert float(part[name]) == pytest.approx(float(whole[name]), rel=0.15), name


def test_regions_move_apart(scene):
    batch, truth = scene
    half = batch.segments.clone()
    half[:, :, SIZE // 2 :] *= 2
    two = truth.label.repeat(1, 2, 1)
    brighter = two.clone()
    brighter[:, 1] += torch.tensor([0.6, 0.0]).repeat_interleave(6).repeat(9)
    result = refine(
        replace(batch, segments=half),
        truth._replace(label=brighter),
        replace(QUICK, order=("material",), c=0.0),
    )
    change = (log_albedo(result.prediction.label) - log_albedo(brighter)).abs().amax(-1)[0]
    # by albedo: no picture tells what moves a label and not its BRDF
    assert change[1] > 5 * change[0]


def test_harmonics_are_orthogonal_over_the_sphere():
    waves = spherical_harmonics(64, 128, 4).reshape(25, -1)
    share = envmap.directions(64, 128)[1].reshape(-1) / (4 * np.pi)
    gram = (waves * share) @ waves.T
    # texel centres for an integral
    np.testing.assert_allclose(gram, np.diag(np.diag(gram)), atol=2e-3)
    by_degree = sorted(1 / np.sqrt(np.diag(gram)))
    expected = [1 + degree for degree in range(5) for _ in range(2 * degree + 1)]
    np.testing.assert_allclose(by_degree, expected, rtol=5e-3)


def test_coordinates_at_zero_are_the_prediction(scene):
    batch, truth = scene
    inside = batch.segments > 0
    zero = [
        torch.zeros(part.shape, dtype=torch.float64)
        for part in (MaterialCoordinates(truth.label), LightCoordinates(truth.light, 3))
    ]
    assert torch.equal(MaterialCoordinates(truth.label)(zero[0]).float(), truth.label)
    np.testing.assert_allclose(LightCoordinates(truth.light, 3)(zero[1]), truth.light, rtol=1e-4)
    normals = NormalCoordinates(truth.n, inside, 0.3)
    again = normals(torch.zeros(normals.shape, dtype=torch.float64))
    seen = inside & (truth.n[:, 2] > 0.2)  # nearer the rim they are drawn in
    np.testing.assert_allclose(again.movedim(1, -1)[seen], truth.n.movedim(1, -1)[seen], atol=1e-6)


def test_material_directions_span_the_training_materials():
    directions = principal_directions()
    spread = np.linalg.norm(directions, axis=1)
    assert (np.diff(spread) <= 1e-12).all()
    gram = directions @ directions.T
    np.testing.assert_allclose(gram, np.diag(spread**2), atol=1e-8)


def test_more_than_one_picture_is_refused(scene):
    batch, truth = scene
    with pytest.raises(ValueError, match="one by one"):
        refine(replace(batch, image=batch.image.repeat(2, 1, 1, 1)), truth)


def test_a_studys_settings_are_read_from_their_names():
    assert refinement_sweep.settings_of("default") == RefinementSettings()
    assert refinement_sweep.settings_of("passes=1").outer_iterations == 1
    assert {level.pixels for level in refinement_sweep.settings_of("pixels=600").levels} == {600}
    assert refinement_sweep.settings_of("c=0.1").c == 0.1
    for moved, values in refinement_sweep.SWEEPS.items():
        assert refinement_sweep.value_of(moved) in values, moved  # the chart shades it
        assert [
            refinement_sweep.value_of(moved, refinement_sweep.settings_of(f"{moved}={value:g}"))
            for value in values
        ] == list(values)
    with pytest.raises(InputError, match="a setting"):
        refinement_sweep.settings_of("d=1")


def known_cases(scene, count):
    """Cases of one picture under several ids; what it is called is the same."""
    batch, truth = scene
    picture = batch.image[0].movedim(0, -1).numpy()
    return [
        refinement_sweep.Case(f"record-{i}", batch, [(truth.label[0], picture)])
        for i in range(count)
    ]


def test_a_study_has_a_row_a_picture_goes_on_where_it_was_and_refuses_other_weights(
    scene, tmp_path, monkeypatch
):
    made, refine_ = [], refinement_sweep.refine
    monkeypatch.setattr(
        refinement_sweep,
        "refine",
        lambda batch, start, settings: made.append(settings.a) or refine_(batch, start, QUICK),
    )
    start = perturbed(scene[1], 3)
    report = refinement_sweep.sweep(
        lambda _: start, known_cases(scene, 3), tmp_path, ["default", "a=1"]
    )
    assert report["default"]["pictures"] == report["a=1"]["pictures"] == 3
    assert made == [0.05] * 3 + [1.0] * 3
    made.clear()
    fewer = refinement_sweep.sweep(lambda _: start, known_cases(scene, 2), tmp_path, ["default"])
    assert not made and set(fewer) == {"default"} and fewer["default"]["pictures"] == 2
    refinement_sweep.pin_settings(tmp_path, {"weights": "one"})
    refinement_sweep.pin_settings(tmp_path, {"weights": "one"})
    with pytest.raises(InputError, match="other weights"):
        refinement_sweep.pin_settings(tmp_path, {"weights": "two"})


def test_a_weight_moved_beside_the_default_alone_is_charted():
    row = {figure: [2.0, 1.0, 2.0, 1.0] for figure in refinement_sweep.FIGURES}
    assert len(refinement_chart.draw({"a=0.1": row}).axes) == 4
    assert refinement_chart.draw({"default": row}) is None


def test_starts_are_of_every_kind_in_turn(scene, tmp_path):
    start = perturbed(scene[1], 3)
    report = refinement_initialisations.measure_refinements(
        lambda _: start, known_cases(scene, 4), 6, tmp_path, LABELS, QUICK
    )
    rows = [json.loads(line) for line in (tmp_path / "starts.jsonl").read_text().splitlines()]
    assert [row["kind"] for row in rows] == [
        *refinement_initialisations.KINDS,
        refinement_initialisations.KINDS[0],
    ]
    assert list(report["by_kind"]) == list(refinement_initialisations.KINDS)
    assert report["above_their_start"] == report["not_finite"] == 0


def test_a_studys_figures_are_of_the_parts_it_is_given(scene):
    (case,), start = known_cases(scene, 1), perturbed(scene[1], 3)
    result, own = (
        refinement_sweep.figures(start, case.batch, case.truths),
        refinement_sweep.figures(scene[1], case.batch, case.truths),
    )
    label, truth = case.truths[0]
    mask = (case.batch.segments[0] > 0).numpy()
    level = tone.auto_exposure(truth, mask)
    assert result["edit"] == pytest.approx(
        tone.display_l2(refinement_sweep.picture(start, label, case.batch), truth, level, mask)
    )
    assert result["image"] == pytest.approx(
        tone.display_l2(
            refinement_sweep.picture(start, start.label[0], case.batch), truth, level, mask
        )
    )
    assert own["edit"] < 1 < 20 < result["edit"] and own["image"] < 1 < 20 < result["image"]
    assert (
        own["angle_deg"] < 0.1 < 10 < result["angle_deg"]
        and own["light"] == 0 < 0.1 < result["light"]
    )


def test_starts_count_what_ended_above_and_what_is_not_finite(scene, tmp_path, monkeypatch):
    start = perturbed(scene[1], 3)
    bad = start._replace(light=torch.full_like(start.light, torch.nan))
    ends = iter([(start, 0.5), (start, 1.5), (start, 2.0), (bad, 0.5)])

    def refined(batch, start, settings):
        prediction, after = next(ends)
        return descent.RefinementResult(prediction, {"total": 1.0}, {"total": after}, [], 0.0)

    monkeypatch.setattr(refinement_initialisations, "refine", refined)
    monkeypatch.setattr(
        refinement_initialisations,
        "picture",
        lambda parts, *_: np.zeros((SIZE, SIZE, 3), np.float32),
    )
    report = refinement_initialisations.measure_refinements(
        lambda _: start, known_cases(scene, 1), 4, tmp_path, LABELS
    )
    assert (report["starts"], report["above_their_start"], report["not_finite"]) == (4, 2, 1)


def test_the_command_measures_and_goes_on(tmp_path, rng, capsys, monkeypatch):
    for module in (refinement_sweep, refinement_initialisations):
        monkeypatch.setattr(
            module,
            "refine",
            lambda batch, start, settings: refine(
                batch, start, replace(settings, levels=LEVELS, outer_iterations=1)
            ),
        )
    catalogue = load_catalogue()
    materials = [
        entry(name, catalogue[name].m.reshape(3, 3, 2, 6), catalogue[name].mixture)
        for name in ("red-fabric", "delrin")
    ]
    write_dataset(tmp_path / "data", materials, rng, size=32, seeds=1, rotations=(0,))
    words = [
        "refinement-ablation",
        "--data",
        str(tmp_path / "data"),
        "--out",
        str(tmp_path / "out"),
        "--pictures",
        "1",
        "--only",
        "default",
        "a=0.2",
    ]
    assert main("learn.experiments", "t", COMMANDS, [*words, "--starts", "5"]) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert set(report["settings"]) == {"default", "a=0.2"} and set(report["times"]) == {"32", "64"}
    ends = report["initialisations"]
    assert ends["starts"] == 5 and len(ends["by_kind"]) == 5 and report["made_by"]["commit"]
    before, after = report["settings"]["default"]["image"][:2]
    assert after < before
    assert (tmp_path / "out" / "chart.png").exists()
    assert "| noisy normals |" in (tmp_path / "out" / "report.md").read_text()
    before = [(tmp_path / "out" / name).read_bytes() for name in ("rows.jsonl", "starts.jsonl")]
    assert main("learn.experiments", "t", COMMANDS, [*words, "--starts", "5"]) == 0
    assert [
        (tmp_path / "out" / name).read_bytes() for name in ("rows.jsonl", "starts.jsonl")
    ] == before
    for wrong in (["--pictures", "0"], ["--starts", "-3"]):
        with pytest.raises(SystemExit):
            main("learn.experiments", "t", COMMANDS, [*words, *wrong])
    capsys.readouterr()


def cliff(x):
    """A bowl with a middle that lies higher: at its rim the value jumps, the gradient does not."""
    scales = np.array([1.0, 7.0, 30.0])
    return float((scales * x**2).sum() + 100 * (x[0] < 1.5)), 2 * scales * x


def test_a_line_search_of_too_many_trials_ends_the_descent_at_the_lowest_value_met():
    start, values = np.array([3.0, -2.0, 0.5]), []

    def counted(x):
        values.append(cliff(x)[0])
        return cliff(x)

    descent.run_lbfgs(counted, start, 20)
    assert len(values) > 40  # line searches towards the cliff
    values.clear()
    lowest = descent.run_lbfgs(counted, start, 20, 5)
    assert len(values) < 15
    assert cliff(lowest)[0] == min(values) < 0.2 * values[0]


def test_a_descent_whose_line_searches_are_short_is_the_same_with_a_limit():
    start = np.array([3.0, -2.0, 0.5])
    scales = np.array([1.0, 4.0, 9.0])

    def bowl(x):
        return float((scales * x**2).sum()), 2 * scales * x

    np.testing.assert_array_equal(
        descent.run_lbfgs(bowl, start, 8), descent.run_lbfgs(bowl, start, 8, 5)
    )


@pytest.mark.parametrize("most", [None, 4])
def test_each_step_of_refinement_has_the_settings_limit_on_line_searches(scene, monkeypatch, most):
    batch, truth = scene
    limits, plain = [], descent.run_lbfgs

    def recorded(function, x, iterations, most_trials=None):
        limits.append(most_trials)
        return plain(function, x, iterations, most_trials)

    monkeypatch.setattr(descent, "run_lbfgs", recorded)
    refine(batch, perturbed(truth, 1), replace(QUICK, outer_iterations=1, most_trials=most))
    assert len(limits) > 2 and set(limits) == {most}
