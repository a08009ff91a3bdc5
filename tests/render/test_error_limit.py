"""Pictures to an error by Cycles: their portions, the denoiser, direct light without noise, and the
error that they have beside a reference.
"""

import functools
import gc
import weakref
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from factory.render.estimators import choice, closed_form
from factory.render.estimators.halves import Halves
from factory.render.estimators.renderer import Effort, Shown, effort
from factory.render.settings import PASSES, PORTION
from manifests.schema import Camera
from shaders import tone
from shaders.mixture import Mixture

pytest.importorskip("numba")
pytestmark = pytest.mark.blender
SIZE = 40
MATTE = Mixture.lambert([0.4, 0.5, 0.6])


@functools.cache
def assets():
    """A mesh, and the light map of a low sun."""
    from factory.lights import load as load_light
    from factory.shapes.catalogue import load

    return load("chair:2"), load_light("sunrise").L64


def show(studio, lens=None, rotation=9, resolution="64x128", mixture=MATTE, azimuth=0.5):
    """Let a studio show a small chair under a sunrise, whatever it showed before."""
    mesh, L = assets()
    studio.set_camera(lens or Camera(size=(SIZE, SIZE)))
    studio.set_shape(mesh)
    studio.set_light(L, rotation, resolution)
    studio.set_materials([mixture] * mesh.segments)
    studio.set_view(azimuth)
    return studio


@pytest.fixture
def chair(studio):
    return show(studio)


def same(one, other):
    """Whether two pictures are the same but for what threads leave open."""
    return np.allclose(one, other, rtol=1e-4, atol=1e-5)


def test_portions_of_a_sequence_add_up_to_the_whole(chair):
    whole = chair.portion(0, 16, 3, "full").noisy
    parts = [chair.portion(first, count, 3, "full").noisy for first, count in ((0, 4), (4, 12))]
    assert not np.allclose(parts[0], parts[1], rtol=0.01)
    assert same((4 * parts[0] + 12 * parts[1]) / 16, whole)


@pytest.mark.parametrize(
    "change", [{"rotation": 40}, {"azimuth": 1.4}, {"mixture": Mixture.lambert([0.6] * 3)}]
)
def test_a_portion_shows_each_change_and_does_not_depend_on_what_was_before(chair, change):
    before = chair.portion(0, 4, 3, "full")
    chair.denoise(before, effort(4))
    assert not same(show(chair, **change).portion(0, 4, 3, "full").noisy, before.noisy)
    chair.portion(4, 8, 3, "direct")
    chair.geometry()
    assert same(show(chair).portion(0, 4, 3, "full").noisy, before.noisy)


def test_after_portions_the_canary_still_sees_a_light_that_cycles_did_not_notice(chair):
    import bpy

    from factory.render import canary, light

    chair.denoise(chair.portion(0, 4, 3, "full"), effort(4))
    canary.check(chair._scene, chair._seen_light, nearest=True)
    other = chair._seen_light[::-1].copy()
    (image,) = (each for each in bpy.data.images if each.name.startswith("light"))
    image.pixels.foreach_set(light.blender_pixels(other).ravel())
    image.update()
    chair.portion(0, 4, 3, "full")
    with pytest.raises(RuntimeError, match="expected the map that was set"):
        canary.check(chair._scene, other, nearest=True)


def test_portions_leave_no_setting_behind(chair):
    scene, layer = chair._scene, chair._scene.view_layers[0]

    def held():
        # which samples are rendered is set for every picture
        paths = [each.path for each in PORTION if each.path != "cycles.samples"]
        paths += ["cycles.sample_offset", "cycles.use_denoising"]
        return [scene.path_resolve(path) for path in paths]

    settings = held()
    portion = chair.portion(4, 8, 3, "full")
    assert held() == settings
    chair.denoise(portion, effort(8))
    assert held() == settings and not any(layer.path_resolve(path) for path in PASSES)


