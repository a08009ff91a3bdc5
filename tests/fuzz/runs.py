"""Training: run files, light maps, options, the caches beside a data set, and what an earlier run
left in the folder.

Every other case walks through a plan: what an earlier run left is damaged, then OPTIONS are tried,
then each key of a run file gets each of VALUES. The cases between are by chance, as is what comes
after the plan. An accepted run trains for two steps of two pictures of 32 × 32 pixels. A refused
run leaves the checkpoint that was there as it was.
"""

import json
import os
import shutil
from pathlib import Path

import numpy as np

from . import Case, Room, mutation, seeds

VALUES = (
    *(
        None,
        True,
        "",
        "x",
        [],
        {},
        0,
        -1,
        1,
        2,
        0.5,
        7,
        33,
        1e30,
        -1e30,
        1e-30,
        10**12,
        2**63,
        10**400,
        float("nan"),
        float("inf"),
    ),
    *(
        ["normals"],
        ["light"],
        ["normals", "normals"],
        ["sound"],
        [7, 9],
        [64, 128],
        [0, 0],
        [128, 256],
    ),
)
KEYS = (
    *(
        "version",
        "name",
        "about",
        "network",
        "size",
        "parts",
        "mixed_precision",
        "start",
        "stages",
        "seed",
        "skipped_steps",
    ),
    *(
        f"data.{key}"
        for key in (
            "source",
            "pictures_share",
            "sharing",
            "tolerance",
            "regions",
            "real_lights",
            "photograph",
        )
    ),
    *(f"data.{key}" for key in ("gloss_curriculum", "validation_lights", "test_lights")),
    *(
        f"data.{key}"
        for key in ("label_mixtures", "scaled_lobes", "principled", "principled_materials")
    ),
    "data.patterns",
    *(
        f"losses.{key}"
        for key in (
            "normals",
            "material",
            "albedo",
            "light_log",
            "light_rendered",
            "image",
            "target",
            "pixels",
            "gradient_bound",
        )
    ),
    *(
        f"losses.{key}"
        for key in (
            "layer_light",
            "rendered",
            "image_features",
            "target_features",
            "features",
            "features_sha256",
        )
    ),
    *(
        f"schedule.{key}"
        for key in (
            "steps",
            "batch",
            "learning_rate",
            "style",
            "warm_up",
            "weight_decay",
            "clip",
            "ema_decay",
            "seconds",
        )
    ),
)
OPTIONS = (
    *(("--steps", value) for value in ("0", "-1", "1", "x", "1e3", "100000001")),
    *(("--seed", value) for value in ("-1", "9223372036854775808", "0")),
    *(("--sheet-every", value) for value in ("0", "-1", "1")),
    *(("--checkpoint-every", value) for value in ("0", "-1", "1")),
    *(("--threads", value) for value in ("0", "-1")),
    *(("--workers", value) for value in ("-1", "1")),
)
LEFT = ("checkpoint.safetensors", "log.jsonl", "run.json", "weights.safetensors", "made.json")
CACHE = ("views.json", "normals.npy", "segments.npy", "skipped.json", "sums.json")
DAMAGE = (
    "empty",
    "cut",
    "noise",
    "a pipe",
    "a folder",
    "a circle of links",
    "text",
    "lists",
    "NaN",
    "removed",
    "of another",
)
PLANNED = [("left", name, how) for name in LEFT for how in DAMAGE] + [
    ("cache", name, how) for name in CACHE for how in DAMAGE
]
PLANNED += [("option", *each) for each in OPTIONS] + [
    ("run", key, value) for key in KEYS for value in VALUES
]
RUN = {
    "name": "fuzzed",
    "size": 32,
    "parts": ["normals", "material", "light"],
    "data": {"sharing": 1},
    "losses": {
        "normals": 1,
        "material": 1,
        "light_log": 1,
        "image": 1,
        "target": 1,
        "pixels": 8,
        "layer_light": [8, 16],
    },
    "schedule": {"steps": 2, "batch": 2, "warm_up": 1},
}
# networks are made before their settings can be seen to be too many for this machine
MEMORY_MB = 2048


def prepare(folder: Path) -> None:
    """The shared seeds; a data set whose cache of packed geometry is complete."""
    from learn.data.geometry import Geometry

    shutil.copytree(seeds.shared(folder) / "views", folder / "views")
    Geometry(folder / "views", progress=False)


