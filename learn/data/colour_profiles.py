"""Converts pictures with a colour profile, such as the Display P3 of phones, to sRGB.

Programs that show pictures do the same. Without it, colours of profiles with a wide gamut would be
read too dull. Profiles that cannot be read, and those of 16-bit greys, are ignored. Pictures in the
curves of HDR screens are converted by learn.data.hdr_curves.
"""

import io

import numpy as np
from PIL import Image, ImageCms

from learn.data import hdr_curves
from learn.data.hdr_curves import SRGB_FROM_P3
from shaders import tone

# Greys, primary colours and mixtures: a profile that leaves them as they are is sRGB already
PROBES = np.stack(np.meshgrid(*3 * [[0, 64, 128, 192, 255]]), -1).reshape(1, -1, 3).astype(np.uint8)
LEAST_DIFFERENCE = 2  # of 255: profiles of sRGB differ by rounding
MOST_BYTES = 16 << 20  # of a profile; those of printers have some megabytes


def to_srgb(picture: Image.Image) -> Image.Image:
    """Return a Pillow image in sRGB: the same one if it has no profile, or one of sRGB."""
    if (named := hdr_curves.curve_of(picture)) is not None:
        return hdr_curves.to_srgb(picture, *named)
    data = picture.info.get("icc_profile")
    if not data and _names_p3(picture):
        return _from_p3(picture)
    if not isinstance(data, bytes) or not data or len(data) > MOST_BYTES:
        return picture
    try:
        profile = ImageCms.ImageCmsProfile(io.BytesIO(data))
        space = profile.profile.xcolor_space.strip()
        if (mode := _mode_for(picture.mode, space)) is None:
            return picture
        if space == "RGB" and _is_srgb(profile):
            return picture
        if mode == "RGB" and "transparency" in picture.info:  # a colour that is transparent
            mode = "RGBA"
        if picture.mode != mode:
            picture = picture.convert(mode)
        transform = _transform(profile, mode, "RGBA" if mode == "RGBA" else "RGB")
        return transform.apply(picture)
    except (ImageCms.PyCMSError, OSError, ValueError, TypeError):
        return picture  # a sound picture beside a damaged profile


def _mode_for(mode, space):
    """The mode in which a picture is converted from a profile's space; None: it stays as it is."""
    if space == "RGB" and not mode.startswith(("I", "F", "CMYK")):
        return "RGBA" if mode in ("RGBA", "LA", "PA", "P", "RGBa", "La") else "RGB"
    return mode if (space, mode) in {("GRAY", "L"), ("CMYK", "CMYK")} else None


def _transform(profile, mode, result):
    intent = ImageCms.Intent.RELATIVE_COLORIMETRIC
    flags = ImageCms.Flags.BLACKPOINTCOMPENSATION
    srgb = ImageCms.createProfile("sRGB")
    return ImageCms.buildTransform(profile, srgb, mode, result, intent, flags)


def _is_srgb(profile):
    """Whether a profile leaves colours as they are."""
    converted = _transform(profile, "RGB", "RGB").apply(Image.fromarray(PROBES))
    difference = np.asarray(converted).astype(int) - PROBES
    return bool(abs(difference).max() <= LEAST_DIFFERENCE)


def _names_p3(picture):
    """Whether a file says by a number that its primary colours are those of Display P3."""
    named = picture.info.get("nclx_profile")
    return (
        isinstance(named, dict)
        and named.get("color_primaries") == hdr_curves.P3
        and picture.mode in ("RGB", "RGBA")
    )


def _from_p3(picture):
    """A picture in sRGB from one in Display P3, which has the same curve."""
    linear = tone.linear_from_srgb(np.arange(256) / 255).astype(np.float32)
    values = np.array(picture)
    for rows in np.array_split(values, max(1, len(values) // 64)):  # views
        converted = tone.srgb(np.clip(linear[rows[..., :3]] @ SRGB_FROM_P3.T, 0, 1))
        rows[..., :3] = np.rint(255 * converted)
    return Image.fromarray(values)
