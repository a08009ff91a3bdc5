"""Photographs as phones make them: HEIC, Display P3, turned by metadata, and of many megapixels."""

import io
import re
import struct
import sys
import zlib

import numpy as np
import pytest
from PIL import Image, features

from brdfactory import editing
from learn.data import cicp, photographs, picture_decoding
from learn.editing import photograph
from manifests import exr
from manifests.errors import InputError
from shaders import tone
from tests.support import icc

RED, GREEN, GREY = (200, 60, 50), (40, 160, 60), (90, 90, 90)
P3_RED = (217, 42, 39)  # RED of Display P3 in sRGB, by its matrix
NEEDS_AVIF = pytest.mark.skipif(not features.check("avif"), reason="this Pillow has no AVIF")
SIZE = (40, 60)  # as the sensor has it; upright it is 60 high


def corners():
    """(H, W, 3) uint8 with red above left, green above right, and grey below."""
    values = np.full((*SIZE, 3), GREY, np.uint8)
    values[:20, :30], values[:20, 30:] = RED, GREEN
    return values


def turned():
    """Metadata that say that a picture is to be turned clockwise by 90°."""
    exif = Image.Exif()
    exif[274] = 6
    return exif


def display(path):
    return 255 * tone.srgb(photographs.read_pixels(path)[0])


def write_heic(path, values=None, mode="RGB", **options):
    heif = pytest.importorskip("pillow_heif", reason="pillow-heif is not installed (extra heic)")
    values = corners() if values is None else values
    size = values.shape[1::-1]
    heif.encode(mode, size, values.tobytes(), path, quality=95, chroma=444, **options)
    return path


def require_upright_corners(shown, first=RED, tolerance=4):
    """Grey on the left; red above and green below on the right: turned clockwise by 90°."""
    assert shown.shape == (60, 40, 3)
    for place, expected in ((np.s_[10, 30], first), (np.s_[50, 30], GREEN), (np.s_[30, 8], GREY)):
        np.testing.assert_allclose(shown[place], expected, atol=tolerance)


# ------------------------------------------------------------------------------------------------
# HEIC


def test_a_heic_is_read_upright(tmp_path):
    path = write_heic(tmp_path / "IMG_1.HEIC", exif=turned().tobytes())
    require_upright_corners(display(path))


def test_a_heic_of_ten_bits_is_read(tmp_path):
    deep = corners().astype(np.uint16) * 257
    path = write_heic(tmp_path / "deep.heic", deep, "RGB;16", exif=turned().tobytes())
    require_upright_corners(display(path))


def test_a_heic_is_told_by_its_contents(tmp_path):
    path = write_heic(tmp_path / "photo.jpg")
    assert photographs.read_pixels(path)[0].shape == (*SIZE, 3)


@pytest.mark.parametrize("how", [{"icc_profile": icc.profile()}, {"color_primaries": 12}])
def test_display_p3_of_a_heic_is_converted(tmp_path, how):
    values = np.full((*SIZE, 3), RED, np.uint8)
    if "color_primaries" in how:
        how |= {"transfer_characteristics": 13, "matrix_coefficients": 6}
    shown = display(write_heic(tmp_path / "photo.heic", values, **how))
    np.testing.assert_allclose(shown[20, 30], P3_RED, atol=4)


# Signals in per cent, by ITU-R BT.2408's tables of luminance in cd/m² on a screen of 1,000: of a
# grey card, and of white paper
HDR_FILES = ["heic", "png", "png without profile", pytest.param("avif", marks=NEEDS_AVIF)]
HDR_GREYS = {16: [(38, 26), (58, 203)], 18: [(38, 26), (75, 203)]}


