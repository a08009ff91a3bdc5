"""Which command lines read which format, as templates.

{file}    the file under test          {seeds}  valid files (tests/fuzz/seeds.py)
{out}     the folder for results       {room}   the case's folder
{data}    a data set                   {views}  a valid one of geometry alone, of the case's own
{job}     a job file beside {file} that names it as its mesh or its light
"""

import json
import shlex
import shutil
from pathlib import Path

from . import Room, seeds

WRITES = ("out", "out.png", "out.json", "out.json.fits", "views/packed", "views/.lock")

QUICK_EDIT = "--no-refine --tolerance 0.5 --weights {seeds}/weights.safetensors --out {out}"

SLOW = ("learn edit", "learn transfer")  # seconds each, where the rest takes tenths

READERS = {
    "mesh": (
        "factory shapes list {file}",
        "factory shapes preview {file} --size 16 --out {room}/out.png",
        "factory shapes add {file} --category object --licence CC0 --library {out}",
        "factory shapes list {file} --segments materials --crease 30 --up z --front x",
        "factory plan {job} --no-probe",
    ),
    "light": (
        "factory lights preview {file} --size 16 --out {room}/out.png",
        "factory lights add {file} --library {out} --licence CC0",
        "factory plan {job} --no-probe",
        (
            "factory materials preview own-brass --catalogue {seeds}/catalogue.json --light {file}"
            " --size 16 --out {room}/out.png"
        ),
    ),
    "maps": (
        "factory lights add {file} --library {out}",
        (
            "learn train {seeds}/run.json --data {views} --lights {file} --steps 1 --workers 0"
            " --out {out}"
        ),
    ),
    "lights.json": (
        "factory lights list {room}/library",
        "factory lights add {seeds}/light.exr --library {room}/library",
        "factory lights preview lamp --library {room}/library --size 16 --out {room}/out.png",
    ),
    "job": (
        "factory plan {file} --no-probe --assets {seeds} --catalogue {seeds}/catalogue.json",
        "factory plan {file} --no-probe --assets {seeds}",
    ),
    "catalogue": (
        "factory materials list --catalogue {file}",
        "factory materials preview --catalogue {file} --size 16 --out {room}/out.png",
        "factory materials report {file} --out {out}",
        "factory plan {seeds}/job.json --no-probe --catalogue {file}",
    ),
    "source": (
        (
            "factory materials report {seeds}/catalogue.json --source {file} --abc {seeds}/abc.csv"
            " --out {out}"
        ),
    ),
    "merl": (
        (
            "factory materials report {seeds}/catalogue.json --source {file} --abc {seeds}/abc.csv"
            " --out {out}"
        ),
    ),
    "abc": (
        (
            "factory materials report {seeds}/catalogue.json --source {seeds}/nbrdf.npz --abc"
            " {file} --out {out}"
        ),
    ),
    "photograph": (
        (
            "learn predict {file} --mask {seeds}/mask.png --weights {seeds}/weights.safetensors"
            " --out {out}"
        ),
        "learn edit {file} --mask {seeds}/mask.png --material brass " + QUICK_EDIT,
        "learn transfer {file} {seeds}/second.png --mask-dir {room}/masks " + QUICK_EDIT,
        "learn edit {seeds}/second.png --material {file} " + QUICK_EDIT,
    ),
    "mask": (
        (
            "learn predict {seeds}/photograph.png --mask {file} --weights"
            " {seeds}/weights.safetensors --out {out}"
        ),
        "learn edit {seeds}/photograph.png --mask {file} --material brass " + QUICK_EDIT,
    ),
    "regions": (
        "learn edit {seeds}/photograph.png --regions {file} --material brass+keep " + QUICK_EDIT,
        "learn edit {seeds}/photograph.png --mask {seeds}/mask.png --regions {file} --material"
        " brass " + QUICK_EDIT,
    ),
    "pictures.txt": ("learn transfer --list {file} --mask-dir {seeds} " + QUICK_EDIT,),
    "material": ("learn edit {seeds}/second.png --material {file} " + QUICK_EDIT,),
    "weights": (
        "learn predict {seeds}/second.png --weights {file} --out {out}",
        (
            "learn edit {seeds}/second.png --material brass --no-refine --tolerance 0.5 --weights"
            " {file} --out {out}"
        ),
        "learn predict {seeds}/data --weights {file} --out {out}",
    ),
    "run": ("learn train {file} --data {views} --workers 0 --steps 1 --out {out}",),
    "checkpoint": ("learn train {seeds}/run.json --data {views} --workers 0 --out {room}/trained",),
    "log": ("learn train {seeds}/run.json --data {views} --workers 0 --out {room}/trained",),
}

FORMATS = {  # format: its seeds, by name in the shared folder
    "mesh": (
        "mesh.obj",
        "mesh.ply",
        "mesh-binary.ply",
        "mesh.glb",
        "mesh.stl",
        "mesh-binary.stl",
        "mesh.off",
    ),
    "light": ("light.exr", "light.hdr", "light.npz"),
    "maps": ("maps.npz",),
    "lights.json": ("library/lights.json",),
    "job": ("job.json",),
    "catalogue": ("catalogue.json",),
    "source": ("nbrdf.npz",),
    "merl": ("merl.binary",),
    "abc": ("abc.csv",),
    "photograph": ("photograph.png", "photograph.exr"),
    "mask": ("mask.png",),
    "regions": ("regions.png",),
    "pictures.txt": ("pictures.txt",),
    "material": ("material.json",),
    "weights": ("weights.safetensors",),
    "run": ("run.json",),
    "checkpoint": ("trained/checkpoint.safetensors",),
    "log": ("trained/log.jsonl",),
}


def draw_small() -> None:
    """Let `learn edit` in this process render 32 pixels across instead of 256: what it reads and
    writes stays the same.
    """
    from learn.editing import compositor, drawing

    compositor.COARSEST, drawing.SPHERE = min(compositor.COARSEST, 32), min(drawing.SPHERE, 16)


def line(
    template: str, room: Room, file: Path | None = None, data: Path | None = None
) -> list[str]:
    """A template as a command line; writes the job that it names, if it names one."""
    words = {
        "data": data,
        "out": room.folder / "out",
        "seeds": seeds.of(room),
        "room": room.folder,
        "file": file,
    }
    if "{job}" in template:
        words["job"] = _job(room, file)
    if "{views}" in template:
        words["views"] = room.folder / "views"
        shutil.copytree(seeds.of(room) / "views", words["views"])
    return [word.format(**words) for word in shlex.split(template)]


def _job(room: Room, file: Path) -> Path:
    job = seeds.job(room.folder)
    job |= (
        {"lights": [file.name]}
        if file.suffix in (".exr", ".hdr", ".npz")
        else {"shapes": [file.name], "lights": ["softboxes-3"]}
    )
    job |= {"shapes": ["cube"]} if "mesh.obj" in job["shapes"] else {}
    path = file.parent / "a-job.json"
    path.write_text(json.dumps(job))
    return path
