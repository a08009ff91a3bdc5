"""The integral over the piecewise-constant map as a dense float64 sum in numpy: an oracle that
shares no code with the methods.

Each texel is split into PARTS × PARTS; midpoints and exact solid angles of the parts. A lobe of γ =
400 is 2.9° wide, a part of a 24-row map 0.5°: the sum is right to about 1e-3, most of it at the
horizon, which cuts through parts.
"""

import numpy as np

from shaders.dsbrdf import evaluate, half_angles
from shaders.envmap import directions
from shaders.frames import camera_from_light

PARTS = 16
VIEWER = np.array([0.0, 0.0, 1.0])


def radiance(n, m, L, v=VIEWER):
    """(3,) radiance of one pixel; n, v (3,) unit vectors, camera frame; m (3, 3, 2, 6); L (height,
    width, 3).
    """
    w, solid_angle = directions(L.shape[0] * PARTS, L.shape[1] * PARTS)
    w = w.reshape(-1, 3) @ camera_from_light().T
    energy = np.repeat(np.repeat(np.asarray(L, np.float64), PARTS, 0), PARTS, 1).reshape(
        -1, 3
    ) * solid_angle.reshape(-1, 1)
    mu = w @ n
    lit = mu > 0
    h, theta_d = half_angles(w[lit], np.broadcast_to(v, w[lit].shape))
    return (evaluate(m, h @ n, theta_d) * energy[lit] * mu[lit, None]).sum(0)
