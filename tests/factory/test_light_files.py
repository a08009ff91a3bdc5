"""Light maps that are hostile, damaged or very large: refused in one line, or read in bounded
memory, pixel for pixel.
"""

import io
import os
import struct
import subprocess
import sys
import zipfile

import numpy as np
import OpenEXR
import pytest

import manifests.exr
from factory.lights import files, library, load
from factory.lights.light import from_pixels, looks_like_eight_bits
from manifests.errors import InputError


@pytest.fixture
def L(rng):
    """A small map (16, 32, 3) float32."""
    return rng.uniform(0.1, 5, (16, 32, 3)).astype(np.float32)


def refused(path, *said):
    with pytest.raises(InputError) as problem:
        load(path)
    line = str(problem.value)
    assert (
        "\n" not in line and line.startswith(str(path)) and all(words in line for words in said)
    ), line


def exr(path, channels, **header):
    with OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, channels) as file:
        file.write(str(path))
    return path


def npy(array):
    stream = io.BytesIO()
    np.lib.format.write_array(stream, array, allow_pickle=True)
    return stream.getvalue()


def zipped(path, members, **options):
    with zipfile.ZipFile(path, "w", **options) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


# OpenEXR


def test_channels_are_read_alike_however_they_are_stored(tmp_path, L):
    R, G, B = (np.ascontiguousarray(L[..., k]) for k in range(3))
    alpha = np.ones_like(R)
    for number, channels in enumerate(
        (
            {"RGB": L},
            {"RGBA": np.concatenate([L, alpha[..., None]], axis=-1)},
            {"R": R, "G": G, "B": B, "Z": alpha},
            {
                "R": R,
                "G": G,
                "B": B,
                "left.R": alpha,
                "left.G": alpha.astype(np.float16),
                "left.B": alpha,
            },
            {"R": R, "G": G, "B": B, "Y": alpha, "V": alpha},
            {"R": R, "G": G, "B": B, "A": alpha.astype(np.float16)},
        )
    ):
        pixels = files.read(exr(tmp_path / f"{number}.exr", channels))[0]
        np.testing.assert_array_equal(pixels, L)
    mixed = files.read(exr(tmp_path / "mixed.exr", {"R": R, "G": G.astype(np.float16), "B": B}))[0]
    np.testing.assert_array_equal(
        mixed, np.stack([R, G.astype(np.float16).astype(np.float32), B], axis=-1)
    )
    tiled = exr(
        tmp_path / "tiled.exr", {"RGB": L}, type=OpenEXR.tiledimage, tiles=OpenEXR.TileDescription()
    )
    np.testing.assert_array_equal(files.read(tiled)[0], L)


def test_a_window_that_begins_anywhere_is_read(tmp_path, L):
    corner = np.array([-7, -3], np.int32)
    window = corner, corner + np.array([31, 15], np.int32)
    path = exr(tmp_path / "a.exr", {"RGB": L}, dataWindow=window, displayWindow=window)
    np.testing.assert_array_equal(files.read(path)[0], L)


@pytest.mark.parametrize(
    ("window", "says"),
    [
        ((0, 0, 2**30, 2**29), ""),
        ((0, 0, -1, -1), ""),
        ((5, 5, 4, 4), ""),
        ((-(2**31), -(2**31), 2**31 - 1, 2**31 - 1), ""),
        ((0, 0, 8191, 4095), "damaged"),  # a lie within bounds
        ((0, 0, 31, 31), "32×32"),
        ((0, 0, 31, 17), "32×18"),
    ],
)
def test_a_data_window_that_lies_is_refused(tmp_path, L, window, says):
    path = exr(tmp_path / "a.exr", {"RGB": L})
    data = path.read_bytes()
    place = data.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    path.write_bytes(data[:place] + struct.pack("<4i", *window) + data[place + 16 :])
    refused(path, says)


@pytest.mark.parametrize("side", [(2**20, 2**20), (2**31 - 1, 1), (2**32 - 1, 2**32 - 1), (0, 0)])
def test_tiles_that_are_larger_than_any_picture_are_refused_before_memory_is_taken(
    tmp_path, L, side
):
    path = exr(
        tmp_path / "a.exr", {"RGB": L}, type=OpenEXR.tiledimage, tiles=OpenEXR.TileDescription()
    )
    data = path.read_bytes()
    place = data.index(b"tiles\0tiledesc\0") + len(b"tiles\0tiledesc\0") + 4
    path.write_bytes(data[:place] + struct.pack("<2I", *side) + data[place + 8 :])
    refused(path)
    with pytest.raises(InputError):
        manifests.exr.read(path)


