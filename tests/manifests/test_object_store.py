"""Folders on object stores: URLs, tries, errors, and copies of bounded size. In memory."""

import os
import sys
import threading
import time
from pathlib import Path

import pytest

from manifests import object_store
from manifests.cached_store import CachedStore, open_store
from manifests.errors import InputError
from manifests.object_store import ObjectFolder, Unreachable, is_url, normalise
from manifests.store import Store
from manifests.verification import faults_of

pytest.importorskip("fsspec", reason="fsspec is not installed (extra stores)")


@pytest.fixture
def remote(request, monkeypatch, tmp_path):
    """A folder in memory, of which nothing is left; copies lie in tmp_path."""
    import fsspec

    monkeypatch.setenv("BRDFACTORY_STORE_CACHE", str(tmp_path / "copies"))
    url = f"memory://{request.node.originalname}"
    yield ObjectFolder(url, patience=0.0)
    files = fsspec.filesystem("memory")
    if files.exists(url):
        files.rm(url, recursive=True)


class Failing:
    """A file system whose requests fail a number of times before each is carried out, and once
    after it was.
    """

    def __init__(self, files, failures, error):
        self._files, self.left, self._error = files, failures, error

    def __getattr__(self, name):
        method = getattr(self._files, name)

        def tried(*values, **keys):
            if self.left <= 0 or name == "invalidate_cache":
                return method(*values, **keys)
            self.left -= 1
            if self.left == 0:
                method(*values, **keys)  # it was done, and the answer is lost
            raise self._error

        return tried


def test_a_url_is_one_and_a_path_is_not():
    for text in ("s3://bucket/x", "s3:/bucket/x", "file:///tmp/x", "memory://a", "abfs://c@a/x"):
        assert is_url(text), text
    for text in ("out/x", "/tmp/x", "C:/x", "./s3", "a b://c"):
        assert not is_url(text), text
    assert normalise("S3:/bucket/x/") == "s3://bucket/x"  # as pathlib writes it
    assert normalise("file:/tmp/x") == "file:///tmp/x"


@pytest.mark.parametrize(
    "url",
    [
        "s3://key:secret@bucket/x",
        "sftp://me:secret@host/x",
        "s3://bucket/x?secret=1",
        "s3://bucket/x#secret",
        "s3://bucket/../x",
        "simplecache::s3://bucket/x",
    ],
)
def test_a_url_with_credentials_or_another_trick_is_refused_without_being_shown(url):
    with pytest.raises(InputError) as caught:
        ObjectFolder(url)
    assert "secret" not in str(caught.value)


def test_a_url_that_was_held_as_a_path_is_shown_with_two_slashes():
    assert InputError(Path("s3://bucket/x"), "a", "b", "c").where == "s3://bucket/x"
    assert InputError(Path("/tmp/x"), "a", "b", "c").where == "/tmp/x"


def test_a_protocol_without_a_plug_in_is_refused_in_a_line():
    with pytest.raises(InputError, match="nothing://a/b: expected a protocol that can be used"):
        ObjectFolder("nothing://a/b")


def test_objects_are_listed_read_and_replaced(remote):
    assert remote.names("records") == {}
    remote.write("records/a.jsonl", b"1\n")
    remote.write("records/a.jsonl", b"12\n")
    remote.write("images/ab/x.exr", b"")
    assert remote.names("records") == {"records/a.jsonl": 3}
    assert remote.names("images") == {}
    assert remote.names("images", deep=True) == {"images/ab/x.exr": 0}
    assert remote.read("records/a.jsonl") == b"12\n"
    with pytest.raises(FileNotFoundError):
        remote.read("records/b.jsonl")


def test_many_objects_are_read_in_order_and_few_of_them_ahead(remote, monkeypatch):
    names = [f"a/{k}" for k in range(200)]
    for name in names:
        remote.write(name, name.encode())
    begun, read = [], remote.read
    monkeypatch.setattr(remote, "read", lambda name: begun.append(name) or read(name))
    for count, pair in enumerate(remote.read_all(names)):
        assert pair == (names[count], names[count].encode())
        assert len(begun) <= count + object_store.AHEAD
    assert count == 199


def test_a_file_is_never_seen_half_written(tmp_path):
    remote = ObjectFolder(f"file://{tmp_path}/x")
    seen = []
    opened = remote._files.pipe_file

    def looked(path, data):
        opened(path, data)
        seen.append(sorted(remote.names("records")))

    remote._files.pipe_file = looked
    try:
        remote.write("records/a.jsonl", b"1\n")
    finally:
        remote._files.pipe_file = opened  # fsspec keeps its file systems
    assert seen == [[]] and remote.read("records/a.jsonl") == b"1\n"


