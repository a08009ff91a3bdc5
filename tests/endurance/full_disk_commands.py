"""Every command that writes and ends within seconds, as full_disk.py and the tests run it: one
table.

ROOM  a folder with what the commands read: data/ (a data set with two materials a view, sides for
training, validation and
      test), photo.png and other.png with their masks, run.json (a run of two steps), lamp.exr,
      maps.npz, kettle.obj
DISK  the folder that runs out
"""

import json
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

STEPS = (0.0, 0.15, 0.4, 0.7, 0.95)  # shares of what a command writes after which the disk is full
SIZE = 32
JOB = {
    "name": "room",
    "shapes": ["chair:0", "chair:13", "chair:1"],  # for training, for validation, for testing
    "materials": ["white-diffuse-bball", "nickel", "aluminium"],
    "lights": ["city"],
    "views": [0, 6],
    "tiers": ["direct"],
    "samples": 4,
    "repeats": 2,
    "camera": {"size": [SIZE, SIZE]},
}
RUN = {
    "name": "tiny",
    "size": SIZE,
    "data": {"sharing": 1},
    "losses": {"normals": 1, "material": 1},
    "schedule": {"steps": 2, "batch": 2, "warm_up": 1},
}
RENDER = (
    "factory render --mesh sphere:3 --material nickel --light city --views 0,6,12 --size 16"
    " --samples 1 --device cpu --out {disk}/out"
)


@dataclass(frozen=True)
class Command:
    """A command.

    line        its words, {room} and {disk} for the two folders
    over        words added to put results in the place of earlier ones; None: a second run does not
    copies      names in ROOM that are copied onto the disk first; damage: called with the disk,
    damages them
    statuses    exit statuses besides 0 that are no failure of the disk
    tolerates   it may end with 0 on a full disk, for what it could not keep it does without
    changes     endings of earlier files that it may change and still fail: those to which it
    appends
    temporary   it writes into the folder for temporary files, which lies on the disk
    """

    name: str
    line: str
    over: str | None = ""
    copies: tuple[str, ...] = ()
    damage: Callable = lambda disk: None
    statuses: tuple[int, ...] = ()
    tolerates: bool = False
    changes: tuple[str, ...] = ()
    temporary: bool = False

    @property
    def overwrites(self):
        """Whether a second run puts results in the place of the first one's."""
        return self.over is not None

    def words(self, room, disk, over=False):
        """The words of a command line, the program first."""
        line = f"{self.line} {self.over or ''}" if over else self.line
        return [word.format(room=room, disk=disk) for word in line.split()]

    def environment(self, disk):
        """Environment variables."""
        return {"TMPDIR": str(disk)} if self.temporary else {}

    def may_change(self, path):
        """Whether an earlier file may be altered by a run that fails."""
        return path.endswith(self.changes) if self.changes else False

    def may_be_empty(self, path):
        """Whether a file without content is right: a file of lines to which none has been
        written.
        """
        return path.endswith(".jsonl")


def _without_an_image(disk):
    next(iter(sorted((disk / "data" / "images").rglob("*.exr")))).unlink()


def _without_some_records(disk):
    (path,) = (disk / "data" / "records").iterdir()
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:-12]))
    for line in lines[-12:]:
        (disk / "data" / json.loads(line)["image"]).unlink()


