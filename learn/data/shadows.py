"""Soft self-shadowing and one bounce of light for pictures that the layer relights.

The layer's pictures have neither (transport tier "direct"). Here each pixel's picture is multiplied
by an RGB factor that is computed from stored depth, in screen space:

1. The sphere around a pixel's direction to the viewer is cut into AZIMUTHS half-planes of SECTORS
   sectors each. Pixels along each half-plane, at STEPS distances, block the sectors between their
   front and their back; depth shows no back, so that surfaces are taken to be THICKNESS deep.
2. The light's energy is summed over the same cells. A free cell brings its light, a blocked one the
   radiance that the picture has where it is blocked: that is the bounce.
3. The picture is split into a diffuse part, the label's value far from its highlight times
   irradiance, and the rest. The diffuse part is multiplied by irradiance with blocking over
   irradiance without, the rest by the same ratio about the mirror direction.

Pixels that lie below a pixel's tangent plane block nothing, so that a convex object has the factor
1 exactly. What no pixel shows blocks nothing.

H, W picture; camera frame as in shaders.frames; lengths in radii of the sphere that the object
fills.

Source: visibility bitmasks, Therrien, Levesque and Gilet, "Screen Space Indirect Lighting with
Visibility Bitmask" (2023).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from manifests.schema import Camera
from shaders.dsbrdf import MAX_EXPONENT, SHAPE, coefficients, evaluate, lobe_sharpness
from shaders.envmap import directions
from shaders.frames import camera_from_light, pixel_grid, view_vectors

AZIMUTHS = 12  # half-planes around the direction to the viewer
SECTORS = 12  # of a half-plane, 15° each, from the viewer to behind the object
STEPS = (1, 2, 3, 4, 6, 8, 11, 15, 20, 27, 36, 48)  # pixels of 128; scaled for other sizes
THICKNESS = 0.3  # radii
LEAST_SLOPE = 0.02  # sine of the angle above the tangent plane below which nothing blocks
LARGEST_FACTOR = 4.0  # a dark side beside a bright one
DIFFUSE_COSINE = 0.5  # h·n at which a label's value is taken for its diffuse part
THETA_D = math.radians(30.0)  # half the angle between light and view there
NARROWEST = 5  # the mirror lobe is (r·w)^(2^j), j at most 5: 24° wide, for cells are 15° apart


def positions(depth: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return each pixel's place in space and its direction to the viewer.

    depth    (H, W) behind the plane through the object's centre (manifests.arrays), of a picture
             by `camera`, at its size or every n-th pixel of it
    Returns  position (H, W, 3), view (H, W, 3) unit vectors; both float32, camera frame
    """
    height, width = depth.shape
    x, y = (axis * camera.half_extent for axis in pixel_grid(height, width))
    fov = None if camera.fov_deg is None else math.radians(camera.fov_deg)
    spread = 1.0 if fov is None else 1 + depth * math.tan(fov / 2) / camera.half_extent
    position = np.stack([x * spread, y * spread, -depth], -1).astype(np.float32)
    return position, view_vectors(height, width, fov=fov).astype(np.float32)


def shadow_factor(
    n: np.ndarray,
    position: np.ndarray,
    view: np.ndarray,
    segments: np.ndarray,
    radiance: np.ndarray,
    label: np.ndarray,
    L: np.ndarray,
    elevation: float,
) -> np.ndarray:
    """Return the factor (H, W, 3) float32 of each pixel; 1 in the background.

    n               (H, W, 3) unit normals in each pixel's ray frame: its view is +z
    position, view  as from `positions`
    segments        (H, W) 1 … S, 0 in the background
    radiance        (H, W, 3) the layer's picture
    label           (S, 108)
    L               (height, width, 3) radiance, light frame of a camera at `elevation` radians
    """
    w, solid_angle = _cells()
    diffuse, power = zip(*(describe_reflection(each) for each in label), strict=True)
    result = np.ones(n.shape, np.float32)
    _kernel()(
        *(np.ascontiguousarray(each, np.float32) for each in (n, position, view)),
        np.ascontiguousarray(segments, np.int64),
        np.ascontiguousarray(radiance, np.float32),
        np.array(diffuse, np.float32),
        np.array(power, np.int64),
        _energy(L, elevation),
        w,
        solid_angle,
        _offsets(max(n.shape[:2])),
        result,
    )
    return result


