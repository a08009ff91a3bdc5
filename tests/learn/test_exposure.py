"""The rule for a photograph's exposure: what a file keeps of a scene's brightness, and the line
through many of them.
"""

import json

import numpy as np
import pytest

from learn.data import framing
from learn.experiments.__main__ import COMMANDS
from learn.experiments.photographs import exposure_rule
from manifests.cli import main
from tests.support.two_materials import written


def test_a_brighter_scene_looks_the_same_in_its_file_and_needs_a_larger_factor(rng):
    radiance, mask = rng.random((16, 16, 3)).astype(np.float32), np.ones((16, 16), bool)
    mask[:4] = False
    (Y, X), (Y_bright, X_bright) = (
        exposure_rule.seen(radiance, mask),
        exposure_rule.seen(3 * radiance, mask),
    )
    assert Y_bright == pytest.approx(Y, rel=1e-5)  # float32
    assert X_bright == pytest.approx(3 * X, rel=1e-5)
    # 1 % of the values are clipped
    assert (radiance[mask] @ [0.2126, 0.7152, 0.0722]).mean() == pytest.approx(X * Y, rel=0.02)
    black = np.where(mask[..., None], radiance, 0)
    # what stands behind the object does not count
    assert exposure_rule.seen(black, mask) == pytest.approx((Y, X))
    mask[:] = True
    radiance[:4] = 50.0
    assert exposure_rule.seen(radiance, mask)[0] != pytest.approx(
        Y, rel=0.1
    )  # only the object counts


def test_a_line_is_found_again_and_its_interval_holds_it(rng):
    Y = rng.uniform(0.05, 0.8, 400)
    groups = [rng.integers(0, 20, 400), rng.integers(0, 15, 400)]
    exact = exposure_rule.fitted(Y, 0.3 * Y**-0.5, groups)
    assert exact["typical"] == pytest.approx([0.3] * 3)
    assert exact["dependence"] == pytest.approx([0.5] * 3)
    noisy = exposure_rule.fitted(Y, 0.3 * Y**-0.5 * np.exp(rng.normal(0, 0.5, 400)), groups)
    for name, truth in (("typical", 0.3), ("dependence", 0.5)):
        value, low, high = noisy[name]
        assert low < value < high
        assert low < truth < high


def test_a_rule_that_is_right_misses_nothing_and_one_off_by_three_misses_by_three():
    Y = np.array([0.1, 0.2, 0.5])
    assert exposure_rule.missed(Y, 0.3 * Y**-0.5, 0.3, 0.5) == {
        "rms_factor": pytest.approx(1),
        "share_beyond_2.5": 0,
    }
    assert exposure_rule.missed(Y, 0.1 * Y**-0.5, 0.3, 0.5) == {
        "rms_factor": pytest.approx(3),
        "share_beyond_2.5": 1,
    }


def test_the_command_fits_one_dataset_and_measures_the_rule_in_use_on_another(tmp_path):
    folders = [str(written(tmp_path / name).folder) for name in ("fit", "check")]
    words = [
        "exposure",
        "--data",
        folders[0],
        "--check",
        folders[1],
        "--out",
        str(tmp_path / "out"),
    ]
    assert main("learn.experiments", "", COMMANDS, words) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["pictures"] == 4
    assert set(report["missed"]) == {"fit", "check"}
    assert report["rules"]["in use"] == [framing.TYPICAL, framing.DEPENDENCE]
