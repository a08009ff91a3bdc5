"""Which photographs are accepted: their radiance, formats, sizes and metadata; every other one is
refused in one line.
"""

import io
import os
import re
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from learn.__main__ import COMMANDS
from learn.data import framing, photographs, picture_decoding
from learn.editing import edit_files, photograph
from manifests import cli, exr
from manifests.errors import InputError

SIZE = (48, 64)


def main(words):
    """The exit status of `learn WORDS`."""
    return cli.main("learn", "test", COMMANDS, words)


@pytest.fixture
def ball():
    """(H, W, 3) float32 radiance of a lit ball before a grey ground."""
    y, x = np.mgrid[-1 : 1 : SIZE[0] * 1j, -1 : 1 : SIZE[1] * 1j]
    level = np.where(x**2 + y**2 < 0.6, np.sqrt(np.maximum(0.7 - x**2 - y**2, 0)), 0.2)
    return (level[..., None] * [1.0, 0.8, 0.5]).astype(np.float32)


@pytest.fixture
def mask_file(tmp_path):
    y, x = np.mgrid[-1 : 1 : SIZE[0] * 1j, -1 : 1 : SIZE[1] * 1j]
    Image.fromarray(np.uint8(255 * (x**2 + y**2 < 0.6))).save(tmp_path / "mask.png")
    return tmp_path / "mask.png"


@pytest.fixture
def exr_file(tmp_path, ball):
    """A function that writes the ball, times a factor, with further channels, and returns the
    path.
    """

    def write(factor=1.0, **more):
        planes = {
            name: (ball[..., k].astype(np.float64) * factor).astype(np.float32)
            for k, name in enumerate("RGB")
        }
        exr.write(tmp_path / "photo.exr", planes | more)
        return tmp_path / "photo.exr"

    return write


def encoded(array, format_="PNG", **options):
    out = io.BytesIO()
    Image.fromarray(array).save(out, format=format_, **options)
    return out.getvalue()


def bytes_of(ball):
    return np.uint8(255 * ball)


# ------------------------------------------------------------------------------------------------
# radiance


@pytest.mark.parametrize("factor", [1e37, 1e12])
def test_radiance_that_no_light_has_is_refused(exr_file, mask_file, factor):
    with pytest.raises(InputError, match=r"photo\.exr: expected radiance up to 1e\+10"):
        photograph.open_photograph(exr_file(factor), [mask_file])


def test_one_huge_value_beside_the_object_is_refused_too(exr_file, mask_file, tmp_path):
    channels = exr.read(exr_file())
    # a white balance would carry it beyond float32, and the mask's 0 times it be NaN
    channels["R"][0, 0] = 1e37
    exr.write(tmp_path / "photo.exr", channels)
    with pytest.raises(InputError, match="radiance up to"):
        photograph.open_photograph(tmp_path / "photo.exr", [mask_file])


@pytest.mark.parametrize(
    ("factor", "found"), [(0, "0, black or negative"), (-1, "0, black or negative"), (1e-5, "e-06")]
)
def test_an_object_without_light_is_refused_with_the_option_to_give(
    exr_file, mask_file, factor, found
):
    with pytest.raises(
        InputError, match=rf"photo\.exr: expected an object of mean luminance .*{found}.*--exposure"
    ):
        photograph.open_photograph(exr_file(factor), [mask_file])


@pytest.mark.parametrize(
    ("level", "accepted"), [(0, False), (2, False), (4, True), (128, True), (255, True)]
)
def test_a_constant_picture_is_accepted_unless_it_is_nearly_black(
    tmp_path, mask_file, level, accepted
):
    """Of 8 bits a mean luminance of 0.001 has three steps; a clipped object is evenly bright, and
    its edit is finite.
    """
    (tmp_path / "photo.png").write_bytes(encoded(np.full((*SIZE, 3), level, np.uint8)))
    if not accepted:
        with pytest.raises(InputError, match="an object of mean luminance"):
            photograph.open_photograph(tmp_path / "photo.png", [mask_file])
        return
    result = photograph.open_photograph(tmp_path / "photo.png", [mask_file])
    framed = framing.frame_object(result.balanced, result.mask, 32, result.exposure, "photo")
    assert np.isfinite(framed.radiance).all()


