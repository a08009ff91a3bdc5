"""Crops a picture to a square around its object, at the size that networks take, and exposes it.

An object is refused if its brightness does not allow its exposure to be guessed
(GUESSABLE_LUMINANCE), or if networks never see one so dark or so bright (EXPOSED_LUMINANCE).
Objects of one colour and fully clipped ones are accepted.
"""

from dataclasses import dataclass

import numpy as np
from PIL import Image
from scipy.ndimage import distance_transform_edt

from learn.data.photographs import LEAST_PIXELS
from manifests.errors import InputError
from shaders.tone import LUMINANCE

# largest side of the square around an object: that of a square picture of MOST_PIXELS pixels
MOST_SQUARE = 9600
# side of the square, relative to the object's: in training, the object fills 0.85 of a picture
MARGIN = 1.18
# The scale of a photograph is unknown. The factor to radiance under a light of unit mean is guessed
# from the object's mean luminance Y in the file as TYPICAL · Y^−DEPENDENCE. This was the best line
# over 200 pictures of known light, exposed for their 99th percentile; on 600 others it is as good
# as a line fitted to them, and either is wrong by more than a factor of 2.5 for a third of them.
# `python -m learn.experiments exposure` measures this (docs/editing-measurements.md).
TYPICAL, DEPENDENCE = 0.23, 0.19
# Mean luminance of an object whose exposure is guessed: below it 8 bits have three steps, above
# it a file is in units of its own.
GUESSABLE_LUMINANCE = (1e-3, 1e3)
# Mean luminance of an object times its exposure. Under light of unit mean the catalogue's materials
# on a sphere have 2.3e-4 (lit by a sun from behind) to 1.8; a mirror that faces the sun may have
# far more, but not over a whole object.
EXPOSED_LUMINANCE = (1e-4, 1e2)
Box = tuple[int, int, int]  # top, left, side


@dataclass(frozen=True)
class Framed:
    """A picture cropped to the object's square.

    box       (top, left, side) in the picture's pixels
    exposure  radiance = photograph × exposure
    clipped   (size, size, 3) in [0, 1]: the share of each pixel's part of the object that is white
              in the file, by channel; None if the file's values have no upper limit
    """

    radiance: np.ndarray
    mask: np.ndarray
    box: Box
    exposure: float
    clipped: np.ndarray | None = None


def resolve_exposure(
    radiance: np.ndarray,
    mask: np.ndarray,
    exposure: float | None = None,
    where: object = "the object",
) -> float:
    """Return the factor by which a picture's radiance is multiplied for the networks.

    radiance  (H, W, 3) linear
    mask      (H, W) bool, not empty
    exposure  the factor, which is only checked; None: guess it from the object's brightness
    where     what an error names as its place
    Raises    InputError for an object that is black, too dark or too bright
    """
    Y = float((radiance[mask] @ LUMINANCE).mean())
    shown = f"{Y:.3g}" + ", black or negative" * (Y == 0)
    if exposure is None:
        if not GUESSABLE_LUMINANCE[0] <= Y <= GUESSABLE_LUMINANCE[1]:
            rule = "an object of mean luminance {:g} to {:g}".format(*GUESSABLE_LUMINANCE)
            raise InputError(
                where,
                rule,
                shown,
                "scale the file so that white is 1, or give --exposure",
            )
        return TYPICAL * Y**-DEPENDENCE
    if not EXPOSED_LUMINANCE[0] <= exposure * Y <= EXPOSED_LUMINANCE[1]:
        rule = "an object whose mean luminance times the exposure is {:g} to {:g}".format(
            *EXPOSED_LUMINANCE
        )
        raise InputError(
            where, rule, f"{shown} times {exposure:g}", "give another --exposure, or leave it out"
        )
    return exposure


