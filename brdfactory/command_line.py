"""The commands of `brdfactory`: those of `factory` and `learn`, grouped by task."""

import argparse
import importlib
import re
import sys
from collections.abc import Callable, Mapping
from functools import partial

from manifests import cli
from manifests.help_format import HelpFormatter
from manifests.provenance import own_version

DESCRIPTION = (
    "Changes the material of an object in a photograph, and makes the data sets and networks that"
    " this needs."
)
# title of a group → {command: package that contains it}
GROUPS: Mapping[str, Mapping[str, str]] = {
    "edit a photograph": dict.fromkeys(("edit", "mask", "app", "predict", "transfer"), "learn"),
    "make a data set": dict.fromkeys(
        ("plan", "render", "status", "verify", "preview", "export"), "factory"
    ),
    "look through materials, shapes and lights": dict.fromkeys(
        ("materials", "shapes", "lights"), "factory"
    ),
    "train, and compare the two renderers": dict.fromkeys(
        (
            "train",
            "train-baselines",
            "join-weights",
            "evaluate",
            "evaluate-network",
            "evaluate-ladder",
            "agree",
        ),
        "learn",
    ),
    "this program": {"completion": "brdfactory"},
}
COMMANDS = {command: package for group in GROUPS.values() for command, package in group.items()}
# how help texts of factory and learn spell their commands, which `brdfactory` rewrites
OTHER_NAMES = re.compile(rf"python -m (?:factory|learn) (?=(?:{'|'.join(COMMANDS)})\b)")


def run(arguments: list[str] | None = None) -> int:
    """Run the command that the arguments name (None: those of the process); return its status."""
    return cli.main(
        "brdfactory",
        DESCRIPTION,
        {command: partial(_register, command) for command in COMMANDS},
        arguments,
        prepare=_prepare,
        prog="brdfactory",
        groups={title: tuple(group) for title, group in GROUPS.items()},
        version=own_version(),
        reword=reword,
    )


def reword(text: str) -> str:
    """Return a text of `factory` or `learn` with its commands spelt `brdfactory COMMAND`."""
    return OTHER_NAMES.sub("brdfactory ", text)


def parser() -> argparse.ArgumentParser:
    """Return a parser of all commands, for shell completion and for the web site."""
    result = argparse.ArgumentParser(prog="brdfactory", description=DESCRIPTION)
    subparsers = result.add_subparsers(required=True, metavar="COMMAND")
    for command in COMMANDS:
        _register(command, subparsers)
    return result


def _register(command: str, subparsers: argparse._SubParsersAction) -> None:
    """Import a command's module and add its parser."""
    if command == "completion":
        _register_completion(subparsers)
        return
    module = f"{COMMANDS[command]}.commands.{command.replace('-', '_')}"
    register: Callable[[argparse._SubParsersAction], None] = importlib.import_module(
        module
    ).register
    register(subparsers)
    _reword_help(subparsers.choices[command])


def _reword_help(parser: argparse.ArgumentParser) -> None:
    """Reword a parser's help, and that of its actions and subcommands."""
    parser.description = reword(parser.description or "")
    parser.epilog = reword(parser.epilog or "")
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for listed in action._choices_actions:
                listed.help = reword(listed.help or "")
            for inner in dict.fromkeys(action.choices.values()):
                _reword_help(inner)
        elif action.help:
            action.help = reword(action.help)


def _register_completion(subparsers: argparse._SubParsersAction) -> None:
    """Add the parser of `completion`."""
    added = subparsers.add_parser(
        "completion",
        help="print a script that completes commands and options in your shell",
        description="Prints a script with which a shell completes commands and their options.",
        epilog='example:\n  eval "$(brdfactory completion bash)"',
        formatter_class=HelpFormatter,
    )
    added.add_argument("shell", choices=("bash", "zsh", "tcsh"), help="your shell")
    added.set_defaults(run=_complete)


def _complete(arguments: argparse.Namespace) -> None:
    """Print the script."""
    import shtab

    print(shtab.complete(parser(), arguments.shell))


def _prepare() -> None:
    """Prepare the process as `python -m learn` does, if the command belongs to `learn`."""
    if any(name.startswith("learn.commands.") for name in sys.modules):
        from learn.commands import prepare

        prepare()
