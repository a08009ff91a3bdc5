"""Claims of factory.materials: solvers right, errors measured right, a known material found again,
more closures only when needed.
"""

import os
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import nnls as reference_nnls

from factory.materials import fitting, joint_fit, nnls, recipe, sphere
from manifests.materials import load_catalogue
from shaders import closures, dsbrdf, envmap, errors, frames, label_model, samples, spline
from shaders.mixture import Mixture

QUICK_VIEWS = (0, 12, 24, 36, 47, 57, 66, 74, 81, 86)
QUICK = recipe.Recipe(closures=(4,), views_deg=QUICK_VIEWS, joint=joint_fit.Settings(iterations=12))


def plastic(cos_h, cos_d):
    """A matte base and one DSBRDF lobe: a material that a label can hold exactly."""
    lobe = np.expm1(1.5 * np.exp(60.0 * np.log(cos_h)))
    return (np.array([0.1, 0.05, 0.02]) + lobe[..., None]) * np.ones(
        (*np.broadcast_shapes(np.shape(cos_h), np.shape(cos_d)), 1)
    )


def test_many_small_nnls_are_solved_as_scipy_solves_them(rng):
    A, y = rng.normal(size=(60, 20, 6)) + 0.4, rng.normal(size=(60, 20))
    x, active = nnls.solve(np.swapaxes(A, 1, 2) @ A, (np.swapaxes(A, 1, 2) @ y[..., None])[..., 0])
    expected = np.array([reference_nnls(a, b)[0] for a, b in zip(A, y, strict=True)])
    np.testing.assert_allclose(x, expected, atol=1e-7)  # the ridge of 1e-9 is all that differs
    assert np.array_equal(active, x > 0)


def test_samples_integrate_the_cosine_over_the_hemisphere():
    s = samples.held_out_samples()
    # midpoints: coarsest at the horizon, worst at 75° (0.4 %)
    np.testing.assert_allclose(s.measure.sum(1), np.pi, rtol=6e-3)


def test_view_stops_lie_on_the_ramps_table():
    stops = samples.view_stops(recipe.VIEWS_DEG)
    assert len(stops) <= 32 and (np.diff(stops) > 0).all()
    np.testing.assert_allclose(stops * 255, np.round(stops * 255), atol=1e-9)


def test_no_reported_or_checked_view_is_a_stop():
    stops = np.degrees(np.arccos(1 - samples.view_stops(recipe.VIEWS_DEG)))
    for angle in (*samples.HELD_OUT_DEG[1:], *recipe.CHECK_DEG):
        assert np.abs(stops - angle).min() > 0.4, angle
    assert not set(recipe.CHECK_DEG) & set(samples.HELD_OUT_DEG)


def test_the_label_model_is_the_dsbrdf(rng):
    label = label_model.clip_to_bounds(rng.normal(size=(3, 3, 2, 6)) + np.array([[-1.0], [2.0]]))
    cos_h, theta_d = rng.uniform(0.1, 1, 50), rng.uniform(0, np.pi / 2, 50)
    result = label_model.values(label, spline.basis(theta_d), np.log(cos_h))
    np.testing.assert_allclose(result, dsbrdf.evaluate(np.exp(label), cos_h, theta_d), rtol=1e-10)


def test_the_labels_slopes_are_its_differences(rng):
    label = label_model.clip_to_bounds(
        rng.normal(size=(1, 3, 2, 6)) * 0.5 + np.array([[-1.0], [2.0]])
    )
    basis, log_c = spline.basis(rng.uniform(0, 1.5, 20)), np.log(rng.uniform(0.2, 0.99, 20))
    _, slope = label_model.slopes(label, basis, log_c)
    for i in range(36):
        step = np.zeros(36)
        step[i] = 1e-6
        moved = [
            label_model.values(label + s * step.reshape(label.shape), basis, log_c)[..., 0]
            for s in (1, -1)
        ]
        # central differences: error ~ step²
        np.testing.assert_allclose(
            slope[0, :, i], (moved[0] - moved[1]) / 2e-6, rtol=1e-5, atol=1e-8
        )


