"""Chooses the record of a data set that is edited."""

from collections.abc import Sequence

from learn.data.records import Records
from manifests.errors import InputError, closest
from manifests.schema import Record


def choose_record(records: Records, requested: str | None, targets: Sequence[str]) -> Record:
    """Return the record of a data set that is edited.

    requested  id of the record, or its beginning. None: the first held-out record in none of the
               target materials; if there is none, the first held-out record, or the first of all
    targets    names of the target materials; an edit into the object's own material shows nothing
    Raises     InputError: there are no records, or none of that id
    """
    if not len(records):
        raise InputError(
            records.folder, "records", "none", "render some: python -m factory render JOB --out DIR"
        )
    if requested is None:
        candidates = [r for r in records.records if r.split == "test"] or records.records
        others = (r for r in candidates if not set(targets) & set(r.materials))
        return next(others, candidates[0])
    record = next((r for r in records.records if r.id.startswith(requested)), None)
    if record is None:
        raise InputError(
            f"record '{requested}'",
            f"a record of {records.folder}",
            "none",
            closest(requested, [r.id for r in records.records]),
        )
    return record