def frame_object(
    radiance: np.ndarray,
    mask: np.ndarray,
    size: int,
    exposure: float | None = None,
    where: object = "the object",
    clipped: np.ndarray | None = None,
) -> Framed:
    """Crop a picture to the square around its object, and scale the square to size².

    radiance  (H, W, 3) linear
    mask      (H, W) bool, not empty
    size      side of the networks' pictures, in pixels
    exposure  as `resolve_exposure` takes it
    where     what an error names as its place
    clipped   (H, W, 3) bool: channels that are white in the file; None if nothing can be clipped
    Returns   Framed with radiance (size, size, 3), times the exposure, and mask (size, size)
    Raises    InputError: too few pixels of the object are left at that size, the object is too
              large, or what `resolve_exposure` raises
    """
    rows, columns = np.nonzero(mask.any(1))[0], np.nonzero(mask.any(0))[0]
    side = max(int(np.ceil(MARGIN * max(np.ptp(rows), np.ptp(columns)))) + 1, 4)
    if side > MOST_SQUARE:
        across = max(np.ptp(rows), np.ptp(columns)) + 1
        rule = f"an object at most {int(MOST_SQUARE / MARGIN)} pixels across"
        raise InputError(where, rule, str(across), "make the picture smaller")
    top, left = (rows[0] + rows[-1] + 1 - side) // 2, (columns[0] + columns[-1] + 1 - side) // 2
    exposure = resolve_exposure(radiance, mask, exposure, where)
    weight = cut_square(mask.astype(np.float32), (top, left, side))
    covered = resize_square(weight, size)
    colour = (
        resize_square(cut_square(radiance * mask[..., None], (top, left, side)), size)
        / np.maximum(covered, 1e-3)[..., None]
    )
    inside = covered >= 0.5
    # a thin object covers few pixels by half: take its most covered pixels, as many as its area
    if inside.sum() < 0.5 * covered.sum():
        inside = covered >= max(np.sort(covered, None)[-round(float(covered.sum()))], 1e-2)
    if inside.sum() < LEAST_PIXELS:
        rule = f"an object of {LEAST_PIXELS} pixels or more at the network's {size} × {size}"
        raise InputError(
            "the mask", rule, f"{int(inside.sum())}", "mask a thicker part of it, or crop to it"
        )
    share = None
    if clipped is not None:
        part = cut_square((clipped & mask[..., None]).astype(np.float32), (top, left, side))
        share = resize_square(part, size) / np.maximum(covered, 1e-3)[..., None]
        share = (np.clip(share, 0, 1) * inside[..., None]).astype(np.float32)
    return Framed(
        (colour * inside[..., None] * exposure).astype(np.float32),
        inside,
        (int(top), int(left), side),
        float(exposure),
        share,
    )


def frame_regions(regions: np.ndarray, framed: Framed) -> np.ndarray:
    """Return regions (H, W) in the object's square, (size, size) int64.

    Each pixel of the framed mask has the nearest pixel's region; 0 outside the mask.
    """
    size = len(framed.mask)
    at = ((np.arange(size) + 0.5) * framed.box[2] / size).astype(int)
    near = distance_transform_edt(
        cut_square(regions, framed.box) == 0, return_distances=False, return_indices=True
    )
    return cut_square(regions, framed.box)[tuple(near)][at][:, at].astype(np.int64) * framed.mask


def cut_square(array: np.ndarray, box: Box) -> np.ndarray:
    """Return the square of an array (H, W, …), 0 where it extends beyond the picture."""
    top, left, side = box
    out = np.zeros((side, side, *array.shape[2:]), array.dtype)
    first_row, first_column = max(top, 0), max(left, 0)
    part = array[first_row : max(top + side, 0), first_column : max(left + side, 0)]
    row, column = first_row - top, first_column - left
    out[row : row + part.shape[0], column : column + part.shape[1]] = part
    return out


def paste_square(array: np.ndarray, square: np.ndarray, box: Box) -> np.ndarray:
    """Return a copy of the array with a square in its place, as far as it lies inside."""
    top, left, side = box
    out = array.copy()
    target = out[max(top, 0) : max(top + side, 0), max(left, 0) : max(left + side, 0)]
    row, column = max(-top, 0), max(-left, 0)
    target[...] = square[row : row + target.shape[0], column : column + target.shape[1]]
    return out


def resize_square(array: np.ndarray, size: int) -> np.ndarray:
    """Return an array (side, side, …) averaged or interpolated to (size, size, …)."""
    planes = array[..., None] if array.ndim == 2 else array
    method = Image.Resampling.BOX if len(array) >= size else Image.Resampling.BILINEAR
    out = np.stack(
        [
            np.asarray(Image.fromarray(planes[..., k]).resize((size, size), method))
            for k in range(planes.shape[-1])
        ],
        -1,
    )
    return out[..., 0] if array.ndim == 2 else out
