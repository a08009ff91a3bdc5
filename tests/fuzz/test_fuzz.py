"""The fuzzer sees what it is meant to see, makes a case again from its number, and finds nothing in
a small seeded part.
"""

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from . import STATUSES, Case, Room, driver, files, mutation

LIMITS = driver.Limits(seconds=30.0, memory_mb=64)
SHORT = driver.Limits(seconds=1.0, memory_mb=64)  # for cases that never end


def run(case, tmp_path, limits=LIMITS):
    """The Outcome of one case, given as a function of its Room."""
    generator = SimpleNamespace(case=lambda index, rng, room: case(room))
    with driver.Driver({"toy": generator}, 0, tmp_path, limits, jobs=1) as fuzzing:
        fuzzing.prepare()
        (outcome,) = fuzzing.run([("toy", 0)])
    return outcome


def wait_for_a_pipe(room):
    os.mkfifo(room.folder / "pipe")
    return (room.folder / "pipe").read_bytes()


def write_elsewhere(room):
    Path("new.txt").write_text("in the current folder")


def leave_a_draft(room):
    (room.folder / "out").mkdir()
    (room.folder / "out" / ".sheet.part").write_text("half")


def change_the_input(room):
    (room.folder / "input").write_text("other")


def print_on_stderr(room):
    print("Traceback (most recent call last):\n  …\nKeyError: 'x'", file=sys.stderr)


def warn(room):
    # as it looks outside of pytest, which keeps warnings to itself
    print("library.py:3: RuntimeWarning: overflow", file=sys.stderr)


FAULTS = {
    "an exception": (lambda room: 1 / 0, "traceback: ZeroDivisionError"),
    "a trace that was only printed": (print_on_stderr, "traceback: KeyError"),
    "a signal": (lambda room: os.kill(os.getpid(), 9), "ended by signal 9"),
    "an end without a verdict": (lambda room: os._exit(0), "ended without a verdict"),
    "a loop": (lambda room: time.sleep(30), "time: more than 1 s"),
    "a pipe": (wait_for_a_pipe, "time: more than 1 s"),
    "memory that is taken": (lambda room: np.ones(1 << 25).sum(), "memory: "),
    "memory that is taken and kept": (
        lambda room: (np.ones(1 << 25), time.sleep(5)),
        "memory: more than ",
    ),
    "a library's warning": (warn, "warning: library.py:3: RuntimeWarning: overflow"),
    "a draft": (leave_a_draft, "draft left behind: out/.sheet.part"),
    "a file in the current folder": (write_elsewhere, "written outside of the output: cwd/new.txt"),
    "a file in TMPDIR": (lambda room: Path(os.environ["TMPDIR"], "x").touch(), "left in TMPDIR: x"),
    "an input that is changed": (change_the_input, "input changed: input"),
    "an input that is deleted": (lambda room: (room.folder / "input").unlink(), "deleted: input"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_the_driver_sees(tmp_path, name):
    function, fault = FAULTS[name]

    def case(room):
        (room.folder / "input").write_text("input")
        return Case(label=name, run=lambda: function(room))

    outcome = run(case, tmp_path, SHORT if fault.startswith("time") else LIMITS)
    assert outcome.fault is not None
    assert outcome.fault.startswith(fault)
    assert (tmp_path / "toy-0-0" / "fault.json").exists()


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (["factory", "plan", "--presets"], None),
        (["factory", "plan", "no-such-job"], None),
        (["factory", "plan", "--no-such-option"], None),
        (["toy", "4"], "exit status 4"),
        (["toy", "1"], "status 1 without a word"),
        (
            ["toy", "1", "half of a message\nand another line"],
            "status 1 with a last line that is no message",
        ),
        (["toy", "1", "toy: one line"], None),
    ],
)
def test_the_driver_judges_a_commands_end(tmp_path, monkeypatch, words, fault):
    def main(program, doc, commands, arguments):
        print("\n".join(arguments[1:]), file=sys.stderr)
        return int(arguments[0])

    monkeypatch.setitem(sys.modules, "toy", SimpleNamespace(__path__=[]))
    monkeypatch.setitem(sys.modules, "toy.__main__", SimpleNamespace(main=main, COMMANDS=()))
    outcome = run(
        lambda room: Case(label="a command", command=words), tmp_path, driver.Limits(20.0, 1024)
    )
    assert (outcome.fault or "").startswith(fault or "")
    assert (outcome.fault is None) == (fault is None)
    assert outcome.status in (*STATUSES, 4)


def test_a_case_whose_check_finds_a_wrong_result_is_a_fault(tmp_path):
    def case(room):
        return Case(
            label="two",
            run=lambda: 2,
            check=lambda result: None if result.value == 3 else f"expected 3, found {result.value}",
        )

    assert run(case, tmp_path).fault == "wrong result: expected 3, found 2"


def test_a_case_depends_on_its_number_alone(tmp_path):
    """The same file and the same command, whatever ran before."""

    def made(name, index):
        room = Room(tmp_path / name, tmp_path / "seeds" / "files")
        room.folder.mkdir(parents=True)
        case = files.case(index, driver.generator_of_numbers("files", 3, index), room)
        words = [word.replace(str(room.folder), "ROOM") for word in case.command]
        return (
            case.label,
            words,
            {path.name: path.read_bytes() for path in room.folder.rglob("*") if path.is_file()},
        )

    from . import seeds

    shared = tmp_path / "seeds" / "shared"
    shared.mkdir(parents=True)
    seeds.write_small(shared)
    index = next(
        k
        for k in range(len(files.VALID), 10_000)
        if files.chosen(k, driver.generator_of_numbers("files", 3, k))[0] == "light"
    )
    assert made("first", index) == made("second", index)


MUTATIONS = {
    "some_bytes": b"some bytes that are longer than a few",
    "some_text": b"v 1 2.5 -3\nf 1 2 3\n",
    "some_json": json.dumps({"a": [1, 2.5, "x", None], "b": {"c": True}}).encode(),
    "some_npz": None,
    "some_exr": None,
}


@pytest.mark.parametrize("name", MUTATIONS)
def test_a_mutation_repeats_for_a_seed_and_says_what_it_did(name):
    data = MUTATIONS[name]
    if name == "some_npz":
        from manifests.files import npz_bytes

        data = npz_bytes({"L": np.ones((4, 8, 3), np.float32)})
    if name == "some_exr":
        data = mutation.exr({"R": np.ones((4, 8), np.float32)})
    mutate, changed = getattr(mutation, name), 0
    for seed in range(60):
        first, label = mutate(data, np.random.default_rng(seed))
        again, _ = mutate(data, np.random.default_rng(seed))
        assert isinstance(first, bytes)
        assert label
        assert first == again or name == "some_npz"  # a zip holds the time of day
        changed += first != data
    assert changed > 50  # now and then a value is replaced by itself


@pytest.mark.long
def test_a_small_seeded_part_of_the_fuzzing_finds_nothing(root, tmp_path):
    """What `make fuzz` does for ten minutes: two cases of every generator, past the plans that some
    begin with.
    """
    names = driver.generator_names()
    words = ["--first", "200", "--cases", str(2 * len(names)), "--out", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz", *words],
        cwd=root,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    assert f"{2 * len(names)} cases of {len(names)} generators, seed 0: 0 faults" in done.stdout
    assert all(re.search(rf"\b{name} 2 in", done.stdout) for name in names)
