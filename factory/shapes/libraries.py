"""Collections of meshes: folders (ShapeNet's layout too) and Sweet Home 3D's .sh3f files.

The latter are zips of OBJ with a catalogue.
"""

import re
from dataclasses import dataclass
from pathlib import Path

from factory.shapes.files import FORMATS
from factory.shapes.library import note_of
from factory.shapes.raw import BYTES_A_TRIANGLE, MAXIMUM_TRIANGLES, MORE
from manifests.archives import DAMAGE, open_zip
from manifests.errors import InputError, closest
from manifests.inputs import require_file

# ShapeNet's names of the paper's categories
SYNSETS = {"02958343": "car", "03001627": "chair", "04256520": "sofa", "03211117": "monitor"}
WORDS = {
    "chair": ("chair", "stool", "seat"),
    "sofa": ("sofa", "couch", "settee", "loveseat"),
    "monitor": ("monitor", "tv", "television", "screen", "display", "laptop", "tablet"),
    "car": ("car", "sedan", "suv", "automobile", "coupe", "hatchback"),
}
CATALOGUE = "PluginFurnitureCatalog.properties"
MOST_INFLATION, MOST_CATALOGUE = 100, 4 << 20
A_LIBRARY, AGAIN = "a .sh3f library, a zip file of meshes", "check the path, or download it again"


@dataclass(frozen=True)
class Entry:
    """One mesh of a collection.

    place    argument of `mesh_import.open_mesh`
    licence  as the library states it, or ''
    section  of a .sh3f library's catalogue, such as "Kitchen", or ''
    """

    place: str
    name: str
    category: str
    licence: str = ""
    section: str = ""


def find(folder: str | Path) -> list[Entry]:
    """Return every mesh below a folder or in one file, sorted by place.

    Raises  InputError if there is none
    """
    folder = Path(folder)
    if folder.is_file():
        return (
            _inside(folder) if folder.suffix.lower() == ".sh3f" else [_of_file(folder, folder.stem)]
        )
    if not folder.is_dir():
        require_file(folder, "a folder of meshes, or a mesh file")
    results = []
    for path in sorted(folder.rglob("*")):
        if path.name.startswith("._"):  # what macOS writes beside each file on other systems' disks
            continue
        if path.suffix.lower() == ".sh3f" and path.is_file():
            results += _inside(path)
        elif path.suffix.lower() in FORMATS and path.is_file():
            results.append(_of_file(path, _name(path, folder)))
    if not results:
        raise InputError(
            folder,
            f"meshes ({', '.join(FORMATS)}, .sh3f)",
            "none in it or below it",
            "name another folder",
        )
    return results


def _of_file(path, name):
    """Return the Entry of a mesh file, with what `shapes add` noted of it."""
    note = note_of(path)
    if note is None:
        return Entry(str(path), name, category_of(path))
    return Entry(str(path), name, note.category, note.licence)


def _name(path, folder):
    """Return a name from the path of a mesh.

    ShapeNet's synset/model/models/model_normalized.obj gives "synset-model".
    """
    parts = path.relative_to(folder).with_suffix("").parts
    meaning = [part for part in parts if part not in ("models", "model_normalized")] or [parts[-1]]
    return "-".join(meaning)


def category_of(path: str | Path, chosen: str = "") -> str:
    """Return the paper's category suggested by a member's name, a file's name or its folders.

    The nearest of these decides; without one it is "object".
    """
    for part in (chosen, *reversed(Path(path).parts[-6:])):
        if part in SYNSETS:
            return SYNSETS[part]
        # armChair_01 → arm, chair; sofas → sofa
        words = [
            w.lower().removesuffix("s")
            for w in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", Path(part).stem)
        ]
        for category, known in WORDS.items():
            if any(
                word in known or (category in ("chair", "sofa") and word.endswith(known))
                for word in words
            ):
                return category
    return "object"


