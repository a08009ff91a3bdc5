"""Pictures to an error, rendered by Cycles: their portions, their errors, and the folder."""

import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

from factory.render import denoiser, direct_light
from factory.render.estimators import choice, closed_form
from factory.render.estimators.halves import Halves
from factory.render.estimators.renderer import Effort, Shown, effort
from factory.render.settings import PORTION
from factory.render.validation import denoiser_law
from manifests.schema import Camera
from manifests.store import Store
from shaders import tone
from shaders.mixture import Mixture

pytestmark = pytest.mark.blender
SIZE = 40


@pytest.fixture(scope="module")
def chair(studio):
    """A studio that shows a small chair of plastic under a sunrise."""
    from factory.lights import load as load_light
    from factory.shapes.catalogue import load

    mesh = load("chair:2")
    studio.set_camera(Camera(size=(SIZE, SIZE)))
    studio.set_shape(mesh)
    studio.set_light(load_light("sunrise").L64, 9)
    studio.set_materials([Mixture.lambert([0.4, 0.5, 0.6])] * mesh.segments)
    studio.set_view(0.5)
    return studio


def test_portions_of_a_sequence_together_are_the_whole(chair):
    whole = chair.portion(0, 16, 3, "full").noisy
    parts = [chair.portion(first, count, 3, "full").noisy for first, count in ((0, 4), (4, 12))]
    assert not np.allclose(parts[0], parts[1], rtol=0.01)
    np.testing.assert_allclose((4 * parts[0] + 12 * parts[1]) / 16, whole, rtol=1e-4, atol=1e-5)


def test_the_denoiser_takes_most_noise_away(chair):
    plain = chair.portion(0, 4, 3, "shadow")
    smooth = chair.denoised(plain, effort(64))
    assert smooth.min() >= 0
    exact = chair.portion(0, 1024, 4, "shadow").noisy
    mask = chair.geometry().mask
    errors = [tone.display_l2(each, exact, 1.0, mask) for each in (smooth, plain.noisy)]
    assert errors[0] < errors[1] / 2


def test_a_denoised_picture_is_the_mean_over_its_flips(chair):
    import bpy

    portion = chair.portion(0, 4, 3, "shadow")
    once, four = (Effort("BALANCED", flips, 1.0, 1.0) for flips in (1, 4))
    each = [
        denoiser.denoised(chair._scene, *(part[::rows, ::columns] for part in portion), once)[
            ::rows, ::columns
        ]
        for rows, columns in denoiser.FLIPS
    ]
    together = denoiser.denoised(chair._scene, *portion, four)
    np.testing.assert_allclose(together, sum(each) / 4, atol=1e-5)
    assert np.abs(each[0] - each[1]).max() > 1e-3 and len(set(denoiser.FLIPS)) == 4
    filtered = denoiser.denoised(chair._scene, *portion, once._replace(prefilter=True))
    assert np.abs(filtered - each[0]).max() > 1e-3
    assert not chair._scene.cycles.use_denoising
    assert not list(Path(bpy.app.tempdir).glob("*.exr"))  # nothing is left behind


def test_direct_light_by_the_closed_form_is_what_many_samples_show(chair):
    mask = chair.geometry().mask
    exact = chair.direct_light()
    many = Halves(Shown(chair, 4, "direct", mask))
    many.grow(1024)
    exposure = tone.auto_exposure(many.picture, mask)
    shown = tone.display_l2(exact.radiance, many.picture, exposure, mask)
    assert shown < 8 + many.estimate().error
    shaded = chair.portion(0, 256, 3, "shadow").noisy
    assert tone.display_l2(exact.radiance, shaded, exposure, mask) > 10 * shown
    np.testing.assert_allclose(exact.alpha, many.alpha, atol=0.2)
    assert abs(exact.alpha.mean() - many.alpha.mean()) < 2e-3


def test_more_points_of_direct_light_are_nearer_to_many_samples_as_their_differences_say(chair):
    mask = chair.geometry().mask
    finest = chair.direct_light(256)
    exposure = tone.auto_exposure(finest.radiance, mask)
    errors, expected = [], []
    for points in (16, 64):
        direct = chair.direct_light(points)
        errors.append(tone.display_l2(direct.radiance, finest.radiance, exposure, mask))
        expected.append(closed_form.differences(direct, mask))
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