def write_png_with_numbers(path, values, primaries, curve):
    """A PNG whose header names its colours, in a chunk that follows the first one."""
    written = io.BytesIO()
    Image.fromarray(values).save(written, "PNG")
    data = written.getvalue()
    chunk = b"cICP" + bytes([primaries, curve, 0, 1])
    chunk = struct.pack(">I", 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
    path.write_bytes(data[:33] + chunk + data[33:])
    return path


def write_avif_with_numbers(path, values, primaries, curve):
    """An AVIF whose header names its colours; those that Pillow writes are replaced."""
    written = io.BytesIO()
    Image.fromarray(values).save(written, "AVIF", quality=100, subsampling="4:4:4")
    before, after = written.getvalue().split(b"colrnclx")
    path.write_bytes(before + b"colrnclx" + struct.pack(">HH", primaries, curve) + after[4:])
    return path


def in_hdr(folder, kind, values, primaries, curve):
    """A file whose values (H, W, 3) uint8 are signals of HDR, of a kind of HDR_FILES."""
    if kind == "png without profile":
        return write_png_with_numbers(folder / "photo.png", values, primaries, curve)
    if kind == "avif":
        return write_avif_with_numbers(folder / "photo.avif", values, primaries, curve)
    if kind == "png":
        path = folder / "photo.png"
        profile = icc.profile(numbers=(primaries, curve, 0, 1))
        Image.fromarray(values).save(path, icc_profile=profile)
        return path
    named = {"color_primaries": primaries, "transfer_characteristics": curve}
    return write_heic(folder / "photo.heic", values, matrix_coefficients=6, **named)


@pytest.mark.parametrize("kind", HDR_FILES)
@pytest.mark.parametrize("curve", HDR_GREYS)
def test_greys_of_hdr_curves_are_as_bright_as_their_standard_says(tmp_path, kind, curve):
    """White paper is white, and what is brighter than paper is clipped."""
    values = np.zeros((*SIZE, 3), np.uint8)
    values[:, 40:] = 255
    for place, (per_cent, _) in zip(
        (np.s_[:, :20], np.s_[:, 20:40]), HDR_GREYS[curve], strict=True
    ):
        values[place] = round(2.55 * per_cent)
    radiance, _ = photographs.read_pixels(in_hdr(tmp_path, kind, values, 9, curve))
    for column, (_, luminance) in zip((10, 30), HDR_GREYS[curve], strict=True):
        # half a step of 8 bits is 2 to 3 % of luminance, and the tables round to 1 %
        np.testing.assert_allclose(radiance[20, column], luminance / 203, rtol=0.06)
    assert (radiance[20, 50] == 1).all()


def rec2020_of(srgb, curve):
    """Signals (3,) of a colour of sRGB's display values: by the definitions of both, backwards."""
    light = np.array(
        [[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]]
    ) @ tone.linear_from_srgb(np.array(srgb) / 255)
    if curve == 16:
        root = (light * 203 / 10_000) ** 0.1593017578125
        signal = ((0.8359375 + 18.8515625 * root) / (1 + 18.6875 * root)) ** 78.84375
    else:
        shown = light * 0.203  # on a screen of 1,000 cd/m²
        luminance = shown @ [0.2627, 0.6780, 0.0593]
        scene = shown * luminance ** (1 / 1.2 - 1)
        logarithmic = 0.17883277 * np.log(np.maximum(12 * scene - 0.28466892, 1e-9)) + 0.55991073
        signal = np.where(scene <= 1 / 12, np.sqrt(3 * scene), logarithmic)
    return np.rint(255 * signal).astype(np.uint8)


@pytest.mark.parametrize("kind", HDR_FILES)
@pytest.mark.parametrize("curve", HDR_GREYS)
def test_colours_of_hdr_curves_are_converted(tmp_path, kind, curve):
    values = np.full((*SIZE, 3), rec2020_of(RED, curve), np.uint8)
    shown = display(in_hdr(tmp_path, kind, values, 9, curve))
    np.testing.assert_allclose(shown[20, 30], RED, atol=5)  # steps of HDR's signal are coarse
    if kind == "png":  # whose colours the file keeps; a blue has least luminance for its light
        values = np.full((*SIZE, 3), rec2020_of((20, 20, 250), curve), np.uint8)
        shown = display(in_hdr(tmp_path, kind, values, 9, curve))
        np.testing.assert_allclose(shown[20, 30, 2], 250, atol=2)
    values = np.full((*SIZE, 4), (*rec2020_of(GREY, curve), 70), np.uint8)
    path = tmp_path / "grey.png"
    for primaries in (1, 12):  # of the same white
        profile = icc.profile(numbers=(primaries, curve, 0, 1))
        Image.fromarray(values).save(path, icc_profile=profile)
        radiance, alpha = photographs.read_pixels(path)
        np.testing.assert_allclose(255 * tone.srgb(radiance[20, 30]), GREY, atol=2)
        np.testing.assert_allclose(255 * alpha[20, 30], 70)
    red = np.full((*SIZE, 3), (120, 40, 40), np.uint8)
    narrow, wide = (display(in_hdr(tmp_path, kind, red, p, curve))[20, 30] for p in (1, 12))
    assert wide[0] > narrow[0] + 2 and wide[1] < narrow[1] - 2


@pytest.mark.parametrize(
    "write", [write_png_with_numbers, pytest.param(write_avif_with_numbers, marks=NEEDS_AVIF)]
)
def test_display_p3_that_a_header_names_is_converted(tmp_path, write):
    values = np.full((*SIZE, 3), RED, np.uint8)
    path = write(tmp_path / "photo", values, 12, 13)
    np.testing.assert_allclose(display(path)[20, 30], P3_RED, atol=4)
    path = write(tmp_path / "photo", values, 1, 13)
    np.testing.assert_allclose(display(path)[20, 30], RED, atol=2)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x89PNG\r\n\x1a\n",
        b"\0\0\0\x0cftypavif",
        b"\0\0\0\x08ftypavif\xff\xff\xff\xffmeta",
        b"\x89PNG\r\n\x1a\n\xff\xff\xff\xffiCCP",
    ],
)
def test_files_that_end_before_their_numbers_have_none(data):
    assert cicp.read_cicp(io.BytesIO(data)) is None


