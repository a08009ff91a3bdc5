"""The folder of an export: parts in a fixed order, each written whole, the data card last.

export.json says which lines of which format the parts hold. The same command continues a half-made
export: parts that exist are whole and stay. A data set that has changed is refused, because its
parts would hold other lines than those that are there.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from manifests import lock
from manifests.errors import InputError
from manifests.exporting import Format
from manifests.exporting.card import data_card
from manifests.exporting.samples import Sample, Samples
from manifests.files import replacing, write_bytes, write_text
from manifests.inputs import require_file
from manifests.outputs import pin_settings
from manifests.schema import Record, View
from manifests.store import Store
from manifests.store_paths import inside, light_path

SETTINGS, CARD = "export.json", "README.md"
# raised when parts of the same settings would hold other bytes
LAYOUTS: dict[Format, int] = {"webdataset": 1, "parquet": 2, "huggingface": 2, "hdf5": 1}
MOST_COPIED_BYTES = 1 << 30  # of materials.json and each other file that is copied
REMEDY = "name another folder, or remove this one first"


class Part(NamedTuple):
    """One file of an export, and the lines that it holds."""

    path: str
    lines: Sequence[Record | View]


class Result(NamedTuple):
    """How many files were made and were there before, and the number of samples in all of them.

    left_out  number of views that are not among the samples because the data set has pictures
    """

    made: int
    already_there: int
    samples: int
    left_out: int


def export(
    store: Store,
    folder: str | os.PathLike,
    form: Format,
    split: str | None = None,
    each: int = 1000,
    author: str = "",
    watch: Callable[[int], Any] | None = None,
) -> Result:
    """Write a data set's samples to a folder in one of the formats; continue a half-made export.

    split   None: all
    each    number of samples in a part; of hdf5, which has a file for each, in a folder
    author  who rendered it, for the data card; "": not said
    watch   called with a number of samples that are done
    Raises  InputError: an empty or damaged data set, a folder with other files, an export of
            other settings or of another state of the data set, a missing package; OSError
    """
    folder, write = Path(folder), _writer(form)
    samples = Samples(store, split)
    _require_own_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with lock.changing(folder):
        settings = {
            "layout": LAYOUTS[form],
            "format": form,
            "split": split,
            "each": each,
            "samples": len(samples.lines),
            "digest": samples.digest(),
        }
        pin_settings(folder / SETTINGS, settings)
        for name in ("dataset.json", "materials.json"):
            _copy(store, name, folder / name)
        for name, entry in samples.dataset.lights.items():
            if entry.file != (own := light_path(name, entry.hash)):
                raise InputError(
                    f"{store.folder}: '{entry.file}'",
                    f"'{own}'",
                    "another name",
                    "do not trust this manifest: verify names all faults",
                )
            _copy(store, own, folder / own)
        counts = {"made": 0, "already_there": 0}
        for part in parts(samples, form, each):
            path = inside(folder, part.path)
            there = path.is_file()
            counts["already_there" if there else "made"] += 1
            if there:
                if watch:
                    watch(len(part.lines))
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as file:
                write(file, _read(samples, part.lines, watch), samples)
        write_text(folder / CARD, data_card(samples, form, each, author))
    return Result(**counts, samples=len(samples.lines), left_out=samples.left_out)


def parts(samples: Samples, form: Format, each: int) -> Iterator[Part]:
    """Yield the parts of an export in their order, which depends on its settings alone."""
    lines = samples.lines
    if form == "hdf5":
        for number, line in enumerate(lines):
            yield Part(f"{number // each:06d}/{number}.hdf5", [line])
    elif form == "huggingface":
        for split in ("train", "test", "mixed"):
            chosen = samples.of_split(split)
            count = -(-len(chosen) // each)
            for number in range(count):
                name = f"data/{split}-{number:05d}-of-{count:05d}.parquet"
                yield Part(name, chosen[number * each : (number + 1) * each])
    else:
        ending = {"webdataset": "tar", "parquet": "parquet"}[form]
        for number in range(-(-len(lines) // each)):
            yield Part(f"{number:06d}.{ending}", lines[number * each : (number + 1) * each])


def _writer(form: Format) -> Callable[[BinaryIO, Iterator[Sample], Samples], None]:
    """Return what writes a part. Raises InputError if the format's package is missing."""
    if form == "webdataset":
        from manifests.exporting.webdataset import write_tar

        return write_tar
    if form == "hdf5":
        from manifests.exporting import blenderproc

        blenderproc.require_package()
        return blenderproc.write_frame
    from manifests.exporting import tables

    tables.require_package()
    return tables.write_huggingface if form == "huggingface" else tables.write_parquet


def _read(
    samples: Samples, lines: Sequence[Record | View], watch: Callable[[int], Any] | None
) -> Iterator[Sample]:
    for line in lines:
        yield samples.read(line)
        if watch:
            watch(1)


def _copy(store: Store, name: str, target: Path) -> None:
    """Copy a file of the data set, unless an earlier run of this export has."""
    if target.is_file():
        return
    source = require_file(
        inside(store.folder, name),
        "a file of the data set",
        "render or copy it again",
        MOST_COPIED_BYTES,
    )
    target.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(target, source.read_bytes())


def _require_own_folder(folder: Path) -> None:
    """Raise InputError if the folder holds files and no export."""
    if os.path.lexists(folder) and not folder.is_dir():
        raise InputError(folder, "a folder, or a name for a new one", "a file", REMEDY)
    if not folder.is_dir() or (folder / SETTINGS).is_file():
        return
    names = sorted(name for name in os.listdir(folder) if not name.startswith("."))
    if names:
        raise InputError(folder, "an empty folder, or one of an earlier export", names[0], REMEDY)
