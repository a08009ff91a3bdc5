"""What happens to a picture on its way through a camera; truth stays as it is, but for a shift that
moves it along.

image (H, W, 3) linear radiance, mask (H, W) bool
"""

import io

import numpy as np
from PIL import Image

from shaders import tone

EXPOSURE = 0.3  # standard deviation of the logarithm
SHIFT = 0.04  # of the picture's side, at most


def seen(rng, image, mask, along, photograph):
    """A picture and its mask as a network sees them, and what moved along with them.

    along       torch tensors (H, W, …) that stay in register with the picture
    photograph  whether anything happens at all, beyond cutting the picture out
    Returns     image (H, W, 3), mask (H, W) bool, [tensors]
    """
    if photograph:
        image, cut, step = photographed(rng, image, mask), nibbled(rng, mask), shift(rng, mask)
        image, mask = np.roll(image, step, (0, 1)), np.roll(cut, step, (0, 1))
        along = [tensor.roll(step, (0, 1)) for tensor in along]
    return image * mask[..., None], mask, along


def shift(rng, mask):
    """Rows and columns to roll by that keep the object inside the frame."""
    rows, columns = np.nonzero(mask.any(1))[0], np.nonzero(mask.any(0))[0]
    reach = int(SHIFT * len(mask))
    return tuple(
        int(rng.integers(-min(reach, r[0]), min(reach, len(mask) - 1 - r[-1]) + 1))
        for r in (rows, columns)
    )


def nibbled(rng, mask):
    """The mask with up to a pixel missing along its rim, in places: nobody cuts out a photograph
    exactly.
    """
    if rng.random() < 0.5:
        return mask
    inner = mask.copy()
    for axis in (0, 1):
        for step in (-1, 1):
            inner &= np.roll(mask, step, axis)
    return mask & (inner | (rng.random(mask.shape) < rng.uniform(0, 1)))


def photographed(rng, image, mask):
    """Another exposure, sensor noise, and now and then a JPEG in between."""
    image = image * np.exp(rng.normal(0, EXPOSURE))
    image = image + rng.normal(0, 1, image.shape) * np.sqrt(
        np.maximum(image, 0) * rng.uniform(0, 2e-3) + rng.uniform(0, 5e-3) ** 2
    )
    image = np.maximum(image, 0).astype(np.float32)
    if rng.random() < 0.25 and mask.any():
        exposure = tone.auto_exposure(image, mask)
        data = io.BytesIO()
        Image.fromarray(np.rint(tone.display(image, exposure)).astype(np.uint8)).save(
            data, "JPEG", quality=int(rng.integers(60, 96))
        )
        encoded = np.asarray(Image.open(data, formats=["JPEG"]), np.float32) / 255.0
        image = tone.linear_from_srgb(encoded).astype(np.float32) / exposure
    return image
