"""Files that results are kept in: written whole or not at all, and gone on with only by what made them."""

import json
import math
import os
from pathlib import Path

from manifests.problems import Problem


def claim(folder, names, overwrite, inputs=()):
    """Raises Problem if one of the files is there and may not be replaced, or is one of the inputs, which never may."""
    if folder.exists() and not folder.is_dir():
        raise Problem(folder, "a folder, or a name for a new one", "a file", "give another --out")
    there = [folder / name for name in names if (folder / name).exists()]
    read = [Path(path) for path in inputs if path is not None and os.path.isfile(path)]
    for path in there:
        if any(path.samefile(each) for each in read):
            raise Problem(path, "a folder for results that does not hold what they are made of", "this input", "give another --out")
    if there and not overwrite:
        raise Problem(there[0], "no earlier result", "one", "give another --out, or --overwrite")


def write_text(path, text):
    """UTF-8 text under a temporary name first: a kill leaves the earlier file."""
    temporary = path.with_name(f".{path.name}")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)


def write_json(path, value):
    """As `write_text`; null stands for what JSON has no number for: NaN, infinity."""
    write_text(path, json.dumps(_finite(value), indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def _finite(value):
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def read_lines(path):
    """The whole lines of a JSONL file, a torn last one passed over; none if it is not there. Raises Problem for a damaged one."""
    try:
        with open(path, "rb") as file:
            text = file.read()
    except FileNotFoundError:
        return []
    found = []
    for number, line in enumerate(text.split(b"\n")[:-1], 1):
        try:
            found.append(json.loads(line))
        except ValueError as error:
            raise Problem(f"{path}:{number}", "a line of JSON", str(error), "remove the line: what it told is made again") from None
    return found


def settle(path, wanted):
    """Write down what the figures beside `path` depend on, or check that it is what is there. Raises Problem.

    wanted  {name: value} that JSON can hold; a tuple is a list there
    """
    wanted = json.loads(json.dumps(wanted))
    if not path.exists():
        write_json(path, wanted)
        return
    try:
        there = json.loads(path.read_text(encoding="utf-8"))
        other = [key for key in wanted if there.get(key) != wanted[key]]
    except (ValueError, AttributeError) as error:
        raise Problem(path, "settings as JSON", str(error), "give another --out") from None
    if other:
        raise Problem(path.parent, "results of the same settings", f"other {', '.join(other)}", "give another --out")