@pytest.mark.parametrize(
    ("factor", "exposure", "accepted"),
    [(1e-5, 1e5, True), (1e-5, 1e-38, False), (1, 1e38, False), (1e4, 1e-4, True)],
)
def test_an_exposure_has_to_bring_the_object_to_what_networks_know(
    exr_file, mask_file, factor, exposure, accepted
):
    path = exr_file(factor)
    if accepted:
        result = photograph.open_photograph(path, [mask_file], exposure=exposure)
        assert framing.frame_object(
            result.balanced, result.mask, 32, exposure
        ).radiance.max() == pytest.approx(0.8, rel=0.1)
    else:
        with pytest.raises(InputError, match="mean luminance times the exposure"):
            photograph.open_photograph(path, [mask_file], exposure=exposure)


@pytest.mark.parametrize("command", ["edit", "predict"])
@pytest.mark.parametrize(
    "options", [("--exposure", "1e-38"), ("--exposure", "1e38"), ("--exposure", "nan")]
)
def test_no_exposure_makes_a_picture_that_is_not_finite(
    tmp_path, ball, mask_file, capsys, command, options
):
    (tmp_path / "photo.png").write_bytes(encoded(bytes_of(ball)))
    more = ["--material", "brass", "--no-refine"] if command == "edit" else []
    words = [
        command,
        tmp_path / "photo.png",
        "--mask",
        mask_file,
        *more,
        *options,
        "--out",
        tmp_path / "out",
    ]
    assert main(list(map(str, words))) == 1
    assert "exposure" in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_transparency_that_is_not_finite_is_refused(exr_file, mask_file, value):
    alpha = np.ones(SIZE, np.float32)
    alpha[0, 0] = value
    with pytest.raises(InputError, match="a finite alpha channel"):
        photograph.open_photograph(exr_file(A=alpha), [mask_file])


def test_transparency_beyond_its_range_is_held_in_it(exr_file):
    # as filters that sharpen leave it
    alpha = np.where(np.arange(SIZE[1]) < 30, -0.5, 1.5).astype(np.float32)
    result = photograph.open_photograph(exr_file(A=np.broadcast_to(alpha, SIZE)))
    assert result.coverage.min() >= 0 and result.coverage.max() <= 1


def test_radiance_of_an_exr_is_multiplied_by_its_alpha_in_the_file_alone(exr_file, tmp_path):
    """As OpenEXR, Blender and Nuke have it; light where nothing is covered is a glow of its own."""
    alpha = np.where(np.arange(SIZE[1]) < 30, 0.5, 1.0).astype(np.float32)
    alpha = np.broadcast_to(alpha, SIZE).copy()
    alpha[:, 0] = 0
    path = exr_file(A=alpha)
    stored, _ = photographs.read_exr(path)
    radiance, opacity = photographs.read_pixels(path)
    np.testing.assert_allclose(radiance[:, 1:30], 2 * stored[:, 1:30])
    np.testing.assert_array_equal(radiance[:, 30:], stored[:, 30:])
    np.testing.assert_array_equal(radiance[:, 0], stored[:, 0])
    photographs.write_picture(tmp_path / "again.exr", radiance, opacity)
    again, again_alpha = photographs.read_exr(tmp_path / "again.exr")
    np.testing.assert_allclose(again, stored, rtol=1e-6)
    np.testing.assert_array_equal(again_alpha, alpha)


def test_a_grey_balance_asks_for_a_background_that_is_not_black(tmp_path, ball, mask_file):
    black = bytes_of(ball) * (bytes_of(ball)[..., :1] > 51)
    (tmp_path / "photo.png").write_bytes(encoded(black))
    with pytest.raises(
        InputError, match="--white-balance grey: expected a background that is not black"
    ):
        photograph.open_photograph(tmp_path / "photo.png", [mask_file], balance="grey")


def test_no_picture_is_written_that_is_not_finite(tmp_path):
    bad = np.ones((4, 4, 3), np.float32)
    bad[1, 2, 0] = np.nan
    for write, name in ((photographs.write_exr, "a.exr"), (edit_files.save_png, "a.png")):
        with pytest.raises(InputError, match="a finite picture"):
            write(tmp_path / name, bad)
        assert not (tmp_path / name).exists()
    # finite as float64, not as the file's float32
    with pytest.raises(InputError, match="a finite picture"):
        photographs.write_exr(tmp_path / "a.exr", np.full((4, 4, 3), 1e39))


# ------------------------------------------------------------------------------------------------
# formats


