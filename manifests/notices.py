"""Lines on standard error that begin with the program that the user typed.

`factory` and `learn` are typed by their own names or as `brdfactory`; manifests.cli says which.
"""

import os
import sys
from collections.abc import Callable

from manifests.errors import printable

VARIABLE = "BRDFACTORY_PROGRAM"  # its name, for processes that are started from here

# without the variable: what a Python program that imports the packages sees
_typed: tuple[str, Callable[[str], str]] = os.environ.get(VARIABLE) or "brdfactory", str


def set_program(name: str, reword: Callable[[str], str] = str) -> None:
    """Set what lines begin with, also in processes started later, and what their text is passed
    through.
    """
    global _typed
    _typed = name, reword
    os.environ[VARIABLE] = name


def line_of(text: object) -> str:
    """Return a text as one line that begins with the program's name."""
    program, reword = _typed
    return f"{program}: {reword(printable(str(text)))}"


def notice(text: object) -> None:
    """Print a text as one line on standard error, above a progress bar if there is one."""
    line = line_of(text)
    if (progress := sys.modules.get("tqdm")) is not None:
        progress.tqdm.write(line, file=sys.stderr)
    else:
        print(line, file=sys.stderr)
