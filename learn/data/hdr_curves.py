"""Converts pictures in the curves of HDR screens, PQ and HLG (ITU-R BT.2100), to sRGB.

Some phones and cameras store HEIC so. A file names its curve and its primary colours by numbers of
ITU-T H.273: HEIC, AVIF and PNG in the header (learn.data.cicp), other files in the tag
`cicp` of their profile (ICC.1:2022).

White of sRGB is the white of paper in HDR pictures, 203 cd/m² (ITU-R BT.2408). What is brighter,
such as highlights and lamps, is clipped, as in a photograph that a camera exposes for its subject.
"""

import struct

import numpy as np
from PIL import Image

from shaders import tone

PQ, HLG = 16, 18  # H.273's numbers of the curves
BT709, BT2020, P3 = 1, 9, 12  # and of primary colours
WHITE, PEAK = 203.0, 1000.0  # cd/m²: of paper, and of the screen on which HLG is shown
# linear sRGB from linear BT.2020, by the primary colours of ITU-R BT.2087
SRGB_FROM_2020 = np.array(
    [
        [1.660491, -0.587641, -0.072850],
        [-0.124550, 1.132900, -0.008349],
        [-0.018151, -0.100579, 1.118730],
    ]
)
# linear sRGB from linear Display P3: from the primary colours of SMPTE EG 432-1 and ITU-R BT.709,
# both with D65 as their white
SRGB_FROM_P3 = np.array(
    [
        [1.2249402, -0.2249402, 0.0],
        [-0.0420569, 1.0420569, 0.0],
        [-0.0196376, -0.0786361, 1.0982735],
    ]
)
# {primary colours: matrix}; all others count as those of BT.2020, in which both curves are defined
SRGB_FROM = {BT709: np.eye(3), P3: SRGB_FROM_P3}
# of BT.2100's functions
M1, M2, C1, C2, C3 = 2610 / 16384, 2523 / 32, 3424 / 4096, 2413 / 128, 2392 / 128
A, B, C = 0.17883277, 0.28466892, 0.55991073
GAMMA = 1.2  # of the whole system of HLG on a screen of PEAK


def pq_light(signal: np.ndarray) -> np.ndarray:
    """Return light, 1 at WHITE, of PQ's signal in [0, 1]: BT.2100's EOTF."""
    root = signal ** (1 / M2)
    return 10_000 / WHITE * (np.maximum(root - C1, 0) / (C2 - C3 * root)) ** (1 / M1)


def hlg_scene(signal: np.ndarray) -> np.ndarray:
    """Return scene light in [0, 1] of HLG's signal in [0, 1]: BT.2100's inverse OETF."""
    return np.where(signal <= 0.5, signal**2 / 3, (np.exp((signal - C) / A) + B) / 12)


def curve_of(picture: Image.Image) -> tuple[int, int] | None:
    """Return (primary colours, curve) of a picture in PQ or HLG, by H.273; None for others."""
    named, profile = (picture.info.get(key) for key in ("nclx_profile", "icc_profile"))
    numbers = []
    if isinstance(named, dict):
        numbers.append((named.get("color_primaries"), named.get("transfer_characteristics")))
    if isinstance(profile, bytes):
        numbers.append(_cicp(profile))
    for primaries, curve in numbers:
        if curve in (PQ, HLG) and picture.mode in ("RGB", "RGBA"):
            return int(primaries or BT2020), int(curve)
    return None


def _cicp(profile):
    """The first two numbers of a profile's tag cicp; two times None without it."""
    try:
        (count,) = struct.unpack_from(">I", profile, 128)
        for number in range(min(count, 100)):
            name, place, size = struct.unpack_from(">4sII", profile, 132 + 12 * number)
            if name == b"cicp" and size >= 12:
                return profile[place + 8], profile[place + 9]
    except (struct.error, IndexError):
        pass
    return None, None


def to_srgb(picture: Image.Image, primaries: int, curve: int) -> Image.Image:
    """Return a Pillow image, RGB or RGBA, in sRGB from one in PQ or HLG."""
    signal = np.arange(256) / 255
    table = (pq_light(signal) if curve == PQ else hlg_scene(signal)).astype(np.float32)
    matrix = SRGB_FROM.get(primaries, SRGB_FROM_2020)
    # luminance of sRGB, which is that of the same colour in other primary colours
    weights = tone.LUMINANCE @ matrix
    values = np.array(picture)
    for rows in np.array_split(values, max(1, len(values) // 64)):  # views
        light = table[rows[..., :3]]
        if curve == HLG:
            luminance = np.maximum(light @ weights, 0)[..., None]
            light = PEAK / WHITE * luminance ** (GAMMA - 1) * light
        rows[..., :3] = np.rint(255 * tone.srgb(np.clip(light @ matrix.T, 0, 1)))
    return Image.fromarray(values)