def _inside(path):
    with open_zip(path, A_LIBRARY, AGAIN) as archive:
        catalogue = _catalogue(archive, path)
        library = catalogue.get("license", catalogue.get("name", ""))
        names = {model: name for name, model in _models(catalogue).items()}
        entries = []
        for key, value in catalogue.items():
            if not key.startswith("model#"):
                continue
            number, model = key.partition("#")[2], value.lstrip("/")
            licence = catalogue.get(f"license#{number}", library)
            creator = catalogue.get(f"creator#{number}", "")
            named = f"{catalogue.get(f'name#{number}', '')} {Path(model).stem}"
            kind = (
                category_of(Path("x"), catalogue.get(f"name#{number}", "")) if named else "object"
            )
            if kind == "object":
                kind = category_of(Path("x"), Path(model).stem)
            entries.append(
                Entry(
                    f"{path}#{names[model]}",
                    names[model],
                    kind,
                    f"{licence}, {creator}".strip(", "),
                    catalogue.get(f"category#{number}", ""),
                )
            )
    return sorted(entries, key=lambda entry: entry.place)


def _models(catalogue):
    """Return {name: member} of a library's meshes: a name is the stem of the member's file.

    Where members in several folders share a stem, the last one in the catalogue has it as it is,
    and those before it have a number as well: "chair", "chair-2", "chair-3".
    """
    members = [value.lstrip("/") for key, value in catalogue.items() if key.startswith("model#")]
    stems = {Path(member).stem for member in members}
    result: dict[str, str] = {}
    for member in dict.fromkeys(reversed(members)):
        name, number = Path(member).stem, 1
        while name in result or (number > 1 and name in stems):
            number += 1
            name = f"{Path(member).stem}-{number}"
        result[name] = member
    return result


def _catalogue(archive, path):
    """Return keys and values of the library's catalogue, a Java properties file."""
    if CATALOGUE not in archive.namelist():
        raise InputError(
            path,
            f"a library with {CATALOGUE}",
            "none in it",
            "use a furniture library of Sweet Home 3D, or unzip it and name the folder",
        )
    text = _extract(archive, CATALOGUE, path, MOST_CATALOGUE).decode("latin-1")
    pairs = (
        line.partition("=")
        for line in text.splitlines()
        if not line.lstrip().startswith(("#", "!"))
    )
    return {
        key.strip(): re.sub(r"\\u([0-9a-fA-F]{4})", lambda m: chr(int(m[1], 16)), value.strip())
        for key, mark, value in pairs
        if mark
    }


def _extract(archive, name, path, most):
    """Return a member's bytes: at most `most`, and at most a hundred times its size in the zip."""
    info = archive.getinfo(name)
    bound = min(most, MOST_INFLATION * max(info.compress_size, 1024))
    if info.file_size > bound:
        raise InputError(
            f"{path}#{name}",
            f"at most {bound:,} bytes unpacked",
            f"{info.file_size:,}",
            f"a file that swells so is hardly a mesh; if it is one, {MORE}",
        )
    try:
        with archive.open(info) as file:
            data = file.read(bound + 1)
    except DAMAGE as error:
        raise InputError(
            f"{path}#{name}", "a readable member", f"'{error}'", "download the library again"
        ) from None
    if len(data) > bound:
        raise InputError(
            f"{path}#{name}",
            f"at most {bound:,} bytes unpacked",
            "more than the zip announces",
            "download the library again",
        )
    return data


def member(
    path: str | Path, chosen: str | None, maximum: int = MAXIMUM_TRIANGLES
) -> tuple[bytes, str, str]:
    """Return (bytes, name, ending) of one mesh of a .sh3f library.

    Raises  InputError: no such name, or none given
    """
    with open_zip(path, A_LIBRARY, AGAIN) as archive:
        by_name = _models(_catalogue(archive, path))
        if chosen is None or chosen not in by_name:
            result = f"'{chosen}'" if chosen else "no name"
            near = closest(chosen, by_name) if chosen else closest("", by_name)
            raise InputError(path, "the name of one of its meshes after '#'", result, near)
        model = by_name[chosen]
        if model not in archive.namelist():
            raise InputError(
                f"{path}#{chosen}",
                "the mesh its catalogue names",
                f"no {model}",
                "download the library again",
            )
        return (
            _extract(archive, model, path, maximum * BYTES_A_TRIANGLE),
            chosen,
            Path(model).suffix.lower(),
        )
