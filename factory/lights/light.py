"""One light: an environment map in our convention, at its own size and at the layer's 64×128.

pixels  (height, width, 3) linear Rec.709 radiance as a file stores them: row 0 at the zenith, the
        picture's centre column where Blender and most programs look for world +x
        (u = ½ − atan2(y, x) / 2π, at rotation 0)
L       the same in the light frame of a camera at azimuth 0 (shaders.envmap): u_file = u + ¼, so
        our column j is the file's column j + width/4. A file whose width is no multiple of 4 is
        first averaged by solid angle to the next one that is.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from manifests.arrays import LIGHT_SHAPE
from manifests.errors import InputError
from shaders import envmap, tone

LAYER_SIZE = LIGHT_SHAPE[:2]  # the paper's map
# negative radiance up to this share of the mean is lossy compression's ripple, set to 0; Blender's
# night map has 1.0 %
RIPPLE = 0.05
# mean luminance: beyond, float32 radiance divided by it loses digits, or is infinite
DARKEST, BRIGHTEST = 1e-30, 1e30
# rows of a map up to which one of odd width is averaged in float64 throughout; 4096 of them would
# take 0.8 GB
PRECISE = 1024


@dataclass(frozen=True)
class Light:
    """A light ready for both renderers.

    L64      (64, 128, 3) float32, solid-angle mean luminance 1, light frame at azimuth 0: what the
             layer sees
    L_full   (H, W, 3) float32, the same light at its own size, divided by the same scale; W is a
             multiple of 4
    scale    the file's mean luminance: file = L × scale
    hash     SHA-256 (hex) of the file's bytes, or of a computed light's name and version
    licence, source  as credits need them
    """

    name: str
    L64: np.ndarray
    L_full: np.ndarray
    scale: float
    hash: str
    licence: str
    source: str


def from_pixels(
    pixels: np.ndarray, name: str, digest: str, licence: str, source: str, in_place: bool = False
) -> Light:
    """Return the Light of a map as a file stores it: (H, W, 3) of any scale, checked here.

    in_place  True: `pixels`, float32 and writable, become the light's own L_full: no second map of
              that size is made
    Raises    InputError
    """
    pixels = np.asarray(pixels, np.float32) if in_place else np.array(pixels, np.float32)
    check_map(pixels, source)
    np.maximum(pixels, 0.0, out=pixels)
    height, width = pixels.shape[:2]
    if width % 4:
        width += 4 - width % 4
        pixels = envmap.resize(
            pixels, height, width, np.float64 if height <= PRECISE else np.float32
        )
    for rows in envmap.bands(height):
        pixels[rows] = envmap.from_file_columns(pixels[rows])
    scale = float(envmap.mean_radiance(pixels) @ tone.LUMINANCE)
    pixels /= scale
    pixels = pixels.astype(np.float32, copy=False)
    L64 = envmap.resize(pixels, *LAYER_SIZE, np.float32)
    return Light(name, L64, pixels, scale, digest, licence, source)


def check_map(pixels: np.ndarray, where: str | Path) -> np.ndarray:
    """Return the map (H, W, 3) itself if its values are those of a light.

    Raises  InputError for values that are not finite, black, negative, or an 8-bit picture's
    """
    rows = [pixels[band] for band in envmap.bands(len(pixels))]
    broken = sum(int((~np.isfinite(each)).any(-1).sum()) for each in rows)
    if broken:
        raise InputError(
            where,
            "finite radiance",
            f"NaN or infinity in {broken} texels",
            "paint them out or export the map again",
        )
    mean = float(envmap.mean_radiance(pixels) @ tone.LUMINANCE)
    lowest, highest = float(pixels.min()), float(pixels.max())
    if lowest == highest == 0:
        raise InputError(
            where, "a map that holds some light", "black everywhere", "choose another map"
        )
    if lowest < -RIPPLE * mean or mean <= 0:
        count = sum(int((each < 0).any(-1).sum()) for each in rows)
        result = f"{count} negative texels, the lowest {lowest:.3g} beside a mean of {mean:.3g}"
        raise InputError(
            where, "radiance of 0 or more", result, "clamp the map at 0 and save it again"
        )
    if not DARKEST < mean < BRIGHTEST:
        raise InputError(
            where,
            f"a mean radiance from {DARKEST:g} to {BRIGHTEST:g}",
            f"{mean:.3g}",
            "scale the map and save it again",
        )
    if looks_like_eight_bits(pixels):
        result = "at most 256 levels per channel and none above 1, as in an 8-bit picture"
        raise InputError(
            where,
            "high-dynamic-range radiance",
            result,
            "use the original .hdr or .exr, not a picture converted from PNG or JPG",
        )
    return pixels


def looks_like_eight_bits(pixels: np.ndarray) -> bool:
    """Return whether a map has the levels of an 8-bit picture.

    Such a map has 17 to 256 levels per channel, none above 1; one with fewer is a drawn test map.
    """
    if pixels.size < 3 * 4096 or pixels.max() > 1.0:
        return False
    levels = [np.zeros(0, np.float32)] * 3
    for rows in envmap.bands(len(pixels)):
        levels = [np.union1d(known, pixels[rows, :, k]) for k, known in enumerate(levels)]
        if max(len(known) for known in levels) > 256:
            return False
    return max(len(known) for known in levels) > 16
