"""Whole files or none, and inputs that are looked at before they are opened."""

import errno
import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from manifests import files
from manifests.errors import InputError
from manifests.inputs import require_file


def test_a_block_that_fails_keeps_the_earlier_file_and_leaves_no_draft(tmp_path):
    path = tmp_path / "a.bin"
    files.write_bytes(path, b"old")
    with pytest.raises(RuntimeError), files.replacing(path) as file:
        file.write(b"new")
        raise RuntimeError
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.bin"]


@pytest.mark.parametrize("count", [0, 1, 4095, 4096])
def test_a_disk_that_takes_only_part_of_a_file_is_an_error_with_its_name(
    tmp_path, small_files, count
):
    path = tmp_path / "a.bin"
    with small_files(count), pytest.raises(OSError, match=r"a\.bin") as error:
        files.write_bytes(path, bytes(4097))
    assert error.value.errno == errno.EFBIG
    assert os.listdir(tmp_path) == []


def test_numpy_writes_through_the_draft_and_not_past_it(tmp_path, small_files):
    """np.save writes by C to any real file, and the error of C's last flush is lost."""
    with small_files(600), pytest.raises(OSError), files.replacing(tmp_path / "a.npy") as file:
        np.save(file, np.ones(100))
    assert os.listdir(tmp_path) == []
    with files.replacing(tmp_path / "a.npy") as file:
        np.save(file, np.ones(100))
    assert np.load(tmp_path / "a.npy").sum() == 100


def test_an_empty_file_is_never_kept(tmp_path):
    with pytest.raises(ValueError, match=r"a\.png: nothing was written"):
        files.write_with(tmp_path / "a.png", lambda file: None)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("name", ["a.png", "a.jpg"])
def test_images_are_written_in_the_format_of_their_ending(tmp_path, name):
    from PIL import Image

    files.write_image(tmp_path / name, np.zeros((2, 3, 3), np.uint8))
    with Image.open(tmp_path / name) as image:
        assert (image.format, image.size) == ({"a.png": "PNG", "a.jpg": "JPEG"}[name], (3, 2))