def test_a_profile_that_ends_within_its_numbers_is_read_without_them(tmp_path):
    path = tmp_path / "photo.png"
    profile = icc.profile(numbers=(9, 16, 0, 1))
    Image.new("RGB", (16, 16), RED).save(path, icc_profile=profile[:-4])
    np.testing.assert_allclose(display(path)[8, 8], P3_RED, atol=3)


def test_a_profile_whose_numbers_are_those_of_display_p3_is_read_as_a_profile(tmp_path):
    path = tmp_path / "photo.png"
    Image.new("RGB", (16, 16), RED).save(path, icc_profile=icc.profile(numbers=(12, 13, 0, 1)))
    np.testing.assert_allclose(display(path)[8, 8], P3_RED, atol=3)


def test_a_heic_without_the_package_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    path = tmp_path / "IMG_0001.HEIC"
    path.write_bytes(b"\0\0\0\x18ftypheic" + bytes(100))
    remedy = r"\(pip install .*\[heic\].*, to read it; or save it as JPEG .* Most Compatible\)"
    with pytest.raises(InputError, match=f"package pillow-heif.*found none {remedy}"):
        photographs.read_pixels(path)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_a_heic_that_is_cut_off_is_refused_in_a_line(tmp_path, share):
    path = write_heic(
        tmp_path / "photo.heic", np.random.default_rng(0).integers(0, 255, (*SIZE, 3), np.uint8)
    )
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match=r"expected a whole picture .*HEIC.*it is damaged"):
        photographs.read_pixels(path)


def test_a_heic_of_too_many_pixels_is_refused_by_its_header(tmp_path, monkeypatch):
    path = write_heic(tmp_path / "photo.heic")
    from pillow_heif import HeifImageFile

    def decoded(self):
        raise AssertionError("it was decoded")

    monkeypatch.setattr(HeifImageFile, "load", decoded)
    monkeypatch.setattr(picture_decoding, "MOST_DECODED", 20_000)
    with pytest.raises(InputError, match=r"megapixels.*found 60 × 40"):
        photographs.read_pixels(path)


