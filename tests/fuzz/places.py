"""Other things where a command expects a file or a folder: pipes, devices, links in circles,
folders, nothing, giants.
"""

import os
from pathlib import Path

import numpy as np

from . import Case, Room, commands, files, mutation, seeds

OUTPUTS = (  # commands that read little and write something
    "factory shapes preview cube --size 16 --out {place}",
    "factory lights preview {seeds}/light.exr --size 16 --out {place}",
    (
        "factory materials preview own-brass --catalogue {seeds}/catalogue.json --light"
        " {seeds}/light.exr --size 16 --out {place}"
    ),
    "factory materials report {seeds}/catalogue.json --out {place}",
    "factory lights add {seeds}/light.exr --library {place}",
    "factory shapes add {seeds}/mesh.obj --category object --library {place}",
    "factory export {seeds}/data --to tars --out {place}",
    "factory export {seeds}/data --to records --out {place}",
    "factory preview {seeds}/data --count 1 --size 16 --out {place}",
    "factory preview {seeds}/data --count 1 --size 16 --overwrite --out {place}",
    "factory render {seeds}/job.json --limit 1 --out {place}",
    "learn predict {seeds}/second.png --weights {seeds}/weights.safetensors --out {place}",
    (
        "learn predict {seeds}/second.png --weights {seeds}/weights.safetensors --overwrite --out"
        " {place}"
    ),
    "learn agree {seeds}/data --limit 1 --out {place}",
    "learn train {seeds}/run.json --data {views} --workers 0 --steps 1 --out {place}",
    "learn.experiments exposure --data {seeds}/data --out {place}",
)
NAMES = (
    "",
    ".",
    "..",
    "/",
    "/dev/null",
    "/dev/full",
    "/proc/self/mem",
    "-",
    "~",
    "x" * 300,
    "no/such/folder/out",
    "é\udcff",
    "a\nb",
    "-x",
)


def prepare(folder: Path) -> None:
    """The shared seeds."""
    seeds.shared(folder)


def case(index: int, rng: np.random.Generator, room: Room) -> Case:
    """Inputs and outputs in turn."""
    return output(rng, room) if index % 3 == 2 else input_(index, rng, room)


def input_(index: int, rng: np.random.Generator, room: Room) -> Case:
    """A command whose input file is something else; now and then it is the input's name that is
    odd.
    """
    format_, name, template = files.chosen(index, rng)
    file = files.place(room, format_, name, (seeds.of(room) / name).read_bytes())
    if rng.random() < 0.25 and "{job}" not in template:
        odd = mutation.pick(
            rng,
            (
                *NAMES,
                str(file.parent),
                f"{file}/x",
                "/dev/zero",
                "/dev/stdin",
                str(room.folder / "circle"),
            ),
        )
        (room.folder / "circle").symlink_to("circle")
        words, label = (
            commands.line(template.replace("{file}", "FILE"), room),
            f"{odd!r} for {name}",
        )
        words = [odd if word == "FILE" else word for word in words]
    else:
        words = commands.line(template, room, file)
        label = f"{name} {mutation.put_instead(file, rng)}"
    return Case(
        label=label,
        command=words,
        check=lambda result: files.unreadable(room.folder / "out", result),
        writes=(*commands.WRITES, files.FOLDERS.get(format_, "out")),
        before=commands.draw_small if template.startswith(commands.SLOW) else None,
    )


def output(rng: np.random.Generator, room: Room) -> Case:
    """A command whose output is to go where something else is."""
    template = mutation.pick(rng, OUTPUTS)
    if rng.random() < 0.5:
        place = mutation.pick(rng, [name for name in NAMES if name not in ("..", "/")])
        label = f"output into {place!r}"
    else:
        place = str(room.folder / "place")
        label = f"output, which {mutation.put_instead(Path(place), rng)}"
    before = seeds.fake_studio if template.startswith("factory render") else None
    words = [
        place if word == "PLACE" else word
        for word in commands.line(template.replace("{place}", "PLACE"), room)
    ]
    inside = (
        os.path.normpath(os.path.join("cwd", place))
        if place and not place.startswith("/")
        else "place"
    )
    writes = (
        inside.split("/no/")[0] + "/no" if "/no/" in inside else inside,
        "views/packed",
        f"{inside}.fits",
    )
    return Case(
        label=label,
        command=words,
        writes=("cwd", "views/packed") if place == "." else writes,
        before=before,
        check=refused(place),
    )


def refused(place: str):
    """An empty name of an output is a variable that was not set: no command may take it for the
    current folder.
    """
    return lambda result: (
        "an empty output name was taken" if place == "" and result.status == 0 else None
    )
