"""Rendered pictures as a camera takes them: with their surroundings behind them, exposed for both.

A data set's pictures show the object alone, in the scale of a light of unit mean. A photograph
shows what is behind it too, and its exposure follows from both, by centre-weighted metering. Here
the light map of the picture is what lies behind, as far away as the light itself.

Most cameras also balance white: they estimate the light's colour from the frame and remove it.
Here the estimate is the sixth root of the mean of the frame's sixth powers ("Shades of Grey and
Colour Constancy", Finlayson and Trezzi, CIC 2004, tested on photographs with known lights).
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from shaders import envmap, tone
from shaders.frames import camera_from_light, pixel_grid
from shaders.tone import LUMINANCE

FIELD_OF_VIEW = np.radians(40.0)  # of the frame
FRAME = 1.5  # sides of the object's picture along a side of the frame
# Weighted mean luminance of a frame, where white is 1: meters assume a grey of about a fifth, and
# the photographs of docs/results/photographs have about that
METERED = 0.2
# The object fills the frame to two thirds, and centre-weighted meters see little beyond that:
# standard deviation of the weight about the middle, in halves of the frame's side
CENTRE = 0.4
# standard deviation in stops of exposures about the metered one: our choice
SPREAD = 0.5
# White balance. The limits keep the colours of frames that are full of one strongly coloured
# surface; lamps and skies are reddish or bluish, but hardly green or magenta. Our choice.
NORM = 6  # power of the mean by which the light's colour is estimated
MOST_RED_BLUE = 2.0  # stops by which the ratio of red to blue is changed at most
MOST_GREEN = 0.3  # stops of green that are removed at most


@dataclass(frozen=True)
class Photographed:
    """A photograph of an object.

    pixels    (N, N, 3) uint8, sRGB
    mask      (N, N) bool
    exposure  factor from radiance under light of unit mean to that of the photograph
    balance   (3,) float32 factors by which the camera multiplied colours
    """

    pixels: np.ndarray
    mask: np.ndarray
    exposure: float
    balance: np.ndarray

    def of(self, radiance: np.ndarray) -> np.ndarray:
        """Return radiance (..., 3) as this camera takes it, where white is 1 and is not clipped."""
        return radiance * (self.balance * np.float32(self.exposure))


def photographed(
    radiance: np.ndarray, mask: np.ndarray, light: np.ndarray, elevation: float, name: str
) -> Photographed:
    """Return the photograph of an object that was rendered alone.

    radiance   (H, H, 3) of the object, under light of unit mean
    mask       (H, H) bool
    light      (64, 128, 3), light frame
    elevation  of the camera, radians
    name       by which the exposure's distance from the metered one is drawn
    """
    behind = surroundings(light, round(FRAME * len(mask)), elevation)
    frame, covered = placed(radiance, behind), placed(mask, np.zeros(behind.shape[:2], bool))
    return exposed(np.where(covered[..., None], frame, behind), covered, name)


def exposed(frame: np.ndarray, mask: np.ndarray, name: str, balances: bool = False) -> Photographed:
    """Return the photograph of a whole frame.

    frame     (N, N, 3) radiance under light of unit mean
    mask      (N, N) bool, the object
    name      by which the exposure's distance from the metered one is drawn
    balances  whether the camera balances white
    """
    drawn = np.random.default_rng(zlib.crc32(name.encode())).normal(0.0, SPREAD)
    exposure = float(metered(frame @ LUMINANCE) * 2**drawn)
    balance = white_balance(frame * exposure) if balances else np.ones(3, np.float32)
    pixels = np.rint(tone.display(frame * balance, exposure)).astype(np.uint8)
    return Photographed(pixels, mask, exposure, balance)


def white_balance(frame: np.ndarray) -> np.ndarray:
    """Return factors (3,) float32 that remove the colour of a frame's light.

    The light keeps its luminance. Pixels that clip have lost their colour and are not counted. The
    factors are 1 if there are no other pixels, or if a channel is 0 in all of them.

    frame  (N, N, 3) radiance, where white is 1
    """
    kept = frame[(frame < 1).all(-1)].astype(np.float64)
    if not len(kept) or not (kept.max(0) > 0).all():
        return np.ones(3, np.float32)
    light = (kept**NORM).mean(0) ** (1 / NORM)
    red, green, blue = np.log2(light)
    half = np.clip(red - blue, -MOST_RED_BLUE, MOST_RED_BLUE) / 2
    greener = np.clip(green - (red + blue) / 2, -MOST_GREEN, MOST_GREEN)
    factors = 2.0 ** -np.array([half, greener, -half])
    factors *= (light @ LUMINANCE) / (light * factors @ LUMINANCE)
    return factors.astype(np.float32)


def placed(picture: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Return a frame (N, N, …) with a picture (H, H, …) in its middle."""
    first = (len(frame) - len(picture)) // 2
    result = frame.copy()
    result[first : first + len(picture), first : first + len(picture)] = picture
    return result


def surroundings(light: np.ndarray, size: int, elevation: float) -> np.ndarray:
    """Return radiance (size, size, 3) of a light map as the camera sees it behind the object.

    light  (64, 128, 3), light frame
    """
    x, y = pixel_grid(size, size)
    across = np.tan(FIELD_OF_VIEW / 2)
    rays = np.stack([across * x, across * y, -np.ones_like(x)], -1) @ camera_from_light(elevation)
    return light[envmap.texel(rays, *light.shape[:2])]


def metered(luminance: np.ndarray) -> float:
    """Return the exposure under which a frame's mean luminance is METERED.

    The middle of the frame counts most, and what is brighter than white as white.

    luminance  (N, N)
    """
    x, y = pixel_grid(*luminance.shape)
    weight = np.exp(-(x**2 + y**2) / (2 * CENTRE**2))
    low, high = -30.0, 30.0  # stops; the mean grows with the exposure
    for _ in range(60):
        middle = (low + high) / 2
        bright = np.average(np.minimum(luminance * 2**middle, 1), weights=weight) > METERED
        low, high = (low, middle) if bright else (middle, high)
    return float(2**low)
