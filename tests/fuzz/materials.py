"""material.json and names of materials: numbers, shapes and texts at the ends of what JSON and a
label allow, and beyond.

A label that is accepted is rendered on a ball: the picture must be finite.
"""

import json
import os
from pathlib import Path

import numpy as np

from . import Case, Result, Room, commands, mutation, seeds

NUMBERS = (
    *(
        "0",
        "-80",
        "-80.001",
        "-79.999",
        "4.4",
        "4.401",
        "14",
        "14.001",
        "-1e308",
        "1e308",
        "1e309",
        "-1e400",
        "1e-400",
        "-0.0",
    ),
    *(
        "1" + "0" * 400,
        "-1" + "0" * 400,
        "1" + "0" * 5000,
        "NaN",
        "Infinity",
        "-Infinity",
        "true",
        "null",
        '"1.5"',
        "[1]",
        "{}",
        "1_0",
        "0x1",
    ),
)
TEXTS = (
    *(
        "",
        " ",
        "null",
        "[]",
        "{}",
        "5",
        '"label"',
        "[1]",
        '{"label": null}',
        '{"labels": null}',
        '{"labels": []}',
        '{"labels": [[]]}',
    ),
    *(
        '{"labels": {}}',
        '{"label": {}}',
        '{"label": "brass"}',
        '{"label": [[0]]}',
        "{",
        "[" * 100_000,
        '{"a":' * 50_000,
        "\ufeff{}",
        "\0",
    ),
    *(
        '{"label": [], "label": []}',
        "NaN",
        '{"label": 1' + "0" * 400 + "}",
        '{"labels": [null]}',
        '{"labels": "' + "x" * 500_000 + '"}',
    ),
)
WORDS = (
    *(
        "keep",
        "brass",
        "Brass",
        "brass ",
        "brass+keep",
        "+",
        "++",
        "brass+",
        "+brass",
        "keep+keep+keep",
        "",
        " ",
        ".",
        "..",
        "/",
        "-",
    ),
    *(
        "x.json",
        "x.png",
        "a" * 300,
        "a" * 5000,
        "brass\n",
        "\u202ebrass",
        "ß",
        "nan",
        "brass.exr",
        "../material.json",
        "\0",
        "material.json\0",
    ),
    *(
        "brass+brass+brass+brass+brass+brass+brass+brass+brass",
        "*",
        "$(touch x)",
        "brass;",
        "%s",
        "example:espresso-cup",
        "con",
        "~",
    ),
)
KINDS = (
    "a pipe",
    "a folder",
    "a device",
    "a circle of links",
    "2 MB of nothing",
    "missing",
    "no permission",
)


def prepare(folder: Path) -> None:
    """The shared seeds."""
    seeds.shared(folder)


def case(index: int, rng: np.random.Generator, room: Room) -> Case:
    """See the module."""
    path = room.folder / "material.json"
    label = json.loads((seeds.of(room) / "material.json").read_text())["label"]
    plan = [("number", value) for value in NUMBERS] + [("text", value) for value in TEXTS]
    plan += [("word", value) for value in WORDS] + [("kind", value) for value in KINDS]
    plan += [("length", value) for value in (0, 1, 107, 109, 216, 108 * 1000)] + [
        ("regions", value) for value in (1, 2, 8, 9, 1000)
    ]
    what, value = plan[index] if index < len(plan) else ("chance", None)
    asked = str(path)
    if what == "number":
        at = int(rng.integers(108))
        numbers = [repr(x) for x in label[:at]] + [value] + [repr(x) for x in label[at + 1 :]]
        path.write_text('{"label": [' + ", ".join(numbers) + "]}")
    elif what == "text":
        path.write_text(value, encoding="utf-8")
    elif what == "word":
        asked = value
    elif what == "kind":
        _place(path, value)
    elif what == "length":
        path.write_text(json.dumps({"label": (label * 1000)[:value]}))
    elif what == "regions":
        path.write_text(json.dumps({"labels": [label] * value}))
    elif rng.random() < 0.5:
        path.write_text(json.dumps({"label": _extreme(rng, label)}))
        value = "values at the ends of their ranges"
    else:
        data, value = mutation.some_json((seeds.of(room) / "material.json").read_bytes(), rng)
        path.write_bytes(data)
    text = f"{what}: {value if isinstance(value, int) else value[:50]!r}"
    if index % 8 == 0:
        there = seeds.of(room)
        words = [
            "edit",
            there / "second.png",
            "--no-refine",
            "--weights",
            there / "weights.safetensors",
        ]
        words += [f"--material={asked}", "--out", room.folder / "out"]
        return Case(label=text, command=["learn", *map(str, words)], before=commands.draw_small)
    return Case(label=text, run=lambda: shown(asked), check=not_finite)


def shown(asked):
    """Balls of the material that is asked for, one for each region; a picture's material is not
    predicted.
    """
    from learn.editing import edit
    from learn.figures import spheres

    labels = edit.labels_by_region(
        asked, 2, lambda path: np.zeros((1, 108), np.float32), {"own": np.zeros(108, np.float32)}
    )
    return [
        spheres.material_sphere(label, spheres.preview_lighting(), 16, 0.35, 1.0)
        for label in labels
        if label is not None
    ]


def not_finite(result: Result) -> str | None:
    """What is wrong with the balls."""
    if result.error is not None:
        return None
    return (
        None
        if all(np.isfinite(ball).all() for ball in result.value)
        else "a ball of the material is not finite"
    )


def _extreme(rng, label):
    """A label whose values are as before or at the ends of their ranges."""
    values = np.array(label).reshape(3, 3, 2, 6)
    ends = np.where(np.arange(2)[:, None] == 0, [[-80.0, 4.4]], [[-80.0, 14.0]])
    spot, high = (
        rng.random(values.shape) < mutation.pick(rng, (0.02, 0.3, 1.0)),
        rng.random(values.shape) < 0.5,
    )
    extreme = np.where(high, ends[:, 1][:, None], ends[:, 0][:, None])
    return np.where(spot, extreme, values).reshape(-1).tolist()


def _place(path, kind):
    if kind == "a pipe":
        os.mkfifo(path)
    elif kind == "a folder":
        path.mkdir()
    elif kind == "a device":
        path.symlink_to("/dev/zero")
    elif kind == "a circle of links":
        path.symlink_to(path)
    elif kind == "2 MB of nothing":
        path.write_bytes(bytes(2 << 20))
    elif kind == "no permission":
        path.write_text("{}")
        path.chmod(0)
