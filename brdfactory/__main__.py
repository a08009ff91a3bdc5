"""`brdfactory`, and `python -m brdfactory`: every command under one name."""

import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]


def hide_working_folder() -> None:
    """Remove the working folder from the search path, where `python -m` puts it first.

    The user's folder may contain a factory.py or a folder learn/ that has nothing to do with this
    program. The folder that contains this package is kept, because `factory` and `learn` are there.
    """
    if sys.path and sys.path[0] in ("", os.getcwd()) and Path.cwd() != HERE:
        del sys.path[0]


def main(arguments: list[str] | None = None) -> int:
    """Run the command that the arguments name (None: those of the process); return its status."""
    try:
        from brdfactory.command_line import run

        return run(arguments)
    except KeyboardInterrupt:  # while modules are imported; manifests.cli handles the rest
        print("\nbrdfactory: stopped before it began", file=sys.stderr)
        return 130


if __name__ == "__main__":
    hide_working_folder()
    sys.exit(main())