def small_problem(rng, view_count=4):
    s = samples.Samples(np.radians(np.linspace(5, 75, view_count)), 16, 6)
    M = plastic(s.cos_h, s.cos_d)
    prior = label_model.initial_labels(plastic)[0]
    problem = joint_fit.JointFit(
        s, M, errors.metric(M, s), joint_fit.Settings(mu=0.2, mu_label=0.3), prior
    )
    shape = view_count, 2
    log_alpha = np.where(np.arange(2) == 0, 0.0, np.log(0.3) + 0.05 * rng.normal(size=shape))
    return problem, joint_fit.State(prior, ("diffuse", "ggx"), log_alpha, np.full(shape, 0.02))


@pytest.mark.parametrize(("part", "tolerance"), [("label", 1e-4), ("nodes", 0.05)])
def test_the_joint_fits_gradient_is_the_slope_of_its_cost(rng, part, tolerance):
    """5 % for the nodes: the closures' own slopes are one-sided differences, with steps of .01 in
    log α and .004 in tilt.
    """
    problem, state = small_problem(rng)
    _, projected = problem.cost(state)
    gradient, H = problem._system(state, projected)
    assert np.allclose(H, H.T)
    direction = rng.normal(size=len(gradient))
    direction[slice(joint_fit.LABEL, None) if part == "label" else slice(joint_fit.LABEL)] = 0
    V, K = state.log_alpha.shape
    nodes = direction[joint_fit.LABEL :].reshape(V, 2, K)
    nodes[:, 0, 0] = 0  # diffuse has no width

    def cost(t):
        moved = replace(
            state,
            label=state.label + t * direction[: joint_fit.LABEL].reshape(state.label.shape),
            log_alpha=state.log_alpha + t * nodes[:, 0],
            tilt=state.tilt + t * nodes[:, 1],
        )
        return problem.cost(moved)[0]

    slope = (cost(1e-5) - cost(-1e-5)) / 2e-5
    # the gradient is of half the cost
    assert 2 * gradient @ direction == pytest.approx(slope, rel=tolerance)


def test_the_joint_fit_never_makes_the_cost_worse(rng):
    problem, state = small_problem(rng)
    before, _ = problem.cost(state)
    after = problem.run(state, iterations=5)
    assert after.cost < 0.5 * before
    assert problem.cost(after)[0] == pytest.approx(after.cost, rel=1e-9)


@pytest.fixture(scope="module")
def fitted_plastic():
    return recipe.fit(plastic, QUICK)


def test_a_material_that_a_label_can_hold_is_found_again(fitted_plastic):
    # four closures on ten stops pull it off by this much
    assert fitted_plastic.label_vs_source.mean() < 0.05
    assert fitted_plastic.nodes_vs_label.mean() < 0.03


def test_errors_are_of_the_numbers_that_are_written(fitted_plastic):
    written = recipe.round_fit(fitted_plastic, plastic)
    assert written.nodes_vs_label.mean() == pytest.approx(
        fitted_plastic.nodes_vs_label.mean(), abs=2e-4
    )
    again = recipe.measure(
        written.label, Mixture.from_json(written.mixture.to_json(recipe.DIGITS)), plastic
    )
    assert np.array_equal(again.nodes_vs_label, written.nodes_vs_label)


