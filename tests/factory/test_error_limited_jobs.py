"""Jobs that limit the error of each picture, with a studio that needs no Blender: what their
pictures' ids depend on, and what is said where a limit is not kept.
"""

import msgspec
import pytest

from factory.commands import render as command
from factory.commands.plan import describe
from factory.planning.fingerprint import render_fingerprint
from factory.render.estimators import plans
from factory.render.estimators import rules as estimator_rules
from manifests.cli import main
from manifests.store import Store
from manifests.verification import faults_of


@pytest.fixture
def limited(small_job):
    """A function of a limit: a job of 6 shots that has it."""
    job = msgspec.structs.replace(small_job, views=(0,))
    return lambda error: msgspec.structs.replace(job, error=error)


@pytest.fixture
def rules(monkeypatch):
    """A function that changes the rules by which estimators are chosen, until the test ends."""

    def change():
        monkeypatch.setattr(estimator_rules, "VERSION", estimator_rules.VERSION + 1)
        render_fingerprint.cache_clear()

    yield change
    monkeypatch.undo()
    render_fingerprint.cache_clear()


def test_pictures_of_a_limit_are_made_once_and_are_others_than_those_of_samples(
    render, limited, tmp_path
):
    outcomes = [render(limited(60.0), tmp_path, limit=4)]
    outcomes += [render(limited(error), tmp_path) for error in (60.0, None, 60.0)]
    counts = [(each.made, each.already_there) for each in outcomes]
    assert counts == [(4, 0), (2, 4), (6, 0), (0, 6)]
    store = Store(tmp_path)
    assert [fault.text for fault in faults_of(store)] == []
    records = list(store.records())
    assert len({record.id for record in records}) == 12
    requested = [record.accuracy.requested if record.accuracy else None for record in records]
    assert (requested.count(60.0), requested.count(None)) == (6, 6)


def test_a_limit_that_was_altered_in_a_record_is_seen(render, limited, tmp_path):
    render(limited(60.0), tmp_path, limit=3)
    (path,) = Store(tmp_path).record_files()
    path.write_text(path.read_text().replace('"requested":60.0', '"requested":30.0', 1))
    altered = next(Store(tmp_path).records()).id
    texts = [fault.text for fault in faults_of(Store(tmp_path))]
    condemned = [text for text in texts if text.startswith("record ")]
    assert len(condemned) == 1 and f"{altered}: expected id" in condemned[0]


def test_other_rules_make_new_pictures_and_leave_those_of_fixed_samples(
    render, limited, rules, tmp_path
):
    render(limited(60.0), tmp_path)
    render(limited(None), tmp_path)
    rules()
    assert render(limited(None), tmp_path).made == 0
    assert render(limited(60.0), tmp_path).made == 6
    assert render(limited(60.0), tmp_path).made == 0
    settings = Store(tmp_path).dataset().settings
    assert sorted("rules" in each for each in settings.values()) == [False, True, True]


def test_a_picture_that_does_not_keep_its_limit_is_kept_and_noted(render, limited, tmp_path):
    notes = []
    outcome = render(
        limited(1e-4),
        tmp_path,
        lambda event, value: notes.append(value) if event == "note" else None,
        limit=1,
    )
    assert (outcome.made, outcome.failed) == (1, 0)
    (record,) = Store(tmp_path).records()
    assert record.samples == 2 * plans.MOST_SAMPLES == 4096
    assert record.accuracy.estimated > record.accuracy.requested == 1e-4
    (note,) = notes
    assert note.startswith(f"{record.id}: its error is about") and "4096 samples" in note
    assert "the job limits it to 0.0001" in note


def test_a_plan_says_the_limit_in_place_of_samples(plan_of, limited):
    lines = {error: "\n".join(describe(plan_of(limited(error)))) for error in (60.0, None)}
    assert "display error ≤ 60" in lines[60.0] and "samples" not in lines[60.0]
    assert "1 sample" in lines[None] and "display error" not in lines[None]


@pytest.mark.parametrize("error", ["0", "-5", "nan", "x", "65026"])
def test_a_limit_that_no_picture_can_have_is_refused(error, tmp_path, capsys):
    words = ["render", "smallest", "--out", str(tmp_path / "data"), "--error", error]
    try:
        status = main("factory", "", {"render": command.register}, words)
    except SystemExit as ended:
        status = ended.code
    assert status in (1, 2) and "--error" in capsys.readouterr().err
    assert not (tmp_path / "data").exists()
