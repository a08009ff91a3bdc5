"""Lights that a user names: a map from a file, a computed one, or the light of a picture.

L  (64, 128, 3) float32 radiance of unit mean luminance, light frame

A map's columns are taken as they stand, as in light.exr of `learn edit`: docs/conventions.md says
which azimuth the first one has. A rotation turns it about the vertical.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from learn.data import lights, photographs
from manifests.arrays import LIGHT_SHAPE
from manifests.errors import InputError, closest
from manifests.inputs import split_path
from manifests.wording import number_of
from shaders import envmap

COMPUTED = "computed:"
HEIGHT, WIDTH, _ = LIGHT_SHAPE
LARGEST_SEED = 2**63 - 1
FORMS = "a map FILE.exr or FILE.npz#NAME, computed:SEED, or a picture with its mask"


def resolve_light(
    text: str, of_picture: Callable[[Path], np.ndarray], rotation_deg: float = 0.0
) -> np.ndarray:
    """Return L of the light that `text` names.

    text          FORMS
    of_picture    path → L: reads the light of a picture
    rotation_deg  about the vertical, rounded to the map's columns of 2.8°
    Raises        InputError: no such file, a map of other proportions, a black one
    """
    if text.startswith(COMPUTED):
        L = _compute(text)
    elif ".npz" in text.lower():
        L = _read_from_collection(text)
    elif text.lower().endswith(".exr"):
        L = _read_map(Path(text))
    else:
        L = of_picture(Path(text))
    turned = envmap.roll(L, round(rotation_deg / 360 * WIDTH))
    return envmap.unit_mean(turned.astype(np.float32))[0].astype(np.float32)


def _compute(text: str) -> np.ndarray:
    """Return the map of computed:SEED."""
    seed = text.removeprefix(COMPUTED)
    if not (seed.isascii() and seed.isdigit() and int(seed) <= LARGEST_SEED):
        raise InputError(f"--light {text}", "a whole number after computed:", seed, "computed:7")
    return lights.draw_computed(np.random.default_rng(int(seed)))


def split_collection(text: str) -> tuple[str, str]:
    """Return the path and the map's name of FILE.npz#NAME; the name of other texts is ""."""
    path, name = split_path(text, "#")
    return path, name.removeprefix("#")


def _read_from_collection(text: str) -> np.ndarray:
    """Return the map of FILE.npz#NAME."""
    path, name = split_collection(text)
    maps = lights.read_maps(path)
    if not name and len(maps) == 1:
        return next(iter(maps.values()))
    if name not in maps:
        result = f"'{name}'" if name else f"no name, and {number_of(len(maps), 'map')}"
        raise InputError(f"--light {text}", "a map's name after '#'", result, closest(name, maps))
    return maps[name]


def _read_map(path: Path) -> np.ndarray:
    """Return the map of an EXR file, resized to L's shape."""
    radiance, _ = photographs.read_exr(path)
    height, width = radiance.shape[:2]
    if width != 2 * height:
        raise InputError(
            path, "a map twice as wide as high", f"{width} × {height}", "export it equirectangular"
        )
    if not (radiance > 0).any():
        raise InputError(path, "light", "a black map", "name another one")
    return envmap.resize(radiance, HEIGHT, WIDTH)
