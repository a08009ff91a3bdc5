"""The figures of the chart of error against time, from rows whose times and errors are known."""

import subprocess
import sys
from argparse import Namespace

import numpy as np
import pytest

pytest.importorskip("bpy", reason="bpy is not installed (extra factory)")
from factory.render.estimators.renderer import Shown
from factory.render.validation import error_target_report, speed_accuracy, speed_accuracy_report
from factory.render.validation import speed_accuracy_settings as settings
from manifests.errors import InputError
from manifests.schema import Camera
from shaders.mixture import Mixture

LIMIT = "limit on the error"


def row(family, setting, error, seconds, scene=0, tier="full"):
    return {
        "shape": "cube",
        "material": "brass",
        "tier": tier,
        "family": family,
        "setting": setting,
        "error": error,
        "seconds": seconds,
        "scene": scene,
        "reference_noise": 0.5,
    }


LIMITS = [row(LIMIT, "5", 4.0, 8.0), row(LIMIT, "20", 16.0, 2.0), row(LIMIT, "60", 64.0, 0.5)]


@pytest.mark.parametrize(
    ("error", "seconds"), [(4.0, 8.0), (8.0, 4.0), (32.0, 1.0), (2.0, 16.0), (500.0, 0.5)]
)
def test_the_time_of_a_limit_is_interpolated_and_continued_by_noise(error, seconds):
    assert speed_accuracy_report.at_error(LIMITS, error) == pytest.approx(seconds)


def test_a_method_is_compared_at_its_own_error_on_each_scene():
    second = [dict(each, scene=1, seconds=2 * each["seconds"]) for each in LIMITS]
    rows = [*LIMITS, *second, row("other", "a", 16.0, 6.0), row("other", "a", 16.0, 2.0, scene=1)]
    other = speed_accuracy_report.summary(rows)[-1]
    assert other["family"] == "other"
    assert other["speed_mean"] == pytest.approx(np.sqrt(3.0 * 0.5))
    assert other["speed_worst"] == pytest.approx(0.5)
    assert (other["error_mean"], other["seconds"]) == (16.0, 4.0)


def test_the_page_and_the_chart_have_every_setting(tmp_path):
    figures = speed_accuracy_report.summary([*LIMITS, row("BlenderProc", "defaults", 8.0, 8.0)])
    result = {
        "figures": figures,
        "rows": LIMITS,
        "scenes": 1,
        "size": 8,
        "tier": "full",
        "reference": 512,
        "command": "c",
        "commit": "d",
        "date": "e",
        "machine": "f",
    }
    page = speed_accuracy_report.report(result)
    assert "| BlenderProc | defaults | 8 | 8 | 8.000 | 2.0 | 2.0 |" in page
    assert page.count(LIMIT) >= 3 and "1024 samples" in page
    speed_accuracy_report.chart(LIMITS, tmp_path / "chart.png")
    assert (tmp_path / "chart.png").read_bytes().startswith(b"\x89PNG")


def test_the_page_compares_tier_by_tier_and_the_closed_form_with_path_tracing():
    """Two scenes: at full transport the peer takes twice a limit's time, in direct light four."""
    direct = [dict(each, scene=1, tier="direct") for each in LIMITS]
    direct += [row("BlenderProc", "defaults", 4.0, 32.0, 1, "direct")]
    direct += [row("closed form", "64 points", 0.1, 1.0, 1, "direct")]
    direct += [row("path tracing", "16 samples", 40.0, 0.5, 1, "direct")]
    direct += [row("path tracing", "64 samples", 10.0, 2.0, 1, "direct")]
    rows = [*LIMITS, row("BlenderProc", "defaults", 4.0, 16.0), *direct]
    result = {key: 2 for key in ("scenes", "size", "reference")} | {"tier": "tiers in turn"}
    result |= {key: "x" for key in ("command", "commit", "date", "machine")}
    figures = speed_accuracy_report.summary(rows)
    page = speed_accuracy_report.report({"figures": figures, "rows": rows, **result})
    assert "| full | 1 | 4.00 | 2.0 | 2.0 | 2.0 | 2.0 |" in page
    # the fastest of ours is the closed form, 1 s for whatever error
    assert "| direct | 1 | 4.00 | 4.0 | 4.0 | 32.0 | 32.0 |" in page
    assert "| geometric mean, worst | | | | 200, 200 | 200, 200 | |" in page


