"""The lights that come with the program: maps of the Blender wheel, measured maps, computed ones.

The wheel holds eight maps under CC0.
"""

import hashlib
import importlib.util
from pathlib import Path

from factory.lights import files, procedural
from factory.lights.light import Light, from_pixels
from manifests import measured_lights
from manifests.errors import InputError

WHEEL_LICENCE = "CC0"
WHEEL_SOURCE = "Greg Zaal, Poly Haven; shipped with Blender as"


def load(name: str) -> Light | None:
    """Return the built-in Light of a name, None where there is none."""
    if (wheel := wheel_maps()) and name in wheel:
        return from_file(wheel[name], name, WHEEL_LICENCE, f"{WHEEL_SOURCE} {wheel[name].name}")
    if (measured := name.replace("-", "_")) in measured_lights.credits():
        return _measured_light(measured, name)
    if parsed := procedural.parse(name):
        digest = hashlib.sha256(
            f"{parsed[0]}-{parsed[1]} version {procedural.VERSION}".encode()
        ).hexdigest()
        return from_pixels(
            procedural.pixels(*parsed),
            name,
            digest,
            "Apache-2.0",
            f"computed by factory.lights.procedural, {name}",
        )
    return None


def _measured_light(known: str, name: str) -> Light:
    """Return the Light of a measured map; its 64×128 texels are all there is of it."""
    credit, L = measured_lights.credits()[known], measured_lights.load(known)
    digest = hashlib.sha256(b"measured light\n" + L.astype("<f4").tobytes()).hexdigest()
    source = f"{credit.author}; {credit.source}"
    return Light(name, L.copy(), L.copy(), 1.0, digest, credit.licence, source)


def wheel_maps() -> dict[str, Path]:
    """Return {name: path} of the maps inside the bpy wheel, {} without it; bpy is not imported."""
    spec = importlib.util.find_spec("bpy")
    if spec is None or spec.origin is None:
        return {}
    return {
        path.stem: path
        for path in sorted(Path(spec.origin).parent.glob("*/datafiles/studiolights/world/*.exr"))
    }


def from_file(path: Path, name: str, licence: str, source: str) -> Light:
    """Return the Light of an .hdr, .exr or .npz file under a name. Raises InputError."""
    pixels, digest = files.read(path)
    try:
        return from_pixels(pixels, name, digest, licence, source, in_place=True)
    # values are judged under the credit's name; the user knows the file by its path
    except InputError as problem:
        raise InputError(path, problem.expected, problem.found, problem.remedy) from None
