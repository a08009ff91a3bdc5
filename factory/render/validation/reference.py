"""Reference radiance of a unit sphere, by closed form and quadrature, to compare Cycles with.

L      (height, width, 3), the map as the camera sees it (light.as_seen), stored layout, light frame
n, v   camera frame; v towards the viewer: (0, 0, 1), because the camera is orthographic
spots  (P, 2), points in the picture plane; the sphere's radius is 1, x points right and y up

The light is constant over a texel, as with nearest look-up; `dense` takes each texel as one
direction, as the layer does.
"""

import numpy as np
from scipy.stats import qmc

from shaders import closures, envmap, frames
from shaders.mixture import Mixture


def sphere_normals(spots: np.ndarray) -> np.ndarray:
    """Return the normals (P, 3), camera frame, of the unit sphere at spots (P, 2)."""
    r2 = (spots**2).sum(-1)
    return np.concatenate([spots, np.sqrt(np.maximum(1 - r2, 0))[:, None]], axis=-1)


def pixel_spots(size: int, half_extent: float) -> np.ndarray:
    """Return the points (size, size, 2) at the centres of a square frame's pixels."""
    x, y = frames.pixel_grid(size, size)
    return np.stack([x, y], axis=-1) * half_extent


def camera_directions(
    height: int, width: int, elevation: float = frames.ELEVATION
) -> tuple[np.ndarray, np.ndarray]:
    """Return directions (height·width, 3), camera frame, and solid angles of a map's texels."""
    w, solid_angle = envmap.directions(height, width)
    return w.reshape(-1, 3) @ frames.camera_from_light(elevation).T, solid_angle.ravel()


def dense(
    mixture: Mixture, normals: np.ndarray, L: np.ndarray, view: np.ndarray | None = None
) -> np.ndarray:
    """Return radiance (P, 3) of normals (P, 3) by the layer's sum, with one direction per texel.

    view  (P, 3), None: (0, 0, 1)
    """
    w, solid_angle = camera_directions(*L.shape[:2])
    light = L.reshape(-1, 3).astype(np.float64) * solid_angle[:, None]
    used = light.max(-1) > 0
    w, light = w[used], light[used]
    view = np.broadcast_to(np.array([0.0, 0.0, 1.0]), normals.shape) if view is None else view
    radiance = np.empty((len(normals), 3))
    for p, (n, v) in enumerate(zip(normals.astype(np.float64), view, strict=True)):
        cos_i, cos_o = w @ n, float(v @ n)
        lit = cos_i > closures.MIN_COS
        h = w[lit] + v
        h /= np.maximum(np.linalg.norm(h, axis=-1, keepdims=True), 1e-12)
        f = mixture.evaluate(
            cos_i[lit], cos_o, np.clip(h @ n, 1e-9, 1.0), np.clip(h @ v, 1e-9, 1.0)
        )
        radiance[p] = np.einsum("lc,l,lc->c", f, cos_i[lit], light[lit])
    return radiance


def look_up(L: np.ndarray, w: np.ndarray, elevation: float = frames.ELEVATION) -> np.ndarray:
    """Return the radiance (…, 3) of the texel around each direction w (…, 3), camera frame."""
    return L[envmap.texel(w @ frames.camera_from_light(elevation), *L.shape[:2])]


def soft_light(height: int = 64, width: int = 128) -> np.ndarray:
    """Return a coloured light (height, width, 3) of unit mean without sharp edges.

    Its contrast is about 1 : 20, so that either renderer has little noise.
    """
    w, _ = envmap.directions(height, width)
    lamps = (
        ((0.3, 0.8, 0.5), (3.0, 2.6, 2.0)),
        ((-0.8, 0.2, 0.4), (0.6, 1.2, 2.2)),
        ((0.6, -0.1, -0.8), (1.5, 0.7, 0.4)),
    )
    L = np.full((height, width, 3), 0.3)
    for towards, colour in lamps:
        axis = np.array(towards) / np.linalg.norm(towards)
        L += np.exp(6 * (w @ axis - 1))[..., None] * np.array(colour)
    return envmap.unit_mean(L)[0]