LINES = (
    "records/worker-00.jsonl",
    "views/worker-00.jsonl",
    "dataset.json",
    "log.jsonl",
    "edits.jsonl",
    "pictures.jsonl",
)
COMMANDS = (
    Command("render", RENDER, None),
    Command("render --geometry-only", f"{RENDER} --geometry-only", None),
    Command(
        "render, continued",
        "factory render {room}/job.json --device cpu --out {disk}/data",
        None,
        ("data",),
        _without_some_records,
        changes=LINES,
    ),
    Command(
        "plan", "factory plan {room}/job.json --device cpu", None, temporary=True, tolerates=True
    ),  # another folder for temporary files
    Command(
        "verify --repair", "factory verify {disk}/data --repair", None, ("data",), _without_an_image
    ),
    Command(
        "preview", "factory preview {room}/data --out {disk}/out --count 2 --size 32", "--overwrite"
    ),
    Command(
        "export, tars", "factory export {room}/data --to tars --out {disk}/out --each 10", None
    ),
    Command(
        "export, records", "factory export {room}/data --to records --out {disk}/table.parquet"
    ),
    Command(
        "lights preview",
        "factory lights preview city {room}/lamp.exr --size 32 --out {disk}/lights.png",
    ),
    Command(
        "lights add",
        "factory lights add {room}/lamp.exr --library {disk}/library --licence CC0",
        None,
    ),
    Command(
        "lights add, of npz",
        "factory lights add {room}/maps.npz --library {disk}/library --licence CC0",
        None,
        changes=("lights.json",),
    ),
    Command(
        "materials preview",
        "factory materials preview white-diffuse-bball --of label --light gradient-1 --size 16"
        " --out {disk}/materials.png",
    ),
    Command("materials report", "factory materials report --out {disk}/out"),
    Command(
        "materials add", "factory materials add {room}/own --closures 1 --out {disk}/own.json", None
    ),
    Command(
        "shapes preview",
        "factory shapes preview sphere:1 --size 64 --azimuths 0 --out {disk}/shapes.png",
    ),
    Command(
        "shapes add",
        "factory shapes add {room}/kettle.obj --library {disk}/mine --category object",
        None,
    ),
    Command(
        "agree", "learn agree {room}/data --limit 2 --tolerance 0.1 --out {disk}/out", statuses=(3,)
    ),
    Command("predict, of a data set", "learn predict {room}/data --out {disk}/out", "--overwrite"),
    Command(
        "predict, of a photograph",
        "learn predict {room}/photo.png --mask {room}/mask.png --out {disk}/out",
        "--overwrite",
    ),
    Command(
        "edit",
        "learn edit {room}/photo.png --mask {room}/mask.png --material nickel aluminium --no-refine"
        " --out {disk}/out",
        "--overwrite",
    ),
    Command(
        "transfer",
        "learn transfer {room}/photo.png {room}/other.png --no-refine --out {disk}/out",
        "--overwrite",
    ),
    Command(
        "train",
        "learn train {room}/run.json --data {room}/data --workers 0 --sheet-every 1"
        " --checkpoint-every 1 --out {disk}/out",
        None,
        changes=LINES,
    ),
    Command(
        "train, on the data set's disk",
        "learn train {room}/run.json --data {disk}/data --workers 0 --out {disk}/elsewhere",
        None,
        ("data",),
        tolerates=True,
        changes=LINES,
    ),
    Command(
        "evaluate",
        "learn evaluate --data {room}/data --weights {room}/out/weights.safetensors --edits 2"
        " --allow-overlap --no-refine --processes 1 --gallery 1 --out {disk}/out",
        None,
        changes=LINES,
    ),
    Command(
        "baselines",
        "learn train-baselines --data {room}/data --only lombardi --out {disk}/out",
        None,
    ),
    Command(
        "card",
        "learn evaluate-network {room}/out/weights.safetensors --data {room}/data --batches 1"
        " --allow-overlap --out {disk}/out",
    ),
    Command(
        "steps",
        "learn.experiments step-profile {room}/run.json --data {room}/data --steps 1 --images 2"
        " --out {disk}/out",
    ),
    Command("exposure", "learn.experiments exposure --data {room}/data --out {disk}/out"),
    Command("promise", "learn.experiments tolerance-check --cases 1 --size 8 --out {disk}/out"),
    Command(
        "the demo's page",
        "learn.agreement.demo_page --sheet {room}/photo.png --agreement {room}/agreement --out"
        " {disk}/index.html",
    ),
)


def pictures(room):
    """Write two photographs, their masks, a light map and a collection of them into a folder."""
    from PIL import Image

    from manifests import exr

    y, x = np.mgrid[-1:1:40j, -1:1:40j]
    inside = x * x + y * y < 0.7
    shade = np.where(
        inside, 90 + 80 * np.sqrt(np.clip(0.7 - x * x - y * y, 0, 1)) - 60 * y, 30 + 20 * x
    )
    mask = Image.fromarray(255 * inside.astype(np.uint8))
    for name, tint in (("photo", (1, 0.8, 0.6)), ("other", (0.5, 0.8, 1))):
        picture = np.clip(np.dstack([shade * part for part in tint]), 0, 255).astype(np.uint8)
        Image.fromarray(picture).save(room / f"{name}.png")
        mask.save(room / f"{name}.mask.png")
    mask.save(room / "mask.png")
    ramp = np.linspace(0.1, 2.0, 16 * 32, dtype=np.float32).reshape(16, 32)
    exr.write(room / "lamp.exr", {name: ramp * (k + 1) for k, name in enumerate("RGB")})
    rng = np.random.default_rng(5)
    np.savez(
        room / "maps.npz",
        **{
            name: np.exp(rng.standard_normal((16, 32, 3))).astype(np.float32)
            for name in ("one", "two")
        },
    )


def mesh(room):
    """Write a mesh into a folder."""
    from factory.shapes.catalogue import load

    solid = load("torus")
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in solid.vertices] + [
        f"f {a} {b} {c}" for a, b, c in solid.faces + 1
    ]
    (room / "kettle.obj").write_text("\n".join(lines) + "\n")


def measurement(room):
    """Write a measured material, as MERL's files hold them, into own/."""
    shape = (90, 90, 180)
    (room / "own").mkdir(exist_ok=True)
    head = np.array(shape, np.int32).tobytes()
    values = (
        np.full((3, *shape), 0.1)
        * np.array([1500.0, 1500 / 1.15, 1500 / 1.66])[:, None, None, None]
    )
    (room / "own" / "own-wood.binary").write_bytes(head + values.astype(np.float64).tobytes())


def prepared(room, run):
    """The folder ROOM, made with Cycles once. run: full_disk.run."""
    room.mkdir(parents=True, exist_ok=True)
    (room / "job.json").write_text(json.dumps(JOB))
    (room / "run.json").write_text(json.dumps(RUN))
    if not (room / "ready").exists():
        pictures(room)
        mesh(room)
        measurement(room)
        for words in (
            ["factory", "render", room / "job.json", "--out", room / "data", "--device", "cpu"],
            [
                "learn",
                "train",
                room / "run.json",
                "--data",
                room / "data",
                "--workers",
                "0",
                "--out",
                room / "out",
            ],
            ["learn", "agree", room / "data", "--limit", "2", "--out", room / "agreement"],
        ):
            ended = run(words)
            if ended.status not in (0, 3):
                raise RuntimeError(f"{words}: {ended.stderr[-500:]}")
        (room / "ready").touch()
    return room
