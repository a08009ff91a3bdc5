"""Signals by which others end a program."""

import os
import signal
import subprocess
import sys
import threading
from concurrent.futures import ProcessPoolExecutor

import pytest

from manifests import cli, stop_signals, subprocesses


def register(run, **words):
    """Return commands of which `wait` runs a function."""

    def add(subparsers):
        subparsers.add_parser("wait").set_defaults(run=run, **words)

    return {"wait": add}


def end_itself(number):
    def run(options):
        os.kill(os.getpid(), number)
        raise AssertionError("the signal was not handled")

    return run


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 130)]
)
@pytest.mark.parametrize(
    ("continues", "how"), [(True, "the same command continues"), (False, "with --overwrite")]
)
def test_a_signal_ends_a_command_in_one_line(capsys, number, status, continues, how):
    commands = register(end_itself(number), continues=continues)
    # programs that a shell starts in the background ignore Ctrl-C
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert cli.main("program", "what it does", commands, ["wait"]) == status
    finally:
        signal.signal(signal.SIGINT, before)
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "stopped; what was written stays" in line and how in line


def test_afterwards_the_signals_are_as_before():
    before = [signal.getsignal(number) for number in stop_signals.NUMBERS]
    with stop_signals.raise_on_signals():
        assert [signal.getsignal(number) for number in stop_signals.NUMBERS] != before
    assert [signal.getsignal(number) for number in stop_signals.NUMBERS] == before


def test_signals_that_somebody_ignores_stay_ignored():
    """As SIGHUP is by nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with stop_signals.raise_on_signals():
            os.kill(os.getpid(), signal.SIGHUP)
            assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_threads_leave_signals_alone():
    seen = []

    def run():
        with stop_signals.raise_on_signals():
            seen.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert seen == [signal.SIG_DFL]


def test_a_second_signal_ends_a_program_that_is_still_cleaning_up():
    code = (
        "import os, signal\n"
        "from manifests import stop_signals\n"
        "with stop_signals.raise_on_signals():\n"
        "    try:\n"
        "        os.kill(os.getpid(), signal.SIGTERM)\n"
        "    finally:\n"
        "        os.kill(os.getpid(), signal.SIGTERM)\n"
        "        print('not ended')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env=subprocesses.environment(),
    )
    assert done.returncode == -signal.SIGTERM and not done.stdout


def _handlers(_):
    return [signal.getsignal(number) == signal.SIG_DFL for number in stop_signals.NUMBERS]


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_workers_do_not_inherit_the_handlers():
    import multiprocessing

    context = multiprocessing.get_context("fork")
    with stop_signals.raise_on_signals():
        for begin, expected in ((subprocesses.end_with_parent, True), (None, False)):
            with ProcessPoolExecutor(1, context, begin) as pool:
                assert next(pool.map(_handlers, [0])) == [expected] * len(stop_signals.NUMBERS)