def describe_reflection(label: np.ndarray) -> tuple[np.ndarray, int]:
    """Return what a label (108,) reflects diffusely, and how wide its highlight is.

    Returns  f (3,) in 1/sr, the BRDF at 60° from its peak; j, where the highlight falls as the
             cosine to the mirror direction to the power 2^j
    """
    m, theta_d = np.exp(label.reshape(SHAPE).astype(np.float64)), np.array([THETA_D])
    diffuse = evaluate(m, np.array([DIFFUSE_COSINE]), theta_d)[0]
    kappa, gamma = (each[0] for each in coefficients(m, theta_d))
    sharpness = lobe_sharpness(kappa, gamma)
    # a lobe's energy goes as its height times its solid angle; wide ones count as diffuse
    energy = np.expm1(np.minimum(kappa, MAX_EXPONENT)) / (1 + sharpness) * (sharpness > 3)
    mean = (energy * np.log2(np.maximum(sharpness, 4) / 4)).sum() / max(energy.sum(), 1e-12)
    return diffuse.astype(np.float32), int(np.clip(round(float(mean)), 1, NARROWEST))


@functools.cache
def _cells() -> tuple[np.ndarray, np.ndarray]:
    """Return directions (AZIMUTHS, SECTORS, 3) and solid angles (SECTORS,) of cells."""
    phi = 2 * np.pi * np.arange(AZIMUTHS)[:, None] / AZIMUTHS
    theta = np.pi * (np.arange(SECTORS) + 0.5) / SECTORS
    w = np.stack(
        np.broadcast_arrays(
            np.cos(phi) * np.sin(theta), np.sin(phi) * np.sin(theta), np.cos(theta)
        ),
        -1,
    )
    edges = np.cos(np.pi * np.arange(SECTORS + 1) / SECTORS)
    solid_angle = (edges[:-1] - edges[1:]) * (2 * np.pi / AZIMUTHS)
    return w.astype(np.float32), solid_angle.astype(np.float32)


@functools.lru_cache(maxsize=8)
def _cell_of(height: int, width: int, elevation: float) -> np.ndarray:
    """Return the cell (height · width,) in which each texel of a map lies."""
    w = directions(height, width)[0].reshape(-1, 3) @ camera_from_light(elevation).T
    sector = np.arccos(np.clip(w[:, 2], -1, 1)) / np.pi * SECTORS
    azimuth = np.rint(np.arctan2(w[:, 1], w[:, 0]) / (2 * np.pi) * AZIMUTHS).astype(int) % AZIMUTHS
    return azimuth * SECTORS + np.minimum(sector.astype(int), SECTORS - 1)


def _energy(L: np.ndarray, elevation: float) -> np.ndarray:
    """Return radiance times solid angle of a map in each cell (AZIMUTHS, SECTORS, 3)."""
    solid_angle = directions(*L.shape[:2])[1]
    cell = _cell_of(L.shape[0], L.shape[1], elevation)
    sums = [
        np.bincount(cell, (L[..., k] * solid_angle).ravel(), AZIMUTHS * SECTORS) for k in range(3)
    ]
    return np.stack(sums, -1).reshape(AZIMUTHS, SECTORS, 3).astype(np.float32)


@functools.cache
def _offsets(side: int) -> np.ndarray:
    """Return rows and columns (AZIMUTHS, STEPS, 2) from a pixel to those that may block it."""
    phi = 2 * np.pi * np.arange(AZIMUTHS)[:, None] / AZIMUTHS
    distance = np.maximum(np.array(STEPS) * side / 128, np.arange(1, len(STEPS) + 1))
    return np.rint(np.stack([-np.sin(phi) * distance, np.cos(phi) * distance], -1)).astype(np.int64)


@functools.cache
def _kernel() -> Callable[..., None]:
    """Return `_write_factors` as machine code."""
    from numba import njit

    compiled: Any = njit(nogil=True, cache=True)(_write_factors)
    return compiled


