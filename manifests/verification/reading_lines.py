"""Lines of records, views and failures, or the faults of those that cannot be read."""

from collections.abc import Iterator
from pathlib import Path

import msgspec

from manifests.errors import InputError
from manifests.line_files import bounded_lines, too_long
from manifests.schema import Failure, Record, View
from manifests.store import LINES, Store
from manifests.verification.faults import Fault
from manifests.verification.strays import kind_of


def read_lines(store: Store, kind: str) -> Iterator[tuple[Path, int, Record | View | Fault]]:
    """Yield (file, number, line) of each Record or View.

    A Fault takes the place of a line, file or folder that cannot be read.
    """
    folder = store.folder / kind
    if kind_of(folder) != "a folder":  # there is none, or folder_faults says what there is instead
        return
    try:
        paths = store.record_files(kind)
    except InputError as problem:
        yield folder, 0, Fault(str(problem))
        return
    decoder = msgspec.json.Decoder(LINES[kind])
    for path in paths:
        where = f"{kind}/{path.name}"
        if (result := kind_of(path)) != "a file":
            yield path, 0, Fault(f"{where}: expected a file of lines, found {result}", file=path)
            continue
        try:
            for number, text in bounded_lines(path):
                yield (
                    path,
                    number,
                    _decode_lines(decoder, f"{where}:{number}", kind[:-1], text, (path, number)),
                )
        except (InputError, OSError) as problem:
            yield path, 0, Fault(f"{where}: {problem}")


def _decode_lines(decoder, where, what, text, line):
    if text is None:
        return Fault(str(too_long(where)), line=line)
    if not text.endswith(b"\n"):
        return Fault(
            f"{where}: expected a whole line, found one cut short (the next run over it"
            " removes it)",
            line=line,
        )
    try:
        return decoder.decode(text)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        return Fault(f"{where}: expected a {what}, found {error}", line=line)


def failure_faults(store: Store) -> Iterator[Fault]:
    """Yield the faults of lines of failures*.jsonl, which `status` cannot read."""
    decoder = msgspec.json.Decoder(Failure)
    for path in sorted(store.folder.glob("failures*.jsonl")):
        if kind_of(path) != "a file":  # folder_faults says so
            continue
        try:
            for number, text in bounded_lines(path):
                line = _decode_lines(
                    decoder, f"{path.name}:{number}", "failure", text, (path, number)
                )
                if isinstance(line, Fault):
                    yield line
        except (InputError, OSError) as problem:
            yield Fault(f"{path.name}: {problem}")
