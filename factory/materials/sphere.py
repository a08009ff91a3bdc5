"""Pictures of a sphere under light maps, fast for any isotropic material.

The light is gathered once; each material then costs one product.

The sphere is seen orthographically from the usual elevation and sampled in rings (same angle to the
view, cos_o) and azimuths: R × A "pixels", weighted by their area. About each pixel's normal the
light, times cos_i, is gathered onto nodes in half-vector space, θ_h = (π/2) u^2.5 by φ_h in [0, π]
(a bivariate BRDF is the same at ±φ_h): Q nodes. A picture is then Σ_q f(ring, q) gathered(pixel,
q), that is f interpolated bilinearly between the nodes and summed exactly over the light.

The light is sampled in two ways, each weighted where it is the finer one (power heuristic, exponent
4): one sample per texel for broad lobes, a jittered half-vector grid with nearest look-up for lobes
narrower than a texel.

maps   {name: (height, width, 3)} linear radiance, light frame (shaders.envmap)
"""

from collections.abc import Mapping

import numpy as np

from shaders import envmap, frames, tone
from shaders.tone import LUMINANCE

POWER = 2.5
HORIZON = 1e-3
# the grid is used where its cells are that much smaller than a texel: a lamp of one texel must not
# fall between samples
FINER = 8.0
# nodes below the horizon carry the f of light this far above it: they have a share in samples just
# above
LOWEST = 0.02


class Sphere:
    """The gathered light; pictures are (R, A, maps, 3) linear radiance."""

    def __init__(
        self,
        maps: Mapping[str, np.ndarray],
        rng: np.random.Generator,
        rings: int = 32,
        azimuths: int = 64,
        n_theta: int = 128,
        n_phi: int = 13,
        oversample: tuple[int, int] = (1, 4),
    ) -> None:
        self.names = tuple(maps)
        self.rings, self.azimuths, self.shape = rings, azimuths, (n_theta, n_phi)
        radius = (np.arange(rings) + 0.5) / rings
        self.view_cos, self.area = np.sqrt(1 - radius**2), np.repeat(radius, azimuths)
        u, phi = np.linspace(0, 1, n_theta), np.linspace(0, np.pi, n_phi)
        theta_h = (np.pi / 2 * u**POWER).repeat(n_phi)
        self.theta_h, self.phi_h = theta_h, np.tile(phi, n_theta)
        self.gathered = self._gather(maps, rng, radius, oversample)

    def nodes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return cos_i, cos_o, cos_h, cos_d (R, Q) at the nodes.

        cos_i is held at 0.02 near and below the horizon.
        """
        cos_o, sin_o = self.view_cos[:, None], np.sqrt(1 - self.view_cos[:, None] ** 2)
        ch, sh = np.maximum(np.cos(self.theta_h), 1e-6), np.sin(self.theta_h)
        cos_d = np.clip(cos_o * ch + sin_o * sh * np.cos(self.phi_h), 1e-3, 1)
        cos_i = np.clip(2 * cos_d * ch - cos_o, LOWEST, 1)
        return cos_i, np.broadcast_to(cos_o, cos_i.shape), np.broadcast_to(ch, cos_i.shape), cos_d

    def picture(self, f: np.ndarray) -> np.ndarray:
        """Return the radiance (R, A, maps, 3) of BRDF values f (R, Q, 3) at the nodes."""
        response = np.ascontiguousarray(np.moveaxis(f, -1, 1), np.float32)  # (R, 3, Q)
        radiance = self.gathered @ response[..., None]  # (R, 3, A·maps, 1)
        return np.moveaxis(
            radiance[..., 0].reshape(self.rings, 3, self.azimuths, -1), 1, -1
        ).astype(float)

    def display_l2(self, picture: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Return the mean squared display difference (maps,) over the sphere's area.

        The exposure brings the 99th percentile of the reference to 1.
        """
        results = []
        for m in range(len(self.names)):
            a, b = picture[:, :, m].reshape(-1, 3), reference[:, :, m].reshape(-1, 3)
            exposure = 1 / max(weighted_percentile(b @ LUMINANCE, self.area, 99.0), 1e-12)
            squared = tone.squared_difference(tone.display(a, exposure), tone.display(b, exposure))
            results.append((self.area * squared).sum() / self.area.sum())
        return np.array(results)

    # --- gathering

    def _gather(self, maps, rng, radius, oversample):
        """Return the light (R, 3, A·maps, Q) float32, times cos_i and solid angle, on each node."""
        height, width = next(iter(maps.values())).shape[:2]
        # (texels, maps·3)
        light = np.stack([np.asarray(L, np.float64) for L in maps.values()], 2).reshape(
            height * width, -1
        )
        w, solid_angle = envmap.directions(height, width)
        w = w.reshape(-1, 3) @ frames.camera_from_light().T
        view = np.array([0.0, 0.0, 1.0])
        h = w + view
        length = np.linalg.norm(h, axis=-1)
        texels = dict(
            w=w,
            h=h / np.maximum(length, 1e-9)[:, None],
            cos_d=length / 2,
            solid_angle=solid_angle.ravel(),
        )
        n_theta, n_phi = (self.shape[0] - 1) * oversample[0], (self.shape[1] - 1) * oversample[1]
        gathered = np.empty(
            (self.rings, 3, self.azimuths, len(maps), self.theta_h.size), np.float32
        )
        for i, r in enumerate(radius):
            for j, a in enumerate((np.arange(self.azimuths) + 0.5) * 2 * np.pi / self.azimuths):
                z = np.sqrt(1 - r * r)
                n, x = (
                    np.array([r * np.cos(a), r * np.sin(a), z]),
                    np.array([-z * np.cos(a), -z * np.sin(a), r]),
                )
                y = np.cross(n, x)
                parts = [
                    _from_texels(texels, n, x, y, n_theta, n_phi),
                    _from_grid(
                        n, x, y, view, n_theta, n_phi, rng, (height, width), solid_angle[:, 0]
                    ),
                ]
                node, share, texel = (
                    np.concatenate(p)
                    for p in zip(*(self._onto_nodes(*p) for p in parts), strict=True)
                )
                for m in range(light.shape[1]):
                    gathered[i, m % 3, j, m // 3] = np.bincount(
                        node, share * light[texel, m], self.theta_h.size
                    )
        return gathered.reshape(self.rings, 3, self.azimuths * len(maps), -1)

    def _onto_nodes(self, theta_h, phi_h, weight, texel):
        """Return node indices, weights and texels of the bilinear shares, four per sample."""
        n_theta, n_phi = self.shape
        u = np.minimum((theta_h * 2 / np.pi) ** (1 / POWER), 1) * (n_theta - 1)
        q = np.abs(phi_h) / np.pi * (n_phi - 1)
        low_u, low_q = np.minimum(u.astype(int), n_theta - 2), np.minimum(q.astype(int), n_phi - 2)
        du, dq = u - low_u, q - low_q
        node = low_u * n_phi + low_q
        nodes = np.concatenate([node, node + 1, node + n_phi, node + n_phi + 1])
        shares = np.concatenate(
            [(1 - du) * (1 - dq), (1 - du) * dq, du * (1 - dq), du * dq]
        ) * np.tile(weight, 4)
        return nodes, shares, np.tile(texel, 4)


