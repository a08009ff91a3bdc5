"""Commands that render jobs with a limit on the error by Cycles: what is written, what a second
command adds, and what a killed run leaves to the next one.
"""

import json
import subprocess
import sys
from collections import Counter

import pytest

from factory.__main__ import COMMANDS
from manifests import cli
from manifests.store import Store
from tests.endurance.kill_and_resume import compared, disturbed
from tests.support.tetrahedron import ROOT

pytest.importorskip("numba")
pytestmark = pytest.mark.blender
PLACE = {"PYTHONPATH": str(ROOT)}


def factory(*words):
    """What a command of the factory prints; it must succeed."""
    done = subprocess.run(
        [sys.executable, "-m", "factory", *words], capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def here(capsys):
    """As `factory`, for commands that need no Blender, in this process."""

    def run(*words):
        status = cli.main("factory", "", COMMANDS, words)
        said = capsys.readouterr()
        assert status == 0, said.err
        return said.out

    return run


def test_a_command_makes_a_data_set_that_keeps_an_error_and_continues(tmp_path, here):
    pytest.importorskip("bpy", reason="needs Blender as a module (pip install .[factory])")
    data, preview = str(tmp_path / "data"), tmp_path / "preview"
    words = ["render", "--mesh", "sphere:4", "--material", "brass", "--material", "nickel"]
    words += ["--light", "city", "--size", "24", "--device", "cpu", "--out", data]
    assert factory(*words, "--error", "30").startswith("2 pictures made")
    records = list(Store(data).records())
    assert {record.accuracy.requested for record in records} == {30.0}
    assert all(record.accuracy.estimated <= 30 for record in records)
    assert "2 were there already" in factory(*words, "--error", "30")
    factory(*words, "--error", "90")
    factory(*words, "--samples", "2")
    assert "6 records, clean" in here("verify", data)
    status = here("status", data)
    assert "error ≤ 30" in status and "error ≤ 90" in status
    by_requested = {}
    for record in Store(data).records():
        key = record.accuracy.requested if record.accuracy else None
        by_requested.setdefault(key, []).append(record.samples)
    assert by_requested[None] == [2, 2] and sum(by_requested[30.0]) >= sum(by_requested[90.0])
    settings = Store(data).dataset().settings
    assert sorted("estimators" in each for each in settings.values()) == [False, True]
    here("preview", data, "--out", str(preview), "--count", "6", "--size", "48")
    assert "of 30" in (preview / "index.html").read_text()


def test_killed_runs_of_a_limited_error_end_with_the_pictures_of_an_undisturbed_one(tmp_path, here):
    """The first kill takes the worker with it, the second leaves it to notice. The shots need every
    estimator, and those of a later run begin without the light and the maps of the earlier one.
    """
    pytest.importorskip("bpy", reason="needs Blender as a module (pip install .[factory])")
    job = {
        "shapes": ["chair:2", "sphere:3"],
        "materials": ["pink-fabric2", "red-fabric"],
        "lights": ["sunrise"],
        "views": [0, 5],
        "tiers": ["direct", "full"],
        "camera": {"size": [24, 24]},
        "error": 30,
    }
    (tmp_path / "job.json").write_text(json.dumps(job))
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    words = ["render", str(tmp_path / "job.json"), "--device", "cpu", "--out"]
    command = [sys.executable, "-m", "factory", *words, str(killed)]
    # each kill comes at once after a picture of its run, of which two seconds of work are left
    kills = disturbed(
        command, killed, 2, window=(0.0, 0.1), seed=0, environment=PLACE, working=True
    )
    assert kills == 2
    assert "16 pictures made" in factory(*words, str(whole))
    estimators = Counter(record.accuracy.estimator for record in Store(whole).records())
    assert set(estimators) == {"path-tracing", "denoised", "ratio", "closed-form"}
    assert compared(whole, killed) == []
    assert len(Store(killed).dataset().settings) == 1  # one render version
    assert "16 records, clean" in here("verify", str(killed))
