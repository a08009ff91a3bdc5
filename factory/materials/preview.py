"""A contact sheet of materials: a sphere of each under one light map.

The spheres show the label or the mixture that Cycles renders.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from PIL import Image, ImageDraw
from scipy.ndimage import map_coordinates

from factory.materials.recipe import label_on
from factory.materials.sphere import Sphere
from manifests import captions
from manifests.materials import Material
from shaders import tone
from shaders.tone import LUMINANCE

GROUND = 24  # display value around the spheres
# percentile of a sphere's luminance that reaches white, if it is brighter than a white sphere
WHITE_AT = 98.0


def contact_sheet(
    materials: Sequence[Material],
    L: np.ndarray,
    size: int,
    columns: int,
    of: str,
    watch: Callable[[Iterable[Material]], Iterable[Material]] = lambda items: items,
) -> Image.Image:
    """Return the contact sheet as a PIL image.

    materials  in the order of the sheet
    L          (height, width, 3) light map, light frame, unit mean
    of         "label", "nodes" or "both" (label in the upper half, nodes in the lower half)
    watch      wraps the iterable, to show progress
    """
    sphere, exposure = light_sphere(L, size)
    rows = -(-len(materials) // columns)
    picture = Image.new("RGB", (columns * size, rows * (size + captions.LINE)), (GROUND,) * 3)
    draw = ImageDraw.Draw(picture)
    for i, material in enumerate(watch(materials)):
        x, y = i % columns * size, i // columns * (size + captions.LINE)
        picture.paste(
            Image.fromarray(material_sphere(sphere, material, size, of, exposure)), (x, y)
        )
        below = (x + size // 2, y + size)
        captions.write_caption(draw, below, material.name, size, fill=(190,) * 3, anchor="ma")
    return picture


def light_sphere(L: np.ndarray, size: int) -> tuple[Sphere, float]:
    """Return the light gathered for pictures of that size, and a white sphere's exposure.

    L  (height, width, 3) light map, light frame
    """
    rings = max(16, size // 3)
    sphere = Sphere(
        {"light": L}, np.random.default_rng(0), rings, 4 * rings // 2, n_theta=96, n_phi=9
    )
    white = sphere.picture(np.full((rings, sphere.theta_h.size, 3), 1 / np.pi))
    return sphere, 1.0 / float(np.percentile(white @ LUMINANCE, 95))


def cut_out_sphere(sphere: Sphere, material: Material, size: int, exposure: float) -> np.ndarray:
    """Return a picture (size, size, 4) uint8 of a sphere of a mixture, transparent around it."""
    display = _display(sphere, material, size, "nodes", exposure)
    return np.round(np.dstack([display, 255 * coverage(size)])).astype(np.uint8)


def material_sphere(
    sphere: Sphere, material: Material, size: int, of: str, exposure: float
) -> np.ndarray:
    """Return a picture (size, size, 3) uint8 of a sphere of one material."""
    display = _display(sphere, material, size, of, exposure)
    return np.round(coverage(size)[..., None] * (display - GROUND) + GROUND).astype(np.uint8)


def _display(sphere: Sphere, material: Material, size: int, of: str, exposure: float) -> np.ndarray:
    """Return display values (size, size, 3) of a sphere that fills the square's corners too."""
    nodes = sphere.nodes()
    label = (
        on_pixels(sphere.picture(label_on(material.label, nodes))[:, :, 0], size)
        if of != "nodes"
        else None
    )
    mixture = (
        on_pixels(sphere.picture(material.mixture.evaluate(*nodes))[:, :, 0], size)
        if of != "label"
        else None
    )
    radiance = (
        label
        if mixture is None
        else (
            mixture
            if label is None
            else np.where(np.arange(size)[:, None] * 2 < size, label, mixture)
        )
    )
    brightest = np.percentile(radiance @ LUMINANCE, WHITE_AT)
    return tone.display(radiance, min(exposure, 1 / max(brightest, 1e-9)))


def _polar(size):
    """Return radius and angle of pixel centres, row 0 at the top.

    The sphere fills 94 % of the square.
    """
    x = ((np.arange(size) + 0.5) / size * 2 - 1) / 0.94
    x, y = np.meshgrid(x, -x)
    return np.hypot(x, y), np.arctan2(y, x) % (2 * np.pi)


def coverage(size: int) -> np.ndarray:
    """Return the share (size, size) of each pixel inside the sphere, for a soft edge."""
    return np.clip((1 - _polar(size)[0]) * size * 0.47 + 0.5, 0, 1)


def on_pixels(rings: np.ndarray, size: int) -> np.ndarray:
    """Return a picture (R, A, 3) in rings and azimuths as (size, size, 3), bilinear."""
    R, A = rings.shape[:2]
    radius, angle = _polar(size)
    wrapped = np.concatenate([rings[:, -1:], rings, rings[:, :1]], axis=1)
    at = np.clip(radius * R - 0.5, 0, R - 1), angle / (2 * np.pi) * A + 0.5
    return np.stack([map_coordinates(wrapped[..., c], at, order=1) for c in range(3)], -1)
