"""Lights by name: maps of the Blender wheel, measured maps, computed families, a library, a path.

The wheel holds eight maps under CC0.
"""

import hashlib
import importlib.util
from pathlib import Path

from factory.lights import files, procedural
from factory.lights.library import entry
from factory.lights.light import Light, from_pixels
from manifests import measured_lights
from manifests.errors import InputError, closest

WHEEL_LICENCE = "CC0"
WHEEL_SOURCE = "Greg Zaal, Poly Haven; shipped with Blender as"


def load(name_or_path: str | Path, library: str | Path | None = None) -> Light:
    """Return the Light of a name or of an .hdr, .exr or .npz file.

    A name is one of the wheel's (`city`), of a computed light (`softboxes-7`), or in the `library`
    folder.

    Raises  InputError for an unknown name (with the closest ones) or a file that holds no usable
            light
    """
    text = str(name_or_path)
    if files.is_light_path(text):
        return _from_file(Path(text), Path(text).stem, "unknown", text)
    if library is not None and (result := library_maps(library).get(text)):
        known = entry(library, text)
        return _from_file(
            result, text, known.get("licence", "unknown"), known.get("source", result.name)
        )
    if (wheel := wheel_maps()) and text in wheel:
        return _from_file(wheel[text], text, WHEEL_LICENCE, f"{WHEEL_SOURCE} {wheel[text].name}")
    if (measured := text.replace("-", "_")) in measured_lights.credits():
        return _measured(measured, text)
    if parsed := procedural.parse(text):
        digest = hashlib.sha256(
            f"{parsed[0]}-{parsed[1]} version {procedural.VERSION}".encode()
        ).hexdigest()
        return from_pixels(
            procedural.pixels(*parsed),
            text,
            digest,
            "Apache-2.0",
            f"computed by factory.lights.procedural, {text}",
        )
    remedy = closest(text, names(library)) + "; `python -m factory lights list` shows all"
    raise InputError(
        f"light {text!r}", "a known name or an .hdr, .exr or .npz file", "neither", remedy
    )


def names(library: str | Path | None = None) -> list[str]:
    """Return the names that `load` knows: of the wheel, computed, measured, of the library.

    Measured maps that the wheel also brings, at full size, are left out.
    """
    own = library_maps(library) if library is not None else {}
    wheel = wheel_maps()
    measured = [
        name for name in measured_lights.credits() if name.removeprefix("blender_") not in wheel
    ]
    return list(dict.fromkeys([*wheel, *procedural.FAMILIES, *measured, *own]))


def _measured(known: str, name: str) -> Light:
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


def library_maps(folder: str | Path) -> dict[str, Path]:
    """Return {name: path} of the .hdr, .exr and .npz files in a folder, without its subfolders.

    Raises  InputError: no such folder, two files of one name
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(
            folder,
            "a folder of .hdr, .exr or .npz files",
            "nothing there" if not folder.exists() else "a file",
            "check the path",
        )
    result: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in files.SUFFIXES:
            continue
        if (first := result.setdefault(path.stem, path)) != path:
            raise InputError(
                folder,
                "one map under a name",
                f"{first.name} and {path.name}",
                "rename or remove one of the files",
            )
    return result


def _from_file(path, name, licence, source):
    pixels, digest = files.read(path)
    try:
        return from_pixels(pixels, name, digest, licence, source, in_place=True)
    # values are judged under the credit's name; the user knows the file by its path
    except InputError as problem:
        raise InputError(path, problem.expected, problem.found, problem.remedy) from None