def test_deep_sub_sampled_and_odd_pictures_are_refused(tmp_path, L):
    deep = np.empty((4, 8), object)
    for place in np.ndindex(4, 8):
        deep[place] = np.ones(2, np.float32)
    refused(
        exr(
            tmp_path / "deep.exr",
            dict.fromkeys("RGB", deep),
            type=OpenEXR.deepscanline,
            compression=OpenEXR.ZIPS_COMPRESSION,
        ),
        "expected a flat picture, found a deep one",
    )
    path = exr(tmp_path / "sampled.exr", {"RGB": L})
    data = path.read_bytes()
    place = data.index(b"G\0\2\0\0\0") + 10  # name, type, pLinear and three bytes more
    path.write_bytes(data[:place] + struct.pack("<2i", 2, 2) + data[place + 8 :])
    refused(path)
    refused(
        exr(tmp_path / "rg.exr", {"R": L[..., 0].copy(), "G": L[..., 1].copy()}),
        "expected channels R, G, B, found G, R",
    )


def test_other_parts_count_before_they_are_read(tmp_path, L, monkeypatch):
    header = {"type": OpenEXR.scanlineimage}
    parts = [
        OpenEXR.Part({**header, "name": name}, {"RGB": L}) for name in ("first", "second", "third")
    ]
    path = tmp_path / "parts.exr"
    OpenEXR.File(parts).write(str(path))
    np.testing.assert_array_equal(files.read(path)[0], L)
    monkeypatch.setattr(files, "LARGEST_TILE", 0)
    monkeypatch.setattr(files, "MAX_HEIGHT", 16)  # of 16 × 32 pixels four channels fit, nine do not
    refused(path, "at most 32×16 pixels of four channels")


# npz


