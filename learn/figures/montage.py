"""What an edit looks like beside what it was made from: labelled tiles, balls of materials, and the
reflectance map as in Figure 14.

Tiles are (size, size, 3) display values in [0, 255]; a reflectance map is the picture of a sphere:
radiance by normal.
"""

import numpy as np
import torch
from PIL import Image, ImageDraw
from scipy.ndimage import distance_transform_edt

from learn.data.devices import array
from learn.layer import render
from learn.layer.display_method import method_for
from shaders import tone

BORDER, CAPTION, GROUND = 4, 14, 32.0
HOLE = 0.06  # of the sphere's radius: farther from any pixel's normal nothing was observed


def tile(display, size):
    """A display picture (H, W, 3) fitted into a square."""
    H, W = display.shape[:2]
    height, width = max(1, round(size * H / max(H, W))), max(1, round(size * W / max(H, W)))
    small = Image.fromarray(np.clip(display, 0, 255).astype(np.uint8)).resize(
        (width, height), Image.Resampling.LANCZOS
    )
    out = np.full((size, size, 3), GROUND)
    top, left = (size - height) // 2, (size - width) // 2
    out[top : top + height, left : left + width] = small
    return out


def rows(lines, size):
    """One picture of lines of (caption, display picture or None) pairs."""
    columns = max(len(line) for line in lines)
    step_y, step_x = size + CAPTION + BORDER, size + BORDER
    canvas = Image.new(
        "RGB", (columns * step_x + BORDER, len(lines) * step_y + BORDER), (int(GROUND) // 2,) * 3
    )
    draw = ImageDraw.Draw(canvas)
    for i, line in enumerate(lines):
        for j, (caption, picture) in enumerate(line):
            if picture is None:
                continue
            x, y = BORDER + j * step_x, BORDER + i * step_y
            draw.text((x, y), fitting(caption, size // 6), fill=(230, 230, 230))
            canvas.paste(
                Image.fromarray(np.clip(tile(picture, size), 0, 255).astype(np.uint8)),
                (x, y + CAPTION),
            )
    return np.asarray(canvas)


def fitting(caption, length):
    """A caption of at most `length` letters: of a longer one its beginning and its end."""
    half = (length - 1) // 2
    return (
        caption if len(caption) <= length else f"{caption[:half]}…{caption[len(caption) - half :]}"
    )


def normals(n, mask):
    """n (H, W, 3) camera frame as colours."""
    return (n * 0.5 + 0.5) * 255 * mask[..., None]


def light(L):
    """A light map (64, 128, 3) at half exposure."""
    return tone.display(L, 0.5)


def sphere(size):
    """Normals (size, size, 3) of a sphere that fills the square, 0 outside."""
    at = (np.arange(size) + 0.5) / size * 2.04 - 1.02
    x, y = np.meshgrid(at, -at)
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, 1))
    return (np.stack([x, y, z], -1) * (z > 0)[..., None]).astype(np.float32)


def material_sphere(label, L, size, elevation, exposure):
    """Display picture of a ball of a material, label (108,), under a light map (Hl, Wl, 3);
    rendered where the label is.
    """
    label = torch.as_tensor(label, dtype=torch.float32)
    n, light = (
        torch.from_numpy(sphere(size))[None].to(label.device),
        torch.as_tensor(L, dtype=torch.float32)[None],
    )
    light = light.to(label.device).contiguous()
    with torch.no_grad():
        radiance = render(
            n, label.exp()[None], light, method=method_for(label), elevation=elevation
        )
    return tone.display(array(radiance[0]), exposure)


def preview_lighting():
    """A plain light for balls of materials: bright above, one window."""
    L = np.full((32, 64, 3), 0.4, np.float32)
    L[:16] = 0.9
    L[6:12, 8:16] = 12.0
    return L


def observed(radiance, n, mask, size, exposure):
    """The reflectance map that a picture shows: its pixels averaged at their normals' place on the
    sphere; grey where none lies.

    radiance, n  (H, W, 3); mask (H, W)
    """
    place = ((n[mask][:, :2] * [1, -1] / 1.02 + 1) * (size / 2)).astype(int).clip(0, size - 1)
    flat = place[:, 1] * size + place[:, 0]
    count = np.bincount(flat, minlength=size * size)
    sums = np.stack([np.bincount(flat, radiance[mask][:, k], size * size) for k in range(3)], -1)
    mean = (sums / np.maximum(count, 1)[:, None]).reshape(size, size, 3)
    distance, index = distance_transform_edt(count.reshape(size, size) == 0, return_indices=True)
    near = (distance < HOLE * size / 2) & (sphere(size)[..., 2] > 0)
    return np.where(near[..., None], tone.display(mean[tuple(index)], exposure), GROUND)
