"""A check before training that every picture is there, whole, finite and shows something.

All files are read once. The good ones are remembered by size and time of change
(packed/pictures.json), so that another run only asks the file system.
"""

import contextlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from learn.data.geometry import Geometry
from learn.data.records import Records
from manifests.errors import InputError
from manifests.files import write_text
from manifests.inputs import require_file
from manifests.progress import tqdm
from manifests.schema import Record
from manifests.store_paths import inside
from manifests.wording import number_of

LARGEST_FILE = 256 << 20  # bytes: a hundred of a picture


def check_records(
    records: Records,
    chosen: Iterable[Record],
    geometry: Geometry,
    skip_bad: bool = False,
    progress: bool = True,
) -> tuple[list[Record], dict[str, str]]:
    """Return the records that training can use, and {id: what is wrong} of the others.

    records   geometry is of the same folder
    chosen    those of the records that are checked
    skip_bad  whether bad records are left out; otherwise the first one raises
    Raises    InputError that names the record's file and the remedy
    """
    path = records.folder / "packed" / "pictures.json"
    known, good, skipped = _remembered_stamps(path), [], {}
    usable = {view.hash for view in geometry.views}
    for record in tqdm(
        chosen, "checking pictures", unit="picture", disable=not progress, leave=False
    ):
        try:
            stamp = _stamp(inside(records.folder, record.image))
            for name in record.materials:
                records.label(name)
            records.light(record.light)
            if stamp is None or known.get(record.id) != stamp:
                _check(records, record)
                known[record.id] = stamp
            if record.geometry_hash not in usable:
                result = geometry.skipped.get(
                    record.geometry_hash, "a shape that covers next to nothing of the frame"
                )
                raise InputError(
                    f"{records.folder}: record {record.id}",
                    "usable geometry",
                    result,
                    "render it again",
                )
            good.append(record)
        except InputError as problem:
            if not skip_bad:
                raise mention_skip_bad(problem) from None
            skipped[record.id] = str(problem)
    # on a full disk, or in a read-only data set, the next run checks them again
    with contextlib.suppress(OSError):
        path.parent.mkdir(exist_ok=True)
        write_text(path, json.dumps(known))
    return good, skipped


def mention_skip_bad(problem: InputError) -> InputError:
    """Return the InputError with a remedy that names --skip-bad too."""
    return InputError(
        problem.where,
        problem.expected,
        problem.found,
        f"{problem.remedy}, or leave it out by --skip-bad",
    )


def _check(records: Records, record: Record) -> None:
    """Read a record's picture. Raises InputError."""
    where = inside(records.folder, record.image)
    image = records.image(record)
    if not np.isfinite(image).all():
        count = int((~np.isfinite(image)).sum())
        raise InputError(
            where,
            "finite radiance",
            number_of(count, "value that is not", "values that are not"),
            "render it again",
        )


def _stamp(path: Path) -> list[int] | None:
    """Return [size, time of change] of a file; None if it is missing."""
    try:
        stat = path.stat()
    except OSError:
        return None
    return [stat.st_size, stat.st_mtime_ns]


def _remembered_stamps(path: Path) -> dict[str, Any]:
    """Return {record id: stamp} of the records that were good when they were last read."""
    try:
        require_file(path, "what was checked before", maximum_bytes=LARGEST_FILE)
        known = json.loads(path.read_text())
    except (OSError, ValueError, RecursionError):  # missing or damaged: all is checked again
        return {}
    return known if isinstance(known, dict) else {}
