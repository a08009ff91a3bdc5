"""Run files and settings files by the names of earlier versions mean the same as by today's."""

import json
from dataclasses import asdict

import msgspec
import pytest

from learn.data.settings import decode_run, read_run
from learn.refinement import RefinementSettings
from manifests import outputs
from manifests.errors import InputError
from manifests.renamed_keys import CURRENT_NAMES, with_current_names
from manifests.training_runs import VERSION, Data, Losses, Run, Schedule, Stage

OLD = {
    "name": "old",
    "data": {"matte_first": 7, "materials": "dataset"},
    "losses": {"normals": 2, "pull": 0.25},
    "schedule": {"steps": 5, "rate": 0.002, "decay": 0.02, "average": 0.9},
    "stages": [{"parts": ["normals"], "steps": 3, "losses": {"pull": 0.75}}],
}
TODAY = Run(
    name="old",
    data=Data(gloss_curriculum=7),
    losses=Losses(normals=2, gradient_bound=0.25),
    schedule=Schedule(steps=5, learning_rate=0.002, weight_decay=0.02, ema_decay=0.9),
    stages=(Stage(("normals",), 3, Losses(gradient_bound=0.75)),),
)
OLD_REFINEMENT = {
    "passes": "outer_iterations",
    "reach": "trust_region",
    "together": "joint_iterations",
}


@pytest.mark.parametrize("version", [{}, {"version": 1}, {"version": 2}])
def test_a_run_by_earlier_names_is_the_same_run_by_todays(version):
    assert decode_run(json.dumps(OLD | version).encode(), "run.json") == TODAY
    assert decode_run(msgspec.json.encode(TODAY), "run.json") == TODAY


def test_every_earlier_name_is_a_setting_of_today_and_no_longer_one_itself():
    types = (Run, Data, Losses, Schedule, Stage)
    settings = RefinementSettings()
    names = {name for type_ in types for name in type_.__struct_fields__}
    names |= set(asdict(settings)) | set(asdict(settings.levels[0]))
    assert set(CURRENT_NAMES.values()) <= names
    assert not set(CURRENT_NAMES) & names
    assert names >= {"learning_rate", "weight_decay", "ema_decay", "gloss_curriculum"}


def test_a_run_is_written_by_todays_names_alone():
    written = json.dumps(msgspec.to_builtins(TODAY))
    assert f'"version": {VERSION}' in written
    assert not [name for name in CURRENT_NAMES if f'"{name}"' in written]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"version": 3}, "expected a known key, found"),
        ({"schedule": {"rates": 0.1}}, "found 'rates'"),
        ({"version": 2, "passes": 3}, "found 'outer_iterations'"),
        (
            {"schedule": {"rate": 0.1, "learning_rate": 0.1}},
            r"run\.json: schedule\.rate: expected one of 'rate' and 'learning_rate'",
        ),
        ({"version": 4}, "version"),
    ],
)
def test_unknown_keys_and_keys_under_both_names_are_refused(changes, words):
    with pytest.raises(InputError, match=words):
        decode_run(json.dumps(OLD | changes).encode(), "run.json")


@pytest.mark.parametrize("depth", [10**3, 10**5])
def test_a_run_nested_beyond_measure_is_refused_in_one_line(depth):
    data = b'{"name": "deep", "version": 2, "data": ' + b"[" * depth + b"]" * depth + b"}"
    with pytest.raises(InputError, match=r"run\.json"):
        decode_run(data, "run.json")


def test_a_run_with_a_number_beyond_measure_is_refused_in_one_line():
    data = b'{"name": "x", "schedule": {"rate": 0.1, "steps": ' + b"9" * 5000 + b"}}"
    with pytest.raises(InputError, match=r"run\.json"):
        decode_run(data, "run.json")


def test_a_preset_by_earlier_names_is_read_from_a_file(tmp_path):
    (tmp_path / "run.json").write_text(json.dumps(OLD))
    assert read_run(tmp_path / "run.json") == TODAY


def test_a_settings_file_by_earlier_names_holds_the_settings_of_today(tmp_path):
    today = {"refine": json.loads(json.dumps(asdict(RefinementSettings()))), "seed": 3}
    old = json.loads(json.dumps(today))
    for name, new in OLD_REFINEMENT.items():
        for part in (old["refine"], *old["refine"]["levels"]):
            if new in part:
                part[name] = part.pop(new)
    assert old["refine"].pop("b_colour") == 0  # which could not be set then, as the next one
    assert old["refine"].pop("unexplained_share_at_half_weight") is None
    assert old["refine"].pop("method") == "auto"
    assert old != today and with_current_names(old) == today
    path = tmp_path / "settings.json"
    path.write_text(json.dumps(old))
    outputs.pin_settings(path, today)  # the same settings
    name = "unexplained_share_at_half_weight"
    later = json.loads(json.dumps(today))
    later["refine"]["half_weight_colour"] = later["refine"].pop(name)
    assert with_current_names(later) == today
    with pytest.raises(InputError, match="other refine"):
        outputs.pin_settings(path, today | {"refine": today["refine"] | {"outer_iterations": 1}})
    with pytest.raises(InputError, match="other refine"):
        outputs.pin_settings(path, today | {"refine": today["refine"] | {"b_colour": 0.2}})