@pytest.fixture
def ghostscript(tmp_path, monkeypatch):
    """A program under Ghostscript's name, and the file that it writes where it is started."""
    (tmp_path / "bin").mkdir()
    program, trace = tmp_path / "bin" / "gs", tmp_path / "started"
    program.write_text(f"#!/bin/sh\ntouch {trace}\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
    from PIL import EpsImagePlugin

    monkeypatch.setattr(EpsImagePlugin, "gs_binary", None)  # Pillow looks for it once
    return trace


@pytest.mark.parametrize("role", ["photograph", "mask", "regions"])
def test_an_eps_starts_no_other_program(tmp_path, ball, mask_file, ghostscript, role):
    (tmp_path / "photo.png").write_bytes(encoded(bytes_of(ball)))
    (tmp_path / "eps.png").write_bytes(encoded(bytes_of(ball), "EPS"))
    given = {
        "photograph": ("eps.png", [mask_file]),
        "mask": ("photo.png", [tmp_path / "eps.png"]),
        "regions": ("photo.png", [mask_file]),
    }
    name, masks = given[role]
    with pytest.raises(
        InputError, match=r"eps\.png: expected a picture in one of the formats PNG, JPEG"
    ):
        photograph.open_photograph(
            tmp_path / name, masks, tmp_path / "eps.png" if role == "regions" else None
        )
    assert not ghostscript.exists()


@pytest.mark.parametrize(
    ("name", "data", "expected"),
    [
        ("clip.mp4", b"\0\0\0\x18ftypisom" + bytes(100), "found a video (save one of its"),
        ("brochure.pdf", b"%PDF-1.7\n" + bytes(100), "found a PDF (save the picture in it"),
        ("empty.jpg", b"", "found an empty file (copy or send it again"),
        ("notes.jpg", "naïve".encode() * 200, "found a text (choose a picture"),
        ("logo.svg", b"<?xml version='1.0'?><svg></svg>", "found a drawing (SVG) (export"),
        ("work.zip", b"PK\3\4" + bytes(100), "found an archive (unpack it"),
        ("IMG_1.CR2", b"II*\0\x10\0\0\0CR\2\0" + bytes(99), "a camera's raw file (save it as JPEG"),
        ("other.png", bytes(range(256)), "found another format, or a damaged file (save it as PNG"),
    ],
)
def test_what_is_no_picture_is_named_with_what_to_do(tmp_path, name, data, expected):
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(InputError, match=re.escape(expected)):
        photographs.read_pixels(path)


def test_a_picture_that_is_too_large_is_refused_with_a_size_that_fits(tmp_path, monkeypatch):
    monkeypatch.setattr(picture_decoding, "MOST_DECODED", 30_000)
    path = tmp_path / "large.png"
    Image.new("L", (800, 600)).save(path)
    with pytest.raises(InputError, match="make it smaller, 200 × 150 at most"):
        photographs.read_pixels(path)


@pytest.mark.parametrize("format_", ["ICO", "ICNS", "PCX", "PPM", "TGA", "DDS", "JPEG2000", "PDF"])
def test_formats_that_are_not_on_the_list_are_refused_with_the_list(
    tmp_path, ball, mask_file, format_
):
    (tmp_path / "photo.png").write_bytes(encoded(bytes_of(ball), format_))
    with pytest.raises(
        InputError,
        match=r"HEIC, WebP, AVIF, TIFF, BMP, GIF or EXR, found a(nother format| PDF| PPM)",
    ):
        photograph.open_photograph(tmp_path / "photo.png", [mask_file])


@pytest.mark.parametrize("format_", ["PNG", "JPEG", "WEBP", "AVIF", "TIFF", "BMP", "GIF", "MPO"])
def test_formats_on_the_list_are_read(tmp_path, ball, mask_file, format_):
    if format_ == "AVIF" and format_ not in picture_decoding.formats():
        pytest.skip("this Pillow has no AVIF")
    (tmp_path / "photo.bin").write_bytes(encoded(bytes_of(ball), format_))
    result = photograph.open_photograph(tmp_path / "photo.bin", [mask_file])
    # colours are averaged by some formats, and palettes coarse
    assert np.median(abs(result.radiance - photographs._linear(ball))) < 0.03


@pytest.mark.parametrize("dtype", [np.int32, np.float32])
def test_a_tiff_of_numbers_that_are_no_display_values_is_refused(tmp_path, ball, mask_file, dtype):
    values = (ball[..., 0] * 1e6 - 1).astype(dtype)  # negative ones were NaN after the sRGB curve
    (tmp_path / "photo.tiff").write_bytes(encoded(values, "TIFF"))
    with pytest.raises(InputError, match="8 or 16 bit values"):
        photograph.open_photograph(tmp_path / "photo.tiff", [mask_file])


def test_damaged_exif_leaves_a_sound_picture_as_it_is(tmp_path, ball, mask_file):
    # a directory that leads back to itself
    noise = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x69\x87\x04\0\x01\0\0\0\x08\0\0\0\x08\0\0\0"
    (tmp_path / "photo.jpg").write_bytes(encoded(bytes_of(ball), "JPEG", exif=noise))
    assert photograph.open_photograph(tmp_path / "photo.jpg", [mask_file]).radiance.shape == (
        *SIZE,
        3,
    )


# ------------------------------------------------------------------------------------------------
# sizes


def promising(width, height):
    """A PNG whose header promises a size."""
    chunks = [
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(bytes(1000))),
        (b"IEND", b""),
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        for name, body in chunks
    )


