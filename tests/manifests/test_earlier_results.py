"""With --overwrite, what an earlier run wrote goes, and nothing else does."""

import hashlib
import json
import os
import re

import pytest

from manifests import earlier_results, files

OWN = re.compile(r"edited(-.+)?\.png")


def run(folder, names, inputs=(), content=b"picture of "):
    """A run that writes pictures of these names and a report; its notice."""
    folder.mkdir(exist_ok=True)
    with files.transaction():
        for name in names:
            files.write_bytes(folder / name, content + name.encode())
        written = earlier_results.written_hashes()
        files.write_json(folder / "edit.json", {"files": written})
        return earlier_results.remove(folder / "edit.json", written, OWN, inputs)


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def test_what_an_earlier_run_wrote_and_this_one_does_not_is_removed(tmp_path):
    out = tmp_path / "out"
    assert run(out, ["edited-a.png", "edited-b.png", "sheet.png"]) is None
    listed = json.loads((out / "edit.json").read_text())["files"]
    assert listed["sheet.png"] == hashlib.sha256(b"picture of sheet.png").hexdigest()
    (out / "edited-mine.png").write_bytes(b"mine")
    (out / "notes.txt").write_bytes(b"mine")
    assert run(out, ["edited-b.png", "sheet.png"], content=b"another of ") is None
    assert names_in(out) == [
        "edit.json",
        "edited-b.png",
        "edited-mine.png",
        "notes.txt",
        "sheet.png",
    ]
    assert (out / "edited-b.png").read_bytes() == b"another of edited-b.png"


def test_a_result_that_was_changed_or_is_read_stays_and_is_named(tmp_path):
    out = tmp_path / "out"
    run(out, ["edited-a.png", "edited-b.png", "edited-c.png", "edited-d.png"])
    (out / "edited-a.png").write_bytes(b"retouched")
    (out / "edited-c.png").rename(tmp_path / "c.png")
    (out / "edited-c.png").symlink_to(tmp_path / "c.png")
    line = run(out, ["edited.png"], inputs=[out / "edited-b.png", "brass"])
    assert line.startswith(f"{out}: edited-a.png and 2 more stayed beside")
    there = ["edit.json", "edited-a.png", "edited-b.png", "edited-c.png", "edited.png"]
    assert names_in(out) == there and (tmp_path / "c.png").exists()


@pytest.mark.parametrize(
    "name",
    [
        "../edited-x.png",
        "inner/edited-x.png",
        "edited-/../../edited-x.png",  # a name of the command's by its letters
        "{absolute}",
        "thesis.txt",
        "edited-x.png\0",
    ],
)
def test_a_forged_report_removes_nothing(tmp_path, name):
    out = tmp_path / "out"
    for folder in ("inner", "edited-"):
        (out / folder).mkdir(parents=True)
    mine = [tmp_path / "edited-x.png", out / "inner" / "edited-x.png", out / "thesis.txt"]
    for path in mine:
        path.write_bytes(b"mine")
    name = name.replace("{absolute}", str(mine[0]))
    listed = {name: hashlib.sha256(b"mine").hexdigest()}
    (out / "edit.json").write_text(json.dumps({"files": listed}))
    run(out, ["edited.png"])
    assert all(path.read_bytes() == b"mine" for path in mine)


@pytest.mark.parametrize(
    "text",
    ['{"materials": ["brass"]}', "{", '{"files": ["edited-x.png"]}', '{"files": {"a": "b"}}'],
)
def test_results_of_a_report_that_lists_none_stay_and_are_named(tmp_path, text):
    (tmp_path / "edit.json").write_text(text)
    assert run(tmp_path, ["edited.png"]) is None  # nothing there that could be of an earlier run
    (tmp_path / "edit.json").write_text(text)
    (tmp_path / "edited-x.png").write_bytes(b"of an earlier version")
    assert f"{tmp_path}: edited-x.png stayed beside the new" in run(tmp_path, ["edited.png"])
    assert (tmp_path / "edited-x.png").exists()


def test_without_a_report_nothing_is_removed_and_a_pipe_is_not_waited_for(tmp_path):
    (tmp_path / "edited-x.png").write_bytes(b"mine")
    kept = ["edited.png"]
    assert earlier_results.remove(tmp_path / "edit.json", kept, OWN) is None
    os.mkfifo(tmp_path / "edit.json")
    assert "edited-x.png" in earlier_results.remove(tmp_path / "edit.json", kept, OWN)
    assert (tmp_path / "edited-x.png").exists()


def test_a_run_that_fails_removes_nothing(tmp_path):
    run(tmp_path, ["edited-a.png"])
    with pytest.raises(RuntimeError), files.transaction():
        files.write_bytes(tmp_path / "edited.png", b"new")
        raise RuntimeError
    assert names_in(tmp_path) == ["edit.json", "edited-a.png"]
