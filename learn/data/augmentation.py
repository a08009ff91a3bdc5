"""Augmentation of pictures as a camera would change them.

The truth stays as it is, except that a shift moves it along with the picture.

image (H, W, 3) linear radiance, mask (H, W) bool
"""

import io
from collections.abc import Sequence

import numpy as np
import torch
from PIL import Image

from learn.data import camera_model
from learn.data.settings import Data
from shaders import tone

EXPOSURE = 0.3  # standard deviation of the logarithm
SHIFT = 0.04  # of the picture's side, at most


def by(
    data: Data,
    training: bool,
    rng: np.random.Generator,
    image: np.ndarray,
    mask: np.ndarray,
    along: Sequence[torch.Tensor],
) -> tuple[np.ndarray, np.ndarray, list[torch.Tensor]]:
    """Return (image, mask, [tensors]) of a picture as a run's data say; arguments as `seen`."""
    photograph = training and data.photograph
    if photograph and data.camera_model and rng.random() < data.camera_model:
        return seen_by_camera(rng, image, mask, along)
    return seen(rng, image, mask, along, photograph)


def seen(
    rng: np.random.Generator,
    image: np.ndarray,
    mask: np.ndarray,
    along: Sequence[torch.Tensor],
    photograph: bool,
) -> tuple[np.ndarray, np.ndarray, list[torch.Tensor]]:
    """Return a picture and its mask as a network sees them, and the tensors moved with them.

    along       tensors (H, W, …) that stay in register with the picture
    photograph  whether the picture is augmented; otherwise the mask is applied to it, no more
    Returns     image (H, W, 3), mask (H, W) bool, [tensors]
    """
    if photograph:
        image, eroded, step = (
            photographed(rng, image, mask),
            eroded_mask(rng, mask),
            shift(rng, mask),
        )
        image, mask = np.roll(image, step, (0, 1)), np.roll(eroded, step, (0, 1))
        along = [tensor.roll(step, (0, 1)) for tensor in along]
    return image * mask[..., None], mask, list(along)


def seen_by_camera(
    rng: np.random.Generator,
    image: np.ndarray,
    mask: np.ndarray,
    along: Sequence[torch.Tensor],
) -> tuple[np.ndarray, np.ndarray, list[torch.Tensor]]:
    """Return what `seen` does of a picture that learn.data.camera_model takes.

    A mask that is drawn too large shows the background; what an occluder hides is in no mask.
    """
    rows, columns = camera_model.window(rng, mask)
    image, mask = image[np.ix_(rows, columns)], mask[np.ix_(rows, columns)]
    along = [tensor[torch.from_numpy(rows)][:, torch.from_numpy(columns)] for tensor in along]
    step = shift(rng, mask)
    image, mask = (np.roll(each, step, (0, 1)) for each in (image, mask))
    along = [tensor.roll(step, (0, 1)) for tensor in along]
    visible = camera_model.occluded(rng, mask)
    drawn = camera_model.drawn_mask(rng, visible)
    image = np.where(visible[..., None], image, camera_model.background(rng, image))
    image, _ = camera_model.photographed(rng, image, drawn)
    hidden = torch.from_numpy(visible)
    along = [tensor * hidden.reshape(*mask.shape, *(1,) * (tensor.ndim - 2)) for tensor in along]
    return image * drawn[..., None], drawn, along


def shift(rng: np.random.Generator, mask: np.ndarray) -> tuple[int, int]:
    """Return rows and columns to roll by that keep the object inside the frame."""
    rows, columns = np.nonzero(mask.any(1))[0], np.nonzero(mask.any(0))[0]
    limit = int(SHIFT * len(mask))
    down, right = (
        int(rng.integers(-min(limit, r[0]), min(limit, len(mask) - 1 - r[-1]) + 1))
        for r in (rows, columns)
    )
    return down, right


def eroded_mask(rng: np.random.Generator, mask: np.ndarray) -> np.ndarray:
    """Return the mask with up to a pixel missing along its rim, in places.

    Masks of photographs are never exact.
    """
    if rng.random() < 0.5:
        return mask
    inner = mask.copy()
    for axis in (0, 1):
        for step in (-1, 1):
            inner &= np.roll(mask, step, axis)
    return mask & (inner | (rng.random(mask.shape) < rng.uniform(0, 1)))


def photographed(rng: np.random.Generator, image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return the picture at another exposure, with sensor noise and, at times, JPEG's losses."""
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
