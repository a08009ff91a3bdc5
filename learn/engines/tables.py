"""Kernels for what a material is at each light of a map, and the way back from sums over pixels to
its control values.

Arrays and letters as in learn.engines.culled, whose tables these are. Besides
m        (many, 3 channels, 2, 6): γ and κ control values of the lobes that are summed
basis    (blocks, 6, 16): the spline's basis at each light's θ_d; it is ≥ 0, so that nothing cancels
chunks   of pixels, whose sums are added in their order
"""

from numba import types

from learn.engines.culled import CONE_ROWS, LARGEST
from learn.engines.distant import LN2
from learn.engines.vector import (
    FLOAT_POINTER,
    fma,
    lane_max,
    lane_sum,
    load,
    maximum,
    minimum,
    select,
    splat,
    store,
)

LOG2_E = 1.4426950408889634
HIGHEST = 1e30

MAKE = types.void(*[types.int64] * 3, *[FLOAT_POINTER] * 5)
GRADIENT = types.void(*[types.int64] * 4, *[FLOAT_POINTER] * 5)


def make(first, last, many, m, basis, energy, lobes, cones):
    """Lobes of blocks first … last − 1, and their energy in the brightest channel, least γ and
    largest κ log2 e in the cones' rows.
    """
    for block in range(first, last):
        row = 16 * CONE_ROWS * (block // 16) + block % 16
        for s in range(many):
            least, largest = splat(HIGHEST), splat(0.0)
            for k in range(3):
                v, o = 12 * (3 * s + k), 96 * (many * block + s) + 32 * k
                gamma, kappa = splat(0.0), splat(0.0)
                for j in range(6):
                    share = load(basis, 96 * block + 16 * j)
                    gamma, kappa = fma(share, m[v + j], gamma), fma(share, m[v + 6 + j], kappa)
                kappa = minimum(kappa * LOG2_E, LARGEST)
                store(lobes, o, gamma)
                store(lobes, o + 16, kappa)
                least, largest = minimum(least, gamma), maximum(largest, kappa)
            cones[row + 16 * (11 + s)] = -lane_max(0.0 - least)
            cones[row + 16 * (14 + s)] = lane_max(largest)
        brightest = types.float32(0.0)
        for k in range(3):
            light = load(energy, 48 * block + 16 * k)
            # a light gathered from others may be negative
            brightest = max(brightest, lane_sum(maximum(light, 0.0 - light)))
        cones[row + 160] = brightest


def gradient(many, blocks, chunks, stride, basis, energy, lobes, lobe_sums, by_m):
    """Derivatives by_m (many, 3, 2, 6, 16), lanes still apart, from what
    learn.engines.culled.backward has summed.

    stride  floats from one chunk's sums to the next one's
    """
    for i in range(36 * many):
        store(by_m, 16 * i, splat(0.0))
    for block in range(blocks):
        for s in range(many):
            for k in range(3):
                o, to = 96 * (many * block + s) + 32 * k, 192 * (3 * s + k)
                by_kappa, by_gamma = load(lobe_sums, o), load(lobe_sums, o + 16)
                for chunk in range(1, chunks):
                    by_kappa = by_kappa + load(lobe_sums, o + stride * chunk)
                    by_gamma = by_gamma + load(lobe_sums, o + stride * chunk + 16)
                kappa, light = load(lobes, o + 16), load(energy, 48 * block + 16 * k)
                by_kappa = select(kappa < LARGEST, by_kappa * light, 0.0)
                by_gamma = by_gamma * (kappa * (LN2 * LN2)) * light
                for j in range(6):
                    share, a = load(basis, 96 * block + 16 * j), to + 16 * j
                    store(by_m, a, fma(by_gamma, share, load(by_m, a)))
                    store(by_m, a + 96, fma(by_kappa, share, load(by_m, a + 96)))
