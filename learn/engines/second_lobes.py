"""Second derivatives of one lobe and channel, at sixteen lights.

The kernels for a distant viewer and for a view per pixel (learn.engines.distant_second,
general_second) share these. Letters are those of learn.engines.distant. I' is the change of the
radiance if the inputs change along a given direction; the other letters with a prime likewise.

    S = Σ_pk g_pk I'_pk,   I'_k = Σ_i (F'_k μ + F_k μ') E_k + F_k μ E'_k,   μ = max(0, n·w),
    μ' = w·n' where μ > 0
    F' = Σ_s exp(x) x',   x = κ c^γ,   x' = c^γ κ' + x q,   q = γ' ln c + γ r,   r = c'/c

Its gradient, of one lobe and channel with u = g E μ and v = g (E μ' + E' μ): α = u exp(x) and
X = exp(x) (u (x' + q) + v) belong to x' and to x; Y = α c^γ κ' + X x to γ ln c; hence

    by κ: X c^γ     by γ: Y ln c + α x r     by ln c: Y γ + α x γ'     by r: α x γ
"""

from typing import NamedTuple

import numpy as np

from learn.engines.compilation import inlined
from learn.engines.distant import LN2
from learn.engines.exponentials import exp2, exp2m1
from learn.engines.triples import add_to
from learn.engines.vector import Lanes, Mask, fma, load, maximum, select


class Change(NamedTuple):
    """What the sum over lobes needs: values of sixteen lights, and their changes.

    n_w, n_w_along  μ and μ'
    log2_c, log_c   log2 c, and ln c
    r               c'/c
    """

    n_w: Lanes
    n_w_along: Lanes
    log2_c: Lanes
    log_c: Lanes
    r: Lanes


class Weights(NamedTuple):
    """The weights of sixteen lights in S, in one channel k.

    energy, energy_along  E and E'
    u, v                  g E μ and g (E μ' + E' μ)
    """

    energy: Lanes
    energy_along: Lanes
    u: Lanes
    v: Lanes


class LobeSecond(NamedTuple):
    """One lobe and channel at sixteen lights.

    value, change                F's summand and that of F'
    by_kappa, by_gamma           derivatives of S by κ and γ
    by_log_c, by_r               by ln c and by r
    alpha_power, alpha_x_log_c   α c^γ and α x ln c: by κ' and γ'
    """

    value: Lanes
    change: Lanes
    by_kappa: Lanes
    by_gamma: Lanes
    by_log_c: Lanes
    by_r: Lanes
    alpha_power: Lanes
    alpha_x_log_c: Lanes


@inlined
def lobe_second(
    gamma: Lanes,
    kappa: Lanes,
    gamma_along: Lanes,
    kappa_along: Lanes,
    change: Change,
    weights: Weights,
) -> LobeSecond:
    """The summands and derivatives of one lobe and channel, by the formulas above.

    kappa is κ log2 e; kappa_along and gamma_along are κ' and γ'.
    """
    power = exp2(gamma * change.log2_c)
    exponent = kappa * power
    value = exp2m1(exponent)
    e, x = value + 1.0, exponent * LN2
    u, v = weights.u, weights.v
    q = fma(gamma_along, change.log_c, gamma * change.r)
    by_power = power * kappa_along
    x_along = fma(x, q, by_power)
    alpha = u * e
    by_x = fma(alpha, x_along + q, v * e)
    both = fma(alpha, by_power, by_x * x)
    alpha_x = alpha * x
    return LobeSecond(
        value,
        e * x_along,
        by_x * power,
        fma(both, change.log_c, alpha_x * change.r),
        fma(both, gamma, alpha_x * gamma_along),
        alpha_x * gamma,
        alpha * power,
        alpha_x * change.log_c,
    )


@inlined
def weights_of(
    energy: np.ndarray, e_along: np.ndarray, i: int, change: Change, g: float
) -> Weights:
    """The weights of one channel, whose energies are at offset i; g: its derivative by radiance."""
    e, e_change, weight = load(energy, i), load(e_along, i), change.n_w * g
    return Weights(e, e_change, weight * e, fma(change.n_w_along * g, e, weight * e_change))


@inlined
def add_by_energy_and_g(
    energy_sums: np.ndarray,
    i: int,
    sums: np.ndarray,
    at: int,
    weights: Weights,
    change: Change,
    f: Lanes,
    f_along: Lanes,
    g: float,
    by_w: Lanes,
) -> Lanes:
    """Add one channel's derivatives by E and by g, and return by_w plus that by μ.

        by E: g (F' μ + F μ')     by g: E (F' μ + F μ') + E' F μ     by μ: g (E F' + E' F)

    i, at       offsets in energy_sums and in sums
    f, f_along  F and F'
    """
    e, e_change = weights.energy, weights.energy_along
    both = fma(f_along, change.n_w, f * change.n_w_along)
    add_to(energy_sums, i, both * g)
    add_to(sums, at, fma(e, both, e_change * f * change.n_w))
    return fma(fma(e, f_along, e_change * f), g, by_w)


@inlined
def by_cosine(by_log_c: Lanes, by_r: Lanes, r: Lanes, inverse_c: Lanes) -> tuple[Lanes, Lanes]:
    """The derivatives by c and by c' of r = c'/c and of ln c, from those by r and ln c."""
    return (by_log_c - by_r * r) * inverse_c, by_r * inverse_c


@inlined
def change_of(
    n_w: Lanes, visible: Mask, w_along: Lanes, c_along: Lanes, c: Lanes, log2_c: Lanes
) -> tuple[Change, Lanes]:
    """The change of sixteen lights, and 1/c.

    n_w, w_along  n·w and n'·w; visible: where n·w is above 0
    c, c_along    c and c', and log2 c
    """
    mu_along, inverse_c = select(visible, w_along, 0.0), 1.0 / c
    r = select(visible, c_along * inverse_c, 0.0)
    return Change(maximum(n_w, 0.0), mu_along, log2_c, log2_c * LN2, r), inverse_c
