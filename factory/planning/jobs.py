"""Jobs: read from a file, from a preset, or from the options --mesh, --material and --light."""

import argparse
import json
import math
import os
from pathlib import Path

import msgspec

from manifests import JOBS
from manifests.errors import InputError, closest
from manifests.reading import decode, read
from manifests.schema import Camera, Draw, Job

MAXIMUM_BYTES = 1 << 20
# the options that a job's keys come from, where they are not --KEY
OPTIONS = {
    "camera.fov_deg": "--fov",
    "shapes": "--mesh",
    "materials": "--material",
    "lights": "--light",
    "render": "render",
}


def presets() -> dict[str, Path]:
    """Return {name: path} of the jobs that come with the program."""
    return {path.stem: path for path in sorted(JOBS.glob("*.json"), key=lambda path: path.stem)}


def load(name_or_path: str | Path) -> tuple[Job, Path]:
    """Return the Job of a file or a preset, and the folder in which its relative paths start.

    A file goes before a preset of the same name, and a preset before a folder.

    Raises  InputError: no such file or preset, or a fault in it
    """
    path, known = Path(name_or_path), presets()
    # a folder of a preset's name may be a data set that was made of it
    other = not os.path.exists(path) or (path.is_dir() and path.name in known)
    if other and path.suffix != ".json" and len(path.parts) == 1:
        if path.name not in known:
            raise InputError(
                f"job '{path}'", "a file or a preset", "neither", closest(path.name, known)
            )
        path = known[path.name]
    return read(path, Job, MAXIMUM_BYTES), path.parent


def from_options(options: argparse.Namespace) -> Job:
    """Return the Job that `render --mesh … --material … --light …` means.

    Raises  InputError under the limits of a job file, because dataset.json holds the job and is
            read back under these limits
    """
    height, width = parse_size(options.size)
    if options.fov is not None and not math.isfinite(options.fov):  # JSON has no such number
        raise InputError(
            "--fov",
            "degrees from 1 to 120",
            str(options.fov),
            "write --fov 40, or leave it out for an orthographic camera",
        )
    job = Job(
        name="command line",
        shapes=tuple(options.mesh),
        materials=tuple(options.material),
        lights=tuple(options.light),
        views=parse_numbers(options.views, "--views", 23),
        rotations=parse_numbers(options.rotations, "--rotations", 127),
        tiers=tuple(options.tier or ["full"]),
        light_resolutions=tuple(options.light_resolution or ["64x128"]),
        samples=options.samples,
        camera=Camera(size=(height, width), fov_deg=options.fov),
        seed=options.seed,
    )
    try:
        return decode(json.dumps(msgspec.to_builtins(job)).encode(), Job, "render")
    except InputError as problem:
        key = problem.where.removeprefix("render: ").partition("[")[0]
        raise InputError(
            OPTIONS.get(key, f"--{key}"),
            problem.expected,
            problem.found,
            "see python -m factory render --help",
        ) from None


def parse_numbers(text: str, option: str, most: int) -> tuple[int, ...] | Draw:
    """Return "0,6" as (0, 6) and "random:5" as a Draw. Raises InputError for other text.

    most  the largest number
    """
    word, colon, count = text.partition(":")
    if word == "random" and colon and _is_number(count) and 1 <= int(count) <= most + 1:
        return Draw(random=int(count))
    parts = text.split(",")
    if not all(_is_number(p) and int(p) <= most for p in parts):
        raise InputError(
            option,
            f"numbers from 0 to {most}",
            f"'{text}'",
            f"write {option} 0,6 or {option} random:5",
        )
    return tuple(int(p) for p in parts)


def _is_number(text: str) -> bool:
    """Return whether a text has digits alone, and few enough for int."""
    return text.isascii() and text.isdigit() and len(text) < 20


def parse_size(text: str) -> tuple[int, int]:
    """Return "128" as (128, 128) and "128x256" as height and width. Raises InputError."""
    parts = text.lower().split("x")
    if len(parts) > 2 or not all(_is_number(p) and 4 <= int(p) <= 8192 for p in parts):
        raise InputError(
            "--size",
            "pixels from 4 to 8192",
            f"'{text}'",
            "write --size 128, or --size 128x256 for height and width",
        )
    return int(parts[0]), int(parts[-1])