def test_the_page_has_the_bias_where_it_was_measured():
    rows = [
        dict(each, squared_bias=bias) for each, bias in zip(LIMITS, (1.5, 0.25, -0.1), strict=True)
    ]
    rows += [dict(rows[0], scene=1, squared_bias=2.5)]
    result = {key: 2 for key in ("scenes", "size", "tier", "reference")}
    result |= {key: "x" for key in ("command", "commit", "date", "machine")}
    figures = speed_accuracy_report.summary(rows)
    page = speed_accuracy_report.report({"figures": figures, "rows": rows, **result})
    assert f"| {LIMIT} | 5 | 4 | 4 | 2 | 2.5 | 8.000 |" in page
    assert f"| {LIMIT} | 60, on 1 of them | 64 | 64 | 0 | 0 |" in page
    header = next(line for line in page.splitlines() if line.startswith("| method"))
    assert header.count("|") == page.splitlines()[-1].count("|")


def test_each_picture_of_a_setting_has_a_seed_of_its_own():
    class Renderer:
        forgotten = 0

        def forget_grids(self):
            self.forgotten += 1

    renderer = Renderer()
    shown = Shown(renderer, 8, "full", np.ones((1, 1), bool))
    pictures, _ = settings.time_pictures(lambda at: np.full((1, 1, 3), at.seed), shown, 2)
    assert renderer.forgotten == 2  # each is timed as the first of its view
    assert pictures.shape == (2, 1, 1, 3) and pictures[0, 0, 0, 0] != pictures[1, 0, 0, 0]


def test_what_would_take_too_long_is_left_out_and_the_page_says_on_how_many_scenes(
    tmp_path, monkeypatch
):
    longest = settings.LONGEST
    known = {("a", "1"): longest - 1, ("a", "2"): longest + 1, ("a", "3"): 1.0, ("b", "1"): 2.0}
    monkeypatch.setattr(settings, "time_pictures", lambda seconds, shown, count: (None, seconds))
    pictures = settings.render_settings(known, None)
    assert [each[:2] for each in pictures] == [("a", "1"), ("a", "2"), ("b", "1")]
    rows = [*LIMITS, *(dict(each, scene=1) for each in LIMITS[1:])]
    figures = speed_accuracy_report.summary(rows)
    assert [each["scenes"] for each in figures] == [1, 2, 2]
    result = {key: 2 for key in ("scenes", "size", "tier", "reference")}
    result |= {key: "x" for key in ("command", "commit", "date", "machine")}
    page = speed_accuracy_report.report({"figures": figures, "rows": rows, **result})
    assert f"| {LIMIT} | 5, on 1 of them | 4 |" in page and f"| {LIMIT} | 20 | 16 |" in page


@pytest.mark.parametrize(
    ("peer", "seconds", "measured"),
    [
        (None, 1.0, []),
        (1.5, 1.0, []),
        (0.8, 1.0, ["1"]),
        (0.4, 1.0, ["1", "0.5"]),
        (0.1, 1.0, ["1", "0.5", "0.125"]),
        (0.1, 100.0, ["1"]),
    ],
)
def test_smaller_limits_are_measured_until_one_is_as_good_as_the_other_program(
    monkeypatch, peer, seconds, measured
):
    monkeypatch.setattr(settings, "render_to_limit", lambda limit: 0.7 * limit)
    monkeypatch.setattr(settings, "time_pictures", lambda error, shown, count: (error, seconds))
    pictures = [(LIMIT, "5", 3.0, 1.0), (LIMIT, "2", 1.2, 2.0), ("denoised", "16", 0.01, 2.0)]
    pictures += [("BlenderProc", "16 samples", 9.0, 1.0)]
    pictures += [] if peer is None else [("BlenderProc", "defaults", peer, 1.0)]
    smaller = list(settings.smaller_limits(pictures, None, lambda picture: picture))
    assert [each[:2] for each in smaller] == [(LIMIT, name) for name in measured]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"estimated": 6.0}, "the most samples did not suffice"),
        ({"achieved_standard_error": 2.0}, "within the uncertainty of the reference"),
        ({"squared_bias": 5.0}, "bias that the estimate missed"),
        ({}, "noise that the halves' difference missed"),
    ],
)
def test_the_cause_of_an_error_above_its_limit_is_named(change, reason):
    shot = {
        "requested": 5.0,
        "estimated": 4.0,
        "standard_error": 0.1,
        "achieved": 8.0,
        "achieved_standard_error": 0.5,
        "squared_bias": 0.1,
    }
    assert error_target_report.cause(shot | change) == reason


