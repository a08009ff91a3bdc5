"""The figures of adaptive sampling before the denoiser, on pictures of known truth and noise."""

import contextlib
import json
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("bpy", reason="bpy is not installed (extra factory)")
from factory.render.estimators.halves import Halves
from factory.render.validation import adaptive_denoiser as measured
from tests.support.known_pictures import Known, error, shown

EQUAL = [{"error": 16.0, "seconds": 1.0}, {"error": 4.0, "seconds": 4.0}]
EQUAL += [{"error": 2.0, "seconds": 16.0}]


@pytest.mark.parametrize(
    ("error_", "seconds"), [(16.0, 1.0), (8.0, 2.0), (2.0, 16.0), (1.0, 64.0), (32.0, 0.5)]
)
def test_the_time_for_an_error_is_interpolated_and_continued_at_the_nearest_rate(error_, seconds):
    assert measured.seconds_at(EQUAL, error_) == pytest.approx(seconds)


class Stopping(Known):
    """A renderer whose adaptive samples have a noise of their own."""

    stops_at = None

    def portion(self, first, count, seed, tier):
        some = super().portion(first, count, seed, tier)
        if self.stops_at is None:
            return some
        noise = (some.noisy - self.truth) * np.sqrt(count / 64) * self.stops_at
        return some._replace(noisy=np.float32(self.truth + noise))


@pytest.fixture
def scene(monkeypatch):
    """Return a stage, what it shows and a reference of nearly no noise, without Blender."""
    known = Stopping(bias=0.02)

    @contextlib.contextmanager
    def stopping_at(scene, threshold):
        known.stops_at = threshold * 30
        yield
        known.stops_at = None

    monkeypatch.setattr(measured, "stop_where_noise_is_below", stopping_at)
    reference = Halves(shown(Known(noise=1e-4), 77))
    reference.grow(16)
    return SimpleNamespace(studio=SimpleNamespace(_scene=None)), shown(known, 5), reference


def test_each_setting_has_the_error_and_bias_of_its_own_picture(scene):
    figures = measured.measure_scene(*scene)
    assert [row["setting"] for row in figures["equal"]] == [
        f"{each} samples" for each in measured.EQUAL
    ]
    assert [row["setting"] for row in figures["adaptive"]] == [
        f"threshold {each:g}" for each in measured.THRESHOLDS
    ]
    errors = [row["error"] for row in figures["equal"]]
    assert errors[0] > errors[1] > errors[2]
    halves = Halves(scene[1])
    halves.grow(16)
    pair = halves.denoised_pictures()
    truth = error((pair[0] + pair[1]) / 2, scene[1].renderer)
    assert errors[0] == pytest.approx(truth, rel=0.02)
    for row in (*figures["equal"], *figures["adaptive"]):
        off = 3 * row["estimated_standard_error"]
        assert row["estimated"] == pytest.approx(row["error"], rel=0.15, abs=off)
        # the denoiser's bias is that of all settings; what is left of the noise is none
        assert row["squared_bias"] == pytest.approx(figures["equal"][2]["squared_bias"], rel=0.25)
    # noise of 0.9 times that of 64 samples
    assert figures["adaptive"][1]["error_without_denoiser"] == pytest.approx(
        0.81 * figures["equal"][1]["error_without_denoiser"], rel=0.1
    )
    # the noise is nearly the same everywhere, so that a division of samples saves nothing
    assert 1 <= figures["pilot"] < 1.5


def test_other_samples_and_thresholds_can_be_requested(scene):
    figures = measured.measure_scene(*scene, counts=(8, 32), thresholds=(0.05,))
    assert [row["setting"] for row in figures["equal"]] == ["8 samples", "32 samples"]
    assert [row["setting"] for row in figures["adaptive"]] == ["threshold 0.05"]


