"""How `python -m factory` and `python -m learn` find their commands and end.

A command is a module with `register(subparsers)`, which adds its parser and sets `run=` to a
function of the parsed arguments. That function returns an exit status: 0 done, 1 failed, 2 wrong
usage, or another one that the command's help explains. It is 130, 143 or 129 if Ctrl-C, SIGTERM or
SIGHUP stopped the command, and 141 if the output's reader has gone. A command sets
`continues=False` if a second run does not continue the first. It names the options for its results
in `result_folders` and `result_files`, so that a place that cannot be written is found before
anything is computed. Only argparse and the standard library may be imported at its top: heavy
libraries are imported inside `run`, so that `--help` is quick.
"""

import argparse
import importlib
import os
import select
import signal
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from manifests.errors import InputError, closest, missing_package, of_system, printable
from manifests.notices import line_of, set_program
from manifests.stop_signals import Stopped, raise_on_signals

OUTPUT = "standard output"
READER_GONE = 141  # what a shell reports of a program that SIGPIPE ends


Commands = Sequence[str] | Mapping[str, Callable[[argparse._SubParsersAction], None]]


def main(
    program: str,
    description: str,
    commands: Commands,
    arguments: list[str] | None = None,
    moved: Mapping[str, str] | None = None,
    prepare: Callable[[], Any] | None = None,
    prog: str | None = None,
    groups: Mapping[str, Sequence[str]] | None = None,
    version: str | None = None,
    reword: Callable[[str], str] = str,
) -> int:
    """Parse, run and return the exit status; a user's mistake is printed as one line.

    description  printed as it is where it holds an empty line, wrapped otherwise
    program    package whose `commands` folder holds the modules; it follows `python -m`
    commands   names in the order of the help; "evaluate-network" lives in evaluate_network.py.
               Or {name: its `register`}, for commands that are not in that folder
    arguments  words, None: those of this process
    moved      {earlier name: what to type now}
    prepare    called before a command runs, and not for --help
    prog       what the usage calls the program; None: "python -m PROGRAM"
    groups     {title: names}: the help lists the commands so; None: in one list
    version    printed by --version; None: there is no such option
    reword     what lines on standard error are passed through
    """
    set_program(program, reword)
    # as for stderr, characters that the terminal lacks are escaped and are no error
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="backslashreplace")
    words = sys.argv[1:] if arguments is None else arguments
    # one command needs only its own module; --help and mistakes need all
    named = [word for word in words if word in commands][:1]
    if (mistake := _mistaken_name(words, commands, {} if named else moved or {})) is not None:
        print(line_of(mistake), file=sys.stderr)
        return 2
    parser = _parser(program, description, prog, version)
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    for name in named or commands:
        if isinstance(commands, Mapping):
            commands[name](subparsers)
        else:
            folder = f"{program}.commands"
            importlib.import_module(f"{folder}.{name.replace('-', '_')}").register(subparsers)
    if groups and not named:
        _list_in_groups(parser, subparsers, groups)
    if not words:  # of which the usage would say only that a command is missing
        parser.print_help(sys.stderr)
        return 2
    with raise_on_signals():
        return _run(parser, words, prepare)


def _mistaken_name(words: list[str], commands: Commands, moved: Mapping[str, str]) -> str | None:
    """Return what to say of a command that has a new name or is unknown, None if it is right."""
    first = next((word for word in words if not word.startswith("-")), None)
    if first is not None and first in moved:
        return f"'{first}' has a new name; type `{moved[first]}`"
    if first and first not in commands:
        shown = printable(first)
        return f"no command '{shown}' ({closest(shown, commands)} --help lists all)"
    return None


def _parser(
    program: str, description: str, prog: str | None, version: str | None
) -> argparse.ArgumentParser:
    """Return the parser of a program, without its commands; arguments are those of `main`."""
    parser = argparse.ArgumentParser(
        prog=prog or f"python -m {program}",
        description=description[:1].upper() + description[1:],
        formatter_class=argparse.RawDescriptionHelpFormatter
        if "\n\n" in description
        else argparse.HelpFormatter,
    )
    parser.add_argument("--debug", action="store_true", help="show the whole trace of an error")
    if version is not None:
        parser.add_argument("--version", action="version", version=f"{program} {version}")
    return parser


