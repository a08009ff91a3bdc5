"""The dataset's folder: whole files or none, lines that survive a kill and a full disk, paths that
stay inside.
"""

import os
import subprocess
import sys

import msgspec
import pytest

from manifests.errors import InputError
from manifests.line_files import Lines, encode
from manifests.schema import Record
from manifests.store import Store
from manifests.store_paths import file_hash, geometry_path, image_path, inside, light_path
from manifests.verification import Fault, repair
from tests.support.work_count import calls


def test_files_are_sharded_by_the_first_two_digits_of_their_id():
    assert image_path("abcdef") == "images/ab/abcdef.exr"
    assert geometry_path("00ff") == "geometry/00/00ff.exr"
    assert light_path("my map/../x", "0123456789abcdef") == "lights/my-map-..-x-0123456789ab.npz"


@pytest.mark.parametrize(
    "path",
    [
        "../x",
        "images/../dataset.json",
        "/etc/passwd",
        "images/../../x",
        "a\\..\\b",
        "",
        "link/x",
        "a\0b",
    ],
)
def test_a_path_that_leaves_the_folder_is_refused(tmp_path, path):
    folder = tmp_path / "data"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    with pytest.raises(InputError, match="inside the data set's folder"):
        inside(folder, path)


def test_a_path_inside_is_given_back(tmp_path):
    assert inside(tmp_path, "images/ab/x.exr") == tmp_path / "images/ab/x.exr"


def test_a_url_is_no_folder_and_its_message_says_what_to_do():
    with pytest.raises(InputError, match=r"^s3://bucket/x: .*found a URL \(copy the data set"):
        Store("s3://bucket/x").dataset()


def test_a_file_that_the_disk_has_no_room_for_leaves_no_trace_and_keeps_the_old_one(
    tmp_path, small_files
):
    store = Store(tmp_path)
    store.place("images/ab/x.exr", b"old", "w")
    with small_files(4096), pytest.raises(OSError, match=r"File too large.*images/ab/x\.exr"):
        store.place("images/ab/x.exr", bytes(5000), "w")
    assert (tmp_path / "images/ab/x.exr").read_bytes() == b"old"
    assert list((tmp_path / "partial").iterdir()) == []


def test_of_two_workers_the_first_geometry_stays(tmp_path):
    store = Store(tmp_path)
    first = store.place("geometry/ab/x.exr", b"first", "w0", keep_first=True)
    second = store.place("geometry/ab/x.exr", b"second", "w1", keep_first=True)
    assert first == second == file_hash(tmp_path / "geometry/ab/x.exr")
    assert (tmp_path / "geometry/ab/x.exr").read_bytes() == b"first"


def test_a_torn_last_line_is_passed_over_by_readers_and_cut_by_the_next_writer(a_dataset, a_record):
    path = a_dataset.record_files()[0]
    whole = path.read_bytes()
    line = msgspec.json.encode(a_record("f" * 24))
    for torn in (line[:1], line[:-1], line):
        path.write_bytes(whole + torn)
        assert len(a_dataset.ids()) == 3 and len(list(a_dataset.records())) == 3
    lines = Lines(path)
    lines.append(a_record("e" * 24))
    lines.close()
    assert path.read_bytes()[: len(whole)] == whole
    assert "e" * 24 in a_dataset.ids() and "f" * 24 not in a_dataset.ids()


def test_a_file_of_one_endless_torn_line_is_emptied(tmp_path):
    path = tmp_path / "records" / "worker-00.jsonl"
    path.parent.mkdir()
    path.write_bytes(b"x" * 200_000)
    Lines(path).close()
    assert path.read_bytes() == b""


def test_a_damaged_line_in_the_middle_is_named_by_file_and_line(a_dataset):
    path = a_dataset.record_files()[0]
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(lines[0] + b'{"id": 5}\n' + lines[1])
    with pytest.raises(
        InputError,
        match=(
            r"worker-00\.jsonl:2: id: expected str, found 5 \(python -m factory verify .*--repair"
        ),
    ):
        list(a_dataset.records())


