"""A camera that takes relit pictures as photographs are taken, and the reader of photographs.

What comes out is what learn.data.photographs makes of a file: an 8-bit picture of unknown exposure,
white balance and tone curve, compressed, clipped, in a mask with errors, brought to the exposure
that the reader estimates. The truth keeps its own scale.

image (H, W, 3) linear radiance, mask (H, W) bool

step                  range, and share of pictures where it is not all
window                a part of the frame of 0.65 to 1 of its side, enlarged; 0.3
occluder              a half-plane, ellipse or bar over up to half of the object; 0.2
holes                 1 to 3 ellipses; 0.1
mask                  exact, worn along the rim, larger by 1 or 2 pixels, or of coarse polygons
blur                  standard deviation up to 0.8 pixels; 0.4
exposure              the 99th percentile of luminance at 2^−3 to 2^1 of white: four stops
white balance         a factor exp(N(0, 0.12)) for each channel
noise                 of photons and of the sensor
tone curve            a mixture with an S-curve, and a power of exp(N(0, 0.12)); 0.6
sharpening            unsharp mask of strength up to 0.8; 0.3
compression           JPEG of quality 50 to 96; 0.6
"""

import io
from dataclasses import dataclass

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter, maximum_filter

from learn.data.framing import GUESSABLE_LUMINANCE, resolve_exposure
from learn.data.photographs import NEAR_WHITE
from shaders import tone
from shaders.tone import LUMINANCE

STOPS = (-3.0, 1.0)  # of the 99th percentile, against white
WHITE_BALANCE = 0.12
LEAST_SHARE = 0.3  # of the object's pixels that occluders and holes leave
SMALLEST_WINDOW = 0.65


@dataclass(frozen=True)
class Clipping:
    """What the camera clipped.

    clipped  (H, W, 3) bool, inside the mask
    white    (3,) radiance, by channel, from which on the camera shows white, before exposure
    """

    clipped: np.ndarray
    white: np.ndarray


def take_photograph(
    rng: np.random.Generator, image: np.ndarray, mask: np.ndarray
) -> tuple[np.ndarray, Clipping]:
    """Return what the reader makes of a photograph, and what the camera clipped.

    mask     of what the photograph's user masks; where it is wider than the object, the image shows
             the background
    Returns  image (H, W, 3) float32, exposed as the reader does; Clipping
    """
    if rng.random() < 0.4:
        image = gaussian_filter(image, (*2 * [rng.uniform(0.2, 0.8)], 0))
    luminance = image[mask] @ LUMINANCE
    white = max(float(np.percentile(luminance, 99)), 1e-6) / 2 ** rng.uniform(*STOPS)
    balance = np.exp(rng.normal(0, WHITE_BALANCE, 3))
    gain = balance / (balance @ LUMINANCE) / white
    linear = image * gain
    spread = np.sqrt(np.maximum(linear, 0) * rng.uniform(0, 2e-3) + rng.uniform(0, 5e-3) ** 2)
    linear = np.clip(linear + rng.normal(0, 1, image.shape) * spread, 0, 1)
    values = tone.srgb(linear)
    if rng.random() < 0.6:
        strength = rng.uniform(-0.2, 0.6)
        curve = values * values * (3 - 2 * values)
        values = ((1 - strength) * values + strength * curve) ** np.exp(rng.normal(0, 0.12))
    if rng.random() < 0.3:
        soft = gaussian_filter(values, (1.0, 1.0, 0))
        values = values + rng.uniform(0, 0.8) * (values - soft)
    stored = np.rint(np.clip(values, 0, 1) * 255).astype(np.uint8)
    if rng.random() < 0.6:
        data = io.BytesIO()
        Image.fromarray(stored).save(data, "JPEG", quality=int(rng.integers(50, 97)))
        stored = np.asarray(Image.open(data, formats=["JPEG"]))
    radiance = tone.linear_from_srgb(stored / 255.0)
    brightness = float((radiance[mask] @ LUMINANCE).mean())
    # an object darker than the reader accepts is shown as the darkest that it does
    radiance = radiance * max(1.0, 1.001 * GUESSABLE_LUMINANCE[0] / max(brightness, 1e-12))
    if brightness <= 0:
        radiance = np.where(mask[..., None], 2 * GUESSABLE_LUMINANCE[0], radiance)
    exposure = resolve_exposure(radiance, mask, None, "a picture of training")
    clipped = (stored >= NEAR_WHITE) & mask[..., None]
    return (radiance * exposure).astype(np.float32), Clipping(
        clipped, (1 / gain).astype(np.float32)
    )


