"""JSON from outside, decoded into the types of manifests.schema, with one-line errors.

path  the key's place as msgspec gives it, "$.camera.size[0]"; a user sees "camera.size[0]"
"""

import codecs
import os
import re
from pathlib import Path
from typing import TypeVar, get_args

import msgspec

from manifests.errors import InputError, closest
from manifests.inputs import require_file

T = TypeVar("T")
# a job is a page of text and dataset.json has a few MiB; a far larger file is something else
MAXIMUM_BYTES = 64 << 20


def read(path: str | os.PathLike, type_: type[T], maximum_bytes: int = MAXIMUM_BYTES) -> T:
    """Return the file as a `type_`.

    Raises  InputError: missing, too large, malformed, unknown key (with the closest one), wrong
            type
    """
    return decode(read_bytes(path, maximum_bytes), type_, path)


def read_bytes(path: str | os.PathLike, maximum_bytes: int = MAXIMUM_BYTES) -> bytes:
    """Return the bytes of a JSON file, without a byte order mark.

    Raises  InputError: missing, no ordinary file, too large
    """
    path = Path(path)
    require_file(path, "a JSON file", lambda: _remedy(path), maximum_bytes)
    return path.read_bytes().removeprefix(codecs.BOM_UTF8)  # editors on Windows write the mark


def _remedy(path):
    """Return what to do about a missing file: similar names, if there are any."""
    try:
        if not path.parent.is_dir():
            return "the folder is missing too"
        names = [p.name for p in path.parent.glob("*.json")]
    except (OSError, ValueError):  # a folder that may not be read, a name that no file can have
        names = []
    return closest(path.name, names) if names else "check the path"


def decode(data: bytes, type_: type[T], where: object) -> T:
    """Return JSON bytes as a `type_`; `where` names their origin in an InputError."""
    try:
        return msgspec.json.decode(data, type=type_)
    except msgspec.ValidationError as error:
        reason = str(error)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        result = str(error).removeprefix("JSON is malformed: ") or "brackets nested too deeply"
        remedy = "check commas, quotes and brackets there"
        raise InputError(where, "JSON", f"a mistake in it: {result}", remedy) from None
    try:
        problem = _explain(reason, data, type_, where)
    except (msgspec.DecodeError, RecursionError):  # no JSON behind the place of the wrong type
        problem = InputError(
            where, "JSON", reason.split(" - at ")[0], "check commas, quotes and brackets there"
        )
    raise problem


def _explain(message, data, type_, where):
    """Return the InputError that says what msgspec's message means."""
    message, _, path = message.partition(" - at ")
    path = path.strip("`")
    place = (
        f"{where}: {path.removeprefix('$').removeprefix('.')}"
        if path not in ("", "$")
        else str(where)
    )
    if unknown := re.search(r"unknown field `(.*)`", message):
        known = sorted(_keys(type_, path))
        return InputError(
            place,
            "a known key",
            f"'{unknown[1]}'",
            closest(unknown[1], known) if known else "leave it out",
        )
    if missing := re.search(r"missing required field `(.*)`", message):
        return InputError(place, f"the key '{missing[1]}'", "none", "add it")
    if choice := re.search(r"Invalid enum value (.*)", message):
        names = [str(c) for c in _choices(type_, path)]
        return InputError(
            place,
            f"one of {', '.join(names)}" if names else "a known value",
            choice[1],
            closest(choice[1].strip("'"), names),
        )
    expected = re.sub(r"^Expected |, got .*$|`", "", message)
    return InputError(
        place,
        expected,
        _value_as_text(_at(data, path)),
        "the schemas in manifests/json-schema say what may stand there",
    )


def _steps(path):
    """Return the keys and indices of a path."""
    return [
        key if key else int(index) if index.isdigit() else ...
        for key, index in re.findall(r"\.(\w+)|\[([^\]]*)\]", path)
    ]


def _at(data, path):
    """Return the raw value at a path, as far as the steps of the path are named."""
    value = msgspec.json.decode(data)
    for step in _steps(path):
        if step is ...:
            break
        value = value[step]
    return value


def _value_as_text(value):
    text = msgspec.json.encode(value).decode()
    return text if len(text) <= 60 else f"{text[:57]}…"


def _types(type_, path):
    """Return the types that may stand at a path; unions are followed on every branch."""
    results = _branches(type_)
    for step in _steps(path):
        inner = []
        for branch in results:
            if (
                isinstance(step, str)
                and isinstance(branch, type)
                and issubclass(branch, msgspec.Struct)
            ):
                inner += [f.type for f in msgspec.structs.fields(branch) if f.encode_name == step]
            elif not isinstance(step, str):
                inner += [a for a in get_args(branch) if a is not ...][-1:]
        results = [b for t in inner for b in _branches(t)]
    return results


def _branches(type_):
    """Return a union's members, without Annotated."""
    if hasattr(type_, "__metadata__"):
        return _branches(type_.__origin__)
    if type(type_).__name__ in ("UnionType", "_UnionGenericAlias"):
        return [b for t in get_args(type_) for b in _branches(t)]
    return [type_]


def _keys(type_, path):
    return {
        f.encode_name
        for t in _types(type_, path)
        if isinstance(t, type) and issubclass(t, msgspec.Struct)
        for f in msgspec.structs.fields(t)
    }


def _choices(type_, path):
    return [
        c
        for t in _types(type_, path)
        if type(t).__name__ == "_LiteralGenericAlias"
        for c in get_args(t)
    ]
