"""The texels of the light map that a sample direction covers, and the mean light over them.

A sample's footprint is the square of its solid angle, at most a texel wide each way, so that it
lies in one texel, two or four: rows k − 1 and k beside border k, and columns likewise. The light of
a sample is the mean over its footprint, so that a sum over samples does not jump where one crosses
a texel's border, and few samples resolve the border's place (learn.methods.half_vectors.footprint).

rotation  (9,): camera_from_light, row by row
light     (height, width, 3): radiance
scratch   rows of sixteen samples from offset o on (learn.engines.layout): FOOTPRINT_ROW and
          FOOTPRINT_COLUMN hold the nearest border, FOOTPRINT_BELOW and FOOTPRINT_RIGHT the share of
          the footprint beyond it
"""

from typing import NamedTuple

import numpy as np

from learn.engines.compilation import inlined
from learn.engines.exponentials import angle
from learn.engines.layout import (
    FOOTPRINT_BELOW,
    FOOTPRINT_COLUMN,
    FOOTPRINT_LIGHT,
    FOOTPRINT_RIGHT,
    FOOTPRINT_ROW,
    LANES,
)
from learn.engines.vector import (
    Lanes,
    Vector,
    anywhere,
    fma,
    lane_max,
    maximum,
    minimum,
    select,
    sqrt,
    store,
)

TINY = 1e-30  # added to a square so that an angle is defined at the poles
PI = 3.141592653589793
ROUND = 12582912.0  # 1.5 · 2^23: x + ROUND − ROUND is the nearest whole number


class Footprint(NamedTuple):
    """Of sixteen samples: the nearest borders, and the share of the footprint beyond each."""

    row: Lanes
    below: Lanes
    column: Lanes
    right: Lanes


@inlined
def footprint(
    w: Vector, solid_angle: Lanes, rotation: np.ndarray, height: int, width: int
) -> Footprint:
    """The footprints of directions w, camera frame, of unit length."""
    wx, wy, wz = w
    w_up = fma(wx, rotation[1], fma(wy, rotation[4], wz * rotation[7]))
    theta, phi = polar_angles(
        fma(wx, rotation[0], fma(wy, rotation[3], wz * rotation[6])),
        w_up,
        fma(wx, rotation[2], fma(wy, rotation[5], wz * rotation[8])),
    )
    side = sqrt(solid_angle)
    row, below = border(theta * (height / PI), side * (height / PI))
    sine = sqrt(maximum(1.0 - w_up * w_up, TINY))
    column, right = border(phi * (width / (2.0 * PI)), side * (width / (2.0 * PI)) / sine)
    return Footprint(row, below, column, right)


@inlined
def store_footprint(scratch: np.ndarray, o: int, at: Footprint) -> None:
    """Write footprints into the rows from offset o on."""
    store(scratch, o + LANES * FOOTPRINT_ROW, at.row)
    store(scratch, o + LANES * FOOTPRINT_COLUMN, at.column)
    store(scratch, o + LANES * FOOTPRINT_BELOW, at.below)
    store(scratch, o + LANES * FOOTPRINT_RIGHT, at.right)


@inlined
def in_one_texel(at: Footprint) -> bool:
    """Whether the footprints of all lanes lie in one texel."""
    return alone(at.row, at.below) and alone(at.column, at.right)


@inlined
def texel_of(at: Footprint, height: int, width: int) -> int:
    """Number of the texel in which all lanes' footprints lie."""
    return corner(
        lane_max(at.row + at.below) - 1.0, lane_max(at.column + at.right) - 1.0, height, width
    )


@inlined
def polar_angles(x: Lanes, y: Lanes, z: Lanes) -> tuple[Lanes, Lanes]:
    """θ from +y in [0, π] and φ from +x through +z in [0, 2π] of sixteen directions."""
    theta = angle(fma(x, x, z * z) + TINY, y * y)
    theta = select(y < 0.0, PI - theta, theta)
    phi = angle(z * z, x * x + TINY)
    phi = select(x < 0.0, PI - phi, phi)
    return theta, select(z < 0.0, 2.0 * PI - phi, phi)


@inlined
def border(x: Lanes, width: Lanes) -> tuple[Lanes, Lanes]:
    """The nearest border k between texels, and the part of [x − width/2, x + width/2] beyond it.

    Texel k begins at x = k.
    """
    k = (x + ROUND) - ROUND
    return k, minimum(maximum((x - k) / minimum(width, 1.0) + 0.5, 0.0), 1.0)


