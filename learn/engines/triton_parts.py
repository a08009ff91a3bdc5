"""Functions that the Triton kernels share: precise exponentials, and a tile's geometry.

A tile is (PIXELS, LIGHTS) float32. `t` are places of lights in rows of `lights` numbers, `p` places
of pixels. Polynomials and bounds are those of learn.engines.exponentials, whose module text
explains them.
"""

import triton
import triton.language as tl


@triton.jit
def exp2(x: tl.tensor) -> tl.tensor:
    """2^x for x ≤ 127, held at 2^-48 below."""
    return tl.exp2(tl.maximum(x, -48.0))


@triton.jit
def exp2m1(x: tl.tensor) -> tl.tensor:
    """2^x − 1 for x ≥ 0, to full relative precision near 0."""
    small = x * (0.69314714 + x * (0.24022351 + x * (0.055505 + x * (0.00966625 + x * 0.00133335))))
    return tl.where(x < 0.5, small, tl.exp2(x) - 1.0)


@triton.jit
def log2(c: tl.tensor, one_minus_c: tl.tensor) -> tl.tensor:
    """log2 of c in (0, 1], to full relative precision near 1."""
    m = -one_minus_c
    p = 0.28819153 + m * (-0.24272362 + m * (0.21632471 + m * (-0.17422922 + m * 0.07806572)))
    near = m * (1.44269503 + m * (-0.72134848 + m * (0.48090208 + m * (-0.36057592 + m * p))))
    return tl.where(c > 0.75, near, tl.log2(c))


@triton.jit
def vectors(
    pointer: tl.tensor, p: tl.tensor, inside: tl.tensor
) -> tuple[tl.tensor, tl.tensor, tl.tensor]:
    """Three columns (PIXELS, 1) of an array (P, 3); 0 outside."""
    x = tl.load(pointer + 3 * p, mask=inside, other=0.0)
    y = tl.load(pointer + 3 * p + 1, mask=inside, other=0.0)
    z = tl.load(pointer + 3 * p + 2, mask=inside, other=0.0)
    return x[:, None], y[:, None], z[:, None]


@triton.jit
def rows(
    pointer: tl.tensor, first: int, t: tl.tensor, lights: int
) -> tuple[tl.tensor, tl.tensor, tl.tensor]:
    """Rows first … first + 2 of (R, lights) at t, each (1, LIGHTS)."""
    x = tl.load(pointer + first * lights + t)
    y = tl.load(pointer + (first + 1) * lights + t)
    z = tl.load(pointer + (first + 2) * lights + t)
    return x[None, :], y[None, :], z[None, :]


@triton.jit
def peak_cosine(x: tl.tensor, y: tl.tensor, z: tl.tensor) -> tuple[tl.tensor, tl.tensor]:
    """c and log2 c from h − n."""
    one_minus_c = 0.5 * (x * x + y * y + z * z)
    c = tl.maximum(1.0 - one_minus_c, 1e-12)
    return c, log2(c, one_minus_c)
