"""A command on a disk that is full, in this process: what every command that writes must keep
to.
"""

import contextlib
import errno
import io
import os
import random

from manifests.cli import main
from tests.endurance.full_disk import bad_records, contents, drafts
from tests.endurance.full_disk_commands import COMMANDS, RUN, SIZE, mesh, pictures

__all__ = [
    "BY_NAME",
    "RUN",
    "SIZE",
    "bad_records",
    "check",
    "check_read_only",
    "contents",
    "done",
    "drafts",
    "mesh",
    "pictures",
]
BY_NAME = {command.name: command for command in COMMANDS}


def done(words):
    """(exit status, lines for the user on stderr, all of stderr) of a command line."""
    program, *rest = words
    error = io.StringIO()
    with contextlib.redirect_stderr(error), contextlib.redirect_stdout(io.StringIO()):
        if program == "learn.agreement.demo_page":
            from learn.agreement import demo_page

            status = demo_page.main(rest)
        else:
            status = main(program, "", (rest[0],), rest)
    lines = error.getvalue().replace("\r", "\n").splitlines()
    return status, [line for line in lines if line.startswith(f"{program}: ")], error.getvalue()


@contextlib.contextmanager
def counted(most=None):
    """A block in which what is written is counted, in a list of one number; beyond `most` bytes the
    disk is full.

    It sees what goes through os.write: all that manifests.files and manifests.line_files write.
    """
    write, total = os.write, [0]

    def counting(descriptor, data):
        left = len(data) if most is None else max(0, most - total[0])
        if not left:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        done = write(descriptor, bytes(data)[:left])
        total[0] += done
        return done

    os.write = counting
    try:
        yield total
    finally:
        os.write = write


def check(name, room, disk, small_files, seed):
    """Run a command of the table on full disks; raises AssertionError for what it must not do.

    small_files  the fixture of that name: a count of bytes beyond which no file can be written
    seed         which of its files does not fit, and at which byte the disk is full

    It fails first where nothing is yet, then, if it puts new results in the place of earlier ones,
    over these; each time it must succeed afterwards, where there is room.
    """
    command = BY_NAME[name]
    fine = (0, *command.statuses)
    whole = disk / "whole"
    whole.mkdir(parents=True)

    def succeeds(folder, over=False):
        status, _, error = done(command.words(room, folder, over))
        assert status in fine, (name, error[-500:])

    def fails(folder, full, what, over=False):
        earlier = contents(folder)
        with full:
            status, said, error = done(command.words(room, folder, over))
        where = f"{name}, {what}, {'over an earlier result' if over else 'where nothing is yet'}"
        assert status == 1, (where, status, error[-500:])
        assert len(said) == 1 and "Traceback" not in error, (where, error[-500:])
        assert not drafts(folder), (where, drafts(folder))
        left = contents(folder)
        lost = [
            path
            for path in earlier
            if left.get(path) != earlier[path] and not command.may_change(path)
        ]
        assert not lost, (where, lost)
        assert not [
            path
            for path in left
            if not (folder / path).stat().st_size and not command.may_be_empty(path)
        ], where

    with counted() as total:
        succeeds(whole)
    moments = random.Random(seed)
    sizes = sorted({path.stat().st_size for path in whole.rglob("*") if path.is_file()} - {0})
    size, most = moments.choice(sizes) - 1, moments.randrange(total[0] // 2, total[0])
    ways = (
        (lambda: small_files(size), f"files of at most {size} bytes"),
        (lambda: counted(most), f"{most} bytes of {total[0]}"),
    )
    for number, (full, what) in enumerate(ways):
        fresh = disk / f"fresh-{number}"
        fresh.mkdir()
        fails(fresh, full(), what)
        succeeds(fresh)
    if command.overwrites:
        for full, what in ways:
            fails(whole, full(), what, over=True)
        succeeds(whole, over=True)


def check_read_only(name, room, disk, read_only):
    """Run a command of the table where it may only read, then where it may not write; raises
    AssertionError for what it must not do.

    read_only  the fixture of that name
    """
    command = BY_NAME[name]
    for folder in ("out", "read only"):
        (disk / folder).mkdir(parents=True)
    read_only(room)
    status, _, error = done(command.words(room, disk / "out"))
    assert status in (0, *command.statuses), (name, "inputs that may only be read", error[-500:])
    read_only(disk / "read only")
    status, said, error = done(command.words(room, disk / "read only"))
    assert status == 1, (name, "a folder in which nothing can be written", error[-500:])
    assert len(said) == 1 and "Traceback" not in error and "Read-only file system" in said[0], (
        name,
        error[-500:],
    )