def test_direct_light_is_compared_with_the_time_of_path_tracing_at_its_error():
    def scene(number, error, seconds):
        traced = row("path tracing", "256 samples", 2.0, 10.0, number)
        few = row("path tracing", "4 samples", 200.0, 1.0, number)
        coarse = row("closed form", "16 points", 50.0, 0.5 * seconds, number)
        closed = row("closed form", "64 points", error, seconds, number)
        return [dict(each, shape="s", material="m") for each in (traced, few, coarse, closed)]

    lines = speed_accuracy_report.against_path_tracing([*scene(0, 0.5, 2.0), *scene(1, 0.001, 4.0)])
    # a hundredth of the error in ten times the time: a quarter in twice as long, and 1/40 in 6.3
    assert lines[-3:] == [
        "| s, m | 0.50 | 2.00 | 2.00 | 20 | 10 | −2.00 |",
        "| s, m | 0.00 | 4.00 | 2.00 | 100 | 16 | −2.00 |",
        "| geometric mean, worst | | | | 45, 20 | 13, 10 | |",
    ]


RENDER = """
import sys
import bpy
import numpy as np
from factory.render import render_result
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
render_result.hook_cycles()
(scene,) = (each for each in bpy.data.scenes if each.camera)
scene.render.use_border, scene.cycles.samples = False, 64
np.save(sys.argv[2], render_result.render_passes(scene)["Combined"][..., :3])
"""


@pytest.mark.blender
def test_a_saved_scene_is_the_picture_also_after_a_closed_form(studio, tmp_path):
    from factory.lights import load as load_light
    from factory.shapes.catalogue import load

    mesh = load("sphere")
    studio.set_camera(Camera(size=(32, 32)))
    studio.set_shape(mesh)
    studio.set_light(load_light("city").L64, 0)
    studio.set_materials([Mixture.lambert([0.2, 0.4, 0.6])] * mesh.segments)
    studio.set_view(0.0)
    exact = studio.direct_light().radiance
    mask = studio.geometry().mask
    shown = Shown(studio, 3, "direct", mask)
    settings.save(shown, tmp_path / "scene.blend")
    words = [str(tmp_path / name) for name in ("scene.blend", "picture.npy")]
    subprocess.run([sys.executable, "-c", RENDER, *words], check=True, capture_output=True)
    picture = np.load(words[1])
    np.testing.assert_allclose(picture[mask].mean(0), exact[mask].mean(0), rtol=0.02)
    assert np.abs(picture[mask] - exact[mask]).mean() < 0.1 * exact[mask].mean()


@pytest.fixture
def measuring(monkeypatch):
    """A function (watch, **options): the options of a measurement that calls watch(scene) instead
    of rendering the scene.
    """

    class Unset:
        materials, studio = ["brass"], None

        def __init__(self, size, threads, references):
            pass

    def options_of(watch, **changes):
        def measured(stage, known, scene, options, longer):
            watch(scene)
            return [{"family": "ratio", "setting": "4 samples", "seconds": 2.0, "error": 1.0}]

        monkeypatch.setattr(speed_accuracy, "Stage", Unset)
        monkeypatch.setattr(speed_accuracy, "measure_scene", measured)
        usual = {
            "seed": 7,
            "size": 16,
            "reference": 8,
            "blenderproc": None,
            "bare_loop": False,
            "longer_reference": 16,
            "longer_scenes": 0,
            "most_samples": 256,
            "no_adaptive": True,
            "families": [],
            "bias": False,
            "rounds": 1,
            "references": None,
        }
        return Namespace(**usual | changes)

    return options_of