def test_a_picture_one_pixel_wide_and_endlessly_high_is_refused_by_its_header(tmp_path):
    """Pillow keeps a pointer to each row: of 60 million rows with one pixel more than a GB."""
    (tmp_path / "photo.png").write_bytes(promising(1, 60_000_000))
    with pytest.raises(InputError, match="65535 a side, found 1 × 60000000"):
        photograph.open_photograph(tmp_path / "photo.png")


def test_a_tiffs_tile_is_no_larger_than_a_picture_may_be(tmp_path):
    entries = [(256, 3, 64), (257, 3, 48), (258, 3, 8), (259, 3, 8), (262, 3, 1), (277, 3, 1)]
    entries += [(322, 4, 46_000), (323, 4, 46_000), (324, 4, 200), (325, 4, 100)]  # a tile of 2 GB
    directory = struct.pack("<H", len(entries)) + b"".join(
        struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in entries
    )
    whole = b"II*\0" + struct.pack("<I", 8) + directory + bytes(4)
    (tmp_path / "photo.tiff").write_bytes(
        whole + bytes(200 - len(whole)) + zlib.compress(bytes(64 * 48))
    )
    with pytest.raises(InputError, match="found tiles of 46000 × 46000"):
        photograph.open_photograph(tmp_path / "photo.tiff")


def test_an_object_as_long_as_a_picture_may_be_is_refused_before_its_square_is_made():
    """The square over an object of 20,000 × 16 pixels would take 2 GB a channel."""
    radiance = np.broadcast_to(np.float32(0.5), (16, 20_000, 3))
    with pytest.raises(
        InputError, match="strip: expected an object at most 8135 pixels across, found 20000"
    ):
        framing.frame_object(radiance, np.ones((16, 20_000), bool), 32, where="strip")


@pytest.mark.parametrize("size", [(1, 64), (64, 1), (4, 4)])
def test_pictures_of_a_few_rows_are_framed_or_refused(tmp_path, size):
    rgba = np.full((*size, 4), 255, np.uint8)
    rgba[0, 0, 3] = 0
    (tmp_path / "photo.png").write_bytes(encoded(rgba))
    try:
        result = photograph.open_photograph(tmp_path / "photo.png")
        framed = framing.frame_object(result.balanced, result.mask, 32)
    except InputError as problem:
        assert "16 pixels or more" in str(problem)
    else:
        assert framed.mask.any() and np.isfinite(framed.radiance).all()


# ------------------------------------------------------------------------------------------------
# what is no file


def circle(path):
    path.symlink_to(path)


@pytest.mark.parametrize(
    ("make", "found"),
    [
        (os.mkfifo, "a pipe"),
        (circle, "too many levels"),
        (lambda p: p.symlink_to("/dev/zero"), "a device"),
    ],
)
@pytest.mark.parametrize("role", ["photograph", "mask", "regions", "material", "list", "exr"])
def test_pipes_devices_and_circles_of_links_are_refused_at_once(
    tmp_path, ball, mask_file, role, make, found, capsys
):
    (tmp_path / "photo.png").write_bytes(encoded(bytes_of(ball)))
    odd = tmp_path / {"exr": "odd.exr", "list": "odd.txt"}.get(role, "odd.png")
    make(odd)
    photo, masks = tmp_path / "photo.png", ["--mask", mask_file]
    words = {
        "photograph": ["edit", odd, *masks, "--material", "brass"],
        "exr": ["edit", odd, *masks, "--material", "brass"],
        "mask": ["edit", photo, "--mask", odd, "--material", "brass"],
        "regions": ["edit", photo, *masks, "--regions", odd, "--material", "brass"],
        "material": ["edit", photo, *masks, "--material", odd],
        "list": ["transfer", "--list", odd],
    }[role]
    assert main([str(word) for word in [*words, "--out", tmp_path / "out"]]) == 1
    line = capsys.readouterr().err.splitlines()[-1]
    assert found in line and odd.name in line