@pytest.mark.parametrize(
    ("brands", "expected"),
    [
        (b"heic\0\0\0\0mif1heic", "pillow-heif"),
        (b"mif1\0\0\0\0mif1heic", "pillow-heif"),
        (b"avif\0\0\0\0avifmif1", "damaged|AVIF"),
        (b"mif1\0\0\0\0mif1avif", "damaged|AVIF"),
        (b"isom\0\0\0\0isommp41", "a video"),
    ],
)
def test_brands_tell_heic_from_avif_and_video(tmp_path, monkeypatch, brands, expected):
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    path = tmp_path / "photo.bin"
    path.write_bytes((8 + len(brands)).to_bytes(4, "big") + b"ftyp" + brands + bytes(100))
    with pytest.raises(InputError, match=expected):
        photographs.read_pixels(path)


# ------------------------------------------------------------------------------------------------
# colour profiles


@pytest.mark.parametrize("format_", ["PNG", "JPEG", "WEBP", "TIFF"])
def test_display_p3_is_converted_to_srgb(tmp_path, format_):
    path = tmp_path / "photo.bin"
    options = {"PNG": {}, "TIFF": {}}.get(format_, {"quality": 95})
    picture = Image.new("RGB", (16, 16), RED)
    picture.save(path, format_, icc_profile=icc.profile(), **options)
    np.testing.assert_allclose(display(path)[8, 8], P3_RED, atol=3)


def test_a_profile_of_srgb_changes_nothing(tmp_path):
    values = np.random.default_rng(0).integers(0, 256, (*SIZE, 3), np.uint8)
    for name, more in (("with.png", {"icc_profile": icc.profile(icc.SRGB)}), ("without.png", {})):
        Image.fromarray(values).save(tmp_path / name, **more)
    np.testing.assert_array_equal(display(tmp_path / "with.png"), display(tmp_path / "without.png"))


def test_transparency_stays_when_a_profile_is_converted(tmp_path):
    values = np.full((*SIZE, 4), (*RED, 255), np.uint8)
    values[:10, :, 3] = 70
    path = tmp_path / "cut.png"
    Image.fromarray(values).save(path, icc_profile=icc.profile())
    radiance, alpha = photographs.read_pixels(path)
    np.testing.assert_allclose(255 * tone.srgb(radiance[20, 30]), P3_RED, atol=2)
    np.testing.assert_allclose(255 * alpha, values[..., 3])


def test_a_transparent_colour_stays_transparent_when_a_profile_is_converted(tmp_path):
    path = tmp_path / "cut.png"
    Image.fromarray(corners()).save(path, icc_profile=icc.profile(), transparency=GREEN)
    alpha = photographs.read_pixels(path)[1]
    np.testing.assert_array_equal(alpha < 0.5, (corners() == GREEN).all(-1))


def test_a_turned_jpeg_in_display_p3_is_upright(tmp_path):
    path = tmp_path / "photo.jpg"
    Image.fromarray(corners()).save(
        path, exif=turned(), icc_profile=icc.profile(), quality=95, subsampling=0
    )
    shown = display(path)
    assert shown.shape == (60, 40, 3)
    np.testing.assert_allclose(shown[10, 30], P3_RED, atol=4)


@pytest.mark.parametrize("profile", [b"none", icc.profile()[:200], icc.profile()[:-30], bytes(300)])
def test_a_damaged_profile_leaves_the_picture_as_it_is(tmp_path, profile):
    path = tmp_path / "photo.png"
    Image.new("RGB", (16, 16), RED).save(path, icc_profile=profile)
    assert np.abs(display(path)[8, 8] - RED).max() < 1 or profile == icc.profile()[:-30]


def test_regions_are_neither_converted_nor_mixed(tmp_path, monkeypatch):
    """Both greens are the same one in sRGB, and a mixture would be a region of its own."""
    monkeypatch.setattr(picture_decoding, "MOST_PIXELS", 600)
    values = np.zeros((*SIZE, 3), np.uint8)
    values[:21, :31], values[:21, 31:] = (0, 255, 0), (30, 255, 0)
    path = tmp_path / "regions.png"
    Image.fromarray(values).save(path, icc_profile=icc.profile())
    labels = photographs.read_labels(path, (20, 30))
    assert sorted(np.unique(labels)) == [0, 1, 2]


# ------------------------------------------------------------------------------------------------
# many megapixels


