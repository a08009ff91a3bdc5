"""Scenes as factory.render.validation.objects_in_rooms writes them: a shaded ball before a wall."""

import json

import numpy as np
from PIL import Image

from manifests import exr

ALBEDOS = {"white-marble": 0.7, "violet-rubber": 0.15}  # by material; what the frames show


def written(folder, size=64, scenes=1, lamp=(1.0, 1.0, 1.0)):
    """Write scenes of one ball in two materials into a folder, each before a wall of its own.

    lamp  colour of the light
    """
    y, x = (np.indices((size, size)) - (size - 1) / 2) / (size / 3)
    coverage = np.clip((1 - np.hypot(x, y)) * size / 3 + 0.5, 0, 1)
    inside = coverage >= 0.5
    for number in range(scenes):
        place = folder / f"{number:04d}"
        place.mkdir(parents=True)
        for name, albedo in ALBEDOS.items():
            shaded = albedo * (0.6 + 0.4 * np.where(coverage > 0, -y, 0.0))
            L = coverage * shaded + (1 - coverage) * (0.2 + 0.1 * number)
            channels = zip("RGB", lamp, strict=True)
            exr.write(place / f"{name}.exr", {c: (L * k).astype(np.float32) for c, k in channels})
        Image.fromarray((255 * inside).astype(np.uint8)).save(place / "mask.png")
        Image.fromarray(np.rint(255 * coverage).astype(np.uint8)).save(place / "coverage.png")
        scene = {
            "shape": "sphere",
            "shape_hash": "5" * 64,
            "category": "sphere",
            "place": "room",
            "seed": number,
            "materials": list(ALBEDOS),
            "azimuth_deg": 0.0,
            "elevation_deg": 20.0,
            "distance": 1.0,
        }
        if number:  # the first is as scenes were before surroundings could vary
            scene["surroundings"] = "varied"
        (place / "scene.json").write_text(json.dumps(scene))
