"""A place for results that cannot be written is found before a command computes anything."""

import argparse
import os
from pathlib import Path

import pytest

from brdfactory import command_line
from manifests import cli, outputs
from manifests.errors import InputError

WRITTEN = {"--out", "--jobs", "--library", "--blend", "--materialx", "--tars", "--parquet"}
READ = {("lights preview", "--library")}


def actions_of(parser, words=()):
    """(words, parser) of each command and action without actions of its own."""
    inner = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    if not inner:
        yield words, parser
    for action in inner:
        for name, each in action.choices.items():
            yield from actions_of(each, (*words, name))


def value(action):
    """The words of an option or argument that is required, with files that do not exist."""
    text = str(next(iter(action.choices))) if action.choices else "missing"
    return [*action.option_strings[-1:], text]


def places():
    """(words before the place, whether it is a folder) of each option for results."""
    for words, parser in actions_of(command_line.parser()):
        needed = [a for a in parser._actions if a.required]
        for action in parser._actions:
            for option in WRITTEN.intersection(action.option_strings):
                if (" ".join(words), option) in READ:
                    continue
                others = [word for a in needed if a is not action for word in value(a)]
                if words == ("export",) and option == "--out":
                    for form in ("webdataset", "tars", "records"):
                        yield (*words, *others, "--to", form, option)
                else:
                    yield (*words, *others, option)


PLACES = sorted(set(places()))


def test_every_command_that_writes_results_is_here():
    commands = {words[0] for words in PLACES}
    silent = {"plan", "status", "verify", "completion"}
    assert commands == set(command_line.COMMANDS) - silent


@pytest.mark.parametrize("words", PLACES, ids=" ".join)
def test_a_place_below_a_file_ends_a_command_before_its_inputs_are_read(words, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert command_line.run([*words, str(tmp_path / "file" / "new")]) == 1
    assert capsys.readouterr().err == (
        f"brdfactory: {tmp_path / 'file'}{'' if ends_in_file(words) else '/new'}: expected a folder"
        " on the way to it, found a file (check the path)\n"
    )
    assert os.listdir(tmp_path) == ["file"]


def test_preview_tries_its_own_choice_of_a_place_too(tmp_path, capsys):
    (tmp_path / "missing-preview").write_text("")
    assert command_line.run(["preview", str(tmp_path / "missing")]) == 1
    assert capsys.readouterr().err.startswith(
        f"brdfactory: {tmp_path / 'missing-preview'}: expected a folder, or a name for a new one,"
        " found a file "
    )


def ends_in_file(words):
    """Whether the place is a file, whose folder is then what is tried."""
    return words[-1] in ("--blend", "--materialx", "--parquet") or (
        words[-1] == "--out"
        and (
            words[1] in ("preview", "fit", "add", "extension")
            or words[0] in ("mask", "join-weights")
            or "records" in words
        )
    )


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="needs Linux's account of a process")
def test_root_is_refused_too_where_nothing_can_be_made():
    for tried in (outputs.try_folder, outputs.try_file):
        with pytest.raises(InputError, match=r"^/proc.*found that nothing can be made in /proc "):
            tried("/proc/brdfactory/x")


def test_an_experiment_tries_its_place_first(tmp_path, capsys):
    from learn.experiments.__main__ import COMMANDS

    (tmp_path / "file").write_text("")
    words = ["exposure", "--data", "missing", "--out", str(tmp_path / "file" / "new")]
    assert cli.main("learn.experiments", "", COMMANDS, words) == 1
    assert "found a file" in capsys.readouterr().err


def test_a_trial_leaves_nothing_and_makes_no_folder(tmp_path):
    outputs.try_folder(tmp_path)
    outputs.try_folder(tmp_path / "a" / "b")
    outputs.try_file(tmp_path / "a" / "b.png")
    assert not os.listdir(tmp_path)


def test_what_lies_in_the_way_of_a_folder_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "link").symlink_to(tmp_path / "gone")
    for name, what in (("file", "a file"), ("link", "a link to nothing")):
        with pytest.raises(InputError, match=rf"found {what} "):
            outputs.try_folder(tmp_path / name)
    with pytest.raises(InputError, match="found a folder"):
        outputs.try_file(tmp_path)


def test_a_url_is_a_place_for_the_command_that_writes_there_and_for_no_other(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = argparse.Namespace(out="s3://bucket/x", jobs=None, result_folders=("out", "jobs"))
    for place in ("s3://bucket/x", Path("s3://bucket/x")):  # a path has lost a slash
        options.out = place
        with pytest.raises(InputError, match=r"^s3://bucket/x: .*found a URL "):
            outputs.require_places(options)
        with pytest.raises(InputError, match=r"^s3://bucket/x: .*found a URL "):
            outputs.try_file(place)
    options.result_urls = ("out",)
    outputs.require_places(options)
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize("read", ["chair.obj", "chair.obj?up=z", "./chair.obj"])
def test_no_result_replaces_a_file_that_the_command_reads(read, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    Path("chair.obj").write_text(text)
    Path("other.png").write_text("an earlier result, which may be replaced")
    words = ["shapes", "preview", read, "--out"]
    assert command_line.run([*words, "chair.obj"]) == 1
    assert "a name for a new file, found this input" in capsys.readouterr().err
    assert Path("chair.obj").read_text() == text
    outputs.require_places(
        argparse.Namespace(result_files=("out",), out=Path("other.png"), mesh=[read], limit=3)
    )


@pytest.mark.parametrize("option", [["--to", "records", "--out"], ["--parquet"]])
def test_a_table_of_records_does_not_replace_a_file_of_its_data_set(option, tmp_path, capsys):
    (tmp_path / "materials.json").write_text("{}")
    place = str(tmp_path / "materials.json")
    assert command_line.run(["export", str(tmp_path), *option, place]) == 1
    assert "a file outside the data set, found a place in it" in capsys.readouterr().err
    assert (tmp_path / "materials.json").read_text() == "{}"