def test_nodes_follow_the_label_up_to_the_horizon(fitted_plastic):
    stops = fitted_plastic.mixture.stops
    fitted = int((stops <= samples.view_stops(QUICK.views_deg)[-1]).sum())
    assert np.degrees(np.arccos(1 - stops[fitted:])) == pytest.approx(recipe.GRAZING_DEG, abs=0.2)
    s = samples.Samples(np.radians((87.6, 88.8, 89.5)), 80, 16)
    label = errors.label_values(fitted_plastic.label, s)
    cut = replace(
        fitted_plastic.mixture,
        **{
            name: getattr(fitted_plastic.mixture, name)[:fitted]
            for name in ("stops", "log_alpha", "tilt", "weights")
        },
    )
    without = errors.relative_l1(cut.evaluate(*s.cosines), label, s)
    within = errors.relative_l1(fitted_plastic.mixture.evaluate(*s.cosines), label, s)
    assert (within < 0.15).all() and (within < 0.6 * without).all()


@pytest.mark.parametrize("name", ["chrome", "pink-felt", "brass"])
def test_the_catalogue_has_the_nodes_beyond_the_fitted_views(name):
    material = load_catalogue()[name]
    stops = material.mixture.stops
    fitted = int((stops <= samples.view_stops(recipe.VIEWS_DEG)[-1]).sum())
    assert fitted == len(stops) - len(recipe.GRAZING_DEG)
    parts = ("stops", "log_alpha", "tilt", "weights")
    cut = replace(
        material.mixture, **{part: getattr(material.mixture, part)[:fitted] for part in parts}
    )
    again = recipe.with_grazing_views(material.label.reshape(3, 3, 2, 6), cut)
    for part in parts:
        np.testing.assert_allclose(
            getattr(again, part), getattr(material.mixture, part), rtol=1e-4, atol=1e-5
        )


def test_closures_do_not_turn_away_from_the_viewer_at_the_horizon():
    for name, material in load_catalogue().items():
        cos_o = 1 - material.mixture.stops[:, None]
        # n'·v but for the length of n', as shaders.closures has it
        assert (cos_o + material.mixture.tilt * (1 - cos_o**2) > 0).all(), name
        assert cos_o[-1] < 0.02, name


def test_lobes_stand_in_canonical_order(fitted_plastic):
    assert (np.diff(fitted_plastic.label[:, :, 1].mean((0, 2))) >= 0).all()


def test_a_matte_material_is_given_no_more_closures_than_it_needs():
    def matte(cos_h, cos_d):
        return np.full((*np.broadcast_shapes(np.shape(cos_h), np.shape(cos_d)), 3), 0.15)

    result = recipe.fit(matte, replace(QUICK, closures=(1, 2)))
    assert len(result.mixture.kinds) == 1
    assert result.nodes_vs_label.mean() < QUICK.l1


def test_relative_l1_of_a_scaled_material_is_the_scale():
    s = samples.held_out_samples()
    M = plastic(s.cos_h, s.cos_d)
    np.testing.assert_allclose(errors.relative_l1(1.07 * M, M, s), 0.07, rtol=1e-9)


# --- pictures of a sphere


@pytest.fixture(scope="module")
def small_sphere():
    rng = np.random.default_rng(1)
    L = rng.uniform(0.2, 1, (32, 64, 3))
    L[9, 20] = 60  # a lamp of one texel
    return sphere.Sphere({"lamp": L}, rng, rings=3, azimuths=4, n_theta=96), L


def direct_sum(L, f, normal, cos_o, finer):
    """Radiance (3,) at one normal (camera frame): every texel split into finer² parts."""
    height, width = L.shape[0] * finer, L.shape[1] * finer
    w, solid_angle = envmap.directions(height, width)
    w = w.reshape(-1, 3) @ frames.camera_from_light().T
    cos_i = w @ normal
    w, part, cos_i = w[cos_i > 1e-3], solid_angle.ravel()[cos_i > 1e-3], cos_i[cos_i > 1e-3]
    h = w + np.array([0.0, 0.0, 1.0])
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    row, column = envmap.texel(w @ frames.camera_from_light(), *L.shape[:2])
    weight = (
        f(cos_i, np.full_like(cos_i, cos_o), h @ normal, np.clip(h[:, 2], 1e-3, 1)) * cos_i * part
    )
    return weight @ L[row, column]