@pytest.mark.parametrize("dtype", ["<f2", "<f4", ">f4", "<f8", ">f8"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_arrays_of_any_float_and_order_are_read_alike(tmp_path, L, dtype, order):
    L = np.tile(L, (5, 5, 1))  # more rows and columns than are read at a time
    np.savez(tmp_path / "a.npz", L=np.asarray(L.astype(dtype), order=order))
    np.testing.assert_array_equal(
        files.read(tmp_path / "a.npz")[0], L.astype(dtype).astype(np.float32)
    )


@pytest.mark.parametrize(
    "array",
    [
        np.ones((16, 32, 3), int),
        np.ones((16, 32, 3), complex),
        np.ones((16, 32, 3), bool),
        np.ones((16, 32, 3), np.longdouble),
        np.full((16, 32, 3), "1.0"),
        np.full((16, 32, 3), None),
        np.zeros((16, 32, 3), [("a", "f4")]),
        np.ones((16, 32)),
        np.ones((16, 31, 3)),
        np.ones((2, 4, 3)),
        np.ones(0),
        np.float32(1),
    ],
)
def test_arrays_that_are_no_maps_are_refused(tmp_path, array):
    refused(zipped(tmp_path / "a.npz", {"L.npy": npy(array)}))


def lying_npy(shape, descr="<f4", data=b"\0" * 64):
    head = f"{{'descr': {descr!r}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    head += b" " * (-(len(head) + 11) % 64) + b"\n"
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(head)) + head + data


@pytest.mark.parametrize(
    "data",
    [
        lying_npy("(4096, 8192, 3)"),  # announces 0.4 GB
        lying_npy("(-16, -32, 3)"),
        lying_npy("(16, 32, 3)"),
        lying_npy("(16.0, 32.0, 3)"),
        lying_npy("(True, 2, 3)"),
        lying_npy("(10000000000000000000000, 20000000000000000000000, 3)"),
        lying_npy("(16, 32, 3)", "|O"),
        lying_npy("(16, 32, 3)", "<f4', '<f4"),
        lying_npy("()"),
        b"\x93NUMPY\1\0\xff\xff" + b"(" * 65535,
        b"\x93NUMPY\x09\0\x10\0",
        b"no array at all",
        b"",
    ],
)
def test_headers_of_arrays_that_lie_are_refused(tmp_path, data):
    refused(zipped(tmp_path / "a.npz", {"L.npy": data}))


def encrypted(path, members):
    """A zip whose directory says that its members are encrypted."""
    data = bytearray(zipped(path, members).read_bytes())
    for signature, flags in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        place = -1
        while (place := data.find(signature, place + 1)) >= 0:
            data[place + flags] |= 1
    path.write_bytes(data)
    return path


def test_encrypted_nested_and_unknown_members_are_refused(tmp_path, L):
    refused(encrypted(tmp_path / "a.npz", {"L.npy": npy(L)}), "encrypted")
    inner = zipped(tmp_path / "inner.npz", {"L.npy": npy(L)}).read_bytes()
    refused(zipped(tmp_path / "b.npz", {"inner.npz": inner}), "a whole .npz file")
    data = bytearray(zipped(tmp_path / "c.npz", {"L.npy": npy(L)}).read_bytes())
    for signature, method in ((b"PK\3\4", 8), (b"PK\1\2", 10)):
        data[data.index(signature) + method] = 99
    (tmp_path / "c.npz").write_bytes(data)
    refused(tmp_path / "c.npz", "a whole .npz file")
    refused(
        zipped(tmp_path / "d.npz", {"a.npy": npy(L), "b.npy": npy(L)}),
        "expected one map, found several ('a', 'b', …)",
    )
    (tmp_path / "e.npz").write_bytes(b"PK\5\6" + b"\0" * 18)
    refused(tmp_path / "e.npz", "begins with")


def test_a_name_in_a_zip_that_is_no_text_is_refused(tmp_path, L):
    path = zipped(tmp_path / "a.npz", {"\u00e9.npy": npy(L)})
    path.write_bytes(path.read_bytes().replace("\u00e9".encode(), b"\xff\xff"))
    refused(path, "a whole .npz file")


@pytest.mark.parametrize("compression", [zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_damage_inside_compressed_members_is_told_in_one_line(tmp_path, L, compression, rng):
    whole = zipped(tmp_path / "a.npz", {"L.npy": npy(L)}, compression=compression).read_bytes()
    for _ in range(40):
        data = bytearray(whole)
        for place in rng.integers(30, len(data), 3):
            data[place] = rng.integers(256)
        (tmp_path / "a.npz").write_bytes(data)
        try:
            light = load(tmp_path / "a.npz")
        except InputError as problem:
            assert "\n" not in str(problem)
        else:
            assert np.isfinite(light.L64).all()


# Values and sizes


def test_radiance_beyond_what_float32_can_be_scaled_by_is_refused(tmp_path, L):
    for scale, says in ((1e-44, "a mean radiance"), (1e36, "a mean radiance")):
        np.savez(tmp_path / "a.npz", L=L * np.float32(scale))
        refused(tmp_path / "a.npz", says)
    np.savez(tmp_path / "a.npz", L=L.astype(float) * 1e300)
    refused(tmp_path / "a.npz", "NaN or infinity in 512 texels")
    np.savez(tmp_path / "a.npz", L=L * np.float32(1e-20))
    assert np.isfinite(load(tmp_path / "a.npz").L_full).all()


@pytest.mark.parametrize(
    "line",
    [
        "EXPOSURE=1e29\n" * 9,
        "EXPOSURE=1e-29\n" * 9,
        "EXPOSURE=nan\n",
        "EXPOSURE=-1\n",
        "EXPOSURE=1e999\n",
    ],
)
def test_exposures_that_no_picture_has_are_refused(tmp_path, line):
    head = f"#?RADIANCE\n{line}FORMAT=32-bit_rle_rgbe\n\n-Y 16 +X 32\n".encode()
    (tmp_path / "a.hdr").write_bytes(head + bytes([128, 128, 128, 130]) * 16 * 32)
    refused(tmp_path / "a.hdr", "EXPOSURE= with a positive number")


def test_the_brightest_exponents_of_radiance_files_are_told_and_not_infinite(tmp_path):
    for exponent in (255, 254, 1):
        data = (
            b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16 +X 32\n"
            + bytes([255, 255, 255, exponent]) * 16 * 32
        )
        (tmp_path / "a.hdr").write_bytes(data)
        refused(tmp_path / "a.hdr", "a mean radiance from 1e-30 to 1e+30")


def test_scanlines_longer_than_a_piece_of_the_file_are_read_whole(tmp_path, monkeypatch, rng):
    from factory.lights import rgbe

    bytes_ = rng.integers(2, 200, (40, 80, 4)).astype(np.uint8)
    (tmp_path / "a.hdr").write_bytes(
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 40 +X 80\n" + bytes_.tobytes()
    )
    whole = files.read(tmp_path / "a.hdr")[0]
    monkeypatch.setattr(rgbe, "PIECE", 100)
    monkeypatch.setattr(rgbe, "ROWS", 7)
    np.testing.assert_array_equal(files.read(tmp_path / "a.hdr")[0], whole)
    np.testing.assert_allclose(
        whole, bytes_[..., :3] * 2.0 ** (bytes_[..., 3:].astype(float) - 136), rtol=1e-7
    )


def test_a_map_of_pictures_levels_is_known_before_all_of_it_is_looked_at(rng):
    levels = np.linspace(0, 1, 256, dtype=np.float32)
    for height in (64, 200):
        pixels = levels[rng.integers(0, 256, (height, 2 * height, 3))]
        assert looks_like_eight_bits(pixels)
        pixels[-1, -1] = 0.12345
        assert not looks_like_eight_bits(pixels)


def test_a_map_made_a_light_stays_as_it_was_unless_it_is_given_away(L):
    before = L.copy()
    light = from_pixels(L, "a", "0" * 64, "CC0", "test")
    np.testing.assert_array_equal(L, before)
    own = from_pixels(L, "a", "0" * 64, "CC0", "test", in_place=True)
    np.testing.assert_array_equal(own.L_full, light.L_full)
    assert np.shares_memory(own.L_full, L)


MEASURED = """
import sys
from factory.lights import load
import OpenEXR, scipy.sparse
def bytes_of(key):
    lines = open("/proc/self/status")
    return next(int(line.split()[1]) << 10 for line in lines if line.startswith(key))
load(sys.argv[1])
for path in sys.argv[2:]:
    open("/proc/self/clear_refs", "w").write("5")
    before = bytes_of("VmRSS")
    light = load(path)
    print(bytes_of("VmHWM") - before)
    del light
"""


@pytest.mark.skipif(
    not os.path.exists("/proc/self/clear_refs"),
    reason="needs Linux's account of a process's memory",
)
def test_large_maps_take_little_more_memory_than_their_pixels(tmp_path, root, rng):
    """7 times the pixels, 2.8 GB of a map of 8192 × 4096, when masks, means and averages were made
    of the whole map in float64.
    """
    height, width = 1152, 2304  # more rows than are copied whole
    values = rng.random((height, width, 3), dtype=np.float32) * 3
    flat = np.concatenate(
        [(values * 80).astype(np.uint8) + 2, np.full((height, width, 1), 129, np.uint8)], axis=-1
    )
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode()
    (tmp_path / "a.hdr").write_bytes(head + flat.tobytes())
    np.savez(tmp_path / "a.npz", L=values)
    plain = {"compression": OpenEXR.NO_COMPRESSION}
    small = exr(tmp_path / "small.exr", {"RGB": values[:16, :32].copy()})
    most = {  # of the pixels' own bytes
        tmp_path / "a.hdr": 1.0,
        tmp_path / "a.npz": 1.0,
        exr(tmp_path / "float.exr", {"RGB": values}, **plain): 1.0,
        exr(tmp_path / "half.exr", {"RGB": values.astype(np.float16)}, **plain): 1.5,
        exr(
            tmp_path / "alpha.exr",
            {"RGBA": np.concatenate([values, values[..., :1]], axis=-1)},
            **plain,
        ): (4 / 3),
        exr(
            tmp_path / "depth.exr",
            {**{c: values[..., k].copy() for k, c in enumerate("RGB")}, "Z": values[..., 0].copy()},
            **plain,
        ): (7 / 3),
    }
    done = subprocess.run(
        [sys.executable, "-c", MEASURED, small, *most],
        cwd=root,
        capture_output=True,
        text=True,
        check=True,
    )
    for (path, share), peak in zip(most.items(), map(int, done.stdout.split()), strict=True):
        # bands of 64 rows in float64, some at a time: 30 MB
        assert peak < share * 12 * height * width + 30e6, (path.name, peak)


# What is no file, and lists


def test_pipes_devices_and_circles_of_links_are_refused_as_lights(tmp_path):
    os.mkfifo(tmp_path / "a.hdr")
    refused(tmp_path / "a.hdr", "expected an .hdr, .exr or .npz file, found a pipe")
    (tmp_path / "b.exr").symlink_to("b.exr")
    refused(tmp_path / "b.exr", "too many levels of symbolic links")
    (tmp_path / "c.exr").symlink_to("/dev/zero")
    refused(tmp_path / "c.exr", "a device")
    assert not files.is_collection(tmp_path / "a.hdr")


def test_a_file_far_larger_than_any_map_is_refused_unread(tmp_path):
    path = tmp_path / "a.hdr"
    with open(path, "wb") as file:
        file.write(b"#?RADIANCE\n")
        file.truncate(3 << 30)
    refused(path, "of at most 1.0 GiB, found 3.0 GiB")


@pytest.mark.parametrize(
    "content",
    [
        b"{",
        b"[]",
        b'{"a": 1}',
        b'{"a": {"licence": 5}}',
        b"[" * 100_000,
        b"\xff\xfe",
        b'{"a": {"file": null}}',
    ],
)
def test_a_damaged_list_of_lights_is_refused(tmp_path, L, content):
    exr(tmp_path / "lamp.exr", {"RGB": L})
    (tmp_path / library.LIST).write_bytes(content)
    with pytest.raises(InputError, match=r"lights\.json"):
        load("lamp", tmp_path)


def test_a_list_of_lights_that_is_a_pipe_is_refused(tmp_path, L):
    exr(tmp_path / "lamp.exr", {"RGB": L})
    os.mkfifo(tmp_path / library.LIST)
    with pytest.raises(InputError, match="a pipe"):
        load("lamp", tmp_path)
