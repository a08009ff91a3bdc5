"""The command `brdfactory`: all commands of both programs, beside a user's factory.py."""

import argparse
import ast
import os
import re
import subprocess
import sys

import pytest

from brdfactory import __main__, command_line
from factory.__main__ import COMMANDS as FACTORY
from learn.__main__ import COMMANDS as LEARN
from manifests import cli


def test_it_has_every_command_of_the_two_programs_and_completion():
    assert set(command_line.COMMANDS) == {*FACTORY, *LEARN, "completion"}


def test_help_lists_all_commands_in_groups(capsys):
    with pytest.raises(SystemExit) as end:
        command_line.run(["--help"])
    text = capsys.readouterr().out
    assert end.value.code == 0
    for title, group in command_line.GROUPS.items():
        block = text.split(f"\n{title}:\n")[1].split("\n\n")[0]
        for command in group:
            assert f"\n  {command} " in f"\n{block}"
    assert text.count("\n  edit ") == 1


def test_every_commands_help_has_an_example():
    parsers = command_line.parser()
    choices = next(a for a in parsers._actions if isinstance(a, argparse._SubParsersAction)).choices
    without = [
        name
        for name, parser in choices.items()
        if not re.search(r"^examples?:\n  ", parser.epilog or "", re.M)
    ]
    assert not without


def test_help_and_errors_name_commands_as_they_are_typed(capsys, tmp_path):
    for words in (["edit", "--help"], ["materials", "--help"], ["shapes", "list", "--help"]):
        with pytest.raises(SystemExit):
            command_line.run(words)
        text = " ".join(capsys.readouterr().out.split())
        assert "brdfactory" in text and "python -m factory" not in text
        assert "python -m learn " not in text
    assert command_line.run(["preview", str(tmp_path), "--out", str(tmp_path / "out")]) == 1
    assert "make one with: brdfactory render JOB" in capsys.readouterr().err
    assert command_line.reword("python -m learn.experiments exposure") == (
        "python -m learn.experiments exposure"
    )


@pytest.mark.parametrize(
    "words",
    [
        ["verify", "missing"],
        ["shapes", "preview", "missing.obj", "--out", "sheet.png"],
        ["render", "missing.json", "--out", "data"],
        ["edit", "missing.png", "--material", "brass", "--out", "edited"],
    ],
)
def test_errors_begin_with_the_program_that_was_typed(words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    package = command_line.COMMANDS[words[0]]
    commands = FACTORY if package == "factory" else LEARN
    for program, run in (
        ("brdfactory", command_line.run),
        (package, lambda words: cli.main(package, "", commands, words)),
    ):
        assert run(words) == 1
        lines = [
            line for line in re.split(r"[\r\n]+", capsys.readouterr().err) if "missing" in line
        ]
        assert lines and all(line.startswith(f"{program}: ") for line in lines)


def test_no_module_names_a_program_before_its_lines(root):
    """manifests.notices does, for a line may be of either program. The extension is of Blender."""
    named = re.compile(r"(brdfactory|factory|learn): ")
    places = []
    for package in ("brdfactory", "factory", "learn", "manifests", "shaders"):
        for path in sorted((root / package).rglob("*.py")):
            if path.parent.name == "blender_extension":
                continue
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                text = node.value if isinstance(node, ast.Constant) else None
                if isinstance(text, str) and named.match(text):
                    places.append(f"{path.relative_to(root)}:{node.lineno}")
    assert places == []


def test_without_a_command_all_are_listed(capsys):
    assert command_line.run([]) == 2
    assert "edit a photograph:" in capsys.readouterr().err


def test_an_unknown_command_names_the_closest_ones(capsys):
    assert command_line.run(["edti", "x"]) == 2
    line = capsys.readouterr().err
    assert "no command 'edti'" in line and "did you mean edit" in line and line.count("\n") == 1


def test_the_version_is_the_packages(capsys):
    with pytest.raises(SystemExit) as end:
        command_line.run(["--version"])
    assert end.value.code == 0
    assert capsys.readouterr().out.split()[0] == "brdfactory"


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completion_knows_commands_and_options(shell, capsys):
    assert command_line.run(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert "evaluate-ladder" in script and "white-balance" in script


def test_it_works_in_a_folder_with_modules_of_the_same_names(tmp_path, root):
    (tmp_path / "factory.py").write_text("raise SystemExit('the wrong factory')")
    for name in ("learn", "manifests"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(f"raise SystemExit('the wrong {name}')")
    environment = {**os.environ, "PYTHONPATH": str(root)}
    for words in (["lights", "list"], ["plan", "smallest", "--no-probe"], ["edit", "--help"]):
        done = subprocess.run(
            [sys.executable, "-m", "brdfactory", *words],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr


@pytest.mark.blender
def test_workers_too_find_the_right_packages_there(tmp_path, root):
    (tmp_path / "factory.py").write_text("raise SystemExit('the wrong factory')")
    words = ["render", "smallest", "--limit", "1", "--out", "data"]
    done = subprocess.run(
        [sys.executable, "-m", "brdfactory", *words],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "1 picture made" in done.stdout


def test_the_entry_point_is_the_packages_main(root):
    assert f'brdfactory = "{__main__.__name__}:main"' in (root / "pyproject.toml").read_text()
    assert __main__.main(["lights", "list"]) == 0


def test_a_stop_while_modules_are_imported_is_one_line(monkeypatch, capsys):
    def stopped(arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(command_line, "run", stopped)
    assert __main__.main(["edit"]) == 130
    assert capsys.readouterr().err.strip() == "brdfactory: stopped before it began"