@inlined
def alone(border: Lanes, beyond: Lanes) -> bool:
    """Whether the footprints of all lanes lie in one row (or column) of texels."""
    place = border + beyond  # whole where no footprint is divided
    return lane_max(place) + lane_max(0.0 - place) == 0.0 and not anywhere(
        beyond * (1.0 - beyond) > 0.0
    )


@inlined
def corner(row: float, column: float, height: int, width: int) -> int:
    """Number of the texel at a row and column; rows end at the poles, columns wrap around."""
    i, j = int(row), int(column)
    i = 0 if i < 0 else height - 1 if i >= height else i
    j = j + width if j < 0 else j - width if j >= width else j
    return i * width + j


@inlined
def add_radiance(
    scratch: np.ndarray,
    light: np.ndarray,
    height: int,
    width: int,
    i0: float,
    i1: float,
    i2: float,
) -> tuple[float, float, float]:
    """I plus the first three rows times the light of the lanes' footprints; o is 0."""
    for lane in range(LANES):
        row = scratch[LANES * FOOTPRINT_ROW + lane]
        column = scratch[LANES * FOOTPRINT_COLUMN + lane]
        under = scratch[LANES * FOOTPRINT_BELOW + lane]
        beside = scratch[LANES * FOOTPRINT_RIGHT + lane]
        for below in range(2):
            share = under if below else 1.0 - under
            if share > 0.0:
                left = 3 * corner(row + below - 1.0, column - 1.0, height, width)
                right = 3 * corner(row + below - 1.0, column, height, width)
                one, other = share * (1.0 - beside), share * beside
                i0 += scratch[lane] * (one * light[left] + other * light[right])
                i1 += scratch[LANES + lane] * (one * light[left + 1] + other * light[right + 1])
                i2 += scratch[2 * LANES + lane] * (one * light[left + 2] + other * light[right + 2])
    return i0, i1, i2


@inlined
def gather(scratch: np.ndarray, o: int, light: np.ndarray, height: int, width: int) -> None:
    """Write the mean light of each lane's footprint; scratch[o] begins the rows of a chunk."""
    for lane in range(LANES):
        i = o + lane
        row, column = scratch[i + LANES * FOOTPRINT_ROW], scratch[i + LANES * FOOTPRINT_COLUMN]
        under = scratch[i + LANES * FOOTPRINT_BELOW]
        beside = scratch[i + LANES * FOOTPRINT_RIGHT]
        l0, l1, l2 = 0.0, 0.0, 0.0
        for below in range(2):
            share = under if below else 1.0 - under
            if share > 0.0:
                left = 3 * corner(row + below - 1.0, column - 1.0, height, width)
                right = 3 * corner(row + below - 1.0, column, height, width)
                one, other = share * (1.0 - beside), share * beside
                l0 += one * light[left] + other * light[right]
                l1 += one * light[left + 1] + other * light[right + 1]
                l2 += one * light[left + 2] + other * light[right + 2]
        scratch[i + LANES * FOOTPRINT_LIGHT] = l0
        scratch[i + LANES * (FOOTPRINT_LIGHT + 1)] = l1
        scratch[i + LANES * (FOOTPRINT_LIGHT + 2)] = l2


@inlined
def scatter(
    scratch: np.ndarray, o: int, sums: np.ndarray, to: int, height: int, width: int
) -> None:
    """Add each lane's derivatives by its light (first three rows) to the texels of its footprint.

    sums[to] begins the map.
    """
    for lane in range(LANES):
        i = o + lane
        d0, d1, d2 = scratch[i], scratch[i + LANES], scratch[i + 2 * LANES]
        row, column = scratch[i + LANES * FOOTPRINT_ROW], scratch[i + LANES * FOOTPRINT_COLUMN]
        under = scratch[i + LANES * FOOTPRINT_BELOW]
        beside = scratch[i + LANES * FOOTPRINT_RIGHT]
        for below in range(2):
            share = under if below else 1.0 - under
            if share > 0.0:
                left = to + 3 * corner(row + below - 1.0, column - 1.0, height, width)
                right = to + 3 * corner(row + below - 1.0, column, height, width)
                one, other = share * (1.0 - beside), share * beside
                sums[left] += one * d0
                sums[left + 1] += one * d1
                sums[left + 2] += one * d2
                sums[right] += other * d0
                sums[right + 1] += other * d1
                sums[right + 2] += other * d2
