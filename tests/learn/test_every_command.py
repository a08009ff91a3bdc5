"""Every command of the programs is run by a test.

The commands in RUN are run here on tiny real input; what other tests run is named by file, and
looked up there.
"""

import contextlib
import importlib
import io
import json

import pytest

from tests.support import command_inputs
from tests.support.full_disk_case import done

PROGRAMS = ("factory", "learn")
RUN = {  # command: its words, and a file that it must leave; None: it writes nothing
    "factory status": ("{room}/data --json", None),
    "learn evaluate-network": (
        "{room}/weights.safetensors --data {room}/data --batches 1 --out {out}",
        "*",
    ),
}
ELSEWHERE = {  # command: (file, what stands there)
    "factory plan": ("tests/manifests/test_command_line.py", '"plan", "smallest"'),
    "factory render": ("tests/factory/test_pipeline.py", '"render",'),
    "factory verify": (
        "tests/factory/test_bad_input.py",
        'command("verify", tmp_path / "data")[0] == 0',
    ),
    "factory preview": ("tests/factory/test_pipeline.py", '"preview"'),
    "factory export": ("tests/factory/test_full_disk_factory.py", '"export, tars"'),
    "factory materials": ("tests/factory/test_materials_command.py", '"materials", "add"'),
    "factory shapes": ("tests/factory/test_full_disk_factory.py", '"shapes add"'),
    "factory lights": ("tests/factory/test_full_disk_factory.py", '"lights add"'),
    "learn train": ("tests/learn/test_full_disk_learn.py", '"train"'),
    "learn predict": ("tests/learn/test_full_disk_learn.py", '"predict, of a data set"'),
    "learn edit": ("tests/learn/test_full_disk_learn.py", '"edit"'),
    "learn mask": ("tests/learn/test_masks_from_points.py", '["mask", *map(str, words)]'),
    "learn app": ("tests/learn/test_app.py", '["app", *words]'),
    "learn transfer": ("tests/learn/test_full_disk_learn.py", '"transfer"'),
    "learn agree": ("tests/learn/test_agree.py", '["agree", str(folder)'),
    "learn evaluate": ("tests/learn/test_full_disk_learn.py", '"evaluate"'),
    "learn evaluate-ladder": ("tests/learn/test_ladder.py", '"evaluate-ladder"'),
    "learn train-baselines": ("tests/learn/test_full_disk_learn.py", '"baselines"'),
    "learn join-weights": ("tests/learn/test_two_encoders.py", '"join-weights"'),
    "learn.experiments": ("tests/learn/test_every_experiment.py", "sorted(SMALLEST)"),
}


def names():
    return {
        f"{program} {name}"
        for program in PROGRAMS
        for name in importlib.import_module(f"{program}.__main__").COMMANDS
    } | {"learn.experiments"}


def test_every_command_is_run_by_a_test(root):
    listed = [*RUN, *ELSEWHERE]
    assert sorted(listed) == sorted(names())
    gone = [
        command
        for command, (file, words) in ELSEWHERE.items()
        if words not in (root / file).read_text(encoding="utf-8")
    ]
    assert not gone


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """What the commands read: a data set of both sides whose pictures the layer made, settings of a
    run, untrained weights.
    """
    room = tmp_path_factory.mktemp("room")
    command_inputs.write(room, room / "weights.safetensors")
    return room


@pytest.mark.parametrize("command", RUN)
def test_a_command_runs_on_tiny_input_and_leaves_its_report(room, tmp_path, command):
    words, left = RUN[command]
    program, name = command.split()
    with contextlib.redirect_stdout(io.StringIO()):
        status, _, error = done(
            [program, name, *words.format(room=room, out=tmp_path / "out").split()]
        )
    assert status == 0, error[-1000:]
    written = [path for path in (tmp_path / "out").glob(left or "*") if path.is_file()]
    assert bool(written) == (left is not None)
    assert all(
        isinstance(json.loads(path.read_text()), dict | list)
        for path in written
        if path.suffix == ".json"
    )


def test_the_schemas_are_published_as_they_lie_in_the_repository(tmp_path, monkeypatch):
    from manifests import publish

    committed = {
        path.name: path.read_text(encoding="utf-8") for path in publish.FOLDER.glob("*.json")
    }
    monkeypatch.setattr(publish, "FOLDER", tmp_path / "json-schema")
    assert publish.main() == 0
    assert {
        path.name: path.read_text(encoding="utf-8") for path in publish.FOLDER.glob("*.json")
    } == committed