def test_a_picture_of_fixed_samples_is_the_same_before_and_after_portions(chair):
    """As long as the object stays Cycles draws from the longest sequence that it has made: pictures
    are compared that follow a portion, and pictures of the object when it is set again.
    """
    alone = chair.picture(4, 3, "full")[0]
    chair.portion(0, 1, 3, "full")
    before = chair.picture(4, 3, "full")[0]
    chair.denoise(chair.portion(4, 8, 3, "full"), effort(8))
    assert same(chair.picture(4, 3, "full")[0], before)
    assert same(show(chair).picture(4, 3, "full")[0], alone)


def test_the_denoiser_removes_most_noise(chair):
    plain = chair.portion(0, 4, 3, "shadow")
    smooth = chair.denoise(plain, effort(64))
    assert smooth.min() >= 0
    exact = chair.portion(0, 1024, 4, "shadow").noisy
    mask = chair.geometry().mask
    errors = [tone.display_l2(each, exact, 1.0, mask) for each in (smooth, plain.noisy)]
    assert errors[0] < errors[1] / 2


def test_a_denoised_picture_is_the_mean_over_its_flips(chair):
    import bpy

    from factory.render import denoiser

    portion = chair.portion(0, 4, 3, "shadow")
    once, four = (Effort("BALANCED", flips, 1.0, 1.0) for flips in (1, 4))
    each = [
        denoiser.denoise(chair._scene, *(part[::rows, ::columns] for part in portion[:3]), once)[
            ::rows, ::columns
        ]
        for rows, columns in denoiser.FLIPS
    ]
    mean = denoiser.denoise(chair._scene, *portion[:3], four)
    np.testing.assert_allclose(mean, sum(each) / 4, atol=1e-5)
    assert np.abs(each[0] - each[1]).max() > 1e-3 and len(set(denoiser.FLIPS)) == 4
    filtered = denoiser.denoise(chair._scene, *portion[:3], once._replace(prefilter=True))
    assert np.abs(filtered - each[0]).max() > 1e-3
    assert not chair._scene.cycles.use_denoising
    assert not list(Path(bpy.app.tempdir).glob("*.exr"))  # nothing is left behind


def test_direct_light_by_the_closed_form_is_what_many_samples_show(chair):
    mask = chair.geometry().mask
    exact = chair.direct_light()
    many = Halves(Shown(chair, 4, "direct", mask))
    many.grow(1024)
    exposure = tone.auto_exposure(many.picture, mask)
    error = tone.display_l2(exact.radiance, many.picture, exposure, mask)
    assert error < 8 + many.estimate().error
    shaded = chair.portion(0, 256, 3, "shadow").noisy
    assert tone.display_l2(exact.radiance, shaded, exposure, mask) > 10 * error
    np.testing.assert_allclose(exact.alpha, many.alpha, atol=0.2)
    assert abs(exact.alpha.mean() - many.alpha.mean()) < 2e-3


def test_more_points_of_direct_light_are_nearer_to_the_most_as_their_differences_say(chair):
    mask = chair.geometry().mask
    finest = chair.direct_light(256)
    exposure = tone.auto_exposure(finest.radiance, mask)
    errors, expected = [], []
    for points in (16, 64):
        direct = chair.direct_light(points)
        errors.append(tone.display_l2(direct.radiance, finest.radiance, exposure, mask))
        expected.append(closed_form.error_by_differences(direct, mask))
    assert errors[1] < errors[0] / 2 and expected[1] < expected[0] / 2
    assert all(0.02 < e / d < 0.6 for e, d in zip(errors, expected, strict=True))


