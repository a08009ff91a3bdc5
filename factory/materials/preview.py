"""A contact sheet of materials: a ball of each under one light map, from the label or from the
mixture that Cycles renders.
"""

import numpy as np
from PIL import Image, ImageDraw
from scipy.ndimage import map_coordinates

from factory.materials.recipe import label_on
from factory.materials.sphere import Sphere
from shaders import tone
from shaders.tone import LUMINANCE

CAPTION = 12  # pixels below a ball
GROUND = 24  # display value around the balls
# percentile of a ball's luminance that reaches white, if the ball is brighter than a white one
WHITE_AT = 98.0


def contact_sheet(materials, L, size, columns, of, watch=lambda items: items):
    """The contact sheet as a PIL image.

    materials  [Material], in the order of the sheet
    L          (height, width, 3) light map, light frame, unit mean
    of         "label", "nodes" or "both" (label left half, nodes right half)
    watch      wraps the iterable, to show progress
    """
    rings = max(16, size // 3)
    sphere = Sphere(
        {"light": L}, np.random.default_rng(0), rings, 4 * rings // 2, n_theta=96, n_phi=9
    )
    white = sphere.picture(np.full((rings, sphere.theta_h.size, 3), 1 / np.pi))
    exposure = 1.0 / np.percentile(white @ LUMINANCE, 95)
    rows = -(-len(materials) // columns)
    picture = Image.new("RGB", (columns * size, rows * (size + CAPTION)), (GROUND,) * 3)
    draw = ImageDraw.Draw(picture)
    for i, material in enumerate(watch(materials)):
        x, y = i % columns * size, i // columns * (size + CAPTION)
        picture.paste(
            Image.fromarray(material_sphere(sphere, material, size, of, exposure)), (x, y)
        )
        text = (
            material.name
            if len(material.name) * 6 <= size
            else material.name[: size // 6 - 1] + "…"
        )
        draw.text((x + size // 2, y + size), text, fill=(190,) * 3, anchor="ma", font_size=10)
    return picture


def material_sphere(sphere, material, size, of, exposure):
    """(size, size, 3) uint8."""
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
    display = tone.display(radiance, min(exposure, 1 / max(brightest, 1e-9)))
    return np.round(coverage(size)[..., None] * (display - GROUND) + GROUND).astype(np.uint8)


def _polar(size):
    """Radius and angle of pixel centres, row 0 at the top; the ball fills 94 % of the square."""
    x = ((np.arange(size) + 0.5) / size * 2 - 1) / 0.94
    x, y = np.meshgrid(x, -x)
    return np.hypot(x, y), np.arctan2(y, x) % (2 * np.pi)


def coverage(size):
    """(size, size): share of each pixel inside the ball, for a soft edge."""
    return np.clip((1 - _polar(size)[0]) * size * 0.47 + 0.5, 0, 1)


def on_pixels(rings, size):
    """A picture (R, A, 3) in rings and azimuths as (size, size, 3), bilinear."""
    R, A = rings.shape[:2]
    radius, angle = _polar(size)
    wrapped = np.concatenate([rings[:, -1:], rings, rings[:, :1]], axis=1)
    at = np.clip(radius * R - 0.5, 0, R - 1), angle / (2 * np.pi) * A + 0.5
    return np.stack([map_coordinates(wrapped[..., c], at, order=1) for c in range(3)], -1)
