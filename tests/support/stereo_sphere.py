"""A photograph of a sphere with its disparities, as stereo_scenes of the experiments reads them."""

import json

import numpy as np
from PIL import Image

FOCAL, BASELINE, OFFSET = 600.0, 100.0, 20.0
RADIUS, DISTANCE = 50.0, 500.0


def sphere(size):
    """(disparities (size, size), NaN beside the sphere; its normals in the camera frame)"""
    y, x = np.indices((size, size)) - (size - 1) / 2
    ray = np.stack([x, -y, np.full_like(x, -FOCAL)], -1) / FOCAL
    centre = np.array([0.0, 0.0, -DISTANCE])
    a, b = (ray * ray).sum(-1), ray @ centre
    inside = b * b - a * (centre @ centre - RADIUS**2)
    t = (b - np.sqrt(np.maximum(inside, 0))) / a
    n = (t[..., None] * ray - centre) / RADIUS
    disparity = np.where(inside > 0, FOCAL * BASELINE / np.maximum(t, 1e-9) - OFFSET, np.nan)
    return disparity, n


def written(folder, size=128, step=0.0, **changes):
    """Write scenes.json, a picture, a mask and disparities into a folder; return the first."""
    folder.mkdir()
    disparity, n = sphere(size)
    mask = np.isfinite(disparity)
    grey = np.where(mask, 60 + 150 * np.clip(n[..., 2], 0, 1), 20).astype(np.uint8)
    Image.fromarray(np.repeat(grey[..., None], 3, 2)).save(folder / "sphere.png")
    Image.fromarray((255 * mask).astype(np.uint8)).save(folder / "mask.png")
    if step:
        whole = np.where(mask, np.rint(disparity / step) * step, 0).astype(np.uint8)
        Image.fromarray(whole).save(folder / "disparity.png")
    np.savez(folder / "disparity.npz", disparity.astype(np.float32))
    scene = {
        "name": "sphere",
        "about": "computed",
        "picture": "sphere.png",
        "disparity": "disparity.png" if step else "disparity.npz",
        "focal": FOCAL,
        "centre": [(size - 1) / 2] * 2,
        "baseline_mm": BASELINE,
        "offset": OFFSET,
        "offset_error": 1.0,
        "step": step,
        "window": 3.0,
        "objects": {"ball": "mask.png"},
        "shapes": {"ball": "ball"},
    }
    path = folder / "scenes.json"
    path.write_text(json.dumps({"scenes": [scene | changes]}))
    return path
