"""Environment maps: texel directions, solid angles, rotation, and resampling that conserves energy.

L      (height, width, 3) linear Rec.709 radiance; row 0 at the zenith, columns around the vertical
w      unit directions, light frame (x right, y up, z towards the viewer; shaders.frames)
θ      polar angle from the zenith, π (row + ½) / height
φ      2π (column + ½) / width, from +x (right) through +z (towards the viewer)

Source: supplement, "Illumination". Deviates: φ spans 2π, texel centres, exact solid angles
(tests/test_misprints.py).
"""

import numpy as np
from numpy.typing import DTypeLike

from shaders.arrays import Array, namespace
from shaders.tone import LUMINANCE

BAND = 64  # rows of a map that are looked at together: 12 MB in float64 of a map of 8192 × 4096
WHOLE = 1024  # rows up to which a map is copied to float64 whole
DENSE = 4096  # columns and rows up to which a table of all pairs is made: 134 MB
SAME_SOURCE = (
    # likeness of copies of one capture, resized, re-encoded or turned, exceeds 0.9999; of 26
    # different ones it stays below 0.9
    0.99
)


def directions(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Return unit directions and solid angles of an environment map's texels.

    Returns  w (height, width, 3), light frame; solid_angle (height, width) in sr, sums to 4π
    """
    row, column = np.indices((height, width), sparse=True)
    w = centres(row, column, height, width)
    return w, np.repeat(row_solid_angles(height, width)[:, None], width, axis=1)


def centres(row: np.ndarray, column: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return unit directions (..., 3), light frame, of the centres of some texels of a map.

    row, column  of each, which broadcast to (...)
    """
    theta, phi = np.pi * (row + 0.5) / height, 2 * np.pi * (column + 0.5) / width
    x, z = np.cos(phi) * np.sin(theta), np.sin(phi) * np.sin(theta)
    return np.stack([x, np.broadcast_to(np.cos(theta), x.shape), z], -1)


def row_solid_angles(height: int, width: int) -> np.ndarray:
    """Return the solid angle (height,) in sr of one texel of each row.

    It is (2π/W)(cos θ_top − cos θ_bottom).
    """
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    return (edges[:-1] - edges[1:]) * (2 * np.pi / width)


def texel(w: np.ndarray, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Return row and column of the texel that holds each direction w (..., 3), light frame."""
    theta = np.arctan2(np.hypot(w[..., 0], w[..., 2]), w[..., 1])
    phi = np.arctan2(w[..., 2], w[..., 0])
    row = np.clip(np.floor(theta / np.pi * height), 0, height - 1).astype(int)
    column = np.floor(phi / (2 * np.pi) * width).astype(int) % width
    return row, column


def roll(L: Array, texels: int) -> Array:
    """Return the map L (..., height, width, 3) rotated by whole texels about the vertical.

    Column j of the result is column j − texels of L.
    """
    xp = namespace(L)
    return xp.roll(L, texels, -2) if xp is not np else np.roll(L, texels, axis=-2)


def rotated(L: np.ndarray, rotation: np.ndarray, samples: int = 2) -> np.ndarray:
    """Return the map L (height, width, 3) as it is seen after a rotation (3, 3) of the light.

    The result's radiance from w is L's from rotationᵀ w: the mean of samples × samples points of
    each texel, each interpolated between the four nearest texel centres. Whole texels about the
    vertical are turned exactly by `roll`.
    """
    height, width = L.shape[:2]
    w, _ = directions(height * samples, width * samples)
    source = w @ rotation  # rows are rotationᵀ w
    row = np.arctan2(np.hypot(source[..., 0], source[..., 2]), source[..., 1]) / np.pi * height
    column = np.arctan2(source[..., 2], source[..., 0]) / (2 * np.pi) * width
    half = width // 2
    # beyond a pole lies the row next to it, half a circle away
    padded = np.concatenate([np.roll(L[:1], half, 1), L, np.roll(L[-1:], half, 1)])
    row, column = row + 0.5, column - 0.5
    top, left = np.floor(row).astype(int).clip(0, height), np.floor(column).astype(int)
    down, right = (row - top)[..., None], (column - left)[..., None]
    values = sum(
        (down if i else 1 - down)
        * (right if j else 1 - right)
        * padded[top + i, (left + j) % width]
        for i in (0, 1)
        for j in (0, 1)
    )
    fine = np.asarray(values).reshape(height, samples, width, samples, -1)
    return fine.mean((1, 3)).astype(L.dtype)


def from_file_columns(L: Array) -> Array:
    """Return a map (..., height, width, 3) with a file's columns as the light frame has them.

    A file's centre column lies towards Blender's world +x at rotation 0. The width must be a
    multiple of 4.
    """
    return roll(L, -(L.shape[-2] // 4))


def mean_radiance(L: np.ndarray) -> np.ndarray:
    """Return the mean (3,) of L (height, width, 3) over solid angle, in the memory of BAND rows."""
    weight = row_solid_angles(*L.shape[:2])[:, None, None] / (4 * np.pi)
    total = np.zeros(L.shape[2:])
    for rows in bands(L.shape[0]):
        part = (np.asarray(L[rows], dtype=np.float64) * weight[rows]).reshape(-1, *L.shape[2:])
        # numpy adds row after row: the same sum, bit by bit, as that of the whole map at once
        part[:1] += total
        total = part.sum(0)
    return total


def bands(height: int) -> list[slice]:
    """Return slices of BAND rows that cover a map, for work on large maps without a copy."""
    return [slice(first, min(first + BAND, height)) for first in range(0, height, BAND)]


def unit_mean(L: np.ndarray) -> tuple[np.ndarray, float]:
    """Return L scaled to a solid-angle mean luminance of 1, and the scale: L = scaled × scale.

    Raises  ValueError if L has no positive mean luminance
    """
    scale = float(mean_radiance(L) @ LUMINANCE)
    if not (np.isfinite(scale) and scale > 0):
        raise ValueError(
            f"light: expected positive finite mean luminance, found {scale:g} (check the file's"
            " pixels)"
        )
    return np.asarray(L / scale, dtype=np.float32), scale


def _overlaps(edges_from, edges_to):
    """Return (to, from): the length of each source interval's overlap with each target interval."""
    low = np.maximum(edges_to[:-1, None], edges_from[None, :-1])
    high = np.minimum(edges_to[1:, None], edges_from[None, 1:])
    return np.maximum(high - low, 0.0)


def resize(L: np.ndarray, height: int, width: int, dtype: DTypeLike = np.float64) -> np.ndarray:
    """Return the map resampled to another size by averages over solid angle.

    The energy in each region of the sphere is conserved, in both directions of scale.

    L        (any height, any width, 3)
    dtype    of the result; sums are float64
    Returns  (height, width, 3)

    Besides the result it takes memory for a float64 copy of at most WHOLE rows and, where the
    height changes, for a float64 map of L's height and the result's width.
    """
    polar = [-np.cos(np.pi * np.linspace(0, 1, count + 1)) for count in (L.shape[0], height)]
    around = [np.linspace(0, 1, count + 1) for count in (L.shape[1], width)]
    if L.shape[0] <= WHOLE and max(L.shape[1], width) <= DENSE:
        rows, columns = _shares(*polar), _shares(*around)
        return np.einsum(
            "ri,ijc,kj->rkc", rows, np.asarray(L, dtype=np.float64), columns, optimize=True
        ).astype(dtype, copy=False)
    narrow = np.empty(
        (L.shape[0], width, *L.shape[2:]), dtype if height == L.shape[0] else np.float64
    )
    columns = _shares(*around) if L.shape[1] * width <= DENSE**2 else None
    for band in bands(L.shape[0]):
        part = np.asarray(L[band], dtype=np.float64)
        narrow[band] = (
            _sparsely(part, *around)
            if columns is None
            else np.einsum("ijc,kj->ikc", part, columns, optimize=True)
        )
    if height == L.shape[0]:
        return narrow
    if L.shape[0] * height <= DENSE**2:
        return np.einsum("ri,ikc->rkc", _shares(*polar), narrow, optimize=True).astype(
            dtype, copy=False
        )
    return _sparsely(narrow.swapaxes(0, 1), *polar).swapaxes(0, 1).astype(dtype, copy=False)


def _shares(edges_from, edges_to):
    """Return (to, from): each source interval's share of each target interval; rows sum to 1."""
    shares = _overlaps(edges_from, edges_to)
    return shares / shares.sum(1, keepdims=True)


def _sparsely(L, edges_from, edges_to):
    """Return means of L (any, from, 3) over target intervals: (any, to, 3).

    This form serves numbers of intervals for which the table of `_shares` would fill the memory.
    """
    first = np.searchsorted(edges_from, edges_to[:-1], side="right") - 1
    last = np.searchsorted(edges_from, edges_to[1:], side="left") - 1
    total, weight = np.zeros((L.shape[0], len(first), *L.shape[2:])), np.zeros(len(first))
    for step in range(int((last - first).max()) + 1):
        source = np.minimum(first + step, len(edges_from) - 2)
        low, high = (
            np.maximum(edges_to[:-1], edges_from[source]),
            np.minimum(edges_to[1:], edges_from[source + 1]),
        )
        share = np.where(first + step <= last, np.maximum(high - low, 0.0), 0.0)
        total += L[:, source] * share[:, None]
        weight += share
    return total / weight[:, None]


def is_same_source(L: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two maps of one size show the same place, however scaled or rotated.

    Such a copy must not train where the other map tests.
    """
    return likeness(L, other) > SAME_SOURCE


def likeness(L: np.ndarray, other: np.ndarray) -> float:
    """Return the highest correlation of two maps' log radiance over all rotations by whole texels.

    L, other  (height, width, 3) of one size, any scale
    """
    return float(highest_correlations(log_spectrum(other)[None], log_spectrum(L), L.shape[1])[0])


def log_spectrum(L: np.ndarray) -> np.ndarray:
    """Return the Fourier series (height, width/2 + 1) along rows of a map's log radiance.

    The log radiance is that of unit mean, averaged over channels, less its mean, of unit length; 0
    for a constant map, which is like no other.
    """
    log = np.log1p(np.asarray(unit_mean(L)[0], np.float64).mean(axis=-1))
    log = log - log.mean()
    return np.fft.rfft(log / max(np.linalg.norm(log), 1e-12), axis=1)


def highest_correlations(spectra: np.ndarray, spectrum: np.ndarray, width: int) -> np.ndarray:
    """Return the highest correlations (N,) of N maps with one over rotations by whole texels.

    spectra   (N, height, width/2 + 1) of `log_spectrum`
    spectrum  (height, width/2 + 1) of one map, which is `width` texels wide
    """
    products = np.einsum("nrf,rf->nf", spectra, np.conj(spectrum))
    return np.fft.irfft(products, n=width, axis=1).max(axis=1)
