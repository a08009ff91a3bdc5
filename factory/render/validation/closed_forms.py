"""Measurements of Cycles against formulas: figures for docs/results/rendering and for the tests.

Each function takes a Studio, sets it up, and returns a dictionary of figures. The unit sphere
stands for all shapes, because it has every normal, and each is known. Where a figure is about
shading, pixels at the silhouette are left out: the sphere covers them in part.
"""

from typing import Any

import numpy as np

from factory.render import light
from factory.render.camera import view_vectors
from factory.render.studio import Studio
from factory.render.validation import reference
from factory.shapes.primitives import sphere
from manifests.schema import Camera
from shaders import envmap, frames
from shaders.mixture import Mixture

GLOSSY = ("ggx", "beckmann", "ashikhmin_shirley")
SINGLE = {
    "diffuse": Mixture.lambert([0.5, 0.4, 0.3]),
    "sheen α .5": Mixture.constant("sheen", 0.5, [0.5] * 3),
    **{
        f"{kind} α {a}": Mixture.constant(kind, a, [0.5] * 3)
        for kind in GLOSSY
        for a in (0.5, 0.1, 0.02)
    },
    **{
        f"{kind} α .15 tilt {t}": Mixture.constant(kind, 0.15, [0.5] * 3, tilt=t)
        for kind in GLOSSY
        for t in (0.3, -0.12)
    },
}


def angle_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angles (…) in degrees between vectors (…, 3); precise near 0."""
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1)))


def _sphere(
    studio: Studio, size: int, level: int = 6, azimuth: float = 0.7, fov_deg: float | None = None
) -> None:
    """Show the unit sphere."""
    studio.set_camera(Camera(size=(size, size), fov_deg=fov_deg))
    studio.set_shape(sphere(level))
    studio.set_view(azimuth)


def _takes(studio: Studio, samples: int, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return mean, variance (height, width, 3) and all of `count` pictures of different seeds."""
    pictures = np.array(
        [studio.render(samples, seed, "direct") for seed in range(count)], dtype=np.float64
    )
    return pictures.mean(0), pictures.var(0, ddof=1), pictures


