"""The JSON Schemas of the contract, made from its types: `python -m manifests.publish` writes
manifests/json-schema/ anew.
"""

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
    """{file name: text} of every schema."""
    return {f"{name}.schema.json": _document(name, type_) for name, type_ in TYPES.items()}


def _document(name, type_):
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": name,
        **msgspec.json.schema(type_),
    }
    schema = _with_dedented_descriptions(schema)
    return (
        msgspec.json.format(msgspec.json.encode(schema, order="deterministic"), indent=1).decode()
        + "\n"
    )


def _with_dedented_descriptions(part: object) -> object:
    """A part of a schema whose descriptions, which are docstrings, have lost their indentation:
    from Python 3.13 on they have none.
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
    """Write the files."""
    FOLDER.mkdir(exist_ok=True)
    for name, text in documents().items():
        write_text(FOLDER / name, text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
