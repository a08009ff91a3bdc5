"""What the validations' commands have in common: options, and a report in two files.

report.json has the figures with the command, commit and machine; report.md is its page.
"""

import argparse
from pathlib import Path
from typing import Any

from manifests.errors import InputError, of_system
from manifests.files import write_json, write_text
from manifests.option_types import positive, whole
from manifests.outputs import try_folder


def parser(
    description: str | None,
    counted: str,
    count: int,
    seed: int,
    size: int,
    reference: int | None = None,
    meshes: bool = False,
    references: bool = False,
) -> argparse.ArgumentParser:
    """Return a parser with the options that say what is rendered; `parse` adds --out.

    counted    what --COUNTED counts, "shots" or "scenes"; count: of them unless it is given
    seed       from which they come, unless it is given; size: of a picture, in pixels
    reference  samples of each half of a reference; None: without that option
    meshes     whether files may be shown instead of the program's shapes
    references  whether references may be kept for the next measurement
    """
    result = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawTextHelpFormatter
    )
    result.add_argument(f"--{counted}", type=positive, default=count, metavar="N")
    result.add_argument(
        "--seed", type=whole, default=seed, metavar="N", help=f"from which {counted} come"
    )
    result.add_argument("--size", type=positive, default=size, metavar="PIXELS")
    if reference is not None:
        result.add_argument(
            "--reference",
            type=positive,
            default=reference,
            metavar="N",
            help="samples of each half",
        )
    if meshes:
        result.add_argument(
            "--meshes", type=Path, metavar="FOLDER", help="of .obj files, as shapes"
        )
    if references:
        result.add_argument(
            "--references",
            type=Path,
            metavar="FOLDER",
            help="keep references there, and use those that an earlier measurement of the same "
            "scenes has kept",
        )
    return result


def parse(
    given: argparse.ArgumentParser,
    out_required: bool = True,
    what: str = "of report.json and report.md",
) -> argparse.Namespace:
    """Add --out, the folder of the results, and return the options of the command line.

    what  help of --out. A folder that cannot be written ends the program as a wrong option does
    """
    given.add_argument(
        "--out",
        type=Path,
        required=out_required,
        metavar="DIR",
        help=what,
    )
    options = given.parse_args()
    if options.out is not None:
        try:
            try_folder(options.out)  # before hours of rendering
        except InputError as problem:
            given.error(str(problem))
        except OSError as error:
            given.error(str(of_system(error) or error))
    return options


def write_report(folder: Path, result: dict[str, Any], page: str | None) -> None:
    """Write report.json and report.md; page: the latter's text, None: without it."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "report.json", result)
    if page is not None:
        write_text(folder / "report.md", page)