def test_the_share_of_leaning_points_is_known_before_direct_light_is_computed(chair):
    share = chair.direct_light_work(16).leaning
    surface = chair._surface()
    cosines = (surface.normals * surface.facets).sum(1)
    assert share == pytest.approx((cosines < np.cos(np.radians(2))).mean(), abs=0.01)
    assert 0.02 < share < 1
    earlier = chair._azimuth
    try:
        chair.set_view(earlier + 1.0)
        assert chair.direct_light_work(16).leaning != share
    finally:
        chair.set_view(earlier)


def test_direct_light_follows_the_material_and_the_light(chair):
    first = chair.direct_light().radiance
    earlier, seen = chair._mixtures, chair._seen
    try:
        chair.set_materials([Mixture.lambert([0.8, 0.5, 0.6])] * len(earlier))
        other = chair.direct_light().radiance
        np.testing.assert_allclose(other[..., 0], 2 * first[..., 0], rtol=1e-3, atol=1e-4)
        chair.set_light(2 * seen, 0)
        np.testing.assert_allclose(chair.direct_light().radiance, 2 * other, rtol=1e-3, atol=1e-4)
    finally:
        chair.set_light(seen, 0)
        chair.set_materials(earlier)


def test_there_is_no_closed_form_in_perspective_or_for_a_light_that_is_interpolated(chair):
    lens, seen = chair._lens, chair._seen
    try:
        chair.set_camera(Camera(size=(SIZE, SIZE), fov_deg=30))
        assert chair.direct_light() is None and chair.direct_light_work() is None
        chair.set_camera(lens)
        assert chair.direct_light_work().points == 64
        assert chair.direct_light_work(16).points == 16
        chair.set_light(seen, 0, "full")
        assert chair.direct_light() is None
    finally:
        chair.set_camera(lens)
        chair.set_light(seen, 0)


