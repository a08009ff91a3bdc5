"""Whole files or none, and inputs that are looked at before they are opened."""

import errno
import os
import socket
from pathlib import Path

import numpy as np
import pytest

from manifests import files
from manifests.inputs import require_file
from manifests.problems import Problem


def test_a_block_that_fails_keeps_the_earlier_file_and_leaves_no_draft(tmp_path):
    path = tmp_path / "a.bin"
    files.write_bytes(path, b"old")
    with pytest.raises(RuntimeError), files.replacing(path) as file:
        file.write(b"new")
        raise RuntimeError
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.bin"]


@pytest.mark.parametrize("count", [0, 1, 4095, 4096])
def test_a_disk_that_takes_only_part_of_a_file_is_an_error_with_its_name(tmp_path, small_files, count):
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
        (os.mkdir, "a folder; name a file in it"),
        (os.mkfifo, "a pipe; save it as a file first"),
        (make_socket, "a socket"),
        (lambda path: path.symlink_to("/dev/zero"), "a device"),
        (lambda path: path.symlink_to(path), "too many levels of symbolic links"),
        (lambda path: path.write_bytes(bytes(2049)), "2.0 KiB; check that this is the right file"),
    ],
    ids=["missing", "folder", "pipe", "socket", "device", "circle of links", "too large"],
)
def test_what_is_no_ordinary_file_is_refused_before_it_is_opened(tmp_path, make, found):
    path = tmp_path / "input"
    make(path)
    with pytest.raises(Problem, match=found):
        require_file(path, "a mesh file", maximum_bytes=2048)


@pytest.mark.parametrize("name", ["a\0b", "a" * 300, "x/y/" * 2000])
def test_names_that_no_file_can_have_are_refused(name):
    with pytest.raises(Problem, match="a mesh file expected"):
        require_file(name, "a mesh file")


def test_an_ordinary_file_is_given_back(tmp_path):
    (tmp_path / "a").write_bytes(b"x")
    assert require_file(tmp_path / "a", "a file", maximum_bytes=1) == tmp_path / "a"
