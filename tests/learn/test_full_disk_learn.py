"""Every command of `learn` that writes, where the disk is full: one line, no draft, nothing lost,
and the same command succeeds later.

RLIMIT_FSIZE stands for the full disk: it needs no root. tests/endurance/full_disk.py does the same
on real small file systems.
"""

import json
from functools import partial

import pytest

from learn.agreement import causes
from learn.editing import drawing
from learn.evaluation import edit_evaluator, methods
from learn.layer import predictions
from tests.support import command_inputs
from tests.support.full_disk_case import BY_NAME, check, check_read_only, done

QUICK = (
    "agree",
    "predict, of a data set",
    "predict, of a photograph",
    "edit",
    "transfer",
    "train",
    "evaluate",
    "baselines",
    "the demo's page",
)


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """What the commands read, its pictures made by the layer."""
    room = tmp_path_factory.mktemp("room")
    command_inputs.write(room, room / "out" / "weights.safetensors")
    (room / "agreement").mkdir()
    summary = {"direct": {}, "breakdowns": {}, "causes": {}}
    (room / "agreement" / "report.json").write_text(json.dumps({"summary": summary, "about": {}}))
    # the first command that reads the data packs them, which another one's count must not contain
    words = BY_NAME["baselines"].words(room, tmp_path_factory.mktemp("packed"), False)
    assert done(words)[0] == 0
    return room


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Nothing here looks at how right the pictures are: they are what is written."""
    monkeypatch.setattr(edit_evaluator, "FIT_PIXELS", 8)
    monkeypatch.setattr(causes, "sampled_pixels", partial(causes.sampled_pixels, most=8))
    monkeypatch.setattr(
        methods,
        "render_by_layer",
        lambda n, label, light, batch: methods.Unchanged().edit(batch, label),
    )
    monkeypatch.setattr(predictions, "method_for", lambda label: "auto")
    monkeypatch.setattr(drawing, "SPHERE", 16)
    monkeypatch.setattr(drawing, "TILE", 16)


@pytest.mark.parametrize("name", QUICK)
def test_a_full_disk_costs_a_line_and_nothing_else(room, tmp_path, small_files, name):
    check(name, room, tmp_path, small_files, seed=QUICK.index(name))


@pytest.mark.parametrize("name", QUICK)
def test_a_read_only_disk_can_be_read_and_costs_a_line_where_it_was_to_be_written(
    room, tmp_path, read_only, name
):
    check_read_only(name, room, tmp_path, read_only)