def _pool(variance: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Return the variance averaged over 5 × 5 pixels inside the mask.

    The variance of a few pictures alone is too uncertain for a 5 σ test.
    """
    from scipy.ndimage import uniform_filter

    total = uniform_filter(variance * inside[..., None], (5, 5, 0), mode="constant")
    return (
        total
        / np.maximum(uniform_filter(inside.astype(float), 5, mode="constant"), 1e-9)[..., None]
    )


def lit_texel(
    studio: Studio, rng: np.random.Generator, directions: int = 64, samples: int = 16
) -> dict[str, Any]:
    """Return the angles between the normals at which a matte sphere peaks in Cycles and by formula.

    One texel of the light is lit; views and rotations are random. Both peaks are fitted: radiance =
    a · n over the pixels that are lit and clearly in front. The first four texels lie in the poles'
    rows, where a texel's middle, which the layer uses, and its centre of area are .47° apart.

    Returns  max_deg, median_deg, degrees (directions,)
    """
    _sphere(studio, 64, level=5)
    studio.set_materials([Mixture.lambert([0.5] * 3)])
    w, solid_angle = envmap.directions(64, 128)
    degrees: list[float] = []
    while len(degrees) < directions:
        column, turn = map(int, rng.integers(128, size=2))
        row = (0, 1, 62, 63)[len(degrees)] if len(degrees) < 4 else int(rng.integers(64))
        towards = frames.camera_from_light() @ w[row, (column + turn) % 128]
        if towards[2] < 0 and len(degrees) >= 4:
            continue  # from behind: no peak is visible
        L = np.zeros((64, 128, 3), np.float32)
        L[row, column] = 100 / solid_angle[row, column]
        studio.set_view(rng.uniform(0, 2 * np.pi))
        studio.set_light(L, turn)
        n = studio.geometry().normals.astype(np.float64)
        result = studio.render(samples, len(degrees))[..., 0].astype(np.float64)
        requested = np.maximum(n @ towards, 0)
        front = n[..., 2] > 0.4
        lit = front & (requested > 0.05)
        peaks = [
            np.linalg.lstsq(n[lit], picture[lit], rcond=None)[0] for picture in (result, requested)
        ]
        degrees.append(float(angle_deg(*peaks)))
    return {"max_deg": max(degrees), "median_deg": float(np.median(degrees)), "degrees": degrees}


def lambert(
    studio: Studio,
    L: np.ndarray,
    samples: int = 32,
    seeds: int = 16,
    size: int = 64,
    rotation: int = 37,
) -> dict[str, Any]:
    """Compare a matte sphere, direct tier and nearest light, with the dense sum over its normals.

    Only pixels with n·v > .3 count: nearer to the silhouette, a pixel's mean differs from the value
    at its centre by more than the noise.

    Returns  relative_mean; largest_sigma, rms_sigma of the pixels; noise: one picture's, relative
    """
    _sphere(studio, size)
    mixture = Mixture.lambert([0.5] * 3)
    studio.set_materials([mixture])
    studio.set_light(L, rotation)
    n = studio.geometry().normals
    inside = n[..., 2] > 0.3
    mean, variance, _ = _takes(studio, samples, seeds)
    requested = np.zeros_like(mean)
    requested[inside] = reference.dense(mixture, n[inside], light.as_seen(L, rotation))
    sigma = np.sqrt(_pool(variance, inside)[inside] / seeds)
    z = (mean - requested)[inside] / sigma
    return {
        "relative_mean": float((mean - requested)[inside].sum() / requested[inside].sum()),
        "largest_sigma": float(np.abs(z).max()),
        "rms_sigma": float(np.sqrt((z**2).mean())),
        "noise": float(np.sqrt(variance[inside].mean()) / requested[inside].mean()),
    }


def closed_form(
    studio: Studio,
    mixture: Mixture,
    samples: int = 128,
    seeds: int = 16,
    size: int = 32,
    points: int = 4096,
    rotation: int = 11,
    pattern: str = "TABULATED_SOBOL",
) -> dict[str, Any]:
    """Compare a mixture on a sphere under a soft light with its integral over pixel and hemisphere.

    pattern  cycles.sampling_pattern; that of pictures has a bias of its own where a mixture has
             several closures (docs/log.md)

    bias, bias_sigma            relative mean difference, and its standard deviation
    rms_sigma, rms_sigma_noise  root mean square of the pixels' differences over their noise, which
                                is 1 if there is no bias, and its standard deviation (the noise of a
                                narrow lobe is in few pixels, which raises it)
    samples                     of all pictures together
    """
    _sphere(studio, size)
    L = reference.soft_light()
    studio.set_light(L, rotation)
    studio.set_materials([mixture])
    spots, width = reference.pixel_spots(size, 1.02), 2 * 1.02 / size
    inside = np.linalg.norm(np.abs(spots) + width / 2, axis=-1) < 0.9
    with studio.sample_by(pattern):
        mean, variance, pictures = _takes(studio, samples, seeds)
    seen = light.as_seen(L, rotation)
    a, b = (
        reference.integrate(mixture, spots[inside], width, seen, points, seed) for seed in (0, 1)
    )
    requested, reference_variance = (a + b) / 2, ((a - b) ** 2).mean(0) / 4
    # (3,): pooled over the sphere, per channel
    total = variance[inside].mean(0) / seeds + reference_variance
    difference = mean[inside] - requested
    # a picture's mean varies more than its pixels' variance suggests: they share a table of samples
    mean_variance = pictures[:, inside].mean((1, 2)).var(
        ddof=1
    ) / seeds + reference_variance.mean() / len(requested)
    weight = variance[inside] / seeds / total  # how much of the noise each value carries
    values = weight.sum() ** 2 / (weight**2).sum()
    return {
        "bias": float(difference.sum() / requested.sum()),
        "bias_sigma": float(np.sqrt(mean_variance) / requested.mean()),
        "rms_sigma": float(np.sqrt((difference**2 / total).mean())),
        "rms_sigma_noise": float(np.sqrt(0.5 / values)),
        "samples": samples * seeds,
    }


def geometry(
    studio: Studio, size: int = 128, level: int = 6, azimuth: float = 0.3
) -> dict[str, Any]:
    """Compare Blender's normals of a sphere with analytic ones, inside the silhouette.

    max_deg, rms_deg  of the angles between them
    length_error      largest | |n| − 1 |
    mask_pixels       number of pixels whose mask differs from that of the disc
    depth_error       largest, world units
    """
    _sphere(studio, size, level, azimuth)
    shot = studio.geometry()
    spots = reference.pixel_spots(size, 1.02)
    radius = np.hypot(*spots.transpose(2, 0, 1))
    requested = reference.sphere_normals(spots.reshape(-1, 2)).reshape(size, size, 3)
    inside = shot.mask & (radius < 0.99)
    difference = angle_deg(shot.normals[inside].astype(np.float64), requested[inside])
    return {
        "max_deg": float(difference.max()),
        "rms_deg": float(np.sqrt((difference**2).mean())),
        "length_error": float(
            np.abs(np.linalg.norm(shot.normals[shot.mask].astype(np.float64), axis=-1) - 1).max()
        ),
        "mask_pixels": int((shot.mask != (radius < 1)).sum()),
        "depth_error": float(np.abs(shot.depth[inside] + requested[inside][:, 2]).max()),
    }


def perspective(
    studio: Studio, fov_deg: float = 40.0, samples: int = 64, seeds: int = 8, size: int = 48
) -> dict[str, Any]:
    """Compare a sphere of GGX α .3 over matte, seen in perspective, with the dense sum.

    relative_mean, rms_sigma  with the view vectors of shaders.frames.view_vectors
    distant_rms_sigma         with one view vector for all pixels, as of a distant viewer
    """
    _sphere(studio, size, fov_deg=fov_deg)
    mixture = Mixture(
        ("diffuse", "ggx"),
        np.array([0.0]),
        np.array([[0.0, np.log(0.3)]]),
        np.array([[0.0, 0.0]]),
        np.array([[[0.3, 0.2, 0.1], [0.4, 0.4, 0.4]]]),
    )
    L = reference.soft_light()
    studio.set_light(L, 5)
    studio.set_materials([mixture])
    n, view = studio.geometry().normals, view_vectors(Camera(size=(size, size), fov_deg=fov_deg))
    inside = (n * view).sum(-1) > 0.5
    mean, variance, _ = _takes(studio, samples, seeds)
    seen = light.as_seen(L, 5)
    requested, distant = (
        reference.dense(mixture, n[inside], seen, v) for v in (view[inside], None)
    )
    sigma = np.sqrt(_pool(variance, inside)[inside] / seeds)
    return {
        "relative_mean": float((mean[inside] - requested).sum() / requested.sum()),
        "rms_sigma": float(np.sqrt((((mean[inside] - requested) / sigma) ** 2).mean())),
        "distant_rms_sigma": float(np.sqrt((((mean[inside] - distant) / sigma) ** 2).mean())),
    }