def _run(
    parser: argparse.ArgumentParser, words: list[str], prepare: Callable[[], Any] | None
) -> int:
    """Parse the words, run the command and return the exit status."""
    debug, options = "--debug" in words, None
    try:
        try:
            _refuse_empty(parser, words)
            options = parser.parse_args(words)
            from manifests.outputs import require_places

            require_places(options)
            if prepare:
                prepare()
            return options.run(options) or 0
        finally:  # inside the outer try, so that a full disk or a closed pipe ends in one line
            _flush_output()
    except InputError as problem:
        return _report_failure(problem, debug)
    except ModuleNotFoundError as error:
        if (missing := missing_package(error)) is None:
            raise
        return _report_failure(missing, debug)
    # full disk, missing file, no permission: the system's message names the file
    except OSError as error:
        if isinstance(error, BrokenPipeError) and (error.filename == OUTPUT or _reader_has_gone()):
            _drop_output()
            return READER_GONE  # `| head` has read enough: nothing to report
        return _report_failure(error, debug, of_system(error))
    except (MemoryError, RuntimeError) as error:
        if not _is_out_of_memory(error):
            raise
        shortage = InputError(
            "memory",
            "as much as this command needs",
            str(error).split(". ")[0] or "less",
            "take fewer --workers, or smaller pictures or batches; on a GPU, --device cpu",
        )
        return _report_failure(shortage, debug)
    except KeyboardInterrupt as interrupt:
        traceback.clear_frames(interrupt.__traceback__)
        how = (
            "the same command continues"
            if getattr(options, "continues", True)
            else "the same command with --overwrite replaces it"
        )
        print(f"\n{line_of(f'stopped; what was written stays, {how}')}", file=sys.stderr)
        return 128 + (interrupt.number if isinstance(interrupt, Stopped) else signal.SIGINT)


def _is_out_of_memory(error: Exception) -> bool:
    """Return whether memory was exhausted, of the machine or, for torch, of a GPU."""
    torch = sys.modules.get("torch")
    if torch is not None and isinstance(error, torch.OutOfMemoryError):
        return True
    # torch has no class of its own for what the CPU's memory refuses
    return isinstance(error, MemoryError) or "DefaultCPUAllocator" in str(error)


def _list_in_groups(
    parser: argparse.ArgumentParser,
    subparsers: argparse._SubParsersAction,
    groups: Mapping[str, Sequence[str]],
) -> None:
    """Let the help list the commands under titles. argparse itself has one list of them."""
    listed = {action.dest: action for action in subparsers._choices_actions}
    for title, names in groups.items():
        group = parser.add_argument_group(title)
        group._group_actions += [listed[name] for name in names]
    subparsers._choices_actions.clear()
    subparsers.help = argparse.SUPPRESS
    parser.usage = "%(prog)s [-h] [--debug] [--version] COMMAND ..."


def _refuse_empty(parser: argparse.ArgumentParser, words: list[str]) -> None:
    """End with the usage and status 2 if an argument is empty.

    An empty argument is a shell variable that was not set: as a path it would mean the current
    folder, and as --shard every picture.
    """
    for before, word in zip(["", *words], words, strict=False):
        if not word or (word.startswith("--") and word.endswith("=")):
            name = word.removesuffix("=") or (before if before.startswith("-") else "an argument")
            parser.error(
                f"{name}: expected a value, found an empty one (is a shell variable not set?)"
            )


def _flush_output() -> None:
    """Write what was printed. Raises OSError.

    What cannot be written is dropped after the error, or Python would end with status 120.
    """
    if sys.stdout is None:  # closed by the caller
        return
    try:
        sys.stdout.flush()
    except OSError as error:
        _drop_output()
        raise OSError(error.errno, error.strerror, OUTPUT) from None


def _drop_output() -> None:
    """Send what is still to be printed nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


def _reader_has_gone() -> bool:
    """Return whether the standard output is a pipe whose reader has gone."""
    if sys.stdout is None or not hasattr(select, "poll"):
        return False
    poll = select.poll()
    poll.register(sys.stdout.fileno(), select.POLLOUT)
    return any(event & select.POLLERR for _, event in poll.poll(0))


def _report_failure(error: Exception, debug: bool, shown: Exception | None = None) -> int:
    """Print an error as one line, with `debug` after the whole trace; return the exit status 1.

    shown   what the line says, if not the error's own text

    The frames that the error passed through are cleared first. This closes their progress bars, so
    that the line is printed below them.
    """
    if debug:
        traceback.print_exception(error)
    traceback.clear_frames(error.__traceback__)
    print(line_of(shown or error), file=sys.stderr)
    return 1
