"""`brdfactory`, and `python -m brdfactory`: every command under one name."""

import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]


def hide_working_folder() -> None:
    """Take the working folder off the search path, where `python -m` puts it first.

    A folder of the user's may hold a factory.py or a folder learn/, which are not ours. Where the
    working folder is the one that holds this package it stays, for there they are.
    """
    if sys.path and sys.path[0] in ("", os.getcwd()) and Path.cwd() != HERE:
        del sys.path[0]


def main(arguments: list[str] | None = None) -> int:
    """Run the command that the arguments name and return its exit status; None: the process's."""
    from brdfactory.command_line import run

    return run(arguments)


if __name__ == "__main__":
    hide_working_folder()
    sys.exit(main())
