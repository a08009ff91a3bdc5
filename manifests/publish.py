"""The JSON Schemas of the contract; `python -m manifests.publish` writes manifests/json-schema/."""

import inspect
import sys
from pathlib import Path

import msgspec

from manifests.files import write_text
from manifests.materials import Catalogue
from manifests.schema import Dataset, Failure, Job, Record, View
from manifests.training_runs import Run

FOLDER = Path(__file__).parent / "json-schema"
TYPES = {
    "job": Job,
    "record": Record,
    "view": View,
    "dataset": Dataset,
    "failure": Failure,
    "materials": Catalogue,
    "run": Run,
}


def documents() -> dict[str, str]:
    """Return {file name: text} of every schema."""
    return {f"{name}.schema.json": _document(name, type_) for name, type_ in TYPES.items()}


def _document(name: str, type_: type) -> str:
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": name,
        **msgspec.json.schema(type_),
    }
    dedented = _with_dedented_descriptions(schema)
    text = msgspec.json.format(msgspec.json.encode(dedented, order="deterministic"), indent=1)
    return text.decode() + "\n"


def _with_dedented_descriptions(part: object) -> object:
    """Return a part of a schema whose descriptions, which are docstrings, have no indentation.

    Python removes the indentation of docstrings itself from version 3.13 on.
    """
    if isinstance(part, list):
        return [_with_dedented_descriptions(each) for each in part]
    if not isinstance(part, dict):
        return part
    return {
        key: (
            inspect.cleandoc(value)
            if key == "description" and isinstance(value, str)
            else _with_dedented_descriptions(value)
        )
        for key, value in part.items()
    }


def main() -> int:
    """Write the files; return 0."""
    FOLDER.mkdir(exist_ok=True)
    for name, text in documents().items():
        write_text(FOLDER / name, text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
