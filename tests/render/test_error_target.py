"""The check of limits on the error: shots whose verdict is in doubt are measured more closely."""

import argparse
import json

import numpy as np
import pytest

from factory.render.estimators.halves import Estimate
from factory.render.validation import error_target, error_target_report, scenes
from manifests.line_files import Lines


def shot(**change):
    return {
        "requested": 6.0,
        "estimator": "ratio",
        "samples": 8,
        "achieved": 3.0,
        "achieved_standard_error": 0.5,
        "squared_bias": 0.5,
        "squared_bias_standard_error": 0.1,
        "estimated": 3.0,
        "standard_error": 0.1,
        "predicted": 3.0,
        "seconds": 1.0,
        "fixed": 3.0,
        "fixed_seconds": 1.0,
        "reference_samples": 256,
    } | change


@pytest.mark.parametrize(
    "change, in_doubt",
    [
        ({}, False),
        ({"achieved": 5.5}, True),
        ({"achieved": 6.5}, True),
        ({"achieved": 9.0}, False),
        ({"squared_bias": 1.9}, True),
        ({"squared_bias": 2.1}, True),
        ({"squared_bias": 2.5}, False),
        ({"squared_bias_standard_error": 1.0}, True),
    ],
)
def test_a_verdict_near_its_limit_is_in_doubt(change, in_doubt):
    assert error_target.is_in_doubt(shot(**change)) is in_doubt


def test_without_an_uncertainty_of_the_bias_the_errors_counts():
    row = shot(achieved_standard_error=1.0)
    del row["squared_bias_standard_error"]
    assert error_target.is_in_doubt(row) and not error_target.is_in_doubt(row | {"requested": 30.0})


@pytest.mark.parametrize("samples, may", [(256, True), (2048, True), (4096, False), (8192, False)])
def test_a_reference_has_a_largest_number_of_samples(samples, may):
    assert error_target.may_be_closer(shot(reference_samples=samples)) is may
    assert error_target.may_be_closer({})  # a row of an older check


def stage_of(monkeypatch, noise):
    """A stage whose reference errs by `noise` standard errors at 256 samples, less at more."""

    class Reference:
        samples = 256

        def grow(self, count):
            self.samples += count

        def estimate(self):
            return Estimate(1.0, 0.1)

    class Stage:
        materials = ("a", "b")
        reference_ = Reference()

        def show(self, scene):
            return np.ones((2, 2), bool)

        def reference(self, scene, mask, samples):
            self.reference_.samples = samples
            return self.reference_

        class studio:
            @staticmethod
            def picture(*_):
                return np.ones((2, 2, 3)), None

    class Picture:
        samples, estimator, traced, predicted = 8, "ratio", "full", 1.0
        estimated, radiance = Estimate(1.0, 0.1), np.ones((2, 2, 3))

    monkeypatch.setattr(error_target.choice, "render_within_error", lambda *_: Picture())
    monkeypatch.setattr(
        error_target,
        "compare",
        lambda one, other, reference: Estimate(1.0, noise * 256 / reference.samples),
    )
    return Stage()


@pytest.mark.parametrize("noise, samples", [(0.1, 256), (1.0, 1024), (8.0, 4096), (1e3, 4096)])
def test_a_reference_has_as_many_samples_as_a_verdict_needs(monkeypatch, noise, samples):
    stage = stage_of(monkeypatch, noise)
    scene = scenes.draw_scene(0, 0, list(stage.materials))
    row = error_target.measure_shot(stage, scene)
    assert row["reference_samples"] == samples
    assert row["squared_bias_standard_error"] == noise * 256 / samples


def test_a_continued_check_measures_doubtful_shots_again(monkeypatch, tmp_path):
    stage = stage_of(monkeypatch, 0.1)
    monkeypatch.setattr(error_target.time, "process_time", lambda: 0.0)
    options = argparse.Namespace(meshes=None, out=tmp_path, shots=4, seed=3)
    first = error_target.check(stage, options)["rows"]
    path = tmp_path / "rows.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    assert rows == first and len(rows) == 4
    rows[1]["achieved_standard_error"] = 99.0
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert error_target.check(stage, options)["rows"] == first
    # it stands at the end, and is read in its place
    assert len(path.read_text().splitlines()) == 5
    assert error_target.read(Lines(path)) == first
    assert error_target.check(stage, options)["rows"] == first
    assert len(path.read_text().splitlines()) == 5


def test_the_report_says_which_biases_are_beyond_doubt():
    rows = [
        shot(),
        shot(squared_bias=2.05),
        shot(squared_bias=4.0),
        shot(achieved=7.0, squared_bias=4.0),
    ]
    figures = error_target_report.group(rows, None)
    assert figures["bias_above_a_third"] == 3 and figures["biased_beyond_doubt"] == 2
    assert figures["kept"] == 3 and figures["both_kept"] == 1
    named = {"shape": "s", "material": "m", "light": "l", "tier": "full"}
    page = error_target_report.report(
        {
            "command": "c", "commit": "1", "date": "d", "machine": "m", "size": 64,
            "figures": {"groups": [figures], "rows": [row | named for row in rows]},
        }
    )  # fmt: skip
    assert "above a third of the limit (3):" in page
    assert page.count("| 4 ± 0.1 | yes |") == 2 and "| 2.05 ± 0.1 | no |" in page
