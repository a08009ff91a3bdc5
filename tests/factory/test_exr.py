"""EXR files come back as they were written, whole or not at all."""

import os
import resource
from types import SimpleNamespace

import numpy as np
import OpenEXR
import pytest

from factory import exr
from manifests.problems import Problem


@pytest.fixture
def geometry(rng):
    normals = rng.normal(size=(24, 40, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    segments = rng.integers(0, 4, (24, 40)).astype(np.uint8)
    normals[segments == 0] = 0
    return SimpleNamespace(normals=normals.astype(np.float32), depth=rng.uniform(-1, 1, (24, 40)).astype(np.float32), segments=segments)


def test_a_picture_comes_back_to_half_precision(tmp_path, rng):
    radiance = rng.lognormal(sigma=3, size=(24, 40, 3)).astype(np.float32)
    exr.write_picture(tmp_path / "p.exr", radiance)
    np.testing.assert_allclose(exr.read_picture(tmp_path / "p.exr"), radiance, rtol=2**-11)
    with OpenEXR.File(str(tmp_path / "p.exr")) as file:
        assert file.channels()["RGB"].pixels.dtype == np.float16


def test_radiance_beyond_half_is_held_at_its_largest_number(tmp_path):
    exr.write_picture(tmp_path / "p.exr", np.full((2, 2, 3), 1e6, np.float32))
    assert (exr.read_picture(tmp_path / "p.exr") == 65504).all()


def test_geometry_comes_back_within_a_thousandth_of_a_degree(tmp_path, geometry):
    exr.write_geometry(tmp_path / "g.exr", geometry)
    normals, mask, depth, segments = exr.read_geometry(tmp_path / "g.exr")
    assert np.abs(normals - geometry.normals).max() <= 2**-16
    assert np.abs(np.linalg.norm(normals[mask], axis=-1) - 1).max() < 1e-3
    assert np.abs(depth - geometry.depth).max() <= 2**-16
    np.testing.assert_array_equal(segments, geometry.segments)
    np.testing.assert_array_equal(mask, geometry.segments > 0)


def test_the_same_pixels_are_the_same_file(tmp_path, geometry):
    for name in ("a.exr", "b.exr"):
        exr.write_geometry(tmp_path / name, geometry)
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


def test_a_write_that_fails_leaves_neither_file_nor_draft_and_says_why(tmp_path, rng):
    """A limit on file size stands for a full disk: the system refuses the bytes in either case."""
    import signal

    radiance = rng.random((256, 256, 3), dtype=np.float32)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    old = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with pytest.raises(OSError, match=r"p\.exr"):
            exr.write_picture(tmp_path / "p.exr", radiance)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, old)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("spoil", ["missing", "truncated", "empty", "text", "folder"])
def test_a_bad_file_is_one_line_that_names_it(tmp_path, geometry, spoil, capfd):
    path = tmp_path / "g.exr"
    exr.write_geometry(path, geometry)
    whole = path.read_bytes()
    path.unlink()
    if spoil == "folder":
        path.mkdir()
    elif spoil != "missing":
        path.write_bytes({"truncated": whole[: len(whole) * 2 // 3], "empty": b"", "text": b"no picture\n" * 40}[spoil])
    with pytest.raises(Problem, match=r"g\.exr: .* expected, found .*; render or copy it again"):
        exr.read_geometry(path)
    out, err = capfd.readouterr()
    assert out == err == ""


def test_a_picture_is_not_geometry(tmp_path):
    exr.write_picture(tmp_path / "p.exr", np.zeros((2, 2, 3), np.float32))
    with pytest.raises(Problem, match=r"channels normal\.X, normal\.Y, normal\.Z expected, found only B, G, R"):
        exr.read_geometry(tmp_path / "p.exr")
