"""Which lobes of a block of lights a list leaves out: a bound on each, a threshold, a cut.

For sixteen blocks side by side, in scratch from offset b on (learn.engines.layout): row
SELECT_BOUND + s holds the most that lobe s can reflect of a block, row SELECT_WEIGHT + s first its
largest weight max(0, n·w) E, then its cut.

many    lobes that are summed, 1 to 3
cut     log2 c at or below which a lobe is left out of a block; NEVER, ALWAYS: above and below any
values  holds a lobe's least γ and largest κ log2 e in rows `gammas` + s and `kappas` + s
"""

import math

import numpy as np

from learn.engines.compilation import inlined
from learn.engines.cones import SLACK
from learn.engines.distant import LEAST_COSINE
from learn.engines.exponentials import LOWEST, exp2, exp2m1, log2
from learn.engines.layout import CUT_REACH, LANES, SELECT_BOUND, SELECT_REACH, SELECT_WEIGHT
from learn.engines.vector import (
    Lanes,
    fma,
    lane_sum,
    load,
    maximum,
    minimum,
    splat,
    sqrt,
    store,
)
from learn.engines.vector import select as choose

LARGEST = 72.13475  # MAX_EXPONENT log2 e
NEVER, ALWAYS = 1.0, -1e30
LEAST_LOG = math.log2(LEAST_COSINE)


@inlined
def bound_lobes(
    scratch: np.ndarray,
    b: int,
    many: int,
    values: np.ndarray,
    gammas: int,
    kappas: int,
    log_c: Lanes,
    weight: Lanes,
) -> None:
    """Write each lobe's bound at the largest log2 c, and its weight."""
    for s in range(many):
        gamma = load(values, gammas + LANES * s)
        kappa = load(values, kappas + LANES * s)
        exponent = kappa * exp2(gamma * log_c)
        bound = weight * exp2m1(minimum(exponent, LARGEST))
        store(scratch, b + LANES * (SELECT_BOUND + s), bound)
        store(scratch, b + LANES * (SELECT_WEIGHT + s), weight)


@inlined
def threshold_within(
    scratch: np.ndarray, stride: int, wide_blocks: int, many: int, budget: float
) -> float:
    """A threshold on bounds so low that what it skips sums to the budget at most."""
    threshold = 0.125 * budget
    for _ in range(12):
        skipped = splat(0.0)
        for wide_block in range(wide_blocks):
            for s in range(many):
                bound = load(scratch, stride * wide_block + LANES * (SELECT_BOUND + s))
                skipped = skipped + minimum(bound, threshold)
        if lane_sum(skipped) <= budget:
            break
        threshold *= 0.25
    return threshold


@inlined
def highest_bound(scratch: np.ndarray, b: int, many: int) -> Lanes:
    """The largest bound of a block's lobes."""
    highest = load(scratch, b + LANES * SELECT_BOUND)
    for s in range(1, many):
        highest = maximum(highest, load(scratch, b + LANES * (SELECT_BOUND + s)))
    return highest


@inlined
def cut_lobes(
    scratch: np.ndarray,
    b: int,
    many: int,
    values: np.ndarray,
    gammas: int,
    kappas: int,
    threshold: float,
    cos_h: Lanes,
    sin_h: Lanes,
) -> Lanes:
    """Write each lobe's cut in place of its weight.

    cos_h, sin_h  of the half angle of the block's cone about h
    Returns       the least n·axis, axis that of this cone, at which a pixel can have any lobe's c
                  above its cut
    """
    reach = splat(NEVER)
    for s in range(many):
        gamma = load(values, gammas + LANES * s)
        kappa = load(values, kappas + LANES * s)
        weight = load(scratch, b + LANES * (SELECT_WEIGHT + s))
        cut = cut_at(threshold, weight, gamma, kappa)
        above = load(scratch, b + LANES * (SELECT_BOUND + s)) > threshold
        store(scratch, b + LANES * (SELECT_WEIGHT + s), choose(above, cut, NEVER))
        reach = minimum(reach, choose(above, least_cosine(cut, cos_h, sin_h), NEVER))
    return reach


@inlined
def is_listed(scratch: np.ndarray, cuts: int, many: int) -> bool:
    """Whether some lobe of a block is summed; scratch[cuts] is the first lobe's cut."""
    listed = False
    for s in range(many):
        listed = listed or scratch[cuts + LANES * s] < NEVER
    return listed


@inlined
def write_entry(
    scratch: np.ndarray,
    b: int,
    lane: int,
    many: int,
    block: int,
    entry: int,
    cuts: np.ndarray,
    o: int,
    entries: np.ndarray,
) -> None:
    """Write a block's number and cuts, of lane `lane`, to a list's entry; o: its offset in cuts."""
    entries[entry] = block
    for s in range(many):
        cuts[o + s] = scratch[b + LANES * (SELECT_WEIGHT + s) + lane]
    cuts[o + CUT_REACH] = scratch[b + LANES * SELECT_REACH + lane]


@inlined
def cut_at(threshold: float, weight: Lanes, gamma: Lanes, kappa: Lanes) -> Lanes:
    """The log2 c at which weight · (2^(κ c^γ) − 1) meets the threshold; κ: κ log2 e."""
    share = threshold / maximum(weight, 1e-30)
    inverse = 1.0 / (1.0 + share)  # log2 takes numbers up to 1
    bits = 0.0 - log2(maximum(inverse, 1e-30), share * inverse)
    height = minimum(bits / maximum(kappa, 1e-30), 1.0)
    cut = log2(maximum(height, 1e-30), 1.0 - height) / gamma
    return choose(threshold * splat(1.0) > 0.0, cut, ALWAYS)


@inlined
def least_cosine(log_c: Lanes, cos_b: Lanes, sin_b: Lanes) -> Lanes:
    """Least cosine with a cone's axis of a vector within arccos c of one in the cone.

    log_c  log2 c; b: half angle of the cone
    """
    one_minus_c = 0.0 - exp2m1(maximum(log_c, LOWEST))
    c, sine = 1.0 - one_minus_c, sqrt(maximum(one_minus_c * (2.0 - one_minus_c), 0.0))
    whole = fma(sine, cos_b, c * sin_b) < 0.0  # the sum of the angles is beyond π
    least = choose(whole, ALWAYS, c * cos_b - sine * sin_b - SLACK)
    # c is held at LEAST_COSINE: every vector has a c above such a cut
    return choose(log_c > LEAST_LOG, least, ALWAYS)
