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


def augment(
    data: Data,
    training: bool,
    rng: np.random.Generator,
    image: np.ndarray,
    mask: np.ndarray,
    along: Sequence[torch.Tensor],
) -> tuple[np.ndarray, np.ndarray, list[torch.Tensor]]:
    """Augment a picture as a run's settings ask for; only pictures for training are changed.

    along    tensors (H, W, …) that must stay aligned with the picture
    Returns  image (H, W, 3), mask (H, W) bool, [tensors]
    """
    # of a thin object no pixel may be left where geometry is larger than the run's pictures
    photograph = training and data.photograph and bool(mask.any())
    if photograph and data.camera_model and rng.random() < data.camera_model:
        return prepare_photograph(rng, image, mask, along)
    return prepare_picture(rng, image, mask, along, photograph)


def prepare_picture(
    rng: np.random.Generator,
    image: np.ndarray,
    mask: np.ndarray,
    along: Sequence[torch.Tensor],
    photograph: bool,
) -> tuple[np.ndarray, np.ndarray, list[torch.Tensor]]:
    """Mask a picture for the network; vary exposure, noise, mask and position if it is augmented.

    along       tensors (H, W, …) that must stay aligned with the picture; they are shifted with it
    photograph  whether to augment; otherwise the mask is applied and nothing else changes
    Returns     image (H, W, 3), mask (H, W) bool, [tensors]
    """
    if photograph:
        image, eroded, step = (
            vary_exposure_and_noise(rng, image, mask),
            erode_mask(rng, mask),
            shift(rng, mask),
        )
        image, mask = np.roll(image, step, (0, 1)), np.roll(eroded, step, (0, 1))
        along = [tensor.roll(step, (0, 1)) for tensor in along]
    return image * mask[..., None], mask, list(along)


def prepare_photograph(
    rng: np.random.Generator,
    image: np.ndarray,
    mask: np.ndarray,
    along: Sequence[torch.Tensor],
) -> tuple[np.ndarray, np.ndarray, list[torch.Tensor]]:
    """Take the picture with the simulated camera of learn.data.camera_model, then mask it.

    A mask that was drawn too large lets the background show. The returned mask and tensors leave
    out what an occluder hides. Arguments and results are those of `prepare_picture`.
    """
    rows, columns = camera_model.draw_window(rng, mask)
    image, mask = image[np.ix_(rows, columns)], mask[np.ix_(rows, columns)]
    along = [tensor[torch.from_numpy(rows)][:, torch.from_numpy(columns)] for tensor in along]
    step = shift(rng, mask)
    image, mask = (np.roll(each, step, (0, 1)) for each in (image, mask))
    along = [tensor.roll(step, (0, 1)) for tensor in along]
    visible = camera_model.occlude(rng, mask)
    drawn = camera_model.draw_mask(rng, visible)
    image = np.where(visible[..., None], image, camera_model.draw_background(rng, image))
    image, _ = camera_model.take_photograph(rng, image, drawn)
    hidden = torch.from_numpy(visible)
    along = [tensor * hidden.reshape(*mask.shape, *(1,) * (tensor.ndim - 2)) for tensor in along]
    return image * drawn[..., None], drawn, along


def shift(rng: np.random.Generator, mask: np.ndarray) -> tuple[int, int]:
    """Draw a shift (rows, columns) that keeps the object inside the frame."""
    rows, columns = np.nonzero(mask.any(1))[0], np.nonzero(mask.any(0))[0]
    limit = int(SHIFT * len(mask))
    down, right = (
        int(rng.integers(-min(limit, r[0]), min(limit, len(mask) - 1 - r[-1]) + 1))
        for r in (rows, columns)
    )
    return down, right


def erode_mask(rng: np.random.Generator, mask: np.ndarray) -> np.ndarray:
    """Remove up to one pixel along parts of a mask's rim, as masks of photographs are never exact.

    Half of the masks are returned unchanged.
    """
    if rng.random() < 0.5:
        return mask
    inner = mask.copy()
    for axis in (0, 1):
        for step in (-1, 1):
            inner &= np.roll(mask, step, axis)
    return mask & (inner | (rng.random(mask.shape) < rng.uniform(0, 1)))


def vary_exposure_and_noise(
    rng: np.random.Generator, image: np.ndarray, mask: np.ndarray
) -> np.ndarray:
    """Change a picture's exposure, add sensor noise and, one time in four, compress it as JPEG."""
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
