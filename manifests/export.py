"""A data set for other programs: records as one Parquet table, pictures as WebDataset tar files.

Ids are hashes, so records in the order of their ids are shuffled, and in the same way everywhere.
In a tar, each record is three files that share its id: ID.json (the record), ID.image.exr,
ID.geometry.exr; dataset.json, materials.json and lights/ are copied beside the tars.
"""

import contextlib
import io
import os
import tarfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import msgspec.inspect

from manifests.errors import InputError
from manifests.files import replacing, transaction, write_bytes
from manifests.inputs import require_file
from manifests.line_files import encode
from manifests.placed_lines import PlacedLines
from manifests.schema import Record
from manifests.store import Store
from manifests.store_paths import geometry_path, image_path, inside, light_path

ROWS = 50_000  # of a Parquet row group


def records_of_split(store: Store, split: str | None = None) -> PlacedLines:
    """Return the records of a split (None: all), in the order of their ids.

    Raises  InputError for a record that is there twice
    """
    lines = PlacedLines(store, keep=lambda record: split in (None, record.split))
    return lines.require_each_once()


def to_parquet(store: Store, path: str | os.PathLike, split: str | None = None) -> int:
    """Write the records as a table, and return their number. Raises InputError without pyarrow.

    Nested keys become columns such as `camera.size`.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        remedy = (
            "pip install 'pyarrow<22' (later ones need numpy 2, which Blender's wheel cannot have)"
        )
        raise InputError(
            "export --parquet", "the package pyarrow", str(error).split(":")[0], remedy
        ) from None
    records = records_of_split(store, split)
    if not records:
        raise InputError(
            store.folder, "records to export", "none", "render some, or choose another --split"
        )
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as file, contextlib.ExitStack() as opened:
        schema = pyarrow.schema(list(_columns(Record)))
        writer = opened.enter_context(pyarrow.parquet.ParquetWriter(file, schema))
        for first in range(0, len(records), ROWS):
            rows = [_flat(msgspec.to_builtins(record)) for record in records[first : first + ROWS]]
            writer.write_table(pyarrow.Table.from_pylist(rows, schema=schema))
    return len(records)


def _columns(kind: type[msgspec.Struct], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (dotted key, Arrow type) of a record's keys.

    They come from the types and not from records, in which keys may be missing.
    """
    for field in msgspec.inspect.type_info(kind).fields:  # type: ignore[attr-defined]
        of = field.type
        if isinstance(of, msgspec.inspect.UnionType):  # T | None
            (of,) = (each for each in of.types if not isinstance(each, msgspec.inspect.NoneType))
        key = f"{prefix}{field.encode_name}"
        if isinstance(of, msgspec.inspect.StructType):
            yield from _columns(of.cls, f"{key}.")
        else:
            yield key, _arrow_type(of)


def _arrow_type(of: msgspec.inspect.Type) -> Any:
    """Return the Arrow type of a value: a text, a number, or a list of them."""
    import pyarrow

    if isinstance(of, msgspec.inspect.TupleType):
        return pyarrow.list_(_arrow_type(of.item_types[0]))
    if isinstance(of, msgspec.inspect.VarTupleType):
        return pyarrow.list_(_arrow_type(of.item_type))
    types = {
        msgspec.inspect.StrType: pyarrow.string(),
        msgspec.inspect.LiteralType: pyarrow.string(),
        msgspec.inspect.IntType: pyarrow.int64(),
        msgspec.inspect.FloatType: pyarrow.float64(),
    }
    return types[type(of)]


def _flat(value: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return a nested dictionary as a flat one with dotted keys."""
    flat: dict[str, Any] = {}
    for key, inner in value.items():
        flat |= (
            _flat(inner, f"{prefix}{key}.")
            if isinstance(inner, dict)
            else {f"{prefix}{key}": inner}
        )
    return flat


def to_tars(
    store: Store,
    folder: str | os.PathLike,
    split: str | None = None,
    each: int = 1000,
    watch: Callable[[], Any] | None = None,
) -> int:
    """Write the records and their files as numbered tars of `each` records; return how many tars.

    Raises  InputError if the folder holds tars, because those with higher numbers than the new ones
            would be taken for records of this export; if a file lies outside the data set's folder
    """
    folder, records = Path(folder), records_of_split(store, split)
    if earlier := sorted(folder.glob("*.tar")):
        raise InputError(
            folder,
            "a folder without tars",
            earlier[0].name,
            "name another folder, or remove this one first",
        )
    if not records:
        raise InputError(
            store.folder, "records to export", "none", "render some, or choose another --split"
        )
    folder.mkdir(parents=True, exist_ok=True)
    starts = range(0, len(records), each)
    with transaction():  # some of the tars would be taken for all of them
        for name in ("dataset.json", "materials.json"):
            write_bytes(folder / name, _bytes(store, name, name))
        for name, entry in store.dataset().lights.items():
            (folder / "lights").mkdir(exist_ok=True)
            path = light_path(name, entry.hash)
            write_bytes(folder / path, _bytes(store, entry.file, path))
        for number, first in enumerate(starts):
            with (
                replacing(folder / f"{number:06d}.tar") as file,
                tarfile.open(fileobj=file, mode="w") as tar,
            ):
                for record in records[first : first + each]:
                    _add(tar, store, record)
                    if watch:
                        watch()
    return len(starts)


def _bytes(store, path, expected):
    """Return the bytes of a file that a manifest names.

    Raises  InputError if its path is not the expected one, or it is no ordinary file
    """
    if path != expected:
        raise InputError(
            f"{store.folder}: '{path}'",
            f"'{expected}'",
            "another name",
            "do not trust this manifest: verify names all faults",
        )
    return require_file(
        inside(store.folder, path), "a file of the data set", "render or copy it again"
    ).read_bytes()


def _add(tar, store, record):
    """Add a record's three files to a tar.

    Their headers hold nothing of this machine, so that the same records give the same tar.
    """
    parts = (
        ("json", encode(record)),
        ("image.exr", _bytes(store, record.image, image_path(record.id))),
        (
            "geometry.exr",
            _bytes(
                store,
                record.geometry,
                geometry_path(record.geometry.rpartition("/")[2].removesuffix(".exr")),
            ),
        ),
    )
    for ending, data in parts:
        info = tarfile.TarInfo(f"{record.id}.{ending}")
        info.size = len(data)
        tar.addfile(info, io.BytesIO(data))