@pytest.fixture
def few_pixels(monkeypatch):
    """Pictures of more than 600 pixels are made smaller: those of SIZE to a half."""
    monkeypatch.setattr(picture_decoding, "MOST_PIXELS", 600)


@pytest.mark.parametrize("format_", ["JPEG", "PNG", "WEBP", "TIFF"])
@pytest.mark.parametrize(("size", "smaller"), [((40, 60), (20, 30)), ((61, 39), (21, 13))])
def test_a_large_picture_is_read_at_the_smallest_whole_part_that_fits(
    tmp_path, few_pixels, format_, size, smaller
):
    y, x = np.mgrid[: size[0], : size[1]]
    values = np.stack([4 * y, 4 * x, 0 * x + 100], -1).astype(np.uint8)
    path = tmp_path / "photo.bin"
    options = {"PNG": {}, "TIFF": {}}.get(format_, {"quality": 95})
    Image.fromarray(values).save(path, format_, **options)
    shown = display(path)
    assert shown.shape[:2] == smaller
    divisor = -(-size[0] // smaller[0])
    y, x = np.mgrid[: smaller[0], : smaller[1]]
    expected = np.stack([divisor * (y + 0.5) - 0.5, divisor * (x + 0.5) - 0.5], -1) * 4
    assert np.abs(shown[1:-1, 1:-1, :2] - expected[1:-1, 1:-1]).mean() < 3.5


def test_masks_of_the_full_and_of_the_reduced_size_fit(tmp_path, few_pixels, capsys):
    Image.fromarray(corners()).save(tmp_path / "photo.jpg", exif=turned(), quality=95)
    full = np.zeros((60, 40), np.uint8)
    full[:30, 20:] = 255  # red, upright
    Image.fromarray(full).save(tmp_path / "full.png")
    Image.fromarray(full[::2, ::2]).save(tmp_path / "reduced.png")
    full[30:, 20:] = 128  # green
    Image.fromarray(full // 128).save(tmp_path / "regions.png")
    for mask in ("full.png", "reduced.png"):
        opened = photograph.open_photograph(tmp_path / "photo.jpg", [tmp_path / mask])
        assert opened.radiance.shape == (30, 20, 3)
        shown = 255 * tone.srgb(opened.radiance[opened.mask])
        np.testing.assert_allclose(np.median(shown, 0), RED, atol=6)
    line = "the photograph has 40 × 60 pixels, more than 0.0006 megapixels"
    said = capsys.readouterr().err
    assert said.count(line) == 2 and "the edit has 20 × 30 pixels" in said
    parted = photograph.open_photograph(tmp_path / "photo.jpg", [], tmp_path / "regions.png")
    assert parted.count == 1 and parted.regions.sum() == 10 * 30
    Image.fromarray(full[:50]).save(tmp_path / "other.png")
    with pytest.raises(InputError, match="a mask of the picture's size 20 × 30"):
        photograph.open_photograph(tmp_path / "photo.jpg", [tmp_path / "other.png"])


def test_palettes_and_masks_of_one_bit_are_made_smaller(tmp_path, few_pixels):
    picture = Image.fromarray(corners())
    picture.quantize(3).save(tmp_path / "palette.png")
    np.testing.assert_allclose(display(tmp_path / "palette.png")[5, 5], RED, atol=2)
    half = np.zeros(SIZE, bool)
    half[:, 31:] = True  # the column 15 of the reduced one is half covered
    Image.fromarray(half).save(tmp_path / "bits.png")
    coverage = photographs.read_mask(tmp_path / "bits.png", (20, 30))
    np.testing.assert_allclose(coverage[3, [14, 15, 16]], [0, 0.5, 1], atol=0.01)
    deep = np.full(SIZE, 30_000, np.uint16)
    Image.fromarray(deep).save(tmp_path / "deep.png")
    np.testing.assert_allclose(display(tmp_path / "deep.png"), 30_000 / 257, rtol=1e-4)


def with_size(data, width, height):
    """A JPEG of which the header says another size."""
    at = re.search(rb"\xff[\xc0\xc2]", data).start() + 5
    return data[:at] + height.to_bytes(2, "big") + width.to_bytes(2, "big") + data[at + 4 :]


def test_a_large_jpeg_is_decoded_at_its_reduced_size(tmp_path, few_pixels, monkeypatch):
    path, decoded = tmp_path / "photo.jpg", []
    Image.new("RGB", (256, 192), RED).save(path)
    resize = Image.Image.resize

    def noted(self, *rest):
        decoded.append(self.size)
        return resize(self, *rest)

    monkeypatch.setattr(Image.Image, "resize", noted)
    assert display(path).shape == (192 // 10 + 1, 256 // 10 + 1, 3)
    assert decoded == [(32, 24)]  # an eighth, from which a tenth is made


@pytest.mark.parametrize("side", [13_000, 60_000])
def test_a_png_that_promises_too_much_is_refused_by_its_header(tmp_path, side):
    path = tmp_path / "photo.png"
    Image.new("RGB", (8, 8)).save(path)
    data = path.read_bytes()
    header = data[12:16] + 2 * side.to_bytes(4, "big") + data[24:29]
    whole = data[:12] + header + zlib.crc32(header).to_bytes(4, "big") + data[33:]
    path.write_bytes(whole)
    expected = rf"at most {160 if side < 20_000 else 179} megapixels.*\(make it smaller"
    with pytest.raises(InputError, match=expected):
        photographs.read_pixels(path)


@pytest.mark.parametrize("channels", [3, 4])
def test_an_array_is_made_smaller_as_its_file_is(tmp_path, monkeypatch, capsys, channels):
    """With its mask and its regions, of the full size or of the reduced one."""
    monkeypatch.setattr(picture_decoding, "MOST_PIXELS", 600)
    path = tmp_path / "photo.png"
    values = np.random.default_rng(0).integers(0, 256, (*SIZE, channels), np.uint8)
    values[..., 3:] |= 128
    mask = np.zeros(SIZE, np.uint8)
    mask[9:31, 11:50] = 255  # of which a border is half covered
    Image.fromarray(values).save(path)
    Image.fromarray(mask).save(tmp_path / "mask.png")
    file = photograph.open_photograph(path, [tmp_path / "mask.png"])
    said = capsys.readouterr().err
    assert file.radiance.shape == (20, 30, 3) and "is read at 1/2 of its width and height" in said
    small = file.coverage
    for given in (mask, mask > 0, mask / 255, small, tmp_path / "mask.png"):
        array = photograph.from_arrays(values, given, name=str(path))
        assert capsys.readouterr().err == said
        np.testing.assert_array_equal(array.radiance, file.radiance)
        assert (array.alpha is None) == (channels == 3)
        if channels == 4:
            np.testing.assert_array_equal(array.alpha, file.alpha)
        # a half is 128 of 255 in a file
        np.testing.assert_allclose(array.coverage, small, atol=0.002)
    for given in (mask, small):  # of a file with an array
        array = editing._open_photograph(str(path), given, None, "none", None, False)
        assert capsys.readouterr().err == said
        np.testing.assert_allclose(array.coverage, small, atol=0.002)
    regions = np.zeros(SIZE, np.int64)
    regions[9:31, 11:29], regions[9:31, 29:50], regions[20:31, 11:50] = 5, 900, 7
    small = regions[1::2, 1::2]  # not mixed
    for given in (regions, small):
        array = photograph.from_arrays(values, None, given, name=str(path))
        np.testing.assert_array_equal(array.regions, np.searchsorted([0, 5, 7, 900], small))
    with pytest.raises(InputError, match=r"mask: expected an array \(20, 30\) of bool"):
        photograph.from_arrays(values, mask[:-2])
    with pytest.raises(InputError, match=r"regions: expected an array \(20, 30\) of whole"):
        photograph.from_arrays(values, None, regions[:-2])


def test_radiance_is_not_made_smaller_and_is_bounded_as_an_exr(monkeypatch):
    monkeypatch.setattr(picture_decoding, "MOST_PIXELS", 600)
    mask = np.zeros(SIZE, bool)
    mask[9:31, 11:50] = True
    radiance = np.full((*SIZE, 3), 0.2)
    assert photograph.from_arrays(radiance, mask).radiance.shape == (*SIZE, 3)
    monkeypatch.setattr(exr, "MAX_PIXELS", 2_399)
    with pytest.raises(InputError, match="megapixels, found 60 × 40"):
        photograph.from_arrays(radiance, mask)


@pytest.mark.parametrize(("channels", "each"), [(3, 4), (4, 8)])
def test_an_array_is_bounded_as_its_file_is(tmp_path, monkeypatch, channels, each):
    values, path = np.full((*SIZE, channels), 128, np.uint8), tmp_path / "photo.png"
    Image.fromarray(values).save(path)
    for room in (0, -1):
        monkeypatch.setattr(picture_decoding, "MOST_DECODED", each * SIZE[0] * SIZE[1] + room)
        for given in (values, path):
            if not room:
                assert photograph.from_arrays(given, np.ones(SIZE, bool)).count == 1
                continue
            with pytest.raises(InputError, match=r"megapixels.*found 60 × 40"):
                photograph.from_arrays(given, np.ones(SIZE, bool))


@pytest.mark.parametrize("mode", ["P", "RGBA", "LA", "I;16"])
def test_copies_in_which_pixels_are_mixed_count_as_memory(monkeypatch, tmp_path, mode):
    """Pillow mixes palettes, transparency and deep greys in modes of more bytes for a pixel."""
    path = tmp_path / "picture.png"
    Image.new(mode, SIZE[::-1]).save(path)
    monkeypatch.setattr(picture_decoding, "MOST_PIXELS", 600)
    # what the decoded picture takes, and a byte for each pixel
    each = picture_decoding.PIXEL_BYTES.get(mode, 4) + 1
    monkeypatch.setattr(picture_decoding, "MOST_DECODED", each * SIZE[0] * SIZE[1])
    labels = picture_decoding.decode_labels(path, lambda reduced: reduced.size)
    assert labels == (30, 20)  # regions are not mixed
    with pytest.raises(InputError, match=r"megapixels.*found 60 × 40 \(make it smaller"):
        photographs.read_pixels(path)


@pytest.mark.parametrize(("channels", "is_read"), [(3, True), (1, False)])
def test_a_jpeg_whose_channels_come_one_by_one_is_bounded_as_a_progressive_one(
    tmp_path, channels, is_read
):
    """Its decoder keeps all coefficients too, though it is not called progressive."""
    out = io.BytesIO()
    Image.new("RGB", (64, 48), RED).save(out, "JPEG")
    data = with_size(out.getvalue(), 16_320, 12_240)
    at = data.index(b"\xff\xda")  # length, number of channels, two bytes for each, three more
    of_channels = b"".join(bytes([number, 0]) for number in range(1, channels + 1))
    first = b"\xff\xda\0" + bytes([6 + 2 * channels, channels]) + of_channels + b"\0\x3f\0"
    path = tmp_path / "photo.jpg"
    path.write_bytes(data[:at] + first + data[at + 14 :])
    with picture_decoding._open(path) as opened:
        if is_read:
            picture_decoding._require_readable(path, opened)
            return
        with pytest.raises(InputError, match=r"at most 91\.4 megapixels"):
            picture_decoding._require_readable(path, opened)


@pytest.mark.parametrize(
    ("sides", "progressive", "is_read"),
    [
        ((16_320, 12_240), False, True),
        ((18_000, 12_240), False, False),
        ((8_000, 6_000), True, True),
        ((16_320, 12_240), True, False),
    ],
)
def test_a_jpeg_is_bounded_by_what_decoding_takes(tmp_path, sides, progressive, is_read):
    """The header's size is changed, so that nothing large has to be written."""
    out = io.BytesIO()
    Image.new("RGB", (64, 48), RED).save(out, "JPEG", progressive=progressive)
    (tmp_path / "photo.jpg").write_bytes(with_size(out.getvalue(), *sides))
    with picture_decoding._open(tmp_path / "photo.jpg") as opened:
        assert opened.size == sides
        if is_read:
            picture_decoding._require_readable("photo.jpg", opened)
            return
        with pytest.raises(InputError, match=r"megapixels, and 65535 a side, found 1\d"):
            picture_decoding._require_readable("photo.jpg", opened)