def test_requests_that_fail_are_tried_again(remote, monkeypatch):
    pauses = []
    monkeypatch.setattr(object_store.time, "sleep", pauses.append)
    remote._patience = 60.0
    remote._files = failing = Failing(remote._files, 5, OSError("reset by peer"))
    remote.write("a.json", b"1")
    assert pauses == [0.5, 1, 2, 4, 8]
    failing.left = 2
    assert remote.read("a.json") == b"1" and len(pauses) == 7
    failing.left = 2
    assert remote.names("") == {"a.json": 1} and len(pauses) == 9


def test_after_the_last_try_there_is_one_line(remote):
    remote._files = Failing(remote._files, 1000, OSError("reset\nby peer"))
    for request in (
        lambda: remote.names("records"),
        lambda: remote.read("a.json"),
        lambda: remote.write("a.json", b""),
    ):
        with pytest.raises(Unreachable, match="expected a store that answers") as caught:
            request()
        assert "reset by peer" in str(caught.value) and "\n" not in str(caught.value)


def test_what_another_try_does_not_mend_is_said_at_once(remote, monkeypatch):
    monkeypatch.setattr(object_store.time, "sleep", lambda _: pytest.fail("it waits"))
    remote._patience = 1000.0
    remote._files = Failing(remote._files, 1000, PermissionError("no"))
    with pytest.raises(Unreachable, match="PermissionError"):
        remote.write("a.json", b"")


def test_missing_credentials_are_said_in_plain_words(remote):
    asked = f"Generic S3 error: PUT http://{object_store.METADATA}/latest/api/token in 12 ms: 403"
    remote._files = Failing(remote._files, 1000, RuntimeError(asked))
    with pytest.raises(Unreachable, match="found no credentials in the environment") as caught:
        remote.write("a.json", b"")
    assert "http" not in str(caught.value) and "docs/clusters.md" in str(caught.value)


def test_a_host_that_does_not_exist_ends_the_command_at_once(monkeypatch):
    monkeypatch.setattr(object_store.time, "sleep", lambda _: pytest.fail("it waits"))
    remote = ObjectFolder("memory://a/b", patience=1000.0)
    error = OSError(-2, "Name or service not known")
    remote._files = Failing(remote._files, 1000, error)
    with pytest.raises(Unreachable, match=r"^memory://a/b: expected a host that exists"):
        remote.write("records/a.json", b"")


