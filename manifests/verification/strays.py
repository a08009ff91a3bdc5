"""What lies in a data set's folder and does not belong there: files that nothing names, and links.

Drafts, pipes and devices do not belong there either. Links are not followed: a file that lies
elsewhere may change or vanish, and what is removed here must not be there. Folders that cannot be
read are faults, too, and the search goes on.
"""

import os
import stat
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from manifests.store import LINES
from manifests.verification.faults import Fault

KNOWN = ("images", "geometry", "lights", "partial", "packed", "shape-facts", *LINES)
_KINDS = {
    stat.S_IFLNK: "a link",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFDIR: "a folder",
    stat.S_IFREG: "a file",
}


def kind_of(path: str | os.PathLike) -> str | None:
    """Return what lies at a path, links not followed: "a file", "a folder", …; or None."""
    try:
        return _KINDS.get(stat.S_IFMT(os.lstat(path).st_mode), "something else")
    except OSError:
        return None


def folder_faults(folder: Path) -> Iterator[Fault]:
    """Yield the faults at the top of the folder: links, pipes, devices, no subfolders."""
    for path in _list_folder(folder):
        kind = kind_of(path)
        if path.name in KNOWN:
            if kind != "a folder":
                yield Fault(f"{path.name}: expected a folder, found {kind}", file=path)
        elif kind not in ("a file", "a folder") and not (kind == "a link" and path.exists()):
            result = "a link that leads nowhere" if kind == "a link" else kind
            yield Fault(
                f"{path.name}: expected a file or a folder, found {result}", file=path, stray=True
            )


def stray_faults(folder: Path, named: Mapping[str, Collection[str]]) -> Iterator[Fault]:
    """Yield files that nothing names, and what is no file.

    named  {"images": paths relative to the folder, …}: what may lie in each of these folders
    """
    for kind, known in named.items():
        yield from _strays(folder, folder / kind, known)
    for kind in LINES:
        for path in _list_folder(folder / kind):
            if not path.name.endswith(".jsonl") and kind_of(path) is not None:
                yield Fault(
                    f"{kind}/{path.name}: expected files *.jsonl, found {kind_of(path)}",
                    file=path,
                    stray=True,
                )
    for path in _list_folder(folder / "partial"):
        text = (
            f"partial/{path.name}: expected nothing, found a file half-written by a run that was"
            " killed"
        )
        yield Fault(text, file=path, stray=True)


def _strays(folder, top, known):
    """Yield the strays in a folder of files, and in the folders in it."""
    if kind_of(top) != "a folder":  # nothing, or reported by folder_faults
        return
    try:
        entries = sorted(os.scandir(top), key=lambda entry: entry.name)
    except OSError as error:
        yield Fault(
            f"{top.relative_to(folder)}: expected a folder that can be read, found {error.strerror}"
        )
        return
    for entry in entries:
        path = Path(entry.path)
        relative = path.relative_to(folder).as_posix()
        kind = kind_of(path)
        if kind == "a folder" and relative not in known:
            yield from _strays(folder, path, known)
        elif relative in known:
            if kind != "a file":
                yield Fault(f"{relative}: expected a file of its own, found {kind}", file=path)
        elif kind is not None:
            text = (
                f"{relative}: expected a record that names it, found"
                f" {'none' if kind == 'a file' else kind}"
            )
            yield Fault(text, file=path, stray=True)


def _list_folder(folder):
    """Return what lies in a folder, in order of name; [] if it is none or cannot be read."""
    if kind_of(folder) != "a folder":
        return []
    try:
        return [Path(folder) / name for name in sorted(os.listdir(folder))]
    except OSError:
        return []