def _write_factors(  # numba derives the types
    n,
    position,
    view,
    segments,
    radiance,
    diffuse,
    power,
    energy,
    w,
    solid_angle,
    offsets,
    out,
):
    """Write the factor of each pixel of the mask into `out`; arguments as of `factor`.

    1. blocker (AZIMUTHS, SECTORS) is the number, row · width + column, of the pixel that blocks
       each cell, or −1. What lies less than LEAST_SLOPE above the pixel's tangent plane blocks
       nothing; of several that block a cell it is the nearest.
    2. Over the cells, with E a cell's energy, and E' what arrives from it: E where it is free, the
       blocking pixel's radiance times the cell's solid angle where not,

           irradiance Σ max(0, n·w) E      arriving Σ max(0, n·w) E'
           highlight  Σ (r·w)^(2^j) E      mirrored Σ (r·w)^(2^j) E'

    3. In each channel the diffuse part of the radiance, `diffuse` times irradiance, is multiplied
       by arriving / irradiance, and the rest by mirrored / highlight.

    It is one function because numba makes it 3 to 58 % slower divided (docs/log/code.md).
    """
    height, width = segments.shape
    azimuths, sectors = w.shape[:2]
    blocker = np.empty((azimuths, sectors), np.int64)
    irradiance, arriving, highlight, mirrored = (
        np.empty(3, np.float32),
        np.empty(3, np.float32),
        np.empty(3, np.float32),
        np.empty(3, np.float32),
    )
    cosines = w[0, :, 2]
    for row in range(height):
        for column in range(width):
            if segments[row, column] == 0:
                continue
            # 1. the pixels that block cells
            nx, ny, nz = n[row, column]
            vx, vy, vz = view[row, column]
            blocker[:] = -1
            blocked = False
            for k in range(azimuths):
                for step in range(offsets.shape[1]):
                    i = row + offsets[k, step, 0]
                    j = column + offsets[k, step, 1]
                    if i < 0 or j < 0 or i >= height or j >= width:
                        break
                    if segments[i, j] == 0:
                        continue
                    dx = position[i, j, 0] - position[row, column, 0]
                    dy = position[i, j, 1] - position[row, column, 1]
                    dz = position[i, j, 2] - position[row, column, 2]
                    towards = dx * vx + dy * vy + dz * vz
                    # the smallest rotation that takes the view to +z (Rodrigues)
                    part = (towards + dz) / (1 + vz)
                    dx, dy = dx - part * vx, dy - part * vy
                    square = dx * dx + dy * dy + towards * towards
                    if dx * nx + dy * ny + towards * nz <= LEAST_SLOPE * math.sqrt(square):
                        continue
                    back = towards - THICKNESS
                    beside = dx * dx + dy * dy
                    at_back = math.sqrt(beside + back * back)
                    at_front = math.sqrt(square)
                    for s in range(sectors):
                        # a sector is blocked if its centre lies between front and back
                        if towards < cosines[s] * at_front:
                            continue
                        if back > cosines[s] * at_back:
                            break
                        if blocker[k, s] < 0:
                            blocker[k, s] = i * width + j
                            blocked = True
            if not blocked:
                continue
            # 2. what reaches the pixel from the cells
            at = segments[row, column] - 1
            # the mirror direction of the viewer, who is at (0, 0, 1)
            rx, ry, rz = 2 * nz * nx, 2 * nz * ny, 2 * nz * nz - 1
            irradiance[:] = 0
            arriving[:] = 0
            highlight[:] = 0
            mirrored[:] = 0
            for k in range(azimuths):
                for s in range(sectors):
                    cosine = nx * w[k, s, 0] + ny * w[k, s, 1] + nz * w[k, s, 2]
                    if cosine <= 0:
                        continue
                    gloss = rx * w[k, s, 0] + ry * w[k, s, 1] + rz * w[k, s, 2]
                    gloss = max(gloss, np.float32(0.0))
                    for _ in range(power[at]):
                        gloss = gloss * gloss
                    by = blocker[k, s]
                    for c in range(3):
                        light = energy[k, s, c]
                        there = light
                        if by >= 0:
                            there = solid_angle[s] * radiance[by // width, by % width, c]
                        irradiance[c] += cosine * light
                        arriving[c] += cosine * there
                        highlight[c] += gloss * light
                        mirrored[c] += gloss * there
            # 3. the factor
            for c in range(3):
                whole = radiance[row, column, c]
                if whole <= 0 or irradiance[c] <= 0:
                    continue
                matte = min(diffuse[at, c] * irradiance[c], whole)
                share = mirrored[c] / highlight[c] if highlight[c] > 0 else 1.0
                value = (matte * arriving[c] / irradiance[c] + (whole - matte) * share) / whole
                out[row, column, c] = min(value, LARGEST_FACTOR)
