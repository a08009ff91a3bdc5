import numpy as np

from shaders.spline import basis, basis_slope


def test_basis_slope_is_the_derivative_of_the_basis():
    # none of the 200 angles is a knot, where the slope has its corners
    theta_d, step = np.linspace(0.01, np.pi / 2 - 0.01, 200), 1e-6
    difference = (basis(theta_d + step) - basis(theta_d - step)) / (2 * step)
    # central differences of a quadratic are exact but for rounding, 1e-16/1e-6
    np.testing.assert_allclose(basis_slope(theta_d), difference, atol=1e-8)