def test_a_measurement_that_was_stopped_renders_no_scene_twice(measuring, tmp_path, monkeypatch):
    seen = []

    def watch(scene):
        if len(seen) == 2:
            raise KeyboardInterrupt
        seen.append(scene.seed)

    options = measuring(watch, scenes=3, tier=None, out=tmp_path, meshes=None)
    with pytest.raises(KeyboardInterrupt):
        speed_accuracy.measure(options)
    first = list(seen)
    seen.clear()
    rows = speed_accuracy.measure(options)
    assert len(first) == 2 and len(seen) == 1 and not set(seen) & set(first)
    assert [each["scene"] for each in rows] == [0, 1, 2]

    times = iter([1.5, 3.0])

    def again(stage, known, scene, options, rows):
        return [(rows[0]["family"], rows[0]["setting"], None, next(times))]

    monkeypatch.setattr(speed_accuracy, "time_again", again)
    options.rounds = 2
    with pytest.raises((StopIteration, RuntimeError)):  # stopped at the third scene
        speed_accuracy.measure(options)
    times = iter([1.0])
    rows = speed_accuracy.measure(options)
    assert [each["seconds"] for each in rows] == [1.5, 2.0, 1.0]
    assert [each["error"] for each in rows] == [1.0] * 3
    options.reference = 16
    with pytest.raises(InputError, match=r"scenes/0\.json"):
        speed_accuracy.measure(options)


def test_families_that_are_not_named_are_left_out_and_limits_are_not(
    measuring, tmp_path, monkeypatch
):
    seen = []

    def families_of(**changes):
        options = measuring(lambda scene: None, scenes=1, tier="full", meshes=None, **changes)

        def measured(stage, known, scene, options, longer):
            seen.append({family for family, _ in known})
            return []

        monkeypatch.setattr(speed_accuracy, "measure_scene", measured)
        speed_accuracy.measure(options)
        return seen[-1]

    every = families_of(out=tmp_path / "all")
    assert every == set(settings.FAMILIES) - {f for f in settings.FAMILIES if "adaptive" in f}
    assert families_of(out=tmp_path / "some", families=["ratio"]) == {
        "ratio",
        speed_accuracy_report.LIMIT,
    }
    with pytest.raises(InputError, match=r"scenes/0\.json"):  # measured under other options
        families_of(out=tmp_path / "some", families=["denoised"])


def test_scenes_of_files_are_reported_without_their_folder(measuring, tmp_path):
    shown = []
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "spoon.obj").touch()
    folders = {"out": tmp_path / "out", "meshes": tmp_path / "meshes"}
    options = measuring(lambda scene: shown.append(scene.shape), scenes=1, tier="full", **folders)
    rows = speed_accuracy.measure(options)
    assert shown == [str(tmp_path / "meshes" / "spoon.obj")]
    assert [row["shape"] for row in rows] == ["spoon.obj"]
    assert str(tmp_path) not in (tmp_path / "out" / "scenes" / "0.json").read_text()


def test_a_python_without_blenderproc_is_refused_before_anything_is_rendered():
    with pytest.raises(InputError, match=r"--blenderproc: .*package blenderproc is missing"):
        settings.run_peer(sys.executable, "--check")


@pytest.mark.blender
def test_a_plain_loop_renders_the_same_scene_by_its_own_settings(studio):
    from factory.lights import load as load_light
    from factory.shapes.catalogue import load

    mesh = load("sphere")
    studio.set_camera(Camera(size=(32, 32)))
    studio.set_shape(mesh)
    studio.set_light(load_light("city").L64, 0)
    studio.set_materials([Mixture.lambert([0.2, 0.4, 0.6])] * mesh.segments)
    studio.set_view(0.0)
    mask = studio.geometry().mask
    shown = Shown(studio, 3, "direct", mask)
    expected = studio.picture(256, 3, "direct")[0]
    made = {name: (of, spent) for _, name, of, spent in settings.render_by_bare_loop(shown, 2)}
    assert list(made) == list(settings.BARE_SETTINGS)
    for pictures, spent in made.values():
        assert pictures.shape == (2, 32, 32, 3) and spent > 0
        assert np.any(pictures[0] != pictures[1])  # seeds of their own
        np.testing.assert_allclose(
            pictures[:, mask].mean((0, 1)), expected[mask].mean(0), rtol=0.05
        )
    noise = {name: float(np.abs(of[0] - of[1])[mask].mean()) for name, (of, _) in made.items()}
    assert noise["64 samples, no denoiser"] > 2 * noise["64 samples"]
    assert noise["16 samples"] > noise["defaults"]