def _grid_density(theta_h, cos_d, n_theta, n_phi):
    """Return the solid angle of light that one cell of the half-vector grid covers."""
    u = (theta_h * 2 / np.pi) ** (1 / POWER)
    d_theta = np.pi / 2 * POWER * u ** (POWER - 1) / n_theta
    return 4 * cos_d * np.sin(theta_h) * d_theta * (np.pi / n_phi)


def _from_texels(texels, n, x, y, n_theta, n_phi):
    """Return one sample per texel above the horizon: θ_h, φ_h, weight (cos_i sr), texel."""
    cos_i = texels["w"] @ n
    above = np.flatnonzero((cos_i > HORIZON) & (texels["cos_d"] > 1e-3))
    h = texels["h"][above]
    along, across, up = h @ x, h @ y, h @ n
    sin_h = np.hypot(along, across)
    theta_h, phi_h = np.arctan2(sin_h, up), np.arctan2(across, along)
    own = texels["solid_angle"][above]
    other = np.maximum(_grid_density(theta_h, texels["cos_d"][above], n_theta, n_phi), 1e-12)
    return (
        theta_h,
        phi_h,
        cos_i[above] * own / (1 + np.minimum(own / (FINER * other), 1e9) ** 4),
        above,
    )


def _from_grid(n, x, y, view, n_theta, n_phi, rng, size, row_solid_angle):
    """Return one jittered sample per cell of the half-vector grid over the full turn.

    Returns  θ_h, φ_h, weight (cos_i sr), and the texel of its direction
    """
    u = (np.arange(n_theta)[:, None] + rng.random((n_theta, 2 * n_phi))) / n_theta
    phi_h = (np.arange(2 * n_phi) + rng.random((n_theta, 2 * n_phi))) / n_phi * np.pi - np.pi
    theta_h = (np.pi / 2 * u**POWER).ravel()
    phi_h = phi_h.ravel()
    sin_h = np.sin(theta_h)
    h = (
        (sin_h * np.cos(phi_h))[:, None] * x
        + (sin_h * np.sin(phi_h))[:, None] * y
        + np.cos(theta_h)[:, None] * n
    )
    cos_d = h @ view
    w = 2 * cos_d[:, None] * h - view
    cos_i = w @ n
    keep = (cos_i > HORIZON) & (cos_d > 1e-3)
    row, column = envmap.texel(w[keep] @ frames.camera_from_light(), *size)
    own = _grid_density(theta_h[keep], cos_d[keep], n_theta, n_phi)
    weight = cos_i[keep] * own / (1 + np.minimum(FINER * own / row_solid_angle[row], 1e9) ** 4)
    return theta_h[keep], phi_h[keep], weight, row * size[1] + column


def weighted_percentile(values: np.ndarray, weight: np.ndarray, percent: float) -> float:
    """Return the value below which `percent` of the weight lies.

    With equal weights it is numpy's percentile but for half a step.
    """
    order = np.argsort(values)
    cumulative = np.cumsum(weight[order])
    return float(
        np.interp(percent / 100 * cumulative[-1], cumulative - 0.5 * weight[order], values[order])
    )
