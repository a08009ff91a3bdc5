"""Folders that an earlier run left behind, damaged, and the same command again: evaluations, kept
fits, libraries of shapes.
"""

import json
import shutil
from pathlib import Path

import numpy as np

from . import Case, Room, commands, files, mutation, seeds

PLACES = (  # file, its mutation, the command that goes on from it
    ("evaluation/edits.jsonl", "lines", "evaluate"),
    ("evaluation/pictures.jsonl", "lines", "evaluate"),
    ("evaluation/settings.json", ".json", "evaluate"),
    ("evaluation/gallery", "instead", "evaluate"),
    ("own.json.fits/FIT", ".json", "fit"),
    ("own.json", ".json", "fit"),
    ("own.json", ".json", "add"),
    ("shapes/object/mesh.json", ".json", "shapes"),
    ("shapes/object/mesh.obj", ".obj", "shapes"),
    ("furniture.sh3f", ".sh3f", "list"),
    ("furniture.sh3f", ".sh3f", "one"),
    ("trained/log.jsonl", "lines", "train"),
    ("trained/checkpoint.safetensors", ".safetensors", "train"),
    ("trained/run.json", ".json", "train"),
)
COMMANDS = {
    "evaluate": (
        "learn evaluate --data {seeds}/data --weights {seeds}/weights.safetensors --no-refine"
        " --edits 2 --processes 1 --out {room}/evaluation"
    ),
    "fit": "factory materials fit {seeds}/nbrdf.npz --only brass --out {room}/own.json",
    "add": "factory materials add {seeds}/nbrdf.npz --only brass --out {room}/own.json",
    "shapes": (
        "factory shapes add {seeds}/mesh.obj --category object --licence CC0 --library"
        " {room}/shapes"
    ),
    "list": "factory shapes list {room}/furniture.sh3f",
    "one": "factory shapes preview {room}/furniture.sh3f#box --size 16 --out {room}/out.png",
    "train": "learn train {seeds}/run.json --data {views} --workers 0 --out {room}/trained",
}
WRITES = (
    "out",
    "out.png",
    "evaluation",
    "own.json",
    "own.json.fits",
    "shapes",
    "trained",
    "views/packed",
    "views/.lock",
)


def prepare(folder: Path) -> None:
    """The shared seeds; an evaluation of two edits; a fit that was kept; a library of furniture."""
    import msgspec

    from factory.materials import fitting, recipe, sources
    from learn.__main__ import COMMANDS as LEARN
    from learn.__main__ import main
    from manifests.materials import read_catalogue

    shared = seeds.shared(folder)
    words = [word.format(seeds=shared, room=folder) for word in COMMANDS["evaluate"].split()[1:]]
    if status := main("learn", "", LEARN, words):
        raise RuntimeError(f"{' '.join(words)}: status {status}")
    source = sources.load(shared / "nbrdf.npz", ["brass"])["brass"]
    entry = next(
        each
        for each in read_catalogue(shared / "catalogue.json").materials
        if each.name == "own-brass"
    )
    kept = folder / "own.json.fits" / f"brass.{fitting.key(source, recipe.Recipe(), {})}.json"
    kept.parent.mkdir()
    fitting.write_entry(msgspec.structs.replace(entry, name="brass"), kept)
    shutil.copy(shared / "catalogue.json", folder / "own.json")
    (folder / "furniture.sh3f").write_bytes(furniture((shared / "mesh.obj").read_bytes()))
    (folder / "shapes" / "object").mkdir(parents=True)
    shutil.copytree(shared / "trained", folder / "trained")
    words = [
        "shapes",
        "add",
        str(shared / "mesh.obj"),
        "--category",
        "object",
        "--licence",
        "CC0",
        "--library",
        str(folder / "shapes"),
    ]
    from factory.__main__ import COMMANDS as FACTORY

    if status := main("factory", "", FACTORY, words):
        raise RuntimeError(f"{' '.join(words)}: status {status}")


def furniture(mesh: bytes) -> bytes:
    """A furniture library of Sweet Home 3D with one model."""
    import io
    import zipfile

    text = (
        "id=tests\nname=Tests\nlicense=CC0\n"
        "id#1=box\nname#1=Box\nmodel#1=/models/box.obj\ncreator#1=tests\n"
    )
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("PluginFurnitureCatalog.properties", text)
        archive.writestr("models/box.obj", mesh)
    return out.getvalue()


def case(index: int, rng: np.random.Generator, room: Room) -> Case:
    """The places in turn; first each as it is."""
    place, how, command = PLACES[index % len(PLACES)]
    top = place.split("/")[0]
    for name in {top, "own.json.fits"} if top == "own.json" else {top}:
        copy(room.seeds / name, room.folder / name)
    if "FIT" in place:
        place = next(room.folder.glob("own.json.fits/*")).relative_to(room.folder).as_posix()
    path = room.folder / place
    label = "as it is"
    if index >= len(PLACES):
        label = (
            mutation.put_instead(path, rng)
            if how == "instead" or rng.random() < 0.15
            else damaged(path, how, rng)
        )
    return Case(
        label=f"{place}: {label}",
        command=commands.line(COMMANDS[command], room),
        writes=WRITES,
        statuses=(0,) if index < len(PLACES) else (0, 1),
        before=no_fitting if command in ("fit", "add") else None,
    )


def copy(source: Path, target: Path) -> None:
    """Copy a file or a folder."""
    shutil.copytree(source, target) if source.is_dir() else shutil.copy(source, target)


def damaged(path: Path, how: str, rng: np.random.Generator) -> str:
    """Change a file; returns what was done."""
    if how == "lines":
        lines = path.read_bytes().splitlines()
        k = int(rng.integers(len(lines)))
        if rng.random() < 0.7:
            row, label = mutation.some_value(json.loads(lines[k]), rng)
            lines[k] = json.dumps(row).encode()
            path.write_bytes(b"\n".join(lines) + b"\n")
            return label
    data, label = files.mutated(
        path.read_bytes(), {"lines": ".txt", ".sh3f": ".npz"}.get(how, how), rng
    )
    path.write_bytes(data)
    return label


def no_fitting() -> None:
    """Let a fit that is not kept be the one of the built-in catalogue: fitting takes a minute."""
    from factory.materials import fitting
    from manifests.materials import BUILT_IN, read_catalogue

    entry = next(each for each in read_catalogue(BUILT_IN[0]).materials if each.name == "brass")

    def write(name):
        fitting.write_entry(entry, fitting._WORKER["files"][name])
        return name

    fitting._fit_one = write
