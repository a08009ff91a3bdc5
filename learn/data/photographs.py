"""Pictures from a user, of any size, with a mask: OpenEXR, or as learn.data.picture_decoding reads.

radiance  (H, W, 3) float32 linear Rec.709; files of 8 and 16 bits are converted from sRGB, and
          those of more than 25 megapixels are made smaller
mask      (H, W) bool, from the picture's own alpha or from a file (brighter than half), whose size
          is either that of the picture's file or (H, W)

Accepted radiance: finite values up to LARGEST_RADIANCE, negative ones counting as 0. What networks
are shown of it, and which brightness they can read, is in learn.data.framing.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from learn.data.picture_decoding import decode, decode_labels, describe_file_reduction
from manifests import exr, notices
from manifests.arrays import PICTURE_CHANNELS
from manifests.errors import InputError
from shaders import tone

LARGEST_RADIANCE = 1e10  # the sun's disk has 1.6e9 cd/m²: in no unit in use is anything brighter
MOST_REGIONS = 8
LEAST_PIXELS = 16  # of the mask; fewer tell nothing of a shape
MASK_REMEDY = "give --mask FILE: white where the object is; `brdfactory mask` makes one"
# Display value, of 255, from which on a file of 8 bits is taken to be clipped: JPEG's losses leave
# white a little below 255.
NEAR_WHITE = 252


def holds_radiance(path: str | Path) -> bool:
    """Return whether a picture's file holds radiance, not display values: an EXR does."""
    return Path(path).suffix.lower() == ".exr"


def find_saturated(radiance: np.ndarray) -> np.ndarray:
    """Return (H, W, 3) bool: channels of linear values from a file of 8 or 16 bits that are white.

    Such a value says no more than "at least this bright". NEAR_WHITE is the limit.
    """
    return radiance >= _linear(np.float64(NEAR_WHITE - 0.5) / 255)


