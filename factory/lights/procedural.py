"""Lights computed from a seed: for tests, for training, and where no file is available.

Each function returns (height, width, 3) float64 radiance, rows and columns as in a file
(factory.lights.light), any scale. A name may carry a seed after a dash: `softboxes-7`. Raise
VERSION with any change that alters pixels, because it enters the lights' hashes.
"""

import numpy as np

from shaders import envmap

VERSION = 1
SIZE = (256, 512)
SKY_ZENITH, SKY_HORIZON = np.array([0.25, 0.45, 1.0]), np.array([0.75, 0.85, 1.0])
GROUND = np.array([0.22, 0.19, 0.16])
SUN = np.array([1.0, 0.9, 0.75])


def constant(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Return 1 everywhere: a white sphere under it shows its albedo."""
    return np.ones((height, width, 3))


def gradient(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Return a gradient from bright zenith to dark nadir, linear in the height above the horizon.

    It is the smoothest light that distinguishes up from down.
    """
    up = envmap.directions(height, width)[0][..., 1]
    return np.repeat((1.0 + 0.9 * up)[..., None], 3, axis=-1)


def one_texel(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Return a map with one white texel of 64×128 lit above the horizon, to test every convention.

    The texel is drawn at random.
    """
    row, column = int(rng.integers(8, 32)), int(rng.integers(0, 128))
    L = np.zeros((64, 128, 3))
    L[row, column] = 1.0
    return np.repeat(np.repeat(L, height // 64, axis=0), width // 128, axis=1)


def sun_and_sky(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Return a clear sky over dull ground, with a sun.

    The sun's disc carries a fifth to two thirds of the light.
    """
    w, _ = envmap.directions(height, width)
    elevation, azimuth = np.radians(rng.uniform(10, 70)), rng.uniform(0, 2 * np.pi)
    sun = np.array(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(elevation),
            np.sin(azimuth) * np.cos(elevation),
        ]
    )
    up = w[..., 1:2]
    haze = np.clip(1.0 - up, 0.0, 1.0) ** 3
    sky = SKY_ZENITH + (SKY_HORIZON - SKY_ZENITH) * haze
    away = np.arccos(np.clip(w @ sun, -1.0, 1.0))[..., None]
    aureole = 2.0 * np.exp(-away / np.radians(12.0)) * SUN
    disc = SUN * np.where(away < np.radians(1.5), rng.uniform(1000, 5000), 0.0)
    # four rows wide, so that no edge is a staircase
    horizon = np.clip(up * height / 4 + 0.5, 0.0, 1.0)
    return GROUND + horizon * (sky + aureole - GROUND) + disc


def softboxes(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Return a dark studio: two to four rectangular lamps with soft rims on dim grey."""
    w, _ = envmap.directions(height, width)
    L = np.full((height, width, 3), rng.uniform(0.02, 0.08))
    for _ in range(int(rng.integers(2, 5))):
        elevation, azimuth = np.radians(rng.uniform(5, 75)), rng.uniform(0, 2 * np.pi)
        s, c = np.sin(azimuth), np.cos(azimuth)
        forward = np.array([c * np.cos(elevation), np.sin(elevation), s * np.cos(elevation)])
        right = np.array([-s, 0.0, c])
        ahead = w @ forward
        plane = (
            np.stack([w @ right, w @ np.cross(forward, right)], axis=-1)
            / np.where(ahead > 0.05, ahead, 1.0)[..., None]
        )
        half_size = rng.uniform(0.15, 0.6, size=2)
        rim = np.clip((half_size - np.abs(plane)) / (0.15 * half_size) + 0.5, 0.0, 1.0).prod(-1)
        warm = rng.uniform(-0.15, 0.15)
        colour = np.array([1.0 + warm, 1.0, 1.0 - warm])
        L += np.where(ahead > 0.05, rim, 0.0)[..., None] * colour * rng.uniform(5, 40)
    return L


FAMILIES = {
    "constant": constant,
    "gradient": gradient,
    "one-texel": one_texel,
    "sun-and-sky": sun_and_sky,
    "softboxes": softboxes,
}


def parse(name: str) -> tuple[str, int] | None:
    """Return (family, seed) of a name such as `softboxes` or `softboxes-7`, or None."""
    family, dash, seed = name.rpartition("-")
    if name in FAMILIES:
        return name, 0
    if dash and family in FAMILIES and seed.isdecimal() and len(seed) < 10:
        return family, int(seed)
    return None


def pixels(family: str, seed: int) -> np.ndarray:
    """Return the map (256, 512, 3) of a family and seed."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(VERSION,)))
    return FAMILIES[family](rng, *SIZE)
