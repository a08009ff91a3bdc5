"""The loops of learn.data.shadows, compiled by numba.

H, W picture; camera frame as in shaders.frames; lengths in radii of the sphere that the object
fills. Directions about a pixel are those of its ray frame, whose view is +z, cut into cells: A
half-planes about the view of S sectors each.

n, position, view, segments, radiance  (H, W, …) as of learn.data.shadows.factor
diffuse, power      (L, 3) what each of L labels reflects diffusely, in 1/sr; (L,) integers j, for
                    a highlight (r·w)^(2^j) about the mirror direction r
energy              (A, S, 3) radiance times solid angle of the light in each cell
w, solid_angle      (A, S, 3) directions of the cells, and (S,) their sizes in sr
offsets             (A, steps, 2) rows and columns from a pixel to those that may block it

They are in one file, with their constants, because numba compiles a cached kernel again only when
the file that defines it has changed. numba derives the types; learn.data.shadows imports this
module when a factor is first needed, so that numba is.

Source: visibility bitmasks, Therrien, Levesque and Gilet, "Screen Space Indirect Lighting with
Visibility Bitmask" (2023).
"""

import math
from typing import Any

import numpy as np
from numba import njit

THICKNESS = 0.3  # radii
LEAST_SLOPE = 0.02  # sine of the angle above the tangent plane below which nothing blocks
LARGEST_FACTOR = 4.0  # a dark side beside a bright one
# rows of a pixel's sums (4, 3): irradiance, and light times highlight; each also as it arrives
IRRADIANCE, ARRIVING, HIGHLIGHT, MIRRORED = range(4)

# steps become part of `fill` before it is compiled: compiled by themselves and inlined by LLVM they
# take up to half as long again
_merged: Any = njit(inline="always")
_compiled: Any = njit(nogil=True, cache=True)


@_merged
def _seen_from(position, vx, vy, vz, row, column, i, j):
    """Return where pixel (i, j) lies from pixel (row, column), in the latter's ray frame.

    The smallest rotation that takes its view (vx, vy, vz) to +z turns the difference (Rodrigues).
    """
    dx = position[i, j, 0] - position[row, column, 0]
    dy = position[i, j, 1] - position[row, column, 1]
    dz = position[i, j, 2] - position[row, column, 2]
    towards = dx * vx + dy * vy + dz * vz
    part = (towards + dz) / (1 + vz)
    return dx - part * vx, dy - part * vy, towards


@_merged
def _block_sectors(dx, dy, towards, length, cosines, number, blocker, k):
    """Set the free sectors of half-plane k that a pixel's surface blocks to its number.

    dx, dy, towards  where the surface's front lies in the ray frame, at distance `length`; its back
                     is THICKNESS farther from the viewer
    cosines          (S,) of the sectors' centres; one is blocked that lies between front and back
    Returns          whether any was free
    """
    back = towards - THICKNESS
    beside = dx * dx + dy * dy
    at_back = math.sqrt(beside + back * back)
    blocked = False
    for s in range(len(cosines)):
        if towards < cosines[s] * length:
            continue
        if back > cosines[s] * at_back:
            break
        if blocker[k, s] < 0:
            blocker[k, s] = number
            blocked = True
    return blocked


@_merged
def _find_blockers(n, position, view, segments, cosines, offsets, row, column, blocker):
    """Set blocker (A, S) to the number of the pixel that blocks each cell of a pixel, or to −1.

    A pixel's number is row · W + column. What lies below the pixel's tangent plane, or less than
    LEAST_SLOPE above it, blocks nothing; of several that block a cell it is the nearest.

    Returns  whether any cell is blocked
    """
    height, width = segments.shape
    nx, ny, nz = n[row, column]
    vx, vy, vz = view[row, column]
    blocker[:] = -1
    blocked = False
    for k in range(offsets.shape[0]):
        for step in range(offsets.shape[1]):
            i = row + offsets[k, step, 0]
            j = column + offsets[k, step, 1]
            if i < 0 or j < 0 or i >= height or j >= width:
                break
            if segments[i, j] == 0:
                continue
            dx, dy, towards = _seen_from(position, vx, vy, vz, row, column, i, j)
            square = dx * dx + dy * dy + towards * towards
            length = math.sqrt(square)
            if dx * nx + dy * ny + towards * nz <= LEAST_SLOPE * length:
                continue
            if _block_sectors(dx, dy, towards, length, cosines, i * width + j, blocker, k):
                blocked = True
    return blocked


@_merged
def _add_cells(normal, power, radiance, energy, w, solid_angle, blocker, sums):
    """Set sums (4, 3) to what reaches a pixel from its cells, with blocking and without.

        irradiance Σ max(0, n·w) E   arriving Σ max(0, n·w) E'   highlight, mirrored: by (r·w)^(2^j)

    E is a cell's energy, E' what arrives from it: E where it is free, the blocking pixel's radiance
    times the cell's solid angle where not. r is the mirror direction of the viewer at (0, 0, 1).

    normal  (3,), and power j of the pixel's label
    """
    width = radiance.shape[1]
    nx, ny, nz = normal
    rx, ry, rz = 2 * nz * nx, 2 * nz * ny, 2 * nz * nz - 1
    sums[:] = 0
    for k in range(w.shape[0]):
        for s in range(w.shape[1]):
            cosine = nx * w[k, s, 0] + ny * w[k, s, 1] + nz * w[k, s, 2]
            if cosine <= 0:
                continue
            gloss = rx * w[k, s, 0] + ry * w[k, s, 1] + rz * w[k, s, 2]
            gloss = max(gloss, np.float32(0.0))
            for _ in range(power):
                gloss = gloss * gloss
            by = blocker[k, s]
            for c in range(3):
                light = energy[k, s, c]
                there = light
                if by >= 0:
                    there = solid_angle[s] * radiance[by // width, by % width, c]
                sums[IRRADIANCE, c] += cosine * light
                sums[ARRIVING, c] += cosine * there
                sums[HIGHLIGHT, c] += gloss * light
                sums[MIRRORED, c] += gloss * there


@_merged
def _set_factor(radiance, diffuse, sums, out):
    """Set out (3,) to a pixel's factor, channels that reflect nothing excepted.

    Of the radiance the diffuse part, `diffuse` times irradiance, is multiplied by arriving over
    irradiance, and the rest by mirrored over highlight.
    """
    for c in range(3):
        whole, irradiance, highlight = radiance[c], sums[IRRADIANCE, c], sums[HIGHLIGHT, c]
        if whole <= 0 or irradiance <= 0:
            continue
        matte = min(diffuse[c] * irradiance, whole)
        share = sums[MIRRORED, c] / highlight if highlight > 0 else 1.0
        value = (matte * sums[ARRIVING, c] / irradiance + (whole - matte) * share) / whole
        out[c] = min(value, LARGEST_FACTOR)


@_compiled
def fill(
    n, position, view, segments, radiance, diffuse, power, energy, w, solid_angle, offsets, out
):
    """Set out (H, W, 3) to the factor of each pixel of the mask that others block."""
    height, width = segments.shape
    blocker = np.empty(w.shape[:2], np.int64)
    sums = np.empty((4, 3), np.float32)
    cosines = w[0, :, 2]
    for row in range(height):
        for column in range(width):
            if segments[row, column] == 0:
                continue
            if not _find_blockers(
                n, position, view, segments, cosines, offsets, row, column, blocker
            ):
                continue
            label = segments[row, column] - 1
            _add_cells(
                n[row, column], power[label], radiance, energy, w, solid_angle, blocker, sums
            )
            _set_factor(radiance[row, column], diffuse[label], sums, out[row, column])