def test_a_missing_folder_is_named_by_the_file_that_was_to_lie_there(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none/a\.txt'"):
        files.write_text(tmp_path / "none" / "a.txt", "text")


def make_socket(path):
    # a relative name, for a socket's own may have no more than 108 letters
    before = Path.cwd()
    os.chdir(path.parent)
    try:
        with socket.socket(socket.AF_UNIX) as opened:
            opened.bind(path.name)
    finally:
        os.chdir(before)


@pytest.mark.parametrize(
    ("make", "found"),
    [
        (lambda path: None, "no such file"),
        (os.mkdir, "a folder \\(name a file in it"),
        (os.mkfifo, "a pipe \\(save it as a file first"),
        (make_socket, "a socket"),
        (lambda path: path.symlink_to("/dev/zero"), "a device"),
        (lambda path: path.symlink_to(path), "too many levels of symbolic links"),
        (
            lambda path: path.write_bytes(bytes(2049)),
            "2.0 KiB \\(check that this is the right file",
        ),
    ],
    ids=["missing", "folder", "pipe", "socket", "device", "circle of links", "too large"],
)
def test_what_is_no_ordinary_file_is_refused_before_it_is_opened(tmp_path, make, found):
    path = tmp_path / "input"
    make(path)
    with pytest.raises(InputError, match=found):
        require_file(path, "a mesh file", maximum_bytes=2048)


@pytest.mark.parametrize("name", ["a\0b", "a" * 300, "x/y/" * 2000])
def test_names_that_no_file_can_have_are_refused(name):
    with pytest.raises(InputError, match="expected a mesh file"):
        require_file(name, "a mesh file")


def test_an_ordinary_file_is_given_back(tmp_path):
    (tmp_path / "a").write_bytes(b"x")
    assert require_file(tmp_path / "a", "a file", maximum_bytes=1) == tmp_path / "a"


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_results_that_belong_together_take_their_places_together_or_not_at_all(tmp_path):
    files.write_text(tmp_path / "a.txt", "old")
    with pytest.raises(RuntimeError), files.transaction():
        files.write_text(tmp_path / "a.txt", "new")
        files.write_text(tmp_path / "b.txt", "new")
        assert (tmp_path / "a.txt").read_text() == "old"
        raise RuntimeError
    assert names(tmp_path) == ["a.txt"] and (tmp_path / "a.txt").read_text() == "old"
    with files.transaction():
        files.write_text(tmp_path / "a.txt", "new")
        with files.transaction():  # belongs to the outer block
            files.write_text(tmp_path / "b.txt", "new")
        assert (tmp_path / "a.txt").read_text() == "old" and not (tmp_path / "b.txt").exists()
    assert names(tmp_path) == ["a.txt", "b.txt"] and (tmp_path / "a.txt").read_text() == "new"


def test_a_disk_that_is_full_at_the_second_of_two_results_takes_neither(tmp_path, small_files):
    files.write_text(tmp_path / "small", "old")
    with small_files(10), pytest.raises(OSError, match="large"), files.transaction():
        files.write_text(tmp_path / "small", "new")
        files.write_text(tmp_path / "large", "a longer text")
    assert names(tmp_path) == ["small"] and (tmp_path / "small").read_text() == "old"


def test_of_two_results_one_that_cannot_be_placed_does_not_hold_up_the_other(tmp_path):
    with pytest.raises(OSError, match="folder"), files.transaction():
        files.write_text(tmp_path / "folder", "text")
        files.write_text(tmp_path / "other", "text")
        (tmp_path / "folder").mkdir()
    assert names(tmp_path) == ["folder", "other"]


KILLED = """
import os, signal, sys
from manifests import files
with files.replacing(sys.argv[1]) as file:
    file.write(b"half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_the_draft_of_a_killed_program_is_hidden_and_goes_with_the_next_file_that_is_written_there(
    tmp_path,
):
    assert (
        subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "a.png")]).returncode
        == -signal.SIGKILL
    )
    (draft,) = names(tmp_path)
    assert draft.startswith(".a.png.") and draft.endswith(".part")
    number = draft.split("-")[-2]
    others = [
        draft.replace(f"-{number}-", f"-{os.getpid()}-"),  # a living program's
        # another machine's, whose numbers mean nothing here
        draft.replace(f"-{number}-", f"elsewhere-{number}-"),
        ".a.png.part",  # no file of ours has that name
    ]
    for name in others:
        (tmp_path / name).write_bytes(b"")
    files.write_bytes(tmp_path / "b.png", b"whole")
    assert names(tmp_path) == sorted(["b.png", *others])


@pytest.mark.parametrize("name", ["b" * 255, "é" * 127])
def test_the_longest_names_a_file_can_have_can_be_written(tmp_path, name):
    files.write_bytes(tmp_path / name, b"x")
    assert names(tmp_path) == [name]


@pytest.mark.parametrize(
    "make",
    [os.mkdir, os.mkfifo, lambda path: path.symlink_to("/dev/null")],
    ids=["folder", "pipe", "device"],
)
def test_what_is_no_file_is_neither_written_into_nor_replaced(tmp_path, make):
    make(tmp_path / "out")
    with pytest.raises(InputError, match="expected a file, or a name for a new one, found a"):
        files.write_bytes(tmp_path / "out", b"x")
    assert names(tmp_path) == ["out"] and not (tmp_path / "out").is_file()


def test_an_error_at_the_last_moment_names_the_file_and_leaves_the_earlier_one(
    tmp_path, monkeypatch
):
    """Some file systems say that a disk is full only when what was written is to reach it."""

    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    files.write_bytes(tmp_path / "a", b"old")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"No space left on device: '.*/a'"):
        files.write_bytes(tmp_path / "a", b"new")
    assert names(tmp_path) == ["a"] and (tmp_path / "a").read_bytes() == b"old"


@pytest.mark.parametrize("name", ["é" * 120, "x" * 250, "é\udcff"])
def test_a_file_of_any_name_that_the_system_takes_can_be_written(tmp_path, name):
    files.write_bytes(tmp_path / name, b"content")
    assert (tmp_path / name).read_bytes() == b"content"
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_file_name_that_is_no_utf8_is_written_down_and_read_back(tmp_path):
    name = os.fsdecode(b"ph\xe9to")
    files.write_json(tmp_path / "a.json", {"name": name})
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8")) == {"name": name}
