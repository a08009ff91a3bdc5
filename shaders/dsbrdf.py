"""The directional-statistics BRDF (DSBRDF), which is the material's label.

It is a sum of three lobes of hemispherical exponential power distributions.

m      (..., 3, 3, 2, 6): channel k, lobe s, (κ, γ), spline control values over θ_d; the paper's
       108 numbers
label  the same shape, natural logarithms of m: what is stored, fitted and predicted; κ, γ > 0 by
       construction
c      h·n, cosine between half vector and normal
f      (..., 3) BRDF in 1/sr, no cosine:  f_k = Σ_s exp(κ_ks(θ_d) c^γ_ks(θ_d)) − 1

Source: supplement, "Material"; Nishino 2009 writes 1 − exp(κ c^γ) with κ < 0; here, as in the
paper, κ ≥ 0.
"""

import numpy as np

from shaders.arrays import Array, like, namespace
from shaders.spline import CONTROL_VALUES, basis

SHAPE = (3, 3, 2, CONTROL_VALUES)
SIZE = int(np.prod(SHAPE))  # 108
# expm1(88.7) is the last finite float32; a BRDF of e^50 is far beyond any measured one
MAX_EXPONENT = 50.0
DARK = 1e-4  # κ below which expm1(κ) counts as κ


def coefficients(m: Array, theta_d: Array) -> tuple[Array, Array]:
    """Return κ and γ at the given angles.

    m        (..., 3, 3, 2, 6), or (..., 108) flat
    theta_d  (P,) radians
    Returns  kappa, gamma, each (..., P, 3, 3): channel, lobe
    """
    if m.shape[-1] == SIZE:
        m = m.reshape(*m.shape[:-1], *SHAPE)
    curves = namespace(m).einsum("...kstb,pb->...pkst", m, basis(theta_d))
    return curves[..., 0], curves[..., 1]


def evaluate(m: Array, cos_h: Array, theta_d: Array) -> Array:
    """Return BRDF values of one material.

    m        (3, 3, 2, 6) or (108,): κ and γ control values, not logarithms
    cos_h    (P,) h·n; values ≤ 0 give the limit 0 of c^γ
    theta_d  (P,) radians, half the angle between light and view
    Returns  f (P, 3) in 1/sr
    """
    xp = namespace(m, cos_h)
    kappa, gamma = coefficients(m, theta_d)
    lit = cos_h > 0
    log_c = xp.log(xp.where(lit, cos_h, 0 * cos_h + 1))[..., None, None]
    power = xp.where(lit[..., None, None], xp.exp(gamma * log_c), 0 * gamma)
    return xp.expm1(xp.clip(kappa * power, 0.0, MAX_EXPONENT)).sum(-1)


def lobe_sharpness(kappa: Array, gamma: Array | float) -> Array:
    """Return the exponent g of a lobe: it falls as c^g about its peak.

    For a lobe expm1(κ c^γ), g = γ κ / (1 − e^−κ). Near the peak the lobe is a Gaussian of the
    half-vector angle with standard deviation 1/√g; g is γ for a dark lobe and κγ for a high one.
    """
    xp = namespace(kappa, gamma)
    steepening = xp.where(kappa > 1e-4, kappa / -xp.expm1(-xp.clip(kappa, 1e-4, None)), 1.0)
    return gamma * steepening


def scale_label(label: Array, factor: Array | float) -> Array:
    """Return a label whose BRDF is `factor` times as large, in good approximation.

    The height of each lobe is exact at each control value, and its sharpness stays. What lies
    between is exact for matte lobes; for the measured materials times 2.7 the relative L1 of f·cos
    is 1.8 % in the mean.

    label   (..., 108) or (..., 3, 3, 2, 6): natural logarithms
    factor  a number, or one for each channel (3,); above 0
    """
    xp = namespace(label)
    lobes = label.reshape(*label.shape[:-1], *SHAPE) if label.shape[-1] == SIZE else label
    by = like(factor, label)[..., None, None]  # for all lobes and control values
    log_kappa, log_gamma = lobes[..., 0, :], lobes[..., 1, :]
    kappa = xp.clip(xp.exp(log_kappa), None, MAX_EXPONENT)
    # expm1(κ) is κ where κ is small
    log_scaled = xp.where(
        kappa < DARK,
        log_kappa + xp.log(by),
        xp.log(xp.log1p(by * xp.expm1(xp.clip(kappa, DARK, None)))),
    )
    log_steeper = xp.log(lobe_sharpness(xp.exp(log_scaled), 1.0) / lobe_sharpness(kappa, 1.0))
    return xp.stack([log_scaled, log_gamma - log_steeper], -2).reshape(label.shape)


def half_angles(w_i: Array, w_o: Array) -> tuple[Array, Array]:
    """Return half vector and difference angle.

    w_i, w_o  (..., 3) unit vectors of one frame, towards the light and towards the viewer
    Returns   h (..., 3) unit, 0 where w_i = −w_o; theta_d (...) in [0, π/2], exact near 0 because
              arctan2 gives it
    """
    xp = namespace(w_i, w_o)
    s, d = w_i + w_o, w_i - w_o
    length_s = xp.sqrt((s * s).sum(-1))
    length_d = xp.sqrt((d * d).sum(-1))
    opposite = length_s < 1e-6
    h = s / xp.where(opposite, 0 * length_s + 1, length_s)[..., None]
    return xp.where(opposite[..., None], 0 * s, h), xp.arctan2(length_d, length_s)


def differentiable_half_angles(w_i: Array, w_o: Array) -> tuple[Array, Array]:
    """Return `half_angles` with derivatives that stay finite where w_i = w_o or w_i = −w_o.

    Both lengths are held at 1e-12 or above, so that the slope of θ_d is 0 at its corner θ_d = 0.
    """
    xp = namespace(w_i, w_o)
    s, d = w_i + w_o, w_i - w_o
    length_s, length_d = (xp.sqrt(xp.clip(xp.square(x).sum(-1), 1e-24, None)) for x in (s, d))
    return s / length_s[..., None], xp.arctan2(length_d, length_s)
