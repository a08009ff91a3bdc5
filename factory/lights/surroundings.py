"""Surfaces as real surroundings have them: dark and coloured ones, wood, tiles, cloth and prints.

The surfaces of factory.lights.interiors are plain and mostly pale. `varied` gives a plan other
ones, drawn from a seed, and leaves everything else as it is: sizes, windows, lamps, furniture.
"""

import colorsys
import dataclasses
from typing import Any

import numpy as np

from factory.lights.interiors import Material, Pattern, Scene, Triple
from shaders.tone import LUMINANCE

KINDS = ("wood", "tiles", "bricks", "stripes", "checks", "weave", "dots", "patches", "mottled",
         "marble")  # fmt: skip
PLAIN = "plain"
# for each part of a scene: how often each kind occurs; sizes in metres; how often it is pale
PARTS: dict[str, tuple[dict[str, float], tuple[float, float], float]] = {
    "wall": (
        {PLAIN: 8, "wood": 2, "bricks": 2, "stripes": 2, "dots": 1, "patches": 1, "tiles": 2,
         "mottled": 2},
        (0.08, 0.3),
        0.5,
    ),
    "floor": (
        {PLAIN: 2, "wood": 8, "tiles": 4, "mottled": 3, "checks": 1, "weave": 1, "patches": 1},
        (0.1, 0.5),
        0.1,
    ),
    "ground": (
        {PLAIN: 1, "mottled": 8, "tiles": 3, "bricks": 3, "patches": 2, "wood": 1},
        (0.1, 0.8),
        0.1,
    ),
    "building": ({PLAIN: 3, "tiles": 5, "bricks": 5, "mottled": 2, "stripes": 2}, (0.5, 3.0), 0.3),
    "picture": ({PLAIN: 1, "patches": 4, "mottled": 3, "stripes": 1, "marble": 1}, (0.1, 0.4), 0.1),
    "table": (
        {PLAIN: 5, "wood": 9, "weave": 2, "stripes": 1, "dots": 1, "checks": 1, "marble": 2},
        (0.02, 0.12),
        0.2,
    ),
    "furniture": (
        {PLAIN: 7, "wood": 5, "weave": 3, "stripes": 2, "dots": 1, "patches": 1, "mottled": 2},
        (0.03, 0.15),
        0.2,
    ),
}  # fmt: skip
DARK_TO_PALE = (0.03, 0.9)  # reflectance, evenly in its logarithm
PALE = (0.5, 0.9)
WOOD_HUES = (0.05, 0.11)  # of 1: from reddish to yellowish brown
GLOSSY = {"table": 0.4, "floor": 0.25}  # how often a part is polished
POLISHED = (0.02, 0.15)  # roughness


def varied(scene: Scene, seed: int) -> Scene:
    """Return a plan whose surfaces, but for ceilings and lamps, are drawn from a seed.

    Things of one material stay alike, such as the parts of a wall about a window.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(212,)))
    known: dict[Material, Material] = {}

    def dressed(thing: Any) -> Any:
        old = thing.material
        if old not in known:
            known[old] = surface(rng, old.part, old.metallic) if old.part in PARTS else old
        return dataclasses.replace(thing, material=known[old])

    return dataclasses.replace(
        scene,
        boxes=tuple(map(dressed, scene.boxes)),
        furniture=tuple(map(dressed, scene.furniture)),
    )


def surface(rng: np.random.Generator, part: str, metallic: float = 0.0) -> Material:
    """Return a material for a part of a scene (PARTS).

    metallic  that furniture keeps; all else is no metal
    """
    often, sizes, pale = PARTS[part]
    weights = np.array(list(often.values()))
    kind = str(rng.choice(list(often), p=weights / weights.sum()))
    low, high = DARK_TO_PALE
    bright = rng.uniform(*PALE) if rng.random() < pale else low * (high / low) ** rng.random()
    hue, saturation = rng.random(), rng.beta(1.0, 2.5)
    if kind == "wood":
        hue, saturation = rng.uniform(*WOOD_HUES), rng.uniform(0.25, 0.6)
        bright = min(bright, 0.6)
    # the second colour: another shade of the first, or a colour of its own
    factor = np.exp(rng.uniform(np.log(0.25), np.log(0.8)) * rng.choice([-1, 1], p=[0.3, 0.7]))
    if kind != "wood" and rng.random() < 0.4:
        second = colour(rng.random(), rng.beta(1.0, 1.5), low * (high / low) ** rng.random())
    else:
        second = colour(hue, saturation, float(np.clip(bright * factor, low / 2, high)))
    roughness = rng.uniform(0.3, 0.9)
    if rng.random() < GLOSSY.get(part, 0.0):
        roughness = rng.uniform(*POLISHED)
    first, last = (float(np.log(size)) for size in sizes)
    pattern = Pattern(
        kind,
        second,
        float(np.exp(rng.uniform(first, last))),
        float(rng.choice([0.0, np.pi / 2, rng.uniform(0, np.pi)], p=[0.45, 0.45, 0.1])),
        (float(rng.uniform(0, 20)), float(rng.uniform(0, 20))),
    )
    return Material(
        colour(hue, saturation, bright),
        float(roughness),
        metallic if part == "furniture" else 0.0,
        part=part,
        pattern=None if kind == PLAIN else pattern,
    )


def colour(hue: float, saturation: float, luminance: float) -> Triple:
    """Return linear red, green and blue of a luminance, as far as each stays in 0.005 to 0.95."""
    rgb = np.array(colorsys.hsv_to_rgb(hue, saturation, 1.0)) ** 2.2
    red, green, blue = np.clip(rgb * (luminance / float(rgb @ LUMINANCE)), 0.005, 0.95)
    return float(red), float(green), float(blue)