def read(path: str | Path, mask_path: str | Path | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return radiance (H, W, 3) and mask (H, W) bool. Raises as `read_with_coverage`."""
    radiance, coverage, _ = read_with_coverage(path, mask_path)
    return radiance, coverage >= 0.5


def read_with_coverage(
    path: str | Path,
    mask_path: str | Path | None = None,
    regions: str | Path | None = None,
    remedy: str = MASK_REMEDY,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return radiance (H, W, 3), coverage (H, W) and alpha (H, W).

    Coverage in [0, 1] is the share of each pixel that the object covers, from a mask's grey or the
    picture's alpha.

    regions  a label image's file: without a mask and transparency the object is all its regions
    remedy   of a picture without a mask

    Raises  InputError: no such file, no picture, no mask, an empty one, one of another size
    """
    path = Path(path)
    radiance, alpha = read_pixels(path)
    if line := describe_reduction(path, radiance.shape[:2]):
        notices.notice(f"{path}: {line}")
    if mask_path is not None:
        coverage = read_mask(mask_path, radiance.shape[:2])
    elif (alpha < 0.5).any():
        coverage = alpha
    elif regions is not None:
        coverage = (read_labels(regions, radiance.shape[:2]) > 0).astype(np.float32)
    else:
        raise InputError(path, "a mask, or transparency around the object", "neither", remedy)
    require_object(mask_path or path, coverage)
    return radiance, coverage, alpha


def describe_reduction(path: Path, size: tuple[int, ...]) -> str | None:
    """Return a sentence that says that a file was made smaller to the size (H, W), else None.

    An EXR never is.

    Raises InputError.
    """
    return None if holds_radiance(path) else describe_file_reduction(path, size)


def require_object(where: str | Path, coverage: np.ndarray) -> None:
    """Raise InputError for a mask of fewer than LEAST_PIXELS pixels."""
    if (count := int((coverage >= 0.5).sum())) < LEAST_PIXELS:
        raise InputError(
            where,
            f"an object of {LEAST_PIXELS} pixels or more in the mask",
            f"{count}",
            "white marks the object",
        )


def read_mask(path: str | Path, size: tuple[int, ...]) -> np.ndarray:
    """Return the coverage (H, W) of a mask file.

    It is the display value, 0 black to 1 white, times the file's alpha. Raises InputError if the
    mask is not of that size.
    """
    values, own = read_pixels(Path(path))
    _require_size(path, values.shape[:2], size, "a mask")
    return tone.srgb(values.mean(-1)).astype(np.float32) * own


def read_labels(path: str | Path, size: tuple[int, ...]) -> np.ndarray:
    """Return regions (H, W) uint8: 0 background, 1 … S by rising value.

    Each grey, colour or palette entry is a region, except for 0 and what is transparent. Raises
    InputError.
    """
    path = Path(path)
    if holds_radiance(path):
        raise InputError(
            path, "a picture of whole numbers, one for each region", "an EXR", "save it as PNG"
        )
    values = decode_labels(path, _label_values)
    _require_size(path, values.shape[:2], size, "regions")
    levels = [level for level in np.unique(values) if level != 0]
    if not 1 <= len(levels) <= MOST_REGIONS:
        remedy = "0 is background, and each region has one value; save without antialiasing or JPEG"
        raise InputError(path, f"1 to {MOST_REGIONS} values besides 0", f"{len(levels)}", remedy)
    return np.searchsorted([0, *levels], values).astype(np.uint8)


def _label_values(picture):
    """(H, W) whole numbers of a Pillow image: greys and palette entries as they are, of colours one
    number each.
    """
    if picture.mode in ("L", "1") or picture.mode.startswith("I"):
        return np.asarray(picture)
    if picture.mode == "P":
        return _palette_values(picture)
    r, g, b, alpha = np.moveaxis(np.asarray(picture.convert("RGBA"), np.uint32), -1, 0)
    return np.where(alpha > 127, r << 16 | g << 8 | b, 0)


def _palette_values(picture):
    """(H, W) palette entries of a Pillow image, 0 where it is background.

    That is what is transparent; and entry 0, unless its colour is another and something else is
    black or transparent, which is background then.
    """
    index = np.asarray(picture).astype(np.int32)
    colors = np.asarray(picture.convert("RGBA"))
    transparent = colors[..., 3] <= 127
    empty = transparent | (colors[..., :3] == 0).all(-1)
    if empty.any() and not empty[index == 0].any():
        return np.where(empty, 0, index + 1)
    return np.where(transparent, 0, index)


def _require_size(path, found, expected, what):
    if tuple(found) != tuple(expected):
        rule = f"{what} of the picture's size {expected[1]} × {expected[0]}"
        raise InputError(path, rule, f"{found[1]} × {found[0]}", "resize it")


def read_pixels(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return radiance (H, W, 3) and alpha (H, W) in [0, 1], upright as the orientation says.

    A file of display values is converted to sRGB and made smaller (learn.data.picture_decoding);
    an EXR is not. Raises InputError.
    """
    if holds_radiance(path):
        radiance, alpha = read_exr(path)
        # an EXR's colours are multiplied by its alpha; where that is 0, they are light of their own
        straight = radiance / np.where(alpha > 0, alpha, 1)[..., None]
        return np.minimum(straight, LARGEST_RADIANCE), alpha
    values = decode(path, _display_values)
    if values.ndim == 2:
        low, high = values.min(), values.max()
        if low < 0 or high > 65535:
            raise InputError(
                path,
                "8 or 16 bit values",
                f"values from {low} to {high}",
                "save it as a 16-bit PNG, or as EXR",
            )
        return np.repeat(_linear(values.astype(np.float32) / 65535)[..., None], 3, -1), np.ones(
            values.shape, np.float32
        )
    # one look-up a value: of twenty megapixels the power would take seconds and gigabytes
    table = _linear(np.arange(256) / 255)
    return table[values[..., :3]], values[..., 3].astype(np.float32) / 255


def _display_values(picture):
    """(H, W, 4) uint8 of a Pillow image's colours and transparency; (H, W) whole numbers of deeper
    greys.
    """
    return np.asarray(picture if picture.mode.startswith("I") else picture.convert("RGBA"))


def _linear(values):
    """float32 linear values of display values in [0, 1]: the sRGB curve backwards."""
    return tone.linear_from_srgb(values).astype(np.float32)


def read_exr(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Return radiance (H, W, 3) float32, 0 or more, and alpha (H, W) of an EXR, as they are stored.

    Raises  InputError: channels missing or of several sizes, values that are not finite
    """
    channels = exr.read(path)
    missing = [name for name in PICTURE_CHANNELS if name not in channels]
    if missing:
        raise InputError(
            path,
            "channels R, G, B",
            f"only {', '.join(sorted(channels)) or 'none'}",
            "export it as RGB",
        )
    planes = {
        name: np.asarray(channels[name]) for name in (*PICTURE_CHANNELS, "A") if name in channels
    }
    kinds = {(plane.shape, plane.dtype.kind) for plane in planes.values()}
    if len({shape for shape, _ in kinds}) > 1 or any(
        len(shape) != 2 or kind not in "fu" for shape, kind in kinds
    ):
        raise InputError(
            path,
            "channels R, G, B and A of one size",
            "channels of several sizes, or deep data",
            "export it as flat RGB",
        )
    radiance = np.stack([planes[name].astype(np.float32) for name in PICTURE_CHANNELS], -1)
    alpha = (
        planes["A"].astype(np.float32) if "A" in planes else np.ones(radiance.shape[:2], np.float32)
    )
    if not np.isfinite(radiance).all():
        raise InputError(path, "finite radiance", "NaN or infinity", "export it again")
    if not np.isfinite(alpha).all():
        raise InputError(path, "a finite alpha channel", "NaN or infinity", "export it again")
    if (brightest := radiance.max()) > LARGEST_RADIANCE:
        raise InputError(
            path,
            f"radiance up to {LARGEST_RADIANCE:g}",
            f"{brightest:g}",
            "divide it by what white is, and export it again",
        )
    return np.maximum(radiance, 0), np.clip(alpha, 0, 1)


def write_exr(path: str | Path, array: np.ndarray, names: Sequence[str] = PICTURE_CHANNELS) -> None:
    """Write an EXR of float32 channels (H, W, C). Raises InputError for values not finite."""
    with np.errstate(over="ignore"):  # beyond float32 is not finite
        planes = {name: np.asarray(array[..., k], np.float32) for k, name in enumerate(names)}
    for plane in planes.values():
        require_finite(path, plane)
    exr.write(path, planes)


def write_picture(path: str | Path, radiance: np.ndarray, opacity: np.ndarray | None) -> None:
    """Write an EXR of a picture (H, W, 3) that `read_pixels` reads back.

    opacity  (H, W) in [0, 1], by which colours are multiplied in the file; None: no alpha
    Raises   InputError for values not finite
    """
    if opacity is None:
        write_exr(path, radiance)
        return
    colors = radiance * np.where(opacity > 0, opacity, 1)[..., None]
    channels = np.concatenate([colors, opacity[..., None]], -1)
    write_exr(path, channels, (*PICTURE_CHANNELS, "A"))


def require_finite(path: str | Path, values: np.ndarray) -> None:
    """Raise InputError if a picture that is to be written to `path` holds NaN or infinity."""
    if not np.isfinite(values).all():
        raise InputError(
            path,
            "a finite picture",
            "NaN or infinity",
            "give another --exposure, or other --weights or --material",
        )