def test_another_schema_version_and_a_missing_dataset_are_refused(a_dataset, tmp_path):
    path = a_dataset.folder / "dataset.json"
    path.write_text(path.read_text().replace('"version": 1', '"version": 2'))
    with pytest.raises(InputError, match=r"expected schema version 1, found 2"):
        a_dataset.dataset()
    with pytest.raises(InputError, match=r"expected a data set .*, found none"):
        Store(tmp_path / "nowhere").dataset()


def test_geometry_that_the_disk_has_no_room_for_is_named_by_its_place(tmp_path, small_files):
    with small_files(10), pytest.raises(OSError, match=r"'.*/geometry/ab/x\.exr'"):
        Store(tmp_path).place("geometry/ab/x.exr", bytes(20), "w", keep_first=True)
    assert os.listdir(tmp_path / "partial") == os.listdir(tmp_path / "geometry" / "ab") == []


@pytest.mark.parametrize(
    "damage", [lambda text: b"", lambda text: text[: len(text) // 2], lambda text: b"[]"]
)
def test_a_damaged_dataset_says_that_it_can_be_made_again(a_dataset, damage):
    path = a_dataset.folder / "dataset.json"
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(InputError, match=r"delete it and render each of the folder's jobs again"):
        a_dataset.dataset()


def test_a_damaged_line_of_failures_says_that_nothing_hangs_on_it(a_dataset):
    (a_dataset.folder / "failures.jsonl").write_bytes(b"{}\n")
    with pytest.raises(InputError, match=r"failures\.jsonl:1: .*delete this file"):
        list(a_dataset.failures())


def test_what_lines_name_is_known_by_one_reading(a_dataset):
    ids, hashes = a_dataset.known_ids()
    assert ids == a_dataset.ids() == {f"{k:024x}" for k in range(3)}
    assert hashes == {
        geometry_path("9" * 24): file_hash(a_dataset.folder / geometry_path("9" * 24))
    }
    assert a_dataset.known_ids("views") == (set(), hashes)


def test_a_pipe_in_the_place_of_a_file_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="found a pipe"):
        file_hash(tmp_path / "pipe")
    with pytest.raises(FileNotFoundError):
        file_hash(tmp_path / "none")


def test_of_two_workers_who_mend_one_file_the_first_ones_stays(tmp_path):
    store, name = Store(tmp_path), "geometry/ab/x.exr"
    damaged = store.place(name, b"damaged", "w0")
    first = store.place_instead(name, b"first", "w0", damaged)
    assert store.place_instead(name, b"second", "w1", damaged) == first
    assert (tmp_path / name).read_bytes() == b"first"
    (tmp_path / name).unlink()
    assert store.place_instead(name, b"third", "w1", None) == file_hash(tmp_path / name)
    assert os.listdir(tmp_path / "partial") == []


OTHER = """
import sys
from manifests.errors import InputError
from manifests.store import Lines
try:
    Lines(sys.argv[1])
except InputError as problem:
    print(problem)
"""


def test_a_file_of_lines_has_one_writer(tmp_path, a_record):
    lines = Lines(tmp_path / "rows.jsonl")
    lines.append({"a": 1})
    # so that a second writer would have something to cut off
    os.write(lines._descriptor, b"half a li")
    other = [sys.executable, "-c", OTHER, str(tmp_path / "rows.jsonl")]
    assert (
        "no other run writes to, found one in use"
        in subprocess.run(other, capture_output=True, text=True).stdout
    )
    assert (tmp_path / "rows.jsonl").read_bytes() == b'{"a":1}\nhalf a li'
    lines.close()
    assert subprocess.run(other, capture_output=True, text=True).stdout == ""
    assert (tmp_path / "rows.jsonl").read_bytes() == b'{"a":1}\n'


def test_a_torn_line_that_could_not_be_cut_off_is_cut_off_before_the_next(
    tmp_path, small_files, monkeypatch
):
    lines = Lines(tmp_path / "rows.jsonl")
    lines.append({"a": 1})

    def fails(*_):
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as failing, small_files(12), pytest.raises(OSError):
        failing.setattr(os, "ftruncate", fails)
        lines.append({"b": 2})
    assert (tmp_path / "rows.jsonl").read_bytes() == b'{"a":1}\n{"b"'
    lines.append({"c": 3})
    lines.close()
    assert (tmp_path / "rows.jsonl").read_bytes() == b'{"a":1}\n{"c":3}\n'


def test_a_repair_leaves_its_draft_where_it_is_swept(a_dataset, monkeypatch):
    """A kill while a file of records is written again must not leave a file that reads as one of
    records.
    """

    class Killed(BaseException):
        pass

    def die(draft, target):
        drafts.append(draft)
        os.link(draft, f"{draft}.left")  # what a kill would leave
        raise Killed

    drafts = []
    monkeypatch.setattr(os, "replace", die)
    with pytest.raises(Killed):
        repair(a_dataset, [Fault("damaged", f"{1:024x}", (a_dataset.record_files()[0], 2))])
    monkeypatch.undo()
    assert [draft.parent for draft in drafts] == [a_dataset.folder / "partial"]
    assert len(a_dataset.ids()) == 3
    a_dataset.sweep()
    assert os.listdir(a_dataset.folder / "partial") == []


def test_records_can_be_filtered(a_dataset):
    assert [r.id for r in a_dataset.records(lambda record: record.id.endswith("1"))] == [
        f"{1:024x}"
    ]


def test_a_line_on_a_full_disk_is_written_whole_or_not_at_all(tmp_path, a_record):
    """RLIMIT_FSIZE cuts a write short just as a full disk does; in a child, since the limit cannot
    be raised again.
    """
    path = tmp_path / "records" / "worker-00.jsonl"
    size = len(encode(a_record("0" * 24))) + 1
    code = f"""
import resource, signal, msgspec
from manifests.schema import Record
from manifests.store import Lines
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, ({2 * size + size // 2},) * 2)
record = msgspec.json.decode({msgspec.json.encode(a_record("0" * 24))!r}, type=Record)
lines = Lines({str(path)!r})
for k in range(5):
    try:
        lines.append(record)
    except OSError as error:
        print(k, error.filename)
        break
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.split() == ["2", str(path)], done.stderr
    assert path.stat().st_size == 2 * size
    assert len(list(Store(tmp_path).records())) == 2


@pytest.fixture
def tiny_disk(tmp_path):
    """A file system of 256 KiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(folder)],
        capture_output=True,
        text=True,
    )
    if done.returncode:
        pytest.skip(f"needs the right to mount a small file system: {done.stderr.strip()}")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_on_a_full_disk_what_was_written_stays_and_the_error_names_the_cause(tiny_disk):
    store = Store(tiny_disk)
    written = {}
    with pytest.raises(OSError, match="No space left on device"):
        for k in range(100):
            name = f"images/ab/{k}.exr"
            written[name] = store.place(name, os.urandom(20_000), "w")
    assert len(written) >= 5
    assert all(file_hash(tiny_disk / name) == digest for name, digest in written.items())
    assert list((tiny_disk / "partial").iterdir()) == []


def test_ids_of_many_records_come_in_a_flash(tmp_path, a_record):
    """720,000 must take seconds: no record is checked field by field (tests/endurance/timings.py
    measures the time).
    """
    count = 2000
    lines = Lines(tmp_path / "records" / "worker-00.jsonl")
    for k in range(count):
        lines.append(a_record(f"{k:024x}"))
    lines.close()
    assert calls(lambda: Store(tmp_path).ids()) < 5 * count  # 3 for each line
    assert len(Store(tmp_path).ids()) == count
    assert all(isinstance(record, Record) for record in Store(tmp_path).records())
