"""The measured light maps that come with the program: 26 panoramas of Poly Haven, all under CC0.

measured-lights/maps.npz   one array (64, 128, 3) float16 per name, with a file's columns: the
                           centre column towards Blender's world +x (factory.lights.light)
measured-lights/maps.json  {name: Credit} of the same names, in the same order

The first part of a name says what brought the map: blender (the bpy wheel), pmndrs (the npm package
@pmndrs/assets) or drei (drei-assets).
"""

from functools import cache
from pathlib import Path

import numpy as np
from msgspec import Struct

from manifests import archives
from manifests.arrays import LIGHT_SHAPE
from manifests.reading import read
from shaders import envmap

FOLDER = Path(__file__).resolve().parent / "measured-lights"
MAPS, CREDITS = FOLDER / "maps.npz", FOLDER / "maps.json"


class Credit(Struct, frozen=True, forbid_unknown_fields=True):
    """Whom a map is due to.

    author  as recorded by what brought the map, or "author not recorded"
    source  what brought the map, and its original's page where that is known
    """

    author: str
    source: str
    licence: str


@cache
def credits() -> dict[str, Credit]:
    """Return {name: Credit} of all measured maps."""
    return read(CREDITS, dict[str, Credit])


@cache
def load(name: str) -> np.ndarray:
    """Return L (64, 128, 3) float32 of a map, mean luminance 1, light frame; it is read-only.

    Raises  KeyError for an unknown name
    """
    if name not in credits():
        raise KeyError(name)
    with archives.open_zip(MAPS, "the program's light maps", "install it again") as archive:
        stored = archives.read_array(archive, f"{name}.npy", 2 * int(np.prod(LIGHT_SHAPE)))
    L = envmap.unit_mean(envmap.from_file_columns(stored.astype(np.float32)))[0]
    L.flags.writeable = False
    return L


def load_all() -> dict[str, np.ndarray]:
    """Return {name: L} of all measured maps, as `load` returns each."""
    return {name: load(name) for name in credits()}