def test_a_plain_loop_that_fails_says_why(tmp_path):
    with pytest.raises(RuntimeError, match=r"bare_loop_peer\.py: .*missing\.json"):
        settings.run_bare_loop(str(tmp_path / "missing.json"))


def test_the_closed_form_is_a_setting_of_direct_light_alone_and_the_ratio_of_the_others():
    known = settings.methods(None, adaptively=False)
    families = {
        tier: {family for family, _ in settings.of_tier(known, tier)}
        for tier in ("direct", "shadow", "full")
    }
    others = {"ratio", "shadow rays", "closed form"}
    assert families["shadow"] == families["full"] == families["direct"] ^ others
    assert "closed form" in families["direct"] and "ratio" not in families["direct"]


def test_adaptive_samples_are_settings_with_and_without_the_denoiser():
    every, fewer = (set(settings.methods(None, adaptively=each)) for each in (True, False))
    thresholds = [f"threshold {each:g}" for each in settings.THRESHOLDS]
    families = ("adaptive sampling", "adaptive sampling, denoised")
    assert every - fewer == {(family, each) for family in families for each in thresholds}


def test_settings_of_most_samples_can_be_left_out():
    every = settings.methods(None, adaptively=False)
    assert ("path tracing", "1024 samples") in settings.methods(None, False, most=1024)
    fewer = settings.methods(None, adaptively=False, most=64)
    assert set(every) - set(fewer) == {("path tracing", "256 samples"), ("denoised", "256 samples")}


def test_the_chart_has_a_row_of_axes_for_each_tier(tmp_path):
    from matplotlib.image import imread

    direct = [dict(each, scene=1, tier="direct") for each in LIMITS]
    direct += [row("closed form", "16 points", 0.1, 1.0, 1, "direct")]
    speed_accuracy_report.chart(LIMITS, tmp_path / "one.png")
    speed_accuracy_report.chart([*LIMITS, *direct], tmp_path / "two.png")
    one, two = (imread(tmp_path / f"{name}.png") for name in ("one", "two"))
    assert two.shape[1] == one.shape[1] and two.shape[0] > 1.8 * one.shape[0]


def test_the_doubt_about_an_error_is_how_much_it_differs_between_references():
    """Pictures that are off by a known amount, and 300 references with noise of their own."""
    rng = np.random.default_rng(4)
    mask = np.ones((24, 24), bool)
    truth = np.full((24, 24, 3), 0.1, np.float32)
    truth[0, :12] = 0.4  # white: the rest is darker, so that nothing is cut off
    picture = truth * rng.uniform(0.8, 1.2, (24, 24, 1)).astype(np.float32)

    class Reference:
        shown = Shown(None, 0, "full", mask)

        def __init__(self):
            # channels share their noise, as those of a white surface do
            noise = 1 + 0.1 * rng.normal(size=(2, 24, 24, 1)).astype(np.float32)
            self.pictures = truth * noise
            # under one exposure for all, so that it does not add a doubt of its own
            self.picture = truth

    errors, doubts = [], []
    for _ in range(300):
        reference = Reference()
        errors.append(settings_compared(picture, reference))
        doubts.append(speed_accuracy.doubt(picture[None], reference))
    assert np.mean(doubts) == pytest.approx(np.std(errors), rel=0.12)


def settings_compared(picture, reference):
    from factory.render.validation.scenes import compare

    return compare(picture, picture, reference).error


def test_the_page_says_what_a_longer_reference_changes():
    peer = row("BlenderProc", "defaults", 8.0, 8.0)
    rows = [
        {
            **each,
            "standard_error": 0.4,
            "longer": {
                "error": 2 * each["error"],
                "standard_error": 0.1,
                "reference_noise": 0.07,
            },
        }
        for each in (*LIMITS, peer)
    ]
    result = {key: 1 for key in ("scenes", "size", "tier", "reference")}
    result |= {key: "x" for key in ("command", "commit", "date", "machine")}
    figures = speed_accuracy_report.summary(rows)
    page = speed_accuracy_report.report({"figures": figures, "rows": rows, **result})
    assert "gives an error is at most 0.4; of other programs' errors it is 5 %" in page
    assert "whose own display error is at most 0.07" in page
    # twice all errors: the same place between the same limits
    assert "| BlenderProc | defaults | 8 ± 0.4 | 16 ± 0.1 | 2.00 | 2.00 |" in page
