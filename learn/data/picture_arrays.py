"""Pictures, masks and regions that come as arrays instead of files.

What they mean follows from their type: whole numbers are display values, as a file of 8 bits has
them, and floats are linear radiance, as an EXR has it. Results are those of learn.data.photographs.
As files are, display values are made smaller, and masks and regions with them
(learn.data.picture_decoding); radiance is not.
"""

import numpy as np
from PIL import Image

from learn.data import picture_decoding
from learn.data.photographs import (
    LARGEST_RADIANCE,
    MASK_REMEDY,
    MOST_REGIONS,
    require_object,
)
from manifests import exr, notices
from manifests.errors import InputError
from shaders import tone

LARGEST_WHITE = 16  # a picture of whole numbers above it holds display values, not radiance


def read_picture(picture: np.ndarray, where: str) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return radiance (H, W, 3) float32, alpha (H, W) and whether the array held radiance.

    picture  (H, W, 3) or, with transparency, (H, W, 4): uint8, or floats of which the fourth
             channel is in [0, 1]
    where    what errors call it
    Raises   InputError
    """
    values = np.asarray(picture)
    rule = "an array (H, W, 3) or (H, W, 4), of uint8 display values or of floats"
    result = f"{values.dtype} of shape {values.shape}"
    shaped = values.ndim == 3 and values.shape[2] in (3, 4) and values.size > 0
    linear = values.dtype.kind == "f"
    if not shaped or not (linear or values.dtype == np.uint8):
        remedy = "convert it: numpy.asarray(PIL.Image.open(FILE).convert('RGB'))"
        raise InputError(where, rule, result, remedy)
    height, width = values.shape[:2]
    # as of an EXR, and of a PNG in colour without and with transparency
    most = exr.MAX_PIXELS if linear else picture_decoding.MOST_DECODED // (4 * values.shape[2] - 8)
    if height * width > most:
        rule = f"at most {most / 1e6:.3g} megapixels"
        raise InputError(where, rule, f"{width} × {height}", "make it smaller")
    if linear:
        values = values.astype(np.float32)
        if not (values.min() >= 0 and values.max() <= LARGEST_RADIANCE):
            rule = f"radiance from 0 to {LARGEST_RADIANCE:g}"
            result = f"{values.min():g} to {values.max():g}"
            raise InputError(where, rule, result, "check for NaN, infinity and negative values")
        if (brightest := values.max()) > LARGEST_WHITE and (values == values.round()).all():
            rule = "floats of linear radiance, in which white is about 1"
            result = f"whole numbers up to {brightest:g}, as display values are"
            raise InputError(where, rule, result, "give display values as uint8")
        radiance, alpha = values[..., :3], values[..., 3:].clip(0, 1)
    else:
        values = _reduce(values, Image.Resampling.BOX)
        if line := picture_decoding.describe_reduction((width, height), values.shape[:2]):
            notices.notice(f"{where}: {line}")
        table = tone.linear_from_srgb(np.arange(256) / 255).astype(np.float32)
        radiance, alpha = table[values[..., :3]], values[..., 3:].astype(np.float32) / 255
    if not alpha.size:
        return radiance, np.ones(radiance.shape[:2], np.float32), linear
    return np.ascontiguousarray(radiance), alpha[..., 0], linear


def read_coverage(
    mask: np.ndarray | None,
    regions: np.ndarray | None,
    alpha: np.ndarray,
    where: str,
) -> np.ndarray:
    """Return the coverage (H, W) float32 in [0, 1] of an object.

    mask     (H, W) bool, uint8 with 255 on the object, or floats in [0, 1]; None: the transparency
    regions  as `read_regions` returns them, or None: without a mask and transparency the object is
             all its regions
    alpha    (H, W) of the picture
    Raises   InputError
    """
    if mask is None and not (alpha < 0.5).any():
        if regions is None:
            rule = "a mask, or transparency around the object"
            raise InputError(where, rule, "neither", MASK_REMEDY.replace("--mask FILE", "a mask"))
        coverage = (regions > 0).astype(np.float32)
    elif mask is None:
        coverage = alpha
    else:
        coverage = _shares(np.asarray(mask), alpha.shape, f"{where}: mask")
    require_object(where if mask is None else f"{where}: mask", coverage)
    return coverage


def read_regions(regions: np.ndarray, size: tuple[int, ...], where: str) -> np.ndarray:
    """Return regions (H, W) uint8: 0 background, 1 … S by rising value. Raises InputError."""
    values = np.asarray(regions)
    rule = f"an array {tuple(size)} of whole numbers, one for each region"
    result = f"{values.dtype} of shape {values.shape}"
    if values.dtype.kind not in "biu" or values.ndim != 2:
        raise InputError(f"{where}: regions", rule, result, "0 is background")
    if values.size and values.min() < 0:
        remedy = "0 is background, and regions are above it"
        raise InputError(f"{where}: regions", rule, f"{values.min()}", remedy)
    levels = [level for level in np.unique(values) if level != 0]
    if not 1 <= len(levels) <= MOST_REGIONS:
        rule = f"1 to {MOST_REGIONS} values besides 0"
        raise InputError(f"{where}: regions", rule, f"{len(levels)}", "0 is background")
    labels = np.searchsorted([0, *levels], values).astype(np.uint8)
    if labels.shape != tuple(size):
        labels = _reduce(labels, Image.Resampling.NEAREST)
    if labels.shape != tuple(size):
        raise InputError(f"{where}: regions", rule, result, "0 is background")
    return labels


def _shares(mask, size, where):
    """A mask's coverage (H, W) float32."""
    rule = f"an array {tuple(size)} of bool, of uint8, or of floats from 0 to 1"
    remedy = "it must have the picture's height and width"
    result = f"{mask.dtype} of shape {mask.shape}"
    if mask.ndim != 2 or not mask.size or (mask.dtype.kind not in "bf" and mask.dtype != np.uint8):
        raise InputError(where, rule, result, remedy)
    if mask.dtype.kind == "f" and not (mask.min() >= 0 and mask.max() <= 1):
        raise InputError(where, rule, f"{mask.min():g} to {mask.max():g}", "divide it by 255")
    shares = mask.astype(np.float32) / (255 if mask.dtype == np.uint8 else 1)
    if shares.shape != tuple(size):
        shares = _reduce(shares, Image.Resampling.BOX)
    if shares.shape != tuple(size):
        raise InputError(where, rule, result, remedy)
    return shares


def _reduce(values: np.ndarray, resampling: Image.Resampling) -> np.ndarray:
    """Return an array (H, W) or (H, W, C) with as many pixels as a file's picture may have."""
    whole = values.shape[0] * values.shape[1]
    if not whole or whole <= picture_decoding.MOST_PIXELS:
        return values
    picture = Image.fromarray(np.ascontiguousarray(values))
    return np.asarray(picture_decoding.reduce_size(picture, resampling))