def test_large_pictures_have_fewer_points_per_pixel_and_then_no_closed_form(chair, monkeypatch):
    lens, earlier = chair._lens, chair._mixtures
    shown = []
    surface = chair._surface

    def counted(*shift):
        shown.append(chair._lens.size[0] // SIZE)
        return surface(*shift)

    monkeypatch.setattr(chair, "_surface", counted)
    shiny = Mixture.constant("ggx", 0.02, [0.5] * 3)
    try:
        chair.set_materials([shiny] * len(earlier))
        for most, grids in (
            (64 * SIZE**2, [4, 4, 4, 4]),
            (32 * SIZE**2, [4, 4]),
            (31 * SIZE**2, [2, 2, 2, 2]),
            (15 * SIZE**2, [1, 1, 1, 1]),
            (4 * SIZE**2 - 1, []),
        ):
            shown.clear()
            monkeypatch.setattr(direct_light, "MOST_POINTS", most)
            assert (chair.direct_light() is None) == (not grids)
            assert shown == grids
            if grids:  # as many directions per pixel, whatever the points
                at = direct_light.points_of(chair._direct_lights(lens), lens, 64)
                assert at.per_pixel * at.samples == 256
        monkeypatch.undo()
        # few points of a mirror-like material mean nothing
        assert [chair.direct_light_work(wanted).points for wanted in (16, 256)] == [64, 256]
        chair.set_materials([Mixture.constant("ggx", 0.3, [0.5] * 3)] * len(earlier))
        assert [chair.direct_light_work(wanted).points for wanted in (16, 256)] == [16, 256]
        assert chair.direct_light_work().maps == 0  # of wide lobes they take no time
        chair.set_materials([Mixture.constant("ggx", 0.05, [0.5] * 3)] * len(earlier))
        assert chair.direct_light_work().maps == pytest.approx(1 / 0.05**2)
        chair.set_materials([shiny] * len(earlier))
        chair.set_camera(msgspec.structs.replace(lens, pixel="centre"))
        assert direct_light.points_of(chair._direct_lights(lens), chair._lens, 64).samples == 256
    finally:
        chair.set_camera(lens)
        chair.set_materials(earlier)


def test_a_picture_of_fixed_samples_is_the_same_before_and_after_portions(chair):
    before, _ = chair.picture(4, 3, "full")
    settings = {s.path: chair._scene.path_resolve(s.path) for s in PORTION}
    chair.denoised(chair.portion(4, 8, 3, "full"), effort(8))
    after, _ = chair.picture(4, 3, "full")
    np.testing.assert_allclose(after, before, rtol=1e-5, atol=1e-6)
    held = {s.path: chair._scene.path_resolve(s.path) for s in PORTION if "subset" in s.path}
    assert held == {path: settings[path] for path in held}


@pytest.mark.parametrize("tier", ["direct", "full"])
def test_pictures_keep_their_error_beside_a_reference(chair, tier):
    mask = chair.geometry().mask
    reference = Halves(Shown(chair, 77, tier, mask))
    reference.grow(512)
    exposure = tone.auto_exposure(reference.picture, mask)
    for requested in (8.0, 60.0):
        achieved, estimated = [], []
        for seed in range(6):
            made = choice.picture(Shown(chair, seed, tier, mask), requested)
            a, r1, r2 = (
                tone.display(each[mask], exposure) for each in (made.radiance, *reference.pictures)
            )
            achieved.append(float(((a - r1) * (a - r2)).mean()))
            estimated.append(made.estimated.error)
        # at 60 it would take more time than the few samples of so small a picture
        assert (made.estimator == "closed-form") == (tier == "direct" and requested < 60)
        kept = sum(error <= requested for error in achieved)
        assert kept >= 5 and np.mean(achieved) <= 0.9 * requested
        if made.estimator == "closed-form":  # which counts with what is expected of it
            assert np.mean(achieved) < np.mean(estimated) < requested / 4
        else:
            assert np.mean(estimated) == pytest.approx(np.mean(achieved), rel=0.2)


def test_a_command_makes_a_data_set_that_keeps_an_error_and_continues(tmp_path):
    def factory(*words):
        done = subprocess.run(
            [sys.executable, "-m", "factory", *words], capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    data = str(tmp_path / "data")
    words = ["render", "--mesh", "sphere:4", "--material", "brass", "--material", "nickel"]
    words += ["--light", "city", "--size", "24", "--device", "cpu", "--out", data]
    assert factory(*words, "--error", "30").startswith("2 pictures made")
    records = list(Store(data).records())
    assert {record.accuracy.requested for record in records} == {30.0}
    assert all(record.accuracy.estimated <= 30 for record in records)
    assert "2 were there already" in factory(*words, "--error", "30")
    factory(*words, "--error", "90")
    factory(*words, "--samples", "2")
    assert "6 records, clean" in factory("verify", data)
    status = factory("status", data)
    assert "error ≤ 30" in status and "error ≤ 90" in status
    by_requested = {}
    for record in Store(data).records():
        key = record.accuracy.requested if record.accuracy else None
        by_requested.setdefault(key, []).append(record.samples)
    assert by_requested[None] == [2, 2] and sum(by_requested[30.0]) >= sum(by_requested[90.0])
    settings = Store(data).dataset().settings
    assert sorted("estimators" in each for each in settings.values()) == [False, True]
    factory("preview", data, "--out", str(tmp_path / "p"), "--count", "6", "--size", "48")
    assert "of 30" in (tmp_path / "p" / "index.html").read_text()


def test_the_denoisers_law_is_fitted_within_shots():
    rng = np.random.default_rng(3)
    rows = []
    for shot, scale in enumerate((0.5, 1.3, 2.0)):
        for pixels in (4096, 16384, 65536):
            for noise in (400.0, 100.0, 25.0) * np.exp(rng.normal(size=3)):
                samples = 8 if noise > 30 else 64  # which are denoised more thoroughly
                bias = scale * (4096 / pixels) ** 0.3 * noise**0.7 * effort(samples).leaves
                row = {"shot": shot, "pixels": pixels, "noise": noise, "samples": samples}
                rows.append({**row, "bias": bias})
    rows = [{**row, "error": 1.5 * row["bias"]} for row in rows]
    unseen = {"shot": 0, "pixels": 4096, "samples": 4, "noise": 9.0, "bias": -3.0, "error": 1.0}
    law = denoiser_law.fitted([*rows, unseen])
    assert (law["power"], law["size"]) == pytest.approx((0.7, 0.3))
    assert law["scale_10_50_90"][1] == pytest.approx(1.3)
    assert law["error_over_bias"] == pytest.approx(1.5)
