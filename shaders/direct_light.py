"""Direct light of a mixture of closures without noise, seen by a distant viewer.

A mixture's radiance is a function of the normal alone when the viewer and the light are distant: a
reflectance map (Ramamoorthi and Hanrahan 2001). Each closure is integrated as its width asks for:

wide    the sum over the light's texels, at the nodes of a map over the visible hemisphere, between
        which radiance is interpolated. Blocks of texels count as one light, at the centre of their
        energy, where the lobe is wider than they are
narrow  at every normal, over sample directions that follow the lobe as far as `reach` around its
        axis; what a long-tailed lobe (GGX) reflects from beyond comes from a map as above

The light is piecewise constant over its texels, as in the layer and in Cycles with nearest look-up.

n      (…, 3) unit normals, camera frame; the viewer is at (0, 0, 1)
t      (tan θ_h / α)²
nodes  of a map: polar angle θ and azimuth φ of the normal at ((θ cos φ, θ sin φ) 2/π + 1)/2
"""

from __future__ import annotations

import numpy as np

from shaders import direct_light_kernels, envmap
from shaders.mixture import Mixture, ramp

NARROW = 0.1  # α below which a lobe is sampled
MAP_SIZE = 64  # nodes of a map across the hemisphere
BLOCKS = ((0.45, 16), (0.2, 32), (0.0, 64))  # rows of light blocks for closures at least so wide
SAMPLES = 12  # directions per normal of each of the two distributions
REACH = 0.2  # radians about the mirrored direction that samples of a narrow lobe cover
LEAST_REACH = 3.0  # in units of tan θ_h / α
SHORT_TAILED = 25.0  # t at which exponential lobes have ended
LEAST_COS = 1e-3  # n·v of normals that lean away from the viewer


class DirectLight:
    """The radiance of one mixture under one light; call `at` with normals.

    mixture            of closures
    light              (height, width, 3) radiance, light frame, nearest look-up
    camera_from_light  (3, 3)
    """

    def __init__(self, mixture: Mixture, light: np.ndarray, camera_from_light: np.ndarray):
        self.mixture = mixture
        self.light = np.ascontiguousarray(light, np.float32)
        self.camera_from_light = camera_from_light
        self._lights: dict[int, tuple[np.ndarray, ...]] = {}
        self._nodes = np.zeros((MAP_SIZE, MAP_SIZE, 3), np.float32)
        self._known = np.zeros((MAP_SIZE, MAP_SIZE), np.uint8)
        self._least = np.exp(mixture.log_alpha.min(0))

    def at(self, n: np.ndarray) -> np.ndarray:
        """Return radiance (P, 3) float32 at normals (P, 3)."""
        n = np.concatenate([n[:, :2], np.maximum(n[:, 2:], LEAST_COS)], axis=1)
        n = (n / np.linalg.norm(n, axis=1, keepdims=True)).astype(np.float32)
        radiance = np.zeros_like(n)
        while direct_light_kernels.interpolate(n, self._nodes, self._known, radiance):
            self._fill(np.argwhere(self._known == 2))
            radiance[:] = 0
        for k in range(len(self.mixture.kinds)):
            if self._is_narrow(k):
                self._sample(k, n, radiance)
        return radiance

    def _is_narrow(self, k: int) -> bool:
        return self.mixture.kinds[k] not in ("diffuse", "sheen") and self._least[k] < NARROW

    def _fill(self, nodes: np.ndarray) -> None:
        """Compute the map's nodes (N, 2) by row and column."""
        place = ((nodes[:, ::-1] - 1) / (MAP_SIZE - 3) * 2 - 1) * (np.pi / 2)
        theta = np.linalg.norm(place, axis=1)
        along = place / np.maximum(theta[:, None], 1e-12)
        theta = np.minimum(theta, np.arccos(LEAST_COS))
        n = np.concatenate([np.sin(theta)[:, None] * along, np.cos(theta)[:, None]], axis=1)
        radiance = np.zeros(n.shape, np.float32)
        for k in range(len(self.mixture.kinds)):
            self._sum(k, n.astype(np.float32), radiance)
        rows, columns = nodes.T
        self._nodes[rows, columns] = radiance
        self._known[rows, columns] = 1

    def lights(self, rows: int) -> tuple[np.ndarray, ...]:
        """Return the lights that stand for blocks of the map, `rows` blocks from pole to pole.

        Returns  directions, half vectors and radiance times solid angle, (3, T) float32 each, in
                 the camera frame
        """
        if rows not in self._lights:
            height, width = self.light.shape[:2]
            step = height // rows
            w, solid_angle = envmap.directions(height, width)
            energy = self.light.astype(np.float64) * solid_angle[..., None]
            brightness = energy.sum(-1, keepdims=True) + 1e-12

            def blocks(values: np.ndarray) -> np.ndarray:
                return values.reshape(rows, step, width // step, step, 3).sum((1, 3)).reshape(-1, 3)

            centre = blocks(w * brightness) @ self.camera_from_light.T
            centre /= np.linalg.norm(centre, axis=1, keepdims=True)
            half = centre + np.array([0.0, 0.0, 1.0])
            half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)
            self._lights[rows] = tuple(
                np.ascontiguousarray(each.T, np.float32) for each in (centre, half, blocks(energy))
            )
        return self._lights[rows]

    def _sum(self, k: int, n: np.ndarray, out: np.ndarray) -> None:
        """Add to out (N, 3) what closure k reflects of all lights, but not what `_sample` adds."""
        kind, narrow = self.mixture.kinds[k], self._is_narrow(k)
        if narrow and kind != "ggx":
            return
        width = 1.0 if kind == "diffuse" else self._least[k]
        rows = len(self.light)
        if not narrow:
            rows = min(rows, next(rows for least, rows in BLOCKS if width >= least))
        alpha, tilt, weights = self._parameters(k, n)
        end = _reach(alpha) if narrow else np.zeros_like(alpha)
        w, h, energy = self.lights(rows)
        direct_light_kernels.add_lights(
            direct_light_kernels.KINDS[kind], n, alpha, tilt, weights, end, w, h, energy, out
        )

    def _sample(self, k: int, n: np.ndarray, out: np.ndarray) -> None:
        """Add to out (P, 3) what narrow closure k reflects from within its reach."""
        kind = self.mixture.kinds[k]
        alpha, tilt, weights = self._parameters(k, n)
        end = _reach(alpha) if kind == "ggx" else np.full_like(alpha, SHORT_TAILED)
        direct_light_kernels.add_samples(
            direct_light_kernels.KINDS[kind],
            0,
            n,
            alpha,
            tilt,
            weights,
            end,
            self.light,
            np.ascontiguousarray(self.camera_from_light.T, np.float32),
            SAMPLES,
            out,
        )

    def _parameters(self, k: int, n: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return closure k's α (N,), tilt (N,) and weights (N, 3) at normals, float32."""
        m = self.mixture
        facing = 1 - n[:, 2].astype(np.float64)
        log_alpha, tilt, weights = (
            ramp(m.stops, values[:, k], facing) for values in (m.log_alpha, m.tilt, m.weights)
        )
        return tuple(x.astype(np.float32) for x in (np.exp(log_alpha), tilt, weights))


def _reach(alpha: np.ndarray) -> np.ndarray:
    """Return t at which samples of a narrow lobe end."""
    return np.maximum(np.float32(np.tan(REACH / 2)) / alpha, np.float32(LEAST_REACH)) ** 2
