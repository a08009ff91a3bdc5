"""Closed forms of the Cycles closures of which materials are made.

Their normal may be tilted in the plane of incidence.

cos_i   n·w_i, towards the light;  cos_o  n·w_o, towards the viewer;  cos_h  n·h;
        cos_d  h·w_i = h·w_o
alpha   width of a closure: the square of the Glossy node's Roughness, the Sheen node's Roughness
        itself; unused by diffuse
tilt    t of the closure's own normal n' = normalize(n + t (w_o − (w_o·n) n)), so that tan(angle) =
        t sin θ_o; 0: n' = n
f       BRDF in 1/sr such that f · cos_i is the factor by which Cycles multiplies the light

All arrays broadcast; numpy or torch. The formulas hold for the plain distributions GGX, BECKMANN,
ASHIKHMIN_SHIRLEY (Glossy) and ASHIKHMIN (Sheen), no multiple scattering, and for materials without
bump-map correction.

Source: Blender 4.5,
intern/cycles/kernel/closure/bsdf_{diffuse,microfacet,ashikhmin_shirley,ashikhmin_velvet}.h
"""

import numpy as np

from shaders.arrays import Array, namespace

PI = float(np.pi)
# exp(−745) is the last float64 above 0: lobes that are dead there must not raise underflow
MIN_EXPONENT = -700.0
# light or view behind a tilted normal sees nothing; below this the formulas divide by almost 0
MIN_COS = 1e-4


def diffuse(alpha: Array, cos_i: Array, cos_o: Array, cos_h: Array, cos_d: Array) -> Array:
    """Return Lambert's 1/π."""
    return 0 * cos_i + 1 / PI


def ggx(alpha: Array, cos_i: Array, cos_o: Array, cos_h: Array, cos_d: Array) -> Array:
    """Return GGX with height-correlated Smith shadowing: D / ((1 + Λ_i + Λ_o) 4 cos_i cos_o)."""
    xp = namespace(alpha, cos_i, cos_o, cos_h)
    a2 = alpha * alpha
    # = 1 + (α² − 1) cos²: written so that nothing cancels at the peak
    spread = (1 - cos_h * cos_h) + a2 * cos_h * cos_h
    d = a2 / (PI * spread * spread)
    root_i = xp.sqrt(1 + a2 * (1 - cos_i * cos_i) / (cos_i * cos_i))
    root_o = xp.sqrt(1 + a2 * (1 - cos_o * cos_o) / (cos_o * cos_o))
    return d / (0.5 * (root_i + root_o)) / (4 * cos_i * cos_o)


def beckmann(alpha: Array, cos_i: Array, cos_o: Array, cos_h: Array, cos_d: Array) -> Array:
    """Return Beckmann with Cycles' rational Λ: D / ((1 + Λ_i + Λ_o) 4 cos_i cos_o)."""
    xp = namespace(alpha, cos_i, cos_o, cos_h)
    c2 = cos_h * cos_h
    d = xp.exp(xp.clip(-(1 - c2) / (c2 * alpha * alpha), MIN_EXPONENT, None)) / (
        PI * alpha * alpha * c2 * c2
    )

    def smith(c):
        # 1e-12: c = 1 has no slope to divide by, and Λ = 0 there
        x = c / (xp.sqrt(1 - c * c + 1e-12) * alpha)
        near = xp.clip(x, 0.0, 1.6)
        return xp.where(
            x < 1.6,
            (1 - 1.259 * near + 0.396 * near * near) / (3.535 * near + 2.181 * near * near + 1e-30),
            0 * x,
        )

    return d / (1 + smith(cos_i) + smith(cos_o)) / (4 * cos_i * cos_o)


def ashikhmin_shirley(
    alpha: Array, cos_i: Array, cos_o: Array, cos_h: Array, cos_d: Array
) -> Array:
    """Return a Phong-like lobe (n + 1)/(8π) · cos_h^n / (cos_d max(cos_i, cos_o)), n = 2/α² − 2."""
    xp = namespace(alpha, cos_i, cos_o, cos_h)
    n = 2 / (alpha * alpha) - 2
    power = xp.exp(xp.clip(n * xp.log(cos_h), MIN_EXPONENT, None))
    return (n + 1) / (8 * PI) * power / (cos_d * xp.where(cos_i > cos_o, cos_i, cos_o + 0 * cos_i))


def sheen(alpha: Array, cos_i: Array, cos_o: Array, cos_h: Array, cos_d: Array) -> Array:
    """Return Ashikhmin's velvet, D · G / (4 cos_i cos_o).

    D = exp(−cot²θ_h/α²)/(π α² sin⁴θ_h); G is that of V-cavities.
    """
    xp = namespace(alpha, cos_i, cos_o, cos_h)
    s2 = xp.clip(1 - cos_h * cos_h, 1e-9, None)  # at the pole the exponential is 0 anyway
    d = xp.exp(xp.clip(-cos_h * cos_h / (s2 * alpha * alpha), MIN_EXPONENT, None)) / (
        alpha * alpha * PI * s2 * s2
    )
    q = 2 * xp.clip(cos_h / cos_d, 1e-5, None)
    least = xp.where(cos_i < cos_o, cos_i, cos_o + 0 * cos_i)
    return 0.25 * d * xp.clip(q * least, None, 1.0) / (cos_i * cos_o)


CLOSURES = {
    "diffuse": diffuse,
    "ggx": ggx,
    "beckmann": beckmann,
    "ashikhmin_shirley": ashikhmin_shirley,
    "sheen": sheen,
}


def tilt_cosines(
    tilt: Array, cos_i: Array, cos_o: Array, cos_h: Array, cos_d: Array
) -> tuple[Array, Array, Array, Array]:
    """Return the cosines about the tilted normal n' = normalize(n + t (w_o − (w_o·n) n)).

    Returns  cos_i', cos_o', cos_h' and a mask, False where light, view or half vector lie behind n'
             (cosines are then held at 1e-4)
    """
    xp = namespace(tilt, cos_i, cos_o, cos_h, cos_d)
    sin2_o = 1 - cos_o * cos_o
    # sin θ_o times the component of h along the view's projection; the same for w_i = 2 cos_d h −
    # w_o
    h_along = cos_d - cos_o * cos_h
    i_along = 2 * cos_d * h_along - sin2_o
    scale = 1 / xp.sqrt(1 + tilt * tilt * sin2_o)
    ci, co, ch = (
        scale * (cos_i + tilt * i_along),
        scale * (cos_o + tilt * sin2_o),
        scale * (cos_h + tilt * h_along),
    )
    seen = (ci > MIN_COS) & (co > MIN_COS) & (ch > MIN_COS)
    return xp.clip(ci, MIN_COS, 1.0), xp.clip(co, MIN_COS, 1.0), xp.clip(ch, MIN_COS, 1.0), seen


def evaluate(
    kind: str, alpha: Array, tilt: Array, cos_i: Array, cos_o: Array, cos_h: Array, cos_d: Array
) -> Array:
    """Return f of one closure with a tilted normal: f(cos_i', …) · cos_i'/cos_i, 0 behind it.

    kind     a key of CLOSURES
    cosines  positive; cos_i ≥ 1e-4
    """
    ci, co, ch, seen = tilt_cosines(tilt, cos_i, cos_o, cos_h, cos_d)
    xp = namespace(ci)
    f = CLOSURES[kind](alpha, ci, co, ch, cos_d) * ci / cos_i
    if kind == "diffuse":  # Cycles asks for no view in front of its normal
        seen = ci > MIN_COS
    return xp.where(seen, f, 0 * f)
