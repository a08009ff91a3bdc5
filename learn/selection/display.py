"""Display values of a photograph in which an object is to be marked.

A very dark photograph is brightened, because neither a user nor superpixels could find edges in it.
"""

import functools

import numpy as np

from learn.figures import montage
from shaders import tone

DARK = 48  # of 255: the green of a picture that is brightened to be marked


def display_for_marking(radiance: np.ndarray, is_linear: bool) -> tuple[np.ndarray, bool]:
    """Return display values (H, W, 3) uint8 to mark an object on, and whether they are brightened.

    radiance   (H, W, 3) linear
    is_linear  whether the photograph holds radiance, which is exposed, and not display values
    """
    shown = None
    if not is_linear:
        shown = display_of(radiance, 1.0)
        if not is_dark(shown):
            return shown, False
    everywhere = np.ones(radiance.shape[:2], bool)
    exposure = tone.auto_exposure(radiance, everywhere)
    return display_of(radiance, exposure), shown is not None


def is_dark(display: np.ndarray) -> bool:
    """Return whether nearly nothing can be seen in a picture (H, W, 3) uint8.

    That is so where all but the brightest hundredth of its pixels are below DARK.
    """
    counts = np.bincount(display[..., 1].ravel(), minlength=256)
    return bool(counts[:DARK].sum() >= 0.99 * counts.sum()) and bool(counts[0] < counts.sum())


@functools.cache
def display_table() -> np.ndarray:
    """Return the display values (65536,) uint8 of linear values 0 to 1 in equal steps."""
    return montage.eight_bit(tone.display(np.arange(65536) / 65535, 1.0))


def display_of(radiance: np.ndarray, exposure: float) -> np.ndarray:
    """Return display values (H, W, 3) uint8 of linear radiance.

    They are looked up, which takes a tenth of the time that computing them does: 4 seconds for a
    photograph of 24 megapixels. Values of a file of 8 bits come back as they were.
    """
    steps = np.clip(radiance * np.float32(exposure), 0, 1)
    return display_table()[np.rint(steps * np.float32(65535)).astype(np.uint16)]