@pytest.mark.parametrize(
    ("alpha", "finer", "tolerance"), [(0.5, 4, 0.02), (0.1, 6, 0.02), (0.02, 24, 0.02)]
)
def test_sphere_pictures_are_the_sum_over_the_light(small_sphere, alpha, finer, tolerance):
    """2 %: f is bilinear between 96 × 13 nodes, which overestimates the bend of a lobe."""
    ball, L = small_sphere

    def f(*c):
        return closures.ggx(alpha, *c)

    picture = ball.picture(np.repeat(f(*ball.nodes())[..., None], 3, -1))[:, :, 0]
    for i, j in ((0, 0), (1, 2), (2, 1)):
        r, a = (i + 0.5) / 3, (j + 0.5) * np.pi / 2
        z = np.sqrt(1 - r * r)
        expected = direct_sum(L, f, np.array([r * np.cos(a), r * np.sin(a), z]), z, finer)
        np.testing.assert_allclose(picture[i, j], expected, rtol=tolerance)


def test_display_l2_of_a_picture_with_itself_is_nothing(small_sphere):
    ball, _ = small_sphere
    picture = ball.picture(np.full((3, ball.theta_h.size, 3), 0.3))
    assert ball.display_l2(picture, picture) == 0
    assert ball.display_l2(0.9 * picture, picture) > 1


def test_weighted_percentile_of_equal_weights_is_nearly_numpys(rng):
    values = rng.normal(size=1000)
    assert sphere.weighted_percentile(values, np.ones(1000), 90) == pytest.approx(
        np.percentile(values, 90), abs=0.02
    )


def test_display_errors_of_a_fit_are_one_a_map_and_small_for_a_good_one(
    fitted_plastic, small_sphere
):
    shown = recipe.display(fitted_plastic, plastic, small_sphere[0])
    assert [len(values) for values in shown] == [1, 1, 1]
    assert 0 < shown[0][0] < 25  # five display values of 255: a fit on ten view stops


def test_noise_on_a_measurement_is_as_large_as_asked_for(rng):
    from factory.materials.conditioning import Noisy

    cos_h, cos_d = rng.uniform(0.05, 1, 4000), rng.uniform(0.05, 1, 4000)
    off = np.concatenate(
        [np.log(Noisy(plastic, 0.01, rng)(cos_h, cos_d) / plastic(cos_h, cos_d)) for _ in range(40)]
    )
    assert np.sqrt((off**2).mean()) == pytest.approx(0.01, rel=0.1)  # 40 draws of six waves: 5 %


@pytest.mark.parametrize(
    ("fail", "message"),
    [
        (lambda: os._exit(1), "materials: expected processes that live.* fewer --workers"),
        (lambda: int("none"), "invalid literal"),
    ],
    ids=["ended", "raised"],
)
def test_a_fit_that_fails_leaves_out_those_that_were_not_begun(
    tmp_path, monkeypatch, fail, message
):
    """A pool waits for all that it was given; a catalogue's fits take hours."""

    def fitted(measured, _):
        (tmp_path / measured).touch()
        if measured == "1":
            fail()
        time.sleep(0.1)

    names = [str(number) for number in range(24)]
    monkeypatch.setattr(recipe, "fit", fitted)
    monkeypatch.setattr(recipe, "round_fit", lambda fit, _: fit)
    monkeypatch.setattr(fitting, "entry", lambda *_: None)
    monkeypatch.setattr(fitting, "write_entry", lambda *_: None)
    worker = {
        "sources": {name: SimpleNamespace(measured=name) for name in names},
        "recipe": None,
        "sphere": None,
        "files": dict.fromkeys(names),
    }
    monkeypatch.setattr(fitting, "_WORKER", worker)
    with pytest.raises(ValueError, match=message):
        list(fitting._each(names, 2))
    assert len(list(tmp_path.iterdir())) < len(names)
