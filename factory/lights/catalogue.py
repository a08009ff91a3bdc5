"""Lights by name: built-in ones, those of a library, or a path."""

from pathlib import Path

from factory.lights import built_in, files, procedural
from factory.lights.built_in import from_file, wheel_maps
from factory.lights.library import entry
from factory.lights.light import Light
from manifests import measured_lights
from manifests.errors import InputError, closest


def load(name_or_path: str | Path, library: str | Path | None = None) -> Light:
    """Return the Light of a name or of an .hdr, .exr or .npz file.

    A name is one of the wheel's (`city`), of a computed light (`softboxes-7`), or in the `library`
    folder.

    Raises  InputError for an unknown name (with the closest ones), a name of the library that a
            built-in light has, too, or a file that holds no usable light
    """
    text = str(name_or_path)
    if files.is_light_path(text):
        return from_file(Path(text), Path(text).stem, "unknown", text)
    if library is not None and (result := library_maps(library).get(text)):
        known = entry(library, text)
        light = from_file(
            result, text, known.get("licence", "unknown"), known.get("source", result.name)
        )
        built_in_light = built_in.load(text)
        if built_in_light is not None and built_in_light.hash != light.hash:
            raise InputError(
                f"light '{text}'",
                "one map under a name",
                f"{result} and the built-in light",
                "rename the file, or give its path in place of the name",
            )
        return light
    if (built_in_light := built_in.load(text)) is not None:
        return built_in_light
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
        # what macOS writes beside each file on other systems' disks is no map
        if path.suffix.lower() not in files.SUFFIXES or path.name.startswith("._"):
            continue
        if (first := result.setdefault(path.stem, path)) != path:
            raise InputError(
                folder,
                "one map under a name",
                f"{first.name} and {path.name}",
                "rename or remove one of the files",
            )
    return result