def test_a_store_that_has_never_answered_is_given_up_soon(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(object_store.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(
        object_store.time, "sleep", lambda pause: clock.__setitem__(0, clock[0] + pause)
    )
    remote = ObjectFolder("memory://a/b", patience=1000.0)
    files = remote._files
    remote._files = Failing(files, 1000, OSError("refused"))
    with pytest.raises(Unreachable, match=r"^memory://a/b: expected a store that answers"):
        remote.names("records")
    assert clock[0] <= object_store.FIRST_PATIENCE
    remote._files = files
    remote.names("records")
    remote._files, before = Failing(files, 1000, OSError("refused")), clock[0]
    with pytest.raises(Unreachable):
        remote.names("records")
    assert clock[0] - before > 900


def test_a_line_says_once_that_a_store_does_not_answer(remote, monkeypatch, capsys):
    monkeypatch.setattr(object_store.time, "sleep", lambda _: None)
    remote._patience, files = 60.0, remote._files
    for _ in range(2):  # an answer between
        remote._files = Failing(files, 3, OSError("reset by peer"))
        remote.write("a.json", b"1")
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1 and "reset by peer; trying again for up to" in lines[0]


def test_a_line_says_where_it_waits_while_a_first_request_hangs(remote, monkeypatch, capsys):
    monkeypatch.setattr(object_store, "SAY_AFTER", 0.01)
    printed = threading.Event()
    monkeypatch.setattr(
        object_store, "notice", lambda text: (print(text, file=sys.stderr), printed.set())
    )
    listed = remote._files.ls

    def slow(*values, **options):
        assert printed.wait(20)
        return listed(*values, **options)

    monkeypatch.setattr(remote._files, "ls", slow)
    remote.names("")
    assert capsys.readouterr().err.startswith(f"{remote.url}: connecting, no answer yet")


def test_the_patience_is_a_number(monkeypatch):
    monkeypatch.setenv(object_store.VARIABLE, "long")
    with pytest.raises(InputError, match="BRDFACTORY_STORE_PATIENCE: expected a number"):
        ObjectFolder("memory://a")


@pytest.fixture
def stored(remote, whole):
    """A whole data set in memory: (ObjectFolder, its own folder)."""
    folder = whole()
    for path in folder.rglob("*"):
        if path.is_file() and not path.name.startswith("."):
            remote.write(path.relative_to(folder).as_posix(), path.read_bytes())
    return remote, folder


def test_a_data_set_is_read_and_verified_from_a_store(stored):
    remote, folder = stored
    for fresh in (False, True):
        store = open_store(remote.url, fresh)
        assert store.dataset() == Store(folder).dataset() and store.name == remote.url
        assert list(store.records()) == list(Store(folder).records())
        record = next(store.records())
        assert not (store.folder / record.image).exists()  # only what is asked for is copied
        assert store.fetch(record.image).read_bytes() == (folder / record.image).read_bytes()
        assert faults_of(store) == []


def test_verify_finds_what_is_wrong_on_a_store(stored):
    remote, folder = stored
    record = next(Store(folder).records())
    remote.write(record.image, b"nothing")
    remote.write("images/ff/stray.exr", b"nothing")
    said = [fault.text for fault in faults_of(open_store(remote.url, fresh=True))]
    assert len(said) == 2 and record.image in said[0] and "images/ff/stray.exr" in said[1]


def test_what_was_changed_or_removed_on_a_store_is_not_read_from_copies(stored):
    remote, _ = stored
    count = len(list(open_store(remote.url).records()))
    (first,) = remote.names("records")
    remote.write("records/more.jsonl", remote.read(first))
    assert len(list(open_store(remote.url).records())) == 2 * count
    remote._files.rm(f"{remote._base}/{first}")
    remote._files.rm(f"{remote._base}/records/more.jsonl")
    assert list(open_store(remote.url).records()) == []


def test_lines_of_the_same_size_are_copied_again_once_they_have_changed(stored, monkeypatch):
    """A folder that was rendered again and copied to the same place."""
    remote, _ = stored
    before = list(open_store(remote.url).records())
    (name,) = remote.names("records")
    remote.write(name, remote.read(name).replace(before[0].id.encode(), b"0" * 24))
    assert next(open_store(remote.url).records()).id == "0" * 24
    read = []
    monkeypatch.setattr(ObjectFolder, "read_all", lambda self, names: read.extend(names) or ())
    open_store(remote.url)
    assert name not in read and "dataset.json" in read


def test_copies_used_longest_ago_make_room(remote):
    names = [f"images/ab/{number}.exr" for number in range(10)]
    for name in names:
        remote.write(name, bytes(1000))
    store = CachedStore(remote.url, limit_bytes=5000)
    begun = time.time() - 1000
    for number, name in enumerate(names):
        path = store.fetch(name)
        os.utime(path, (begun + number, begun + number))
        store._recent.clear()  # as if another process had used it
    held = [name for name in names if (store.folder / name).exists()]
    assert held == names[-len(held) :] and 3 <= len(held) <= 5
    assert store.fetch(names[0]).stat().st_size == 1000  # and they come back
    for name in names:  # used just now: none is removed while it may be read
        assert store.fetch(name).exists()
    assert all((store.folder / name).exists() for name in names)


def test_copies_make_room_after_the_clock_was_set_back(remote, monkeypatch):
    names = [f"images/ab/{number}.exr" for number in range(10)]
    for name in names:
        remote.write(name, bytes(1000))
    for name in names:
        CachedStore(remote.url, limit_bytes=100_000).fetch(name)
    real = time.time
    monkeypatch.setattr(time, "time", lambda: real() - 86_400.0)
    remote.write("images/ab/more.exr", bytes(1000))
    store = CachedStore(remote.url, limit_bytes=5000)
    store.fetch("images/ab/more.exr")
    held = [name for name in names if (store.folder / name).exists()]
    assert held == names[-len(held) :] and 3 <= len(held) <= 4


def test_copies_about_to_be_read_stay_when_the_clock_jumps_ahead(remote, monkeypatch):
    names = [f"images/ab/{number}.exr" for number in range(10)]
    for name in names:
        remote.write(name, bytes(1000))
    store, real = CachedStore(remote.url, limit_bytes=5000), time.time
    for number, name in enumerate(names):
        monkeypatch.setattr(time, "time", lambda ahead=3600.0 * number: real() + ahead)
        store.fetch(name)
    assert all((store.folder / name).exists() for name in names)


def test_a_path_that_leaves_the_folder_is_not_copied(remote):
    store = CachedStore(remote.url)
    with pytest.raises(InputError, match="one that leaves it"):
        store.fetch("../../secret")


@pytest.mark.parametrize("kind", ["lights", "images", "geometry"])
def test_verify_ends_where_the_store_is_lost(stored, kind):
    """That it is lost is no fault of the file that was asked for."""
    store = open_store(stored[0].url, fresh=True)
    for path in (store.folder / "lights").iterdir():
        path.unlink()
    read = store.remote.read

    def lost(relative):
        if relative.startswith(kind):
            raise Unreachable(relative, "a store that answers", "none", "wait")
        return read(relative)

    store.remote.read = lost
    with pytest.raises(Unreachable, match=rf"{kind}/.* found none"):
        faults_of(store)


def test_a_url_held_as_a_path_is_shown_with_its_slashes():
    for text in ("s3://bucket/x", "file:///tmp/x", "az://c/x"):
        assert str(InputError(Path(text), "a", "b", "c")).startswith(f"{text}: expected a")
