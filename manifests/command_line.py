"""How `python -m factory` and `python -m learn` find their commands and end.

A command is a module with `register(subparsers)`, which adds its parser and sets `run=` to a function of the parsed arguments that
returns an exit status: 0 done, 1 failed, 2 wrong usage; and `continues=False` where a second run does not go on from what is there. Only
argparse and the standard library may be imported at its top: heavy libraries load inside `run`, so that `--help` is quick.
"""

import argparse
import importlib
import sys
import traceback

from manifests.problems import Problem


def main(program, description, commands, arguments=None):
    """Parse, run, and return the exit status; one line for a user's mistake, a trace only with --debug."""
    parser = argparse.ArgumentParser(prog=f"python -m {program}", description=description)
    parser.add_argument("--debug", action="store_true", help="show the whole trace of an error")
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    words = sys.argv[1:] if arguments is None else arguments
    named = [word for word in words if word in commands][:1]  # one command needs only its own module; --help and mistakes need all
    for name in named or commands:
        importlib.import_module(f"{program}.commands.{name}").register(subparsers)
    options = parser.parse_args(arguments)
    try:
        return options.run(options) or 0
    except Problem as problem:
        if options.debug:
            traceback.print_exc()
        print(f"{program}: {problem}", file=sys.stderr)
        return 1
    except OSError as error:  # full disk, missing file, no permission: the system's own words name the file
        if options.debug:
            traceback.print_exc()
        print(f"{program}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        how = "the same command continues" if getattr(options, "continues", True) else "the same command with --overwrite replaces it"
        print(f"\n{program}: stopped; what was written stays, {how}", file=sys.stderr)
        return 130