def test_smaller_thresholds_are_left_out_where_one_took_too_long(scene, monkeypatch):
    monkeypatch.setattr(measured, "LONGEST", -1.0)
    figures = measured.measure_scene(*scene)
    assert [row["setting"] for row in figures["adaptive"]] == ["threshold 0.1"]


def test_the_page_has_a_row_for_each_setting(scene):
    figures = measured.measure_scene(*scene)
    words = {"shape": "cube", "material": "steel", "light": "city"}
    result = {"size": 48, "reference": 16, "scenes": [{**words, **figures}]}
    result |= {key: "x" for key in ("command", "commit", "date", "machine")}
    page = measured.page(result)
    assert "**cube, steel, city.**" in page
    assert page.count("| threshold ") == 3 and page.count(" samples | ") == 3
    assert f"| {figures['adaptive'][0]['gain']:.2f} |" in page
    # only the last threshold's picture is better than that of the most equal samples
    assert page.count("* |") == 1 and f"| {figures['adaptive'][2]['gain']:.2f} * |" in page


def test_settings_of_equal_samples_have_no_mark(scene):
    figures = measured.measure_scene(*scene, counts=(8, 32), thresholds=(0.05,))
    figures["equal"][0]["error"] = figures["equal"][1]["error"] / 2  # by noise, for example
    words = {"shape": "cube", "material": "steel", "light": "city"}
    result = {"size": 48, "reference": 16, "scenes": [{**words, **figures}]}
    result |= {key: "x" for key in ("command", "commit", "date", "machine")}
    assert "– *" not in measured.page(result)


def test_one_number_of_equal_samples_is_refused(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("sys.argv", ["x", "--equal", "16", "16", "--out", str(tmp_path)])
    monkeypatch.setattr(measured, "measure", lambda options: pytest.fail("it begins"))
    with pytest.raises(SystemExit):
        measured.main()
    assert "--equal: a gain is read between two numbers" in capsys.readouterr().err


@pytest.mark.parametrize("peer", [[], [{"family": "BlenderProc", "setting": "16 samples"}]])
def test_charts_without_rows_of_the_other_programs_defaults_are_refused(
    peer, monkeypatch, capsys, tmp_path
):
    rows = [{"scene": 0, "family": "denoised", "setting": "", **row} for row in EQUAL]
    (tmp_path / "chart.json").write_text(json.dumps({"rows": rows + peer}))
    words = ["x", "--charts", str(tmp_path / "chart.json"), "--out", str(tmp_path / "out")]
    monkeypatch.setattr("sys.argv", words)
    with pytest.raises(SystemExit):
        measured.main()
    said = capsys.readouterr().err
    assert "chart.json has no rows of BlenderProc: make the chart with --blenderproc" in said
    assert not (tmp_path / "out").exists()


def test_charts_say_what_equal_samples_take_for_the_error_of_the_other_programs_defaults():
    words = {"shape": "cube", "material": "steel"}
    rows = [{**words, "scene": 0, "family": "denoised", "setting": "", **row} for row in EQUAL]
    peer = {**words, "family": "BlenderProc", "setting": "defaults", "seconds": 8.0}
    rows += [{**peer, "scene": 0, "error": 8.0}, {**peer, "scene": 0, "setting": "16 samples"}]
    rows += [{**row, "scene": 1} for row in rows[:3]] + [
        {**peer, "scene": 1, "error": 1.0, "seconds": 16.0}
    ]
    first, second = measured.beside_defaults(rows)
    assert (first["equal_seconds"], first["speed"]) == pytest.approx((2.0, 4.0))
    assert (second["equal_seconds"], second["speed"]) == pytest.approx((64.0, 0.25))
    assert second["is_continued"] and not first["is_continued"]
    result = {"scenes": [first, second], "command": "c", "commit": "d", "date": "e"}
    page = measured.page_of_charts(result)
    assert "| cube, steel | 8.00 | 8.0 | 2.0 | 4.00 |" in page
    assert "| cube, steel | 1.00 | 16.0 | 64.0 * | 0.25 |" in page
