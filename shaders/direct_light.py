"""Direct light of a mixture of closures without noise, seen by a distant viewer.

A mixture's radiance is a function of the normal alone when the viewer and the light are distant: a
reflectance map (Ramamoorthi and Hanrahan 2001). Each closure is integrated as its width asks for:

wide    the sum over the light's texels, at the nodes of a map over the visible hemisphere, between
        which radiance is interpolated. Blocks of texels count as one light, at the centre of their
        energy, where the lobe is wider than they are
narrow  at every normal, over sample directions that follow the lobe as far as `extent` around its
        axis; what a long-tailed lobe (GGX) reflects from beyond comes from a map as above

The light is piecewise constant over its texels, as in the layer and in Cycles with nearest look-up.

n      (…, 3) unit normals, camera frame; the viewer is at (0, 0, 1)
t      (tan θ_h / α)²
nodes  of a map: polar angle θ and azimuth φ of the normal at ((θ cos φ, θ sin φ) 2/π + 1)/2
"""

from __future__ import annotations

import numpy as np

from shaders import direct_light_kernels, envmap
from shaders.mixture import Mixture, ramp_table

LOBES = ("ggx", "beckmann", "ashikhmin_shirley")
NARROW = 0.1  # α below which a lobe is sampled
MAP_SIZE = 64  # nodes of a map across the hemisphere
BLOCKS = ((0.45, 16), (0.2, 32), (0.0, 64))  # rows of light blocks for closures at least so wide
SAMPLES = 12  # directions per normal of each of the two distributions
EXTENT = 0.2  # radians about the mirrored direction that samples of a narrow lobe cover
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
        self._tables = [_table(mixture, k) for k in range(len(mixture.kinds))]

    @property
    def narrowest(self) -> float:
        """The least α of a closure with a lobe, 1 without one."""
        lobes = [
            a for a, kind in zip(self._least, self.mixture.kinds, strict=True) if kind in LOBES
        ]
        return float(min(lobes, default=1.0))

    @property
    def narrow(self) -> int:
        """The number of narrow closures."""
        return sum(self._is_narrow(k) for k in range(len(self.mixture.kinds)))

    def at(self, n: np.ndarray, samples: int = SAMPLES) -> np.ndarray:
        """Return radiance (P, 3) float32 at normals (P, 3).

        samples  directions per normal of each of the two distributions of a narrow lobe; few
                 suffice where many normals are averaged, for their errors differ
        """
        n = np.concatenate([n[:, :2], np.maximum(n[:, 2:], LEAST_COS)], axis=1)
        n = (n / np.linalg.norm(n, axis=1, keepdims=True)).astype(np.float32)
        radiance = np.zeros_like(n)
        while direct_light_kernels.interpolate(n, self._nodes, self._known, radiance):
            self._fill(np.argwhere(self._known == 2))
            radiance[:] = 0
        for k in range(len(self.mixture.kinds)):
            if self._is_narrow(k):
                self._sample(k, n, samples, radiance)
        return radiance

    def _is_narrow(self, k: int) -> bool:
        return self.mixture.kinds[k] in LOBES and bool(self._least[k] < NARROW)

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
        # sheen is bright near the horizon, whatever its width
        width = {"diffuse": 1.0, "sheen": 0.1}.get(kind, self._least[k])
        rows = len(self.light)
        if not narrow:
            rows = min(rows, next(rows for least, rows in BLOCKS if width >= least))
        extent = np.float32(np.tan(EXTENT / 2) if narrow else 0)
        w, h, energy = self.lights(rows)
        number = direct_light_kernels.KINDS[kind]
        direct_light_kernels.add_lights(number, n, self._tables[k], extent, w, h, energy, out)

    def _sample(self, k: int, n: np.ndarray, samples: int, out: np.ndarray) -> None:
        """Add to out (P, 3) what closure k reflects from within its extent."""
        direct_light_kernels.add_samples(
            direct_light_kernels.KINDS[self.mixture.kinds[k]],
            n,
            self._tables[k],
            np.float32(np.tan(EXTENT / 2)),
            self.light,
            np.ascontiguousarray(self.camera_from_light.T, np.float32),
            samples,
            out,
        )


def _table(mixture: Mixture, k: int) -> np.ndarray:
    """Return closure k's log α, tilt and weights (S, 5) at equal steps of 1 − n·v, float32."""
    columns = (mixture.log_alpha[:, k, None], mixture.tilt[:, k, None], mixture.weights[:, k])
    values = np.concatenate(columns, axis=1)
    table = ramp_table(mixture.stops, values) if len(values) > 1 else np.repeat(values, 2, axis=0)
    return table.astype(np.float32)
