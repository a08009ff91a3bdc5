"""Kernels for a material at each light of a map, and for derivatives by its control values.

Arrays and letters as in learn.engines.culled_lists, whose tables these are. Besides
m        (many, 3 channels, 2, 6): γ and κ control values of the lobes that are summed
basis    (blocks, 6, 16): the spline's basis at each light's θ_d; it is ≥ 0, so that nothing cancels
chunks   of pixels, whose sums are added in their order
"""

import numpy as np
from numba import types

from learn.engines.block_cuts import LARGEST
from learn.engines.distant import LN2
from learn.engines.layout import (
    BASIS_STRIDE,
    CHANNEL_STRIDE,
    CHANNEL_VALUES,
    CONE_ENERGY,
    CONE_GAMMA,
    CONE_KAPPA,
    CONE_STRIDE,
    CONTROL_VALUES,
    ENERGY_STRIDE,
    KAPPA,
    KAPPA_VALUES,
    LANES,
    LOBE_STRIDE,
    LOBE_VALUES,
)
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


def make(
    first: int,
    last: int,
    many: int,
    m: np.ndarray,
    basis: np.ndarray,
    energy: np.ndarray,
    lobes: np.ndarray,
    cones: np.ndarray,
) -> None:
    """Write the lobes of blocks first … last − 1, and the material's rows of the cones."""
    for block in range(first, last):
        lane = CONE_STRIDE * (block // LANES) + block % LANES
        for s in range(many):
            least, largest = splat(HIGHEST), splat(0.0)
            for k in range(3):
                v = LOBE_VALUES * s + CHANNEL_VALUES * k
                o = LOBE_STRIDE * (many * block + s) + CHANNEL_STRIDE * k
                gamma, kappa = splat(0.0), splat(0.0)
                for j in range(CONTROL_VALUES):
                    share = load(basis, BASIS_STRIDE * block + LANES * j)
                    gamma, kappa = (
                        fma(share, m[v + j], gamma),
                        fma(share, m[v + KAPPA_VALUES + j], kappa),
                    )
                kappa = minimum(kappa * LOG2_E, LARGEST)
                store(lobes, o, gamma)
                store(lobes, o + LANES * KAPPA, kappa)
                least, largest = minimum(least, gamma), maximum(largest, kappa)
            cones[lane + LANES * (CONE_GAMMA + s)] = -lane_max(0.0 - least)
            cones[lane + LANES * (CONE_KAPPA + s)] = lane_max(largest)
        brightest = types.float32(0.0)
        for k in range(3):
            light = load(energy, ENERGY_STRIDE * block + LANES * k)
            # a light gathered from others may be negative
            brightest = max(brightest, lane_sum(maximum(light, 0.0 - light)))
        cones[lane + LANES * CONE_ENERGY] = brightest


def gradient(
    many: int,
    blocks: int,
    chunks: int,
    stride: int,
    basis: np.ndarray,
    energy: np.ndarray,
    lobes: np.ndarray,
    lobe_sums: np.ndarray,
    by_m: np.ndarray,
) -> None:
    """Derivatives by_m (many, 3, 2, 6, 16), one per lane, from the sums of culled_sums.backward.

    stride  floats from one chunk's sums to the next one's
    """
    for i in range(LOBE_VALUES * many):
        store(by_m, LANES * i, splat(0.0))
    for block in range(blocks):
        for s in range(many):
            for k in range(3):
                o = LOBE_STRIDE * (many * block + s) + CHANNEL_STRIDE * k
                to = LANES * (LOBE_VALUES * s + CHANNEL_VALUES * k)
                by_kappa, by_gamma = load(lobe_sums, o), load(lobe_sums, o + LANES)
                for chunk in range(1, chunks):
                    by_kappa = by_kappa + load(lobe_sums, o + stride * chunk)
                    by_gamma = by_gamma + load(lobe_sums, o + stride * chunk + LANES)
                kappa = load(lobes, o + LANES * KAPPA)
                light = load(energy, ENERGY_STRIDE * block + LANES * k)
                by_kappa = select(kappa < LARGEST, by_kappa * light, 0.0)
                by_gamma = by_gamma * (kappa * (LN2 * LN2)) * light
                for j in range(CONTROL_VALUES):
                    share, a = load(basis, BASIS_STRIDE * block + LANES * j), to + LANES * j
                    store(by_m, a, fma(by_gamma, share, load(by_m, a)))
                    a += LANES * KAPPA_VALUES
                    store(by_m, a, fma(by_kappa, share, load(by_m, a)))