def draw_window(rng: np.random.Generator, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rows (H,) and columns (W,) whose pixels become the picture: a part of it, enlarged.

    The part shows at least half of the object; the whole frame is returned in 0.7 of the calls.
    """
    height, width = mask.shape
    whole = np.arange(height), np.arange(width)
    if rng.random() >= 0.3:
        return whole
    share = rng.uniform(SMALLEST_WINDOW, 1)
    rows, columns = (
        (rng.uniform(0, (1 - share) * side) + share * (np.arange(side) + 0.5)).astype(int)
        for side in (height, width)
    )
    kept = mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].sum()
    return (rows, columns) if 2 * kept >= mask.sum() else whole


def occlude(rng: np.random.Generator, mask: np.ndarray) -> np.ndarray:
    """Return the mask of what an occluder and holes leave: at least LEAST_SHARE of it."""
    left = mask
    if rng.random() < 0.2:
        left = left & ~_occluder(rng, mask)
    if rng.random() < 0.1:
        for _ in range(int(rng.integers(1, 4))):
            left = left & ~_ellipse(rng, mask, rng.uniform(0.02, 0.12, 2))
    return left if left.sum() >= LEAST_SHARE * mask.sum() else mask


def draw_mask(rng: np.random.Generator, mask: np.ndarray) -> np.ndarray:
    """Return the mask as a user or a program draws it: exact, worn, too large or coarse."""
    kind = rng.random()
    if kind < 0.4:
        return mask
    if kind < 0.6:
        inner = ~maximum_filter(~mask, size=3)
        worn = mask & (inner | (rng.random(mask.shape) < rng.uniform(0, 1)))
        # all of an object that is nowhere three pixels wide is border
        return worn if worn.sum() >= LEAST_SHARE * mask.sum() else mask
    if kind < 0.8:
        return maximum_filter(mask, size=int(rng.choice([3, 5])))
    side = int(rng.integers(3, 7))
    blurred = gaussian_filter(mask.astype(np.float32), side / 2)
    coarse = blurred[side // 2 :: side, side // 2 :: side] > 0.5
    steps = [
        np.minimum(np.arange(n) // side, m - 1)
        for n, m in zip(mask.shape, coarse.shape, strict=True)
    ]
    polygons = gaussian_filter(coarse[np.ix_(*steps)].astype(np.float32), side / 2) > 0.5
    return polygons if (polygons & mask).sum() >= LEAST_SHARE * mask.sum() else mask


def draw_background(rng: np.random.Generator, image: np.ndarray) -> np.ndarray:
    """Return a blurred random background (H, W, 3) as bright as the picture, within two stops."""
    height, width = image.shape[:2]
    coarse = np.exp(rng.normal(0, 0.5, (4, 4, 1)) + rng.normal(0, 0.3, 3))
    rows, columns = (np.arange(n) * 4 // n for n in (height, width))
    level = max(float(image.mean()), 1e-6) * 2 ** rng.uniform(-2, 2)
    return gaussian_filter(coarse[np.ix_(rows, columns)], (height / 10, width / 10, 0)) * level


def _plane(rng: np.random.Generator, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates of each pixel about a random pixel of the object, in a turned frame.

    A length of 1 is the square root of the object's area.
    """
    rows, columns = np.nonzero(mask)
    centre = int(rng.integers(len(rows)))
    angle, unit = rng.uniform(0, 2 * np.pi), np.sqrt(len(rows))
    y = (np.arange(mask.shape[0])[:, None] - rows[centre]) / unit
    x = (np.arange(mask.shape[1])[None] - columns[centre]) / unit
    return x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)


def _ellipse(rng: np.random.Generator, mask: np.ndarray, half_axes: np.ndarray) -> np.ndarray:
    u, v = _plane(rng, mask)
    return (u / half_axes[0]) ** 2 + (v / half_axes[1]) ** 2 < 1


def _occluder(rng: np.random.Generator, mask: np.ndarray) -> np.ndarray:
    """Return where a half-plane, an ellipse or a bar hides the object."""
    kind = rng.integers(3)
    if kind == 0:
        return _plane(rng, mask)[0] > 0
    if kind == 1:
        return _ellipse(rng, mask, rng.uniform(0.15, 0.5, 2))
    return np.abs(_plane(rng, mask)[0]) < rng.uniform(0.03, 0.2)
