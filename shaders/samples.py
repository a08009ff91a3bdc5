"""Sample points at which BRDFs are compared.

They lie in the light's hemisphere, in half-vector space, for several view angles.

V  view angles, P  points per view
θ_h = (π/2) u^power, u = (i + ½)/n: points are dense at the peak, where measured lobes are 0.2–0.5°
wide; φ_h in (0, π), mirrored
cos_d = cos_o cos_h + sin_o sin_h cos φ_h;  cos_i = 2 cos_d cos_h − cos_o;
dω_i = 4 cos_d sin θ_h dθ_h dφ_h, twice for the mirror image
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from shaders.mixture import TABLE_SIZE
from shaders.spline import basis

# a measured material: (cos_h, cos_d) → f (…, 3) in 1/sr
Measured: TypeAlias = Callable[[np.ndarray, np.ndarray], np.ndarray]
POWER = 2.5  # u² is too coarse for chrome
MIN_COS_I = 1e-3
HELD_OUT_DEG = (0.5, 15.0, 30.0, 45.0, 60.0, 75.0)  # never fitted: errors are reported there
HELD_OUT_POINTS = 120, 24  # numbers of θ_h and φ_h at each of these views


class Samples:
    """cos_i, cos_o, cos_h, cos_d, solid_angle (V, P), all float64.

    Points below the horizon have solid angle 0 and harmless cosines.
    """

    def __init__(
        self,
        theta_o: ArrayLike,
        n_theta: int = 44,
        n_phi: int = 10,
        narrowest: float | None = None,
    ) -> None:
        """Place the samples for view angles theta_o (V,), radians from the normal.

        narrowest  width of the narrowest lobe, radians: θ_h then follows sinh, equally dense within
                   that width and in equal ratios beyond it
        """
        self.theta_o = np.atleast_1d(np.asarray(theta_o, dtype=np.float64))
        u = (np.arange(n_theta) + 0.5) / n_theta
        if narrowest is None:
            theta_h = np.pi / 2 * u**POWER
            d_theta = np.pi / 2 * POWER * u ** (POWER - 1) / n_theta
        else:
            span = np.arcsinh(np.pi / 2 / narrowest)
            theta_h = narrowest * np.sinh(span * u)
            d_theta = narrowest * span * np.cosh(span * u) / n_theta
        phi_h = (np.arange(n_phi) + 0.5) / n_phi * np.pi
        cos_o, sin_o = np.cos(self.theta_o)[:, None, None], np.sin(self.theta_o)[:, None, None]
        ch, sh = np.cos(theta_h)[None, :, None], np.sin(theta_h)[None, :, None]
        cos_d = cos_o * ch + sin_o * sh * np.cos(phi_h)
        cos_i = 2 * cos_d * ch - cos_o
        area = 4 * cos_d * (sh * d_theta[None, :, None]) * (2 * np.pi / n_phi)
        lit = (cos_i > MIN_COS_I) & (cos_d > 1e-4)

        def flat(values, otherwise):
            return np.where(lit, values, otherwise).reshape(len(self.theta_o), -1)

        self.cos_i, self.cos_d = flat(cos_i, 0.5), flat(cos_d, 0.9)
        self.cos_h, self.cos_o = flat(ch, 0.9), flat(cos_o, 0.5)
        self.solid_angle = flat(area, 0.0)
        self.view_cos = np.cos(self.theta_o)
        self.cos_o = np.where(lit.reshape(self.cos_o.shape), self.cos_o, self.view_cos[:, None])
        self.measure = self.solid_angle * self.cos_i  # cosine-weighted

    @property
    def cosines(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return (cos_i, cos_o, cos_h, cos_d), in the order of shaders.closures."""
        return self.cos_i, self.cos_o, self.cos_h, self.cos_d

    def spline(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the spline basis (V, P, 6) at θ_d and log cos_h (V, P), which the label needs."""
        return basis(np.arccos(np.clip(self.cos_d, 0, 1))), np.log(self.cos_h)

    def thinned(self, step: int) -> "Samples":
        """Return every step-th view."""
        part = object.__new__(Samples)
        for name, value in vars(self).items():
            setattr(part, name, value[::step])
        return part


def held_out_samples() -> Samples:
    """Return the samples at the view angles that no fit sees; finer than those of the fit."""
    return Samples(np.radians(HELD_OUT_DEG), *HELD_OUT_POINTS)


def view_stops(theta_deg: ArrayLike) -> np.ndarray:
    """Return the facings (V,) nearest to 1 − cos θ at which a colour ramp's table is exact.

    They are multiples of 1/255, each once.
    """
    return np.unique(np.round((1 - np.cos(np.radians(theta_deg))) * (TABLE_SIZE - 1))) / (
        TABLE_SIZE - 1
    )
