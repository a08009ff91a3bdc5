"""How every command ends: one line below its progress bar, and a status of 0, 1, 2, 3 or 130
whatever its output is.
"""

import importlib.util
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from manifests import cli
from manifests.errors import InputError

ENVIRONMENT = {
    name: value
    for name, value in os.environ.items()
    if name not in ("PYTHONUNBUFFERED", "PYTHONIOENCODING")
}


def presets(root, **options):
    """`plan --presets`: a page of text with characters beyond ASCII, printed without imports that
    take long.
    """
    command = [sys.executable, "-m", "factory", "plan", "--presets"]
    return subprocess.run(
        command, cwd=root, check=False, stderr=subprocess.PIPE, text=True, **options
    )


def test_output_that_a_full_disk_refuses_ends_with_one_line_and_status_1(root):
    with open("/dev/full", "w") as full:
        done = presets(root, stdout=full, env=ENVIRONMENT)
    assert (done.returncode, done.stderr) == (
        1,
        "factory: [Errno 28] No space left on device: 'standard output'\n",
    )


def test_a_reader_that_has_gone_ends_a_command_in_silence_as_the_signal_does(root):
    reader, writer = os.pipe()
    os.close(reader)
    done = presets(root, stdout=writer, env=ENVIRONMENT)
    os.close(writer)
    assert (done.returncode, done.stderr) == (128 + signal.SIGPIPE, "")


def test_a_reader_that_leaves_in_the_middle_of_much_output_is_no_error_either(root):
    many = "print(*range(200000), sep='\\n')"
    program = (
        "import sys; from manifests.cli import main; from types import SimpleNamespace as S\n"
        f"def run(options): {many}\n"
        "sys.exit(main('much', 'x', {'print': lambda sub: sub.add_parser('print')"
        ".set_defaults(run=run)}, ['print']))"
    )
    command = f'{sys.executable} -c "$PROGRAM" | head -1; echo ${{PIPESTATUS[0]}}'
    done = subprocess.run(
        ["bash", "-c", command],
        cwd=root,
        capture_output=True,
        text=True,
        check=False,
        env=ENVIRONMENT | {"PROGRAM": program},
    )
    assert (done.stdout, done.stderr) == ("0\n141\n", "")


HAS_BLENDER = importlib.util.find_spec("bpy") is not None
WITH_BLENDER = pytest.mark.skipif(
    not HAS_BLENDER, reason="the job's light maps come with Blender (pip install .[factory])"
)


@pytest.mark.parametrize(
    "words",
    [
        pytest.param(["plan", "smallest", "--no-probe"], marks=WITH_BLENDER),
        ["materials", "list"],
        ["plan", "--help"],
    ],
)
def test_a_terminal_of_another_character_set_gets_escapes_instead_of_an_error(root, words):
    command = [sys.executable, "-m", "factory", *words]
    environment = ENVIRONMENT | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run(command, cwd=root, capture_output=True, env=environment, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.isascii()


def test_a_command_whose_output_was_closed_by_the_caller_ends_with_0(root):
    done = subprocess.run(
        f"'{sys.executable}' -m factory plan --presets >&-",
        shell=True,
        cwd=root,
        capture_output=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.fixture
def fail(monkeypatch, capsys):
    """fail(error): what stderr holds after a command whose progress bar is interrupted by the
    error.
    """

    def run_with(error):
        def run(options):
            from tqdm import tqdm

            def step(_):
                raise error

            # the traceback keeps the bar alive
            return [step(k) for k in tqdm(range(3), desc="at work")]

        class Command:
            @staticmethod
            def register(subparsers):
                subparsers.add_parser("work").set_defaults(run=run)

        monkeypatch.setattr(cli.importlib, "import_module", lambda name: Command)
        assert cli.main("factory", "", ("work",), ["work"]) == 1
        return capsys.readouterr().err

    return run_with


@pytest.mark.parametrize(
    "error", [InputError("x", "y", "z", "w"), OSError(28, "No space left on device", "out")]
)
def test_what_is_wrong_stands_on_a_line_of_its_own_below_the_progress_bar(fail, error):
    lines = re.split(r"[\r\n]+", fail(error).strip())
    assert lines[-1] == f"factory: {error}"
    assert any(line.startswith("at work") for line in lines[:-1])


def test_a_file_name_with_a_line_break_does_not_break_the_line(fail):
    assert fail(OSError(2, "No such file or directory", "a\nb")).endswith(
        "\nfactory: a\\nb: expected a file or folder of this name, found none (check the path)\n"
    )
    assert fail(InputError("a\nb", "x", "y", "z")).endswith(
        "\nfactory: a\\nb: expected x, found y (z)\n"
    )


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (
            FileExistsError(17, "File exists", "out"),
            "out: expected a folder, or a name for a new one, found a file (give another name)",
        ),
        (
            PermissionError(13, "Permission denied", b"out"),
            "out: expected a place that may be used, found Permission denied (change its"
            " permissions, or name another)",
        ),
        (
            FileNotFoundError(2, "No such file or directory", Path("a folder") / "it's"),
            "a folder/it's: expected a file or folder of this name, found none (check the path)",
        ),
        (
            IsADirectoryError(21, "Is a directory", b"\xff"),
            "\\udcff: expected a file, found a folder (name a file in it)",
        ),
        (
            PermissionError(1, "Operation not permitted", 7),
            "file descriptor 7: expected a place that may be used, found Operation not permitted"
            " (change its permissions, or name another)",
        ),
        (
            OSError(30, "Read-only file system", "out"),
            "out: expected a place that can be written, found Read-only file system (name another)",
        ),
        (OSError(5, "Input/output error", "out"), "[Errno 5] Input/output error: 'out'"),
        (OSError(2, "No such file or directory"), "[Errno 2] No such file or directory"),
    ],
)
def test_errors_of_the_system_say_what_was_expected_and_what_helps(fail, error, says):
    assert fail(error).splitlines()[-1] == f"factory: {says}"


def test_what_takes_long_is_not_begun_for_a_place_that_cannot_be_written(
    tmp_path, capsys, monkeypatch
):
    for place in (
        "manifests.subprocesses.results_of",
        "factory.materials.preview.contact_sheet",
    ):
        monkeypatch.setattr(place, lambda *values, **options: pytest.fail("it begins"))
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    for words, says in (
        (["lights", "make", "--library", str(tmp_path / "file"), "--count", "1"], "found a file"),
        (["materials", "preview", "--out", str(tmp_path / "folder")], "found a folder"),
        (["materials", "list", "--catalogue", str(tmp_path / "no.json")], "found no such file"),
    ):
        assert cli.main("factory", "", (words[0],), words) == 1
        said = capsys.readouterr().err
        assert said.startswith("factory: ") and says in said


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (["factory", "render", "smallest", "--out", "", "--shard", "1/2"], "--out"),
        (["factory", "render", "smallest", "--out", "data", "--shard", ""], "--shard"),
        (["factory", "render", "smallest", "--out=", "--limit", "1"], "--out"),
        (["learn", "predict", "", "--out", "parts"], "an argument"),
        (["factory", ""], "an argument"),
    ],
)
def test_an_empty_argument_is_wrong_usage_and_never_the_current_folder(
    words, name, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    program, *arguments = words
    commands = ("render",) if program == "factory" else ("predict",)
    with pytest.raises(SystemExit) as ended:
        cli.main(program, "", commands, arguments)
    assert ended.value.code == 2
    assert f"{name}: expected a value, found an empty one" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
