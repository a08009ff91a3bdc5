"""Pictures, geometry and light maps come back as they were written, whole or not at all."""

import os
from types import SimpleNamespace

import numpy as np
import OpenEXR
import pytest

from manifests import exr
from manifests.arrays import DEPTH_CHANNEL, NORMAL_CHANNELS, SEGMENT_CHANNEL
from manifests.errors import InputError
from manifests.facets import OTHER_NORMALS, OTHERS, SHARE, Facets, number_channels
from manifests.files import npz_bytes, write_bytes
from manifests.light_files import encode_light, read_light
from manifests.picture_files import encode_geometry, encode_picture, read_geometry, read_picture
from shaders.envmap import unit_mean


def write_picture(path, radiance):
    write_bytes(path, encode_picture(radiance))


def write_geometry(path, geometry):
    write_bytes(path, encode_geometry(geometry))


@pytest.fixture
def geometry(rng):
    normals = rng.normal(size=(24, 40, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    segments = rng.integers(0, 4, (24, 40)).astype(np.uint8)
    normals[segments == 0] = 0
    return SimpleNamespace(
        normals=normals.astype(np.float32),
        depth=rng.uniform(-1, 1, (24, 40)).astype(np.float32),
        segments=segments,
        facets=None,
    )


@pytest.fixture
def facets(rng, geometry):
    """Of the geometry: every third pixel inside is beside an edge."""

    def unit(mask):
        vectors = rng.normal(size=(24, 40, 3))
        return (vectors / np.linalg.norm(vectors, axis=-1, keepdims=True) * mask[..., None]).astype(
            np.float32
        )

    inside = geometry.segments > 0
    mixed = inside & (np.arange(24 * 40).reshape(24, 40) % 3 == 0)
    mixed = np.stack([mixed, *[np.zeros_like(mixed)] * (OTHERS - 2), mixed])
    return Facets(
        unit(inside),
        (rng.uniform(-1, 1, (24, 40)) * inside).astype(np.float32),
        (rng.integers(1, 13, mixed.shape) / 32 * mixed).astype(np.float32),
        np.stack([unit(each) for each in mixed]),
        np.stack([unit(each) for each in mixed]),
        (mixed * rng.integers(1, 4, mixed.shape)).astype(np.uint8),
    )


def test_facets_come_back_and_files_without_them_hold_none(tmp_path, geometry, facets):
    write_geometry(tmp_path / "without.exr", geometry)
    assert read_geometry(tmp_path / "without.exr", exact=True).facets is None
    geometry.facets = facets
    write_geometry(tmp_path / "with.exr", geometry)
    back = read_geometry(tmp_path / "with.exr", exact=True)
    assert back.facets is not None
    for given, stored in zip(facets, back.facets, strict=True):
        assert stored.dtype == given.dtype and np.abs(stored - given).max() <= 2**-16
    np.testing.assert_array_equal(back.segments, geometry.segments)


def earlier_name(name):
    """The name of a channel in files that knew one other surface; None for further surfaces."""
    if not name.startswith("other."):
        return name
    return name.replace(".1.", ".") if ".1." in name else None


@pytest.mark.parametrize("knew", [earlier_name, lambda name: None if "other." in name else name])
def test_geometry_whose_points_are_of_an_earlier_version_is_read_without_them(
    tmp_path, geometry, facets, knew
):
    geometry.facets = facets
    write_geometry(tmp_path / "g.exr", geometry)
    channels = exr.read(tmp_path / "g.exr")
    named = {knew(name): values for name, values in channels.items()}
    named.pop(None, None)
    assert "facet.cosine" in named and "other.1.share" not in named
    exr.write(tmp_path / "g.exr", named)
    back = read_geometry(tmp_path / "g.exr", exact=True)
    assert back.facets is None
    np.testing.assert_array_equal(back.segments, geometry.segments)


@pytest.mark.parametrize(
    "wrong", [{number_channels(OTHER_NORMALS[0])[2]: None}, {number_channels(SHARE)[0]: np.nan}]
)
def test_facets_in_part_or_not_finite_are_refused(tmp_path, geometry, facets, wrong):
    geometry.facets = facets
    write_geometry(tmp_path / "g.exr", geometry)
    channels = exr.read(tmp_path / "g.exr")
    ((name, value),) = wrong.items()
    if value is None:
        del channels[name]
    else:
        channels[name] = np.full_like(channels[name], value)
    exr.write(tmp_path / "g.exr", channels)
    with pytest.raises(InputError, match=name.replace(".", r"\.")):
        read_geometry(tmp_path / "g.exr")


def test_interpolated_normals_are_what_they_were_before_they_faced_the_viewer(facets):
    cosine = np.array([[-0.3, 0.0005, 0.4]], np.float32)
    across = np.array([0.6, 0.8])
    given = np.concatenate([np.sqrt(1 - cosine**2)[..., None] * across, cosine[..., None]], axis=-1)
    seen = np.maximum(cosine, 1e-3)
    stored = np.concatenate([np.sqrt(1 - seen**2)[..., None] * across, seen[..., None]], axis=-1)
    back = facets._replace(cosine=cosine).interpolated_normals(stored.astype(np.float32))
    np.testing.assert_allclose(back, given, atol=1e-6)


def test_a_picture_comes_back_to_half_precision(tmp_path, rng):
    radiance = rng.lognormal(sigma=3, size=(24, 40, 3)).astype(np.float32)
    write_picture(tmp_path / "p.exr", radiance)
    np.testing.assert_allclose(read_picture(tmp_path / "p.exr"), radiance, rtol=2**-11)
    with OpenEXR.File(str(tmp_path / "p.exr")) as file:
        assert file.channels()["RGB"].pixels.dtype == np.float16


def test_radiance_beyond_half_is_held_at_its_largest_number(tmp_path):
    write_picture(tmp_path / "p.exr", np.full((2, 2, 3), 1e6, np.float32))
    assert (read_picture(tmp_path / "p.exr") == 65504).all()


def test_geometry_comes_back_within_a_thousandth_of_a_degree(tmp_path, geometry):
    write_geometry(tmp_path / "g.exr", geometry)
    back = read_geometry(tmp_path / "g.exr")
    normals, mask, depth, segments = back.normals, back.mask, back.depth, back.segments
    assert np.abs(normals - geometry.normals).max() <= 2**-16
    assert np.abs(np.linalg.norm(normals[mask], axis=-1) - 1).max() < 1e-3
    assert np.abs(depth - geometry.depth).max() <= 2**-16
    np.testing.assert_array_equal(segments, geometry.segments)
    np.testing.assert_array_equal(mask, geometry.segments > 0)


def test_the_same_pixels_are_the_same_file(tmp_path, geometry):
    for name in ("a.exr", "b.exr"):
        write_geometry(tmp_path / name, geometry)
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


def test_a_write_that_fails_leaves_neither_file_nor_draft_and_says_why(tmp_path, rng, small_files):
    with small_files(4096), pytest.raises(OSError, match=r"p\.exr"):
        write_picture(tmp_path / "p.exr", rng.random((256, 256, 3), dtype=np.float32))
    assert os.listdir(tmp_path) == []


def test_a_small_file_that_the_disk_has_no_room_for_is_an_error_and_no_empty_file(
    tmp_path, small_files
):
    """OpenEXR passes over the error of its last flush, which for a file below 2 KB is the only
    one.
    """
    with small_files(100), pytest.raises(OSError, match=r"p\.exr"):
        exr.write(tmp_path / "p.exr", {"Y": np.ones((4, 4), np.float32)})
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("arrays", "found"),
    [
        ({"L": np.ones((4, 8, 3), np.float32)}, r"\(4, 8, 3\)"),
        ({"L": np.full((64, 128, 3), np.nan, np.float32)}, "24576 values"),
        ({"L": np.full((64, 128, 3), -1, np.float32)}, "24576 values"),
        ({"L": np.ones((64, 128, 3), np.int32)}, "of int32"),
        ({"M": np.ones((64, 128, 3), np.float32)}, "L.npy"),
        ({"L": np.zeros((2000, 2000, 3), np.float32)}, r"\(2000, 2000, 3\) of float32"),
    ],
)
def test_a_stored_light_that_is_no_light_is_refused(tmp_path, arrays, found):
    write_bytes(tmp_path / "light.npz", npz_bytes(arrays))
    with pytest.raises(InputError, match=found):
        read_light(tmp_path / "light.npz")


def test_a_stored_light_comes_back(tmp_path, rng):
    L, _ = unit_mean(rng.random((64, 128, 3)))
    write_bytes(tmp_path / "light.npz", encode_light(L, 2.0))
    np.testing.assert_array_equal(read_light(tmp_path / "light.npz"), L)


@pytest.mark.parametrize("segment", [-1.0, 0.5, 256.0, 257.0, np.nan])
def test_segments_that_would_wrap_are_refused(tmp_path, geometry, segment):
    channels = dict.fromkeys((*NORMAL_CHANNELS, DEPTH_CHANNEL), np.zeros((2, 2), np.float32))
    exr.write(
        tmp_path / "g.exr", channels | {SEGMENT_CHANNEL: np.full((2, 2), segment, np.float32)}
    )
    with pytest.raises(InputError, match="expected segments 0 to 255"):
        read_geometry(tmp_path / "g.exr")


@pytest.mark.parametrize("value", [np.nan, np.inf, -0.5])
def test_a_picture_with_values_that_are_no_radiance_is_refused(tmp_path, value):
    exr.write(tmp_path / "p.exr", dict.fromkeys("RGB", np.full((2, 2), value, np.float16)))
    with pytest.raises(InputError, match="12 values that are not"):
        read_picture(tmp_path / "p.exr")


def test_a_picture_of_another_size_than_its_record_says_is_refused(tmp_path):
    write_picture(tmp_path / "p.exr", np.ones((2, 4, 3), np.float32))
    with pytest.raises(InputError, match="expected 4 × 2 pixels, found 2 × 4"):
        read_picture(tmp_path / "p.exr", (4, 2))


@pytest.mark.parametrize("spoil", ["missing", "truncated", "empty", "text", "folder"])
def test_a_bad_file_is_one_line_that_names_it(tmp_path, geometry, spoil, capfd):
    path = tmp_path / "g.exr"
    write_geometry(path, geometry)
    whole = path.read_bytes()
    path.unlink()
    if spoil == "folder":
        path.mkdir()
    elif spoil != "missing":
        path.write_bytes(
            {"truncated": whole[: len(whole) * 2 // 3], "empty": b"", "text": b"no picture\n" * 40}[
                spoil
            ]
        )
    with pytest.raises(
        InputError,
        match=r"g\.exr: expected .*, found .* \((render or copy it again|name a file in it)",
    ):
        read_geometry(path)
    out, err = capfd.readouterr()
    assert out == err == ""


def test_a_picture_is_not_geometry(tmp_path):
    write_picture(tmp_path / "p.exr", np.zeros((2, 2, 3), np.float32))
    with pytest.raises(InputError, match=r"expected channels normal\.X, .*, found only B, G, R"):
        read_geometry(tmp_path / "p.exr")