def integrate(
    mixture: Mixture, spots: np.ndarray, width: float, L: np.ndarray, points: int, seed: int
) -> np.ndarray:
    """Return radiance (P, 3) of square pixels, by quasi Monte Carlo over pixel and hemisphere.

    Each closure is sampled by a density of its own.

    spots   (P, 2), centres of pixels that lie within the sphere
    width   of a pixel in the picture plane
    points  of each closure, a power of 2
    seed    of the Sobol sequence's scrambling; errors of different seeds are independent
    """
    radiance = np.zeros((len(spots), 3))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(len(mixture.kinds),)))
    for k, kind in enumerate(mixture.kinds):
        sobol = qmc.Sobol(
            4, seed=np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(k,)))
        ).random(points)
        for p, spot in enumerate(spots):
            # each pixel has its own shift, so that errors do not add up over the picture
            u = (sobol + rng.random(4)) % 1.0
            n = sphere_normals(spot + (u[:, :2] - 0.5) * width)
            log_alpha, tilt, weights = mixture.at(n[:, 2])
            alpha, tilt, weights = np.exp(log_alpha[:, k]), tilt[:, k], weights[:, k]
            sample = _matte if kind in ("diffuse", "sheen") else _glossy
            w, density = sample(n, alpha, tilt, u[:, 2:])
            cos_i, h = (w * n).sum(-1), w + np.array([0.0, 0.0, 1.0])
            h /= np.maximum(np.linalg.norm(h, axis=-1, keepdims=True), 1e-12)
            lit = (cos_i > closures.MIN_COS) & (density > 0)
            cosines = (
                cos_i[lit],
                n[lit, 2],
                np.clip((h * n).sum(-1)[lit], 1e-9, 1.0),
                np.clip(h[lit, 2], 1e-9, 1.0),
            )
            f = closures.evaluate(kind, alpha[lit], tilt[lit], *cosines) * cos_i[lit] / density[lit]
            radiance[p] += np.einsum("q,qc,qc->c", f, weights[lit], look_up(L, w[lit])) / points
    return radiance


def _frame(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors perpendicular to each n (P, 3)."""
    other = np.where(np.abs(n[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    a = np.cross(n, other)
    a /= np.linalg.norm(a, axis=-1, keepdims=True)
    return a, np.cross(n, a)


def _around(axis: np.ndarray, cosine: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return unit vectors with `cosine` to the axis (P, 3), turned by `angle` about it."""
    a, b = _frame(axis)
    sine = np.sqrt(np.maximum(1 - cosine**2, 0))
    return (
        sine[:, None] * (np.cos(angle)[:, None] * a + np.sin(angle)[:, None] * b)
        + cosine[:, None] * axis
    )


def _matte(
    n: np.ndarray, alpha: np.ndarray, tilt: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return directions, uniform over the hemisphere, and their density."""
    return _around(n, u[:, 0], 2 * np.pi * u[:, 1]), np.full(len(n), 1 / (2 * np.pi))


def _glossy(
    n: np.ndarray, alpha: np.ndarray, tilt: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return directions whose half vectors follow GGX about the tilted normal, and their density.

    The density is 0 where the half vector faces away from the viewer.
    """
    v = np.array([0.0, 0.0, 1.0])
    leaning = n + tilt[:, None] * (v - n[:, 2:] * n)
    leaning /= np.linalg.norm(leaning, axis=-1, keepdims=True)
    cos2 = (1 - u[:, 0]) / (1 + (alpha**2 - 1) * u[:, 0])
    h = _around(leaning, np.sqrt(cos2), 2 * np.pi * u[:, 1])
    d = alpha**2 / (np.pi * ((1 - cos2) + alpha**2 * cos2) ** 2)
    facing = h[:, 2] > 1e-6
    density = np.where(facing, d * np.sqrt(cos2) / (4 * np.where(facing, h[:, 2], 1.0)), 0.0)
    return 2 * h[:, 2:] * h - v, density
