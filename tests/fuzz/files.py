"""Damaged files of every format, through each command that reads the format.

Where another generator knows a format better (its meaning, not only its bytes), this one still sees
what crashes.
"""

import shutil
from pathlib import Path

import numpy as np

from . import STATUSES, Case, Result, Room, commands, mutation, seeds

MUTATIONS = {
    ".json": mutation.some_json,
    ".jsonl": mutation.some_text,
    ".npz": mutation.some_npz,
    ".safetensors": mutation.some_safetensors,
    ".exr": mutation.some_exr,
    ".png": mutation.some_png,
    ".txt": mutation.some_text,
    ".csv": mutation.some_text,
    ".obj": mutation.some_text,
    ".off": mutation.some_text,
}
# read with what lies beside them
FOLDERS = {"lights.json": "library", "checkpoint": "trained", "log": "trained"}


VALID = [
    (format_, name, template)
    for format_, names in commands.FORMATS.items()
    for template in commands.READERS[format_]
    for name in names
]


def prepare(folder: Path) -> None:
    """The shared seeds."""
    seeds.shared(folder)


def case(index: int, rng: np.random.Generator, room: Room) -> Case:
    """First each valid file through each of its commands, which must end with 0; then damaged ones,
    formats in turn.
    """
    valid = index < len(VALID)
    format_, name, template = VALID[index] if valid else chosen(index, rng)
    data, label = (seeds.of(room) / name).read_bytes(), "as it is"
    if not valid:
        data, label = mutated(data, Path(name).suffix, rng)
    file = place(room, format_, name, data)
    return Case(
        label=f"{name}: {label}",
        command=commands.line(template, room, file),
        check=lambda result: unreadable(room.folder / "out", result),
        writes=(*commands.WRITES, FOLDERS.get(format_, "out")),
        before=commands.draw_small if template.startswith(commands.SLOW) else None,
        statuses=(0,) if valid else STATUSES,
    )


def chosen(index: int, rng: np.random.Generator) -> tuple[str, str, str]:
    """Format, seed and command of a case."""
    format_ = list(commands.FORMATS)[index % len(commands.FORMATS)]
    readers = commands.READERS[format_]
    quick = [template for template in readers if not template.startswith(commands.SLOW)]
    few = quick and rng.random() < 0.85  # the slow ones read files by the same functions
    return (
        format_,
        mutation.pick(rng, commands.FORMATS[format_]),
        mutation.pick(rng, quick if few else readers),
    )


def mutated(data: bytes, suffix: str, rng: np.random.Generator) -> tuple[bytes, str]:
    """One to three mutations that know the format, or only bytes."""
    labels = []
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        knowing = MUTATIONS.get(suffix, mutation.some_bytes)
        try:
            data, label = (knowing if rng.random() < 0.85 else mutation.some_bytes)(data, rng)
        except Exception:  # what an earlier mutation left is none of this format any more
            data, label = mutation.some_bytes(data, rng)
        labels.append(label)
    return data, ", then ".join(labels)


def place(room: Room, format_: str, name: str, data: bytes) -> Path:
    """Write the file, with what belongs beside it; returns its path."""
    if format_ in FOLDERS:
        shutil.copytree(seeds.of(room) / FOLDERS[format_], room.folder / FOLDERS[format_])
        path = room.folder / name
    else:
        path = room.folder / Path(name).name
    if format_ == "mesh":
        shutil.copy(seeds.of(room) / "mesh.mtl", room.folder)
    if format_ == "pictures.txt":
        for each in ("photograph.png", "second.png"):
            shutil.copy(seeds.of(room) / each, room.folder)
    if format_ == "photograph":
        (room.folder / "masks").mkdir()
        shutil.copy(seeds.of(room) / "mask.png", room.folder / "masks" / "photograph.png")
        shutil.copy(seeds.of(room) / "mask.png", room.folder / "masks" / "second.png")
        shutil.copy(seeds.of(room) / "mask.png", room.folder / "photograph.mask.png")
    path.write_bytes(data)
    return path


def unreadable(out: Path, result: Result) -> str | None:
    """What is wrong with the files of a command that ended with 0: none, empty, not readable, not
    finite.
    """
    from PIL import Image

    if result.status != 0 or not out.is_dir():
        return None
    for path in sorted(out.rglob("*")):
        if path.suffix in (".png", ".jpg", ".exr", ".json", ".npz") and not path.stat().st_size:
            return f"{path.name} is empty"
        if path.suffix in (".png", ".jpg"):
            with Image.open(path) as picture:
                picture.load()
        if path.suffix == ".exr":
            channels = mutation.exr_channels(path.read_bytes())
            wrong = [name for name, values in channels.items() if not np.isfinite(values).all()]
            if wrong:
                return f"{path.name}: channel {wrong[0]} is not finite"
    return None