def test_direct_light_is_made_finer_where_it_is_asked_for(chair):
    coarse, fine = (chair.direct_light(points) for points in (16, 64))
    where = np.zeros((SIZE, SIZE), bool)
    where[:, : SIZE // 2] = chair.geometry().mask[:, : SIZE // 2]
    mixed = chair.direct_light(64, coarse, where)
    for name in ("radiance", "alpha", "variance"):
        before, after, values = (getattr(each, name) for each in (coarse, fine, mixed))
        np.testing.assert_allclose(values[where], after[where], rtol=1e-4, atol=1e-5)
        assert (values[~where] == before[~where]).all()
        assert np.abs(after[where] - before[where]).max() > 1e-3 * np.abs(before).max()


def test_what_grids_of_points_see_is_looked_at_once_for_each_view(chair, monkeypatch):
    from factory.render import view_light as module

    look, seen = chair._direct_light._look, []

    def counted(view, across, shift, where):
        seen.append((across, None if where is None else int(where.sum())))
        return look(view, across, shift, where)

    monkeypatch.setattr(chair._direct_light, "_look", counted)
    chair.forget_grids()
    first = chair.direct_light(64)
    where = chair.geometry().mask
    seen.clear()
    again = chair.direct_light(64)
    assert seen == []
    chair.direct_light(16, again, where)
    assert seen == [(2, where.sum())] * 4  # in those pixels alone
    seen.clear()
    less, more = where.copy(), where.copy()
    less[: SIZE // 2], more[0] = False, True
    chair.direct_light(16, again, less)
    assert seen == []
    chair.direct_light(16, again, more)
    assert seen == [(2, more.sum())] * 4
    for name in ("radiance", "alpha", "variance"):
        assert (getattr(first, name) == getattr(again, name)).all()
    # another view, the same view again, and more points than are kept: nothing old is shown
    chair.set_view(1.5)
    other = chair.direct_light(64).radiance
    assert np.abs(other - first.radiance).max() > 0.1
    monkeypatch.setattr(module, "MOST_KEPT", 0)
    chair.forget_grids()
    seen.clear()
    assert (chair.direct_light(64).radiance == other).all()
    assert (chair.direct_light(64).radiance == other).all()
    assert len(seen) == 8 and not chair._direct_light.grids


def test_what_grids_of_points_see_is_let_go_with_its_view_and_its_shape(chair):
    def kept():
        return [weakref.ref(grid.surface.depth) for grid in chair._direct_light.grids.values()]

    def alive(references):
        gc.collect()
        return sum(each() is not None for each in references)

    chair.direct_light(64)
    first = kept()
    assert alive(first) == len(first) > 0
    chair.set_view(1.5)
    chair.direct_light(64)
    second = kept()
    assert (alive(first), alive(second)) == (0, len(first))
    chair.set_shape(assets()[0])
    assert alive(second) == 0 and not chair._direct_light.grids


def test_the_share_of_leaning_points_is_known_before_direct_light_is_computed(chair):
    share = chair.direct_light_work(16).leaning
    surface = chair._surface()
    cosines = (surface.normals * surface.facets).sum(1)
    assert share == pytest.approx((cosines < np.cos(np.radians(2))).mean(), abs=0.01)
    assert 0.02 < share < 1
    chair.set_view(1.5)
    assert chair.direct_light_work(16).leaning != share


def test_direct_light_follows_the_material_and_the_light(chair):
    first = chair.direct_light().radiance
    chair.set_materials([Mixture.lambert([0.8, 0.5, 0.6])] * len(chair._mixtures))
    other = chair.direct_light().radiance
    np.testing.assert_allclose(other[..., 0], 2 * first[..., 0], rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(other[..., 1:], first[..., 1:], rtol=1e-3, atol=1e-4)
    chair.set_light(2 * chair._seen_light)
    np.testing.assert_allclose(chair.direct_light().radiance, 2 * other, rtol=1e-3, atol=1e-4)


def test_there_is_no_closed_form_in_perspective_or_for_a_light_that_is_interpolated(chair):
    assert chair.direct_light_work().points == 64
    assert chair.direct_light_work(16).points == 16
    at = Shown(chair, 3, "direct", chair.geometry().mask)
    assert choice.render_within_error(at, 30.0).estimator == "closed-form"
    for change in ({"lens": Camera(size=(SIZE, SIZE), fov_deg=30)}, {"resolution": "full"}):
        show(chair, **change)
        assert chair.direct_light() is None and chair.direct_light_work() is None
        made = choice.render_within_error(replace(at, mask=chair.geometry().mask), 30.0)
        assert made.estimator in ("path-tracing", "denoised") and made.estimated.bound <= 30


def test_large_pictures_have_fewer_points_per_pixel_and_then_no_closed_form(chair, monkeypatch):
    from factory.render import direct_light

    lens, look, scales = chair._lens, chair._direct_light._look, []

    def counted(view, across, shift, where):
        scales.append(across)
        return look(view, across, shift, where)

    def glossy(alpha):
        chair.set_materials([Mixture.constant("ggx", alpha, [0.5] * 3)] * len(chair._mixtures))

    monkeypatch.setattr(chair._direct_light, "_look", counted)
    glossy(0.02)
    for most, grids in (
        (64 * SIZE**2, [4, 4, 4, 4]),
        (32 * SIZE**2, [4, 4]),
        (31 * SIZE**2, [2, 2, 2, 2]),
        (15 * SIZE**2, [1, 1, 1, 1]),
        (4 * SIZE**2 - 1, []),
    ):
        scales.clear()
        chair.forget_grids()
        monkeypatch.setattr(direct_light, "MOST_POINTS", most)
        assert (chair.direct_light() is None) == (not grids)
        assert scales == grids
        if grids:  # as many directions per pixel, whatever the points
            at = direct_light.points_of(
                chair._direct_light.closed_forms(chair._shown_view()), lens, 64
            )
            assert at.per_pixel * at.samples == 256
    monkeypatch.undo()
    # of few pixels more points fit than of all, up to what a frame's grids may hold
    where = np.zeros((SIZE, SIZE), bool)
    where[SIZE // 2] = True
    known = chair.direct_light()
    with monkeypatch.context() as patch:
        patch.setattr(direct_light, "MOST_POINTS", 300 * SIZE)
        assert chair.direct_light_work(256).points < 256
        assert chair.direct_light(256, known, where) is not None
        assert chair.direct_light(512, known, where) is None
        patch.setattr(direct_light, "MOST_PLACES", 256 * SIZE**2 - 1)
        assert chair.direct_light(256, known, where) is None
    # few points of a mirror-like material mean nothing
    assert [chair.direct_light_work(points).points for points in (16, 256)] == [64, 256]
    glossy(0.3)
    assert [chair.direct_light_work(points).points for points in (16, 256)] == [16, 256]
    assert chair.direct_light_work().maps == 0  # of wide lobes they take no time
    glossy(0.05)
    assert chair.direct_light_work().maps == pytest.approx(1 / 0.05**2)
    glossy(0.02)
    # but in large frames they are as many on the object, and have as many directions each
    with monkeypatch.context() as patch:
        patch.setattr(direct_light, "LARGE", SIZE**2)
        assert [chair.direct_light_work(points).points for points in (16, 256)] == [16, 256]
        forms = chair._direct_light.closed_forms(chair._shown_view())
        assert [direct_light.points_of(forms, lens, count).samples for count in (16, 64)] == [4, 4]
    chair.set_camera(msgspec.structs.replace(lens, pixel="centre"))
    assert (
        direct_light.points_of(
            chair._direct_light.closed_forms(chair._shown_view()), chair._lens, 64
        ).samples
        == 256
    )


@pytest.mark.parametrize("tier", ["direct", "full"])
def test_pictures_keep_their_error_beside_a_reference(chair, tier):
    mask = chair.geometry().mask
    reference = Halves(Shown(chair, 77, tier, mask))
    reference.grow(512)
    exposure = tone.auto_exposure(reference.picture, mask)
    for requested in (8.0, 60.0):
        achieved, estimated = [], []
        for seed in range(6):
            made = choice.render_within_error(Shown(chair, seed, tier, mask), requested)
            a, r1, r2 = (
                tone.display(each[mask], exposure) for each in (made.radiance, *reference.pictures)
            )
            achieved.append(float(((a - r1) * (a - r2)).mean()))
            estimated.append(made.estimated.error)
        # at 60 it would need more time than the few samples of so small a picture
        assert (made.estimator == "closed-form") == (tier == "direct" and requested < 60)
        kept = sum(error <= requested for error in achieved)
        assert kept >= 5 and np.mean(achieved) <= 0.9 * requested
        if made.estimator == "closed-form":  # which counts with what is expected of it
            assert np.mean(achieved) < np.mean(estimated) < requested / 4
        else:
            assert np.mean(estimated) == pytest.approx(np.mean(achieved), rel=0.2)
