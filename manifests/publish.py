"""The JSON Schemas of the contract, made from its types: `python -m manifests.publish` writes manifests/json-schema/ anew."""

import sys
from pathlib import Path

import msgspec

from manifests.files import write_text
from manifests.materials import Catalogue
from manifests.schema import Dataset, Failure, Job, Record, View

FOLDER = Path(__file__).parent / "json-schema"
TYPES = {"job": Job, "record": Record, "view": View, "dataset": Dataset, "failure": Failure, "materials": Catalogue}


def documents() -> dict[str, str]:
    """{file name: text} of every schema."""
    return {f"{name}.schema.json": _document(name, type_) for name, type_ in TYPES.items()}


def _document(name, type_):
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": name, **msgspec.json.schema(type_)}
    return msgspec.json.format(msgspec.json.encode(schema, order="deterministic"), indent=1).decode() + "\n"


def main() -> int:
    """Write the files."""
    FOLDER.mkdir(exist_ok=True)
    for name, text in documents().items():
        write_text(FOLDER / name, text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
