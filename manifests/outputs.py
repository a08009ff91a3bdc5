"""A command's results in their folder: not written over, continued only under the same settings."""

import errno
import json
import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from manifests.errors import InputError
from manifests.files import require_place_for_file, write_json
from manifests.inputs import require_file, split_path
from manifests.object_store import is_url

MOST_LINE_BYTES = 256 << 20  # of a file of result lines: a thousand edits take 4 MB


def require_places(options: object) -> None:
    """Raise unless every result that a command's options name can be written.

    options  parsed arguments; their `result_folders` and `result_files` are names of options, whose
             values are paths or None, and `result_urls` those of them that may be URLs of an object
             store, which is tried when the command opens it
    Raises   as `try_folder` and `try_file`; InputError for a file that another option reads

    A command computes for minutes or days before it writes, so this is called before its run.
    """
    for name in getattr(options, "result_folders", ()):
        folder = getattr(options, name)
        if folder is not None and not (
            is_url(folder) and name in getattr(options, "result_urls", ())
        ):
            try_folder(folder)
    for name in getattr(options, "result_files", ()):
        path = getattr(options, name)
        if path is not None:
            _refuse_inputs(Path(path), name, vars(options))
            try_file(path)


def _refuse_inputs(path: Path, name: str, values: Mapping[str, Any]) -> None:
    """Raise InputError if a result's file is one that another option than `name` names.

    values  {option: its value}; a value may be a list, and a text may go on after its file's path
    """
    if not path.is_file():
        return
    for option, value in values.items():
        for each in value if isinstance(value, list | tuple) else [value]:
            if option != name and isinstance(each, str | os.PathLike):
                there = split_path(os.fspath(each))[0]
                if os.path.isfile(there) and path.samefile(there):
                    raise _is_input(path, "a name for a new file")


def _is_input(path: Path, rule: str) -> InputError:
    return InputError(path, rule, "this input", "give another --out")


def try_folder(folder: str | os.PathLike) -> None:
    """Raise unless files can be made in a folder, or the folder can be made if it is missing.

    Raises  InputError or OSError that name it. The cause may be a file in the way, a read-only
            disk, no permission, or a file system that has files of its own only, such as /proc
    """
    _require_place_for_folder(Path(folder))
    _try_place(Path(folder))


def try_file(path: str | os.PathLike) -> None:
    """Raise, as `try_folder`, unless a file can be made or replaced at a path."""
    _refuse_url(path)
    require_place_for_file(Path(path))
    _try_place(Path(path).parent)


def _refuse_url(path: str | os.PathLike) -> None:
    """Raise InputError for a URL, which as a path would be a folder named after its scheme."""
    if is_url(path):
        raise InputError(
            path,
            "a place on this machine: `render` alone writes to object stores",
            "a URL",
            "write into a folder, and copy it there",
        )


def _require_place_for_folder(folder: Path) -> None:
    """Raise InputError for a URL, and if something other than a folder lies there."""
    _refuse_url(folder)
    if os.path.lexists(folder) and not folder.is_dir():
        kind = "a file" if folder.exists() else "a link to nothing"
        raise InputError(folder, "a folder, or a name for a new one", kind, "give another --out")


def _try_place(folder: Path) -> None:
    """Make and remove a folder in `folder`, or in the nearest folder in which it would be made.

    Permissions are not asked, because root has them where nothing can be made. The trial has a name
    of its own, so that commands which begin at the same time do not meet.
    """
    there = folder
    while not os.path.lexists(there) and there != there.parent:
        there = there.parent
    try:
        os.rmdir(tempfile.mkdtemp(prefix=".", dir=there))
    except OSError as error:
        if error.errno != errno.ENOENT:
            raise OSError(error.errno, error.strerror, str(folder)) from None
        remedy = "name another"
        raise InputError(
            folder, "a place that can be written", f"that nothing can be made in {there}", remedy
        ) from None


def reserve_outputs(
    folder: Path,
    names: Iterable[str],
    overwrite: bool,
    inputs: Iterable[str | os.PathLike | None] = (),
) -> None:
    """Raise InputError if one of the files exists and may not be replaced, or is an input.

    folder     of the results
    names      of the files in it
    overwrite  whether existing files may be replaced; inputs never may
    inputs     files that the results are computed from
    """
    _require_place_for_folder(folder)
    there = [folder / name for name in names if (folder / name).exists()]
    read = [Path(path) for path in inputs if path is not None and os.path.isfile(path)]
    for path in there:
        if any(path.samefile(each) for each in read):
            raise _is_input(path, "a folder for results that does not hold what they are made of")
    if there and not overwrite:
        raise InputError(there[0], "no earlier result", "one", "give another --out, or --overwrite")


def pin_settings(path: Path, requested: Mapping[str, Any]) -> None:
    """Write the settings of the results beside `path`, or check that they are the ones in the file.

    requested  {name: value} that JSON can hold; a tuple becomes a list
    Raises     InputError if the file holds other settings
    """
    from manifests.reading import read
    from manifests.renamed_keys import with_current_names

    requested = with_current_names(json.loads(json.dumps(requested)), path)
    if not os.path.lexists(path):
        write_json(path, requested)
        return
    try:
        there = with_current_names(read(path, dict[str, Any]), path)
    except InputError as problem:
        raise InputError(
            problem.where, "settings as JSON", problem.found, "give another --out"
        ) from None
    other = [key for key in requested if there.get(key) != requested[key]]
    if other:
        raise InputError(
            path.parent,
            "results of the same settings",
            f"other {', '.join(other)}",
            "give another --out",
        )


def read_lines(path: str | os.PathLike, line_type: Any = dict[str, Any]) -> list[dict[str, Any]]:
    """Return the lines of a JSONL file as dictionaries; an unfinished last line is left out.

    line_type  what msgspec checks each line against; unknown keys are kept
    Returns    [] if there is no file
    Raises     InputError for a damaged line, for what is no ordinary file, and for a file larger
               than MOST_LINE_BYTES
    """
    import msgspec

    from manifests.reading import decode

    if not os.path.lexists(path):
        return []
    require_file(path, "lines of JSON", "give another --out", MOST_LINE_BYTES)
    lines = []
    for number, line in enumerate(Path(path).read_bytes().split(b"\n")[:-1], 1):
        try:
            decode(line, line_type, f"{path}:{number}")
        except InputError as problem:
            remedy = "remove the line: what it holds is made again"
            raise InputError(problem.where, problem.expected, problem.found, remedy) from None
        lines.append(msgspec.json.decode(line))
    return lines