def case(index: int, rng: np.random.Generator, room: Room) -> Case:
    """See the module."""
    there, out, more = seeds.of(room), room.folder / "out", []
    # a copy of its own: training writes a damaged cache again
    data = room.folder / "views"
    shutil.copytree(room.seeds / "views", data)
    run, text = json.loads(json.dumps(RUN)), None
    if index % 2 or index // 2 >= len(PLANNED):
        label, run, text, more = by_chance(rng, room, run, out)
    else:
        what, first, second = PLANNED[index // 2]
        label = f"{what} {first}: {str(second)[:40]}"
        if what == "run":
            *sections, last = first.split(".")
            parent = run
            for section in sections:
                parent = parent[section]
            parent[last] = second
        elif what == "left":
            shutil.copytree(there / "trained", out)
            run = json.loads((there / "run.json").read_text())
            damage(out / first, second, rng)
        elif what == "cache":
            damage(data / "packed" / first, second, rng)
        else:
            more = [first, second]
    path = room.folder / "run.json"
    path.write_bytes(text if text is not None else json.dumps(run).encode())
    words = [
        "learn",
        "train",
        path,
        "--data",
        data,
        "--out",
        out,
        *([] if "--workers" in more else ["--workers", "0"]),
        *more,
    ]
    kept = content(out / "checkpoint.safetensors")
    return Case(
        label=label,
        command=list(map(str, words)),
        writes=("out", "views"),
        check=lambda result: lost(result, out, kept),
    )


def by_chance(rng, room, run, out):
    """(label, run, its text or None, further options)."""
    there, kind = seeds.of(room), rng.random()
    if kind < 0.4:
        text, label = mutation.some_json(json.dumps(run).encode(), rng)
        return f"run: {label}", run, text, []
    own = json.loads((there / "run.json").read_text())
    if kind < 0.6:
        data, label = mutation.some_npz((there / "maps.npz").read_bytes(), rng)
        (room.folder / "maps.npz").write_bytes(data)
        return f"lights: {label}", own, None, ["--lights", str(room.folder / "maps.npz")]
    shutil.copytree(there / "trained", out)
    if kind < 0.9:
        data, label = mutation.some_safetensors((out / "checkpoint.safetensors").read_bytes(), rng)
        (out / "checkpoint.safetensors").write_bytes(data)
        return f"checkpoint: {label}", own, None, []
    data, label = mutation.some_text((out / "log.jsonl").read_bytes(), rng)
    (out / "log.jsonl").write_bytes(data)
    return f"log: {label}", own, None, []


def damage(path: Path, how: str, rng: np.random.Generator) -> None:
    """Do something to a file, which need not be there."""
    data = path.read_bytes() if path.is_file() else b"{}\n"
    path.unlink(missing_ok=True)
    if how == "a pipe":
        os.mkfifo(path)
    elif how == "a folder":
        path.mkdir()
    elif how == "a circle of links":
        path.symlink_to(path)
    elif how != "removed":
        text = {
            "empty": b"",
            "cut": data[: len(data) // 2],
            "text": b"hello\n",
            "lists": b"[" * 50_000,
            "NaN": b"NaN\n",
        }
        text |= {
            "noise": rng.bytes(len(data)),
            "of another": b'{"step": "one"}\n[1]\n{"step": null}\n5\n',
        }
        path.write_bytes(text[how])


def content(path: Path) -> bytes | None:
    """The bytes of a file, None where there is none."""
    return path.read_bytes() if path.is_file() else None


def lost(result, out: Path, kept: bytes | None) -> str | None:
    """What is wrong after a run: a checkpoint that went or changed though the run was refused,
    weights that are not finite.
    """
    if result.status == 1 and kept is not None and content(out / "checkpoint.safetensors") != kept:
        return "the checkpoint that was there is another, or gone"
    if result.status == 0:
        from learn.networks import weights

        weights.load_network(out / "weights.safetensors")
        steps = [
            json.loads(line)["step"]
            for line in (out / "log.jsonl").read_text(encoding="utf-8").splitlines()
        ]
        if steps != sorted(set(steps)):
            return f"the log has steps {steps}"
    return None
