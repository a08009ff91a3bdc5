"""Pictures from users: whatever they bring is read, framed, or refused in one line."""

import numpy as np
import pytest
from PIL import Image

from learn.data import framing, photographs
from manifests.errors import InputError


@pytest.fixture
def disc():
    y, x = np.mgrid[0:60, 0:80]
    return (x - 50) ** 2 + (y - 30) ** 2 < 20**2


def saved(path, array, mode=None):
    picture = Image.fromarray(array)
    (picture.quantize() if mode == "P" else picture.convert(mode) if mode else picture).save(path)
    return path


@pytest.fixture
def mask_file(tmp_path, disc):
    return saved(tmp_path / "mask.png", disc.astype(np.uint8) * 255)


@pytest.mark.parametrize(
    ("mode", "suffix"),
    [("RGB", "png"), ("L", "png"), ("CMYK", "jpg"), ("P", "gif"), ("RGB", "tiff")],
)
def test_pictures_of_any_mode_become_linear_radiance(tmp_path, mask_file, mode, suffix):
    path = saved(tmp_path / f"picture.{suffix}", np.full((60, 80, 3), 188, np.uint8), mode)
    radiance, _ = photographs.read(path, mask_file)
    assert radiance.shape == (60, 80, 3)
    # sRGB 188 is 0.503; JPEG and palettes move a step or two
    np.testing.assert_allclose(radiance, 0.5, atol=0.02)


def test_sixteen_bit_grey_is_read_at_its_depth(tmp_path, mask_file):
    path = saved(tmp_path / "deep.png", np.full((60, 80), 40000, np.uint16))
    radiance, _ = photographs.read(path, mask_file)
    assert radiance[0, 0, 0] == pytest.approx(((40000 / 65535 + 0.055) / 1.055) ** 2.4, rel=1e-5)


def test_transparency_is_a_mask(tmp_path, disc):
    rgba = np.dstack([np.full((60, 80, 3), 99, np.uint8), disc.astype(np.uint8) * 255])
    _, mask = photographs.read(saved(tmp_path / "cut.png", rgba))
    assert (mask == disc).all()


def test_a_dark_picture_is_taken_to_be_of_a_darker_scene_but_not_in_proportion():
    mask = np.ones((20, 20), bool)
    result = [
        framing.frame_object(np.full((20, 20, 3), Y, np.float32), mask, 16).exposure
        for Y in (0.05, 0.5)
    ]
    # docs/editing-measurements.md
    np.testing.assert_allclose(result, [0.23 * 0.05**-0.19, 0.23 * 0.5**-0.19], rtol=1e-5)
    assert (
        framing.frame_object(np.full((20, 20, 3), 0.5, np.float32), mask, 16, exposure=2.0).exposure
        == 2.0
    )


def test_a_thin_object_keeps_about_its_area_at_the_networks_size():
    y, x = np.mgrid[0:1200, 0:1200]
    ring = abs(np.hypot(x - 600, y - 600) - 590) < 1.5
    result = framing.frame_object(np.full((1200, 1200, 3), 0.5, np.float32), ring, 128)
    share = ring.sum() * (128 / result.box[2]) ** 2  # its area in the network's pixels
    assert 0.8 * share < result.mask.sum() < 1.5 * share
    np.testing.assert_allclose(result.radiance[result.mask], 0.5 * result.exposure, rtol=1e-3)


def test_an_object_that_is_nearly_all_air_is_refused():
    specks = np.zeros((2000, 2000), bool)
    specks[::1990, ::1990] = True
    specks[:4, :4] = True
    with pytest.raises(InputError, match="16 pixels or more at the network's 128 × 128"):
        framing.frame_object(np.full((2000, 2000, 3), 0.5, np.float32), specks, 128)


def test_what_cannot_be_used_is_refused_with_the_remedy(tmp_path, mask_file):
    plain = saved(tmp_path / "plain.png", np.zeros((60, 80, 3), np.uint8))
    empty = saved(tmp_path / "empty.png", np.zeros((60, 80), np.uint8))
    small = saved(tmp_path / "small.png", np.full((6, 8), 255, np.uint8))
    corrupt = tmp_path / "corrupt.png"
    corrupt.write_bytes(plain.read_bytes()[:40])
    for arguments, words in (
        ((plain,), "--mask"),
        ((plain, empty), "pixels or more in the mask"),
        ((plain, small), "80 × 60"),
        ((corrupt, mask_file), "PNG, JPEG or EXR"),
        ((tmp_path / "none.png", mask_file), "no such file"),
    ):
        with pytest.raises(InputError, match=words):
            photographs.read(*arguments)


def test_an_object_is_framed_in_its_middle_at_the_size_asked_for(disc):
    radiance = np.where(disc[..., None], 0.5, 9.0).astype(np.float32).repeat(3, -1)[..., :3]
    framed = framing.frame_object(radiance, disc, 32)
    rows, columns = np.nonzero(framed.mask)
    assert framed.radiance.shape == (32, 32, 3)
    # a picture's pixel is 1.6 here: its rounding, either way
    np.testing.assert_allclose([rows.mean(), columns.mean()], 15.5, atol=1)
    inner = framed.mask & (framed.radiance[..., 0] > 0)
    # background at 9 does not leak in
    np.testing.assert_allclose(framed.radiance[inner], 0.5 * framed.exposure, rtol=0.05)
    span = np.ptp(columns) + 1
    assert span == pytest.approx(32 / framing.MARGIN, abs=2)
