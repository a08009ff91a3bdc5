"""How `lights`, `materials` and `shapes` add their actions, and options of several actions."""

import argparse
from collections.abc import Callable
from pathlib import Path

from manifests.help_format import HelpFormatter

Run = Callable[[argparse.Namespace], int | None]


def add_command(
    subparsers: argparse._SubParsersAction, name: str, help: str, description: str, epilog: str
) -> argparse._SubParsersAction:
    """Add a command that consists of actions; return the object to which the actions are added."""
    parser = subparsers.add_parser(
        name, help=help, description=description, epilog=epilog, formatter_class=HelpFormatter
    )
    return parser.add_subparsers(required=True, metavar="ACTION", title="actions")


def add_action(
    actions: argparse._SubParsersAction, name: str, run: Run, help: str, example: str
) -> argparse.ArgumentParser:
    """Add an action, and return its parser.

    run      called with the parsed options
    help     what the action does, for the list of actions and for the action's own help
    example  one command line
    """
    parser = actions.add_parser(
        name,
        help=help,
        description=help[0].upper() + help[1:] + ".",
        epilog=f"example:\n  {example}",
        formatter_class=HelpFormatter,
    )
    parser.set_defaults(run=run)
    return parser


def add_picture_output(parser: argparse.ArgumentParser) -> None:
    """Add the option `--out` of an action that writes one picture."""
    parser.add_argument("--out", required=True, type=Path, metavar="PNG", help="the file to write")
    parser.set_defaults(result_files=("out",))


def add_library(parser: argparse.ArgumentParser) -> None:
    """Add the options of an action that copies files into a folder of the user's own."""
    parser.add_argument(
        "--library",
        required=True,
        type=Path,
        metavar="DIR",
        help="the folder to copy into; it is made if it does not exist",
    )
    parser.set_defaults(result_folders=("library",))
    parser.add_argument(
        "--licence",
        default="unknown",
        metavar="TEXT",
        help="the licence, which every data set that uses the files states (default: %(default)s)",
    )


def add_catalogues(parser: argparse.ArgumentParser) -> None:
    """Add the option `--catalogue` of an action that reads materials."""
    parser.add_argument(
        "--catalogue",
        type=Path,
        action="append",
        metavar="FILE",
        help=(
            "a catalogue of materials; repeat the option for several (default: the built-in"
            " catalogues)"
        ),
    )
