"""Results of an earlier run that a run with --overwrite does not write again, and their removal.

A command's report, a JSON file among its results, lists the others with their hashes under the key
"files". A listed file is removed if it lies directly in the report's folder, has a name that the
command gives, is no input, and still holds the bytes that were written. Whatever a user has put
there or has changed stays, and so does what a forged report lists.
"""

import hashlib
import os
import re
import stat
from collections.abc import Collection, Iterable
from pathlib import Path

import msgspec

from manifests import files
from manifests.errors import InputError
from manifests.reading import read
from manifests.schema import Hash


class Report(msgspec.Struct, frozen=True):
    """What is read of a report. files: {name: sha256}, None where it lists none."""

    files: dict[str, Hash] | None = None


def written_hashes() -> dict[str, str]:
    """Return {name: sha256} of the files that the transaction in progress has written so far."""
    return {target.name: _hash(draft) for target, draft in sorted(files.drafts().items())}


def remove(
    report: Path,
    kept: Collection[str],
    own: re.Pattern[str],
    inputs: Iterable[str | os.PathLike] = (),
) -> str | None:
    """Remove what the earlier run of a report has written and this run does not write.

    report  of the earlier run; without it nothing is removed
    kept    names of the files that this run writes
    own     matches the names that the command gives
    inputs  files that this run reads
    Returns a line about earlier results that stay, None if there are none
    """
    if not os.path.lexists(report):
        return None
    folder, listed = report.parent, _listed_files(report)
    read_files = [path for path in inputs if os.path.isfile(path)]
    stay = []
    if listed is None:
        stay = [name for name in sorted(os.listdir(folder)) if own.fullmatch(name)]
        stay = [name for name in stay if name not in kept]
    for name, digest in (listed or {}).items():
        path = folder / name
        if name in kept or os.path.basename(name) != name or not own.fullmatch(name):
            continue
        if os.path.lexists(path) and not _remove_unchanged(path, digest, read_files):
            stay.append(name)
    if not stay:
        return None
    others = f" and {len(stay) - 1} more" if len(stay) > 1 else ""
    return (
        f"{folder}: {stay[0]}{others} stayed beside the new results: {report.name} does not list"
        " them as they are, or this run reads them; remove what is not needed"
    )


def _listed_files(report: Path) -> dict[str, str] | None:
    """Return the files that a report lists, None where it does not."""
    try:
        return read(report, Report).files
    except InputError:  # damaged, or another program's
        return None


def _remove_unchanged(path: Path, digest: str, inputs: list[str | os.PathLike]) -> bool:
    """Remove a file of that sha256 that is no input; return whether it was removed."""
    try:
        # of a link neither the link nor its target was written by a run
        if not stat.S_ISREG(os.lstat(path).st_mode):
            return False
        if any(path.samefile(each) for each in inputs) or _hash(path) != digest:
            return False
        path.unlink()
    except OSError:  # may not be read or removed
        return False
    return True


def _hash(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
