"""Tampering with data sets: each field of each line and entry, each file, and what `verify` says of
it.

    python -m tests.fuzz.tampering --out DIR            data sets rendered by Cycles into DIR/bases,
    made once
    python -m tests.fuzz.tampering --out DIR --synthetic    data sets computed here, in a second
    python -m tests.fuzz tampering                      the synthetic ones, as one of the fuzzing
    generators

Three kinds of forgers tamper:

- one who changes a field or a file and nothing else;
- one who writes the hashes of files again, wherever they stand, and the figures that follow from
  pixels;
- one who knows how ids are made, and gives altered lines new ids, new names of pictures, seeds and
  orders that fit.

`learned` is everything that a reader could learn from a folder, read without any check: a tampering
counts as harmful if that changes. Harm that `verify` does not find makes this program end with
status 1, unless the forger left nothing in the folder that contradicts him: such tamperings carry
their reason in `principle`, and are listed.
"""

import argparse
import contextlib
import hashlib
import io
import json
import os
import shutil
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np

from manifests import arrays, exr, ids, picture_files
from manifests.files import npz_bytes
from manifests.schema import Camera, Job
from manifests.store import Store
from manifests.store_paths import geometry_path, image_path, light_path
from shaders.envmap import unit_mean
from shaders.tone import LUMINANCE

from . import Case, Result, Room

PEOPLE = "it is for people; nothing is computed from it"
SAME = "it says the same as before"
CONSISTENT = (
    "nothing in the folder contradicts it: every hash, figure, id, seed and order was made to fit"
)
UNFINISHED = (
    "it is what a run that was stopped earlier would have left; verify and status say how many"
    " pictures are owed"
)
MEASURED = (
    "it was measured against data that the folder does not hold; reports show it, nothing is"
    " learned from it"
)


@dataclass(frozen=True)
class Tampering:
    """One way to alter a data set.

    name       what is altered, and how: "BASE: place: change"
    forge      a function of a Folder and a generator of random numbers
    principle  why no reading of the folder can find it, None: it can
    harmless   why it alters nothing that is learned from, for the list
    """

    name: str
    forge: Callable[["Folder", np.random.Generator], None]
    principle: str | None = None
    harmless: str = PEOPLE


@dataclass(frozen=True)
class Verdict:
    """What became of a tampering: harmful, whether verify found it, whether its readers refused it,
    its first line.
    """

    tampering: Tampering
    harmful: bool
    found: bool
    refused: bool
    said: str


# ------------------------------------------------------------------------------------------- the
# folder under the knife


class Folder:
    """A data set's folder as plain JSON and bytes, with what a forger needs to alter it."""

    def __init__(self, path: Path):
        self.path = Path(path)
        self.kind = "records" if (self.path / "records").exists() else "views"
        self.lines_file = min((self.path / self.kind).glob("*.jsonl"))

    def lines(self) -> list[dict]:
        """The records or views."""
        files = sorted(self.lines_file.parent.glob("*.jsonl"))
        return [json.loads(line) for file in files for line in file.read_bytes().splitlines()]

    def write(self, lines: list[dict]) -> None:
        """Puts other records or views in their place."""
        self.lines_file.write_bytes(b"".join(json.dumps(line).encode() + b"\n" for line in lines))

    def json(self, name: str) -> dict:
        """dataset.json or materials.json."""
        return json.loads(content(self.path / name))

    def write_json(self, name: str, value: dict) -> None:
        """Puts another in its place."""
        (self.path / name).write_text(json.dumps(value))

    def rehash(self, path: str, content: bytes) -> None:
        """Another content of a file, its hash written again wherever it stands."""
        before = hashlib.sha256((self.path / path).read_bytes()).hexdigest()
        (self.path / path).write_bytes(content)
        after = hashlib.sha256(content).hexdigest()
        for file in (self.path / "dataset.json", self.lines_file):
            file.write_text(file.read_text().replace(before, after))

    def geometry_of(self, line: dict) -> picture_files.Geometry:
        """A line's geometry, unchecked."""
        channels = exr.read(self.path / line["geometry"])
        normals = np.stack([channels[name] for name in arrays.NORMAL_CHANNELS], -1)
        return picture_files.Geometry(
            normals, channels[arrays.DEPTH_CHANNEL], channels[arrays.SEGMENT_CHANNEL]
        )

    def picture_of(self, line: dict) -> np.ndarray:
        """A record's picture, unchecked, float32."""
        channels = exr.read(self.path / line["image"])
        return np.stack([channels[name] for name in "RGB"], -1).astype(np.float32)

    def figures(self, lines: list[dict], geometry: str | None = None) -> None:
        """Writes coverage, mean and maximum of lines again, of all or those of one geometry
        file.
        """
        for line in lines:
            if geometry in (None, line["geometry"]):
                mask = self.geometry_of(line).segments > 0
                where = line["statistics"] if self.kind == "records" else line
                where["coverage"] = round(float(mask.mean()), 6)
                if self.kind == "records" and mask.any():
                    inside = self.picture_of(line)[mask]
                    where["mean"] = round(
                        float(inside.mean(axis=0, dtype=np.float64) @ LUMINANCE), 6
                    )
                    where["max"] = round(float(inside.max()), 6)
        self.write(lines)

    def render(self) -> str:
        """The render version that the ids of this folder are hashed with."""
        return next(iter(self.json("dataset.json")["settings"]))

    def reidentify(self, line: dict, seed: bool = False) -> dict:
        """The line with the id, the files' names and the azimuth that follow from it, its files
        under those names.

        seed  give it the seed that its job gives it, too
        """
        dataset, new = self.json("dataset.json"), dict(line)
        camera = ids.camera_words(msgspec.convert(line["camera"], Camera))
        id_ = geometry = ids.geometry_id(
            line["shape_hash"], camera, line["viewpoint"], self.render()
        )
        if self.kind == "records":
            hashes = tuple(dataset["materials"][name]["hash"] for name in line["materials"])
            place = (
                line["viewpoint"],
                line["rotation_texels"],
                line["tier"],
                line["light_resolution"],
            )
            if seed:
                job = msgspec.convert(dataset["orders"][0]["job"], Job)
                choice = None if job.segment_materials is None else 0
                word, _, _ = ids.draws(
                    job,
                    ids.combination_key(line["shape_hash"], hashes, line["light_hash"], 0, choice),
                )
                new["seed"] = ids.shot_seed(word, ids.shot_place(*place, 0))
            digest = ids.shots_digest(
                self.render(),
                line["shape_hash"],
                hashes,
                line["light_hash"],
                camera,
                line["samples"],
            )
            id_ = ids.shot_id(digest, *place, new["seed"])
            new["image"] = image_path(id_)
            self._move(line["image"], new["image"])
        new |= {
            "id": id_,
            "geometry": geometry_path(geometry),
            "azimuth_deg": 15.0 * line["viewpoint"],
        }
        self._copy(line["geometry"], new["geometry"])
        return new

    def _move(self, old: str, new: str) -> None:
        if old != new:
            self._copy(old, new)
            (self.path / old).unlink()

    def _copy(self, old: str, new: str) -> None:
        if old != new and not (self.path / new).exists():
            (self.path / new).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(self.path / old, self.path / new)

    def without_unnamed_geometry(self) -> None:
        """Removes geometry files that no line names."""
        named = {line["geometry"] for line in self.lines()}
        for path in (self.path / "geometry").rglob("*.exr"):
            if path.relative_to(self.path).as_posix() not in named:
                path.unlink()


def content(path: Path) -> bytes:
    """The bytes of an ordinary file; for a pipe this would wait. Raises FileNotFoundError."""
    if not path.is_file():
        raise FileNotFoundError(path)
    return path.read_bytes()


def learned(folder: Path) -> object:
    """Everything that could be learned from a folder, read without a check; a text that says so if
    it cannot be read.
    """
    with _without_pipes(folder):
        return _learned(folder)


@contextlib.contextmanager
def _without_pipes(folder):
    """Within it no pipe lies in the folder: reading one without a check would wait for ever, and
    nothing can be learned from it.
    """
    moved = [
        (pipe, folder.parent / f"pipe-{number}")
        for number, pipe in enumerate(folder.rglob("*"))
        if pipe.is_fifo()
    ]
    for pipe, place in moved:
        pipe.rename(place)
    try:
        yield
    finally:
        for pipe, place in moved:
            place.rename(pipe)


def _learned(folder):
    try:
        there = Folder(folder)
        dataset, labels = there.json("dataset.json"), there.json("materials.json")["materials"]
        labels = {e["name"]: (e["label"], e["mixture"]) for e in labels}
        result = []
        for line in there.lines():
            shape = dataset["shapes"][line["shape"]]
            own = [line[key] for key in ("shape", "category", "viewpoint", "camera")]
            own += [
                shape["side"],
                line.get("split"),
                line.get("side"),
                line.get("segments"),
                line.get("materials"),
            ]
            own += [
                line.get(key)
                for key in (
                    "rotation_texels",
                    "tier",
                    "light_resolution",
                    "samples",
                    "seed",
                    "light",
                )
            ]
            own += [line["statistics"]["coverage"] if "statistics" in line else line["coverage"]]
            own += [labels[name] for name in line.get("materials", ())]
            own += [dataset["materials"][name]["side"] for name in line.get("materials", ())]
            geometry = there.geometry_of(line)
            pixels = [np.ascontiguousarray(array).tobytes() for array in geometry[:3]]
            if there.kind == "records":
                pixels += [
                    there.picture_of(line).tobytes(),
                    _map(folder, dataset["lights"][line["light"]]["file"]),
                ]
            result.append((json.dumps(own), *(hashlib.sha256(each).hexdigest() for each in pixels)))
        lights = {
            name: (entry["side"], _map(folder, entry["file"]))
            for name, entry in dataset["lights"].items()
        }
        return (
            sorted(result),
            lights,
            labels if there.kind == "views" else None,
            _packed_geometry(folder),
        )
    except Exception as error:  # whatever it is, nothing can be learned
        return f"unreadable: {type(error).__name__}"


def is_harmed(data: Path, base: Path) -> bool:
    """Whether something else is learned from a copy than from its base. A cache that training makes
    again does no harm.
    """
    return learned(data) != learned(base)


def _packed_geometry(folder):
    """Digest of the geometry that training reads, through the cache of a folder that has one; None
    for one without.
    """
    from learn.data.geometry import Geometry

    if not (folder / "packed").exists():
        return None
    geometry = Geometry(folder, progress=False)
    arrays_ = [
        np.ascontiguousarray(array)
        for k in range(len(geometry))
        for array in (geometry.normals(k), geometry.segments(k))
    ]
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays_)).hexdigest()


def _map(folder, file):
    with np.load(io.BytesIO(content(folder / file)), allow_pickle=False) as stored:
        return stored["L"].astype(np.float32).tobytes()


# --------------------------------------------------------------------------------------------- what
# is altered, and how

RECORD_FIELDS = {
    "id": ("0" * 24, lambda v, _: v.upper(), "../../../../tmp/x", lambda v, other: other["id"]),
    "shape": ("cube-2", lambda v, other: other["shape"]),
    "shape_hash": (
        "5" * 64,
        lambda v, other: other["shape_hash"],
        lambda v, _: v[:-1] + ("0" if v[-1] != "0" else "1"),
    ),
    "category": ("chair", "sofa", ""),
    "viewpoint": (lambda v, _: (v + 1) % 24, lambda v, other: other["viewpoint"], 24, -1),
    "azimuth_deg": (lambda v, _: v + 15, lambda v, _: v + 1e-9, 370.0),
    "camera.size": (lambda v, _: [v[0] + 1, v[1]], lambda v, _: [v[1] * 2, v[0]]),
    "camera.fov_deg": (30.0, lambda v, _: None if v else 60.0),
    "camera.elevation_deg": (lambda v, _: v + 1, lambda v, _: -v),
    "camera.half_extent": (lambda v, _: v * 1.01,),
    "camera.pixel": (lambda v, _: "square" if v == "centre" else "centre",),
    "light": ("sun", ""),
    "light_hash": ("7" * 64,),
    "rotation_texels": (lambda v, _: (v + 1) % 128, lambda v, _: (v + 64) % 128, 128),
    "tier": ("direct", "shadow", "full"),
    "light_resolution": (lambda v, _: "full" if v == "64x128" else "64x128",),
    "samples": (lambda v, _: v + 1, lambda v, _: 64 * v),
    "seed": (0, lambda v, _: v ^ 1),
    "image": (lambda v, other: other["image"], "images/00/none.exr", "../x.exr", "/etc/passwd"),
    "image_hash": ("0" * 64, lambda v, other: other["image_hash"]),
    "geometry": (lambda v, other: other["geometry"], "geometry/00/none.exr"),
    "geometry_hash": ("0" * 64, lambda v, other: other["geometry_hash"]),
    "split": ("train", "test", "mixed"),
    "statistics.coverage": (0.01, lambda v, _: v + 1e-4, 1.0),
    "statistics.mean": (lambda v, _: v * 1.002, 0.0),
    "statistics.max": (lambda v, _: v * 1.002, 0.0),
    "seconds": (9.9, 0.0),
    "materials": (
        lambda v, other: other["materials"],
        lambda v, _: v[::-1],
        lambda v, _: [*v, v[0]],
        lambda v, _: v[1:],
        ["felt"],
    ),
}
VIEW_FIELDS = {
    "coverage": (0.01, lambda v, _: v + 1e-4, 1.0),
    "segments": (lambda v, _: v + 1, lambda v, _: v - 1, 255),
    "side": ("train", "test"),
} | {
    key: RECORD_FIELDS[key]
    for key in (
        "id",
        "shape",
        "shape_hash",
        "category",
        "viewpoint",
        "azimuth_deg",
        "geometry",
        "geometry_hash",
        "seconds",
        *tuple(key for key in RECORD_FIELDS if key.startswith("camera.")),
    )
}
IN_ID = (
    "viewpoint",
    "rotation_texels",
    "tier",
    "light_resolution",
    "samples",
    "seed",
    "materials",
    *tuple(key for key in RECORD_FIELDS if key.startswith("camera.")),
)


def at(value: dict, path: str) -> tuple[dict, str]:
    """The dictionary that holds a dotted key, and the key."""
    *owners, key = path.split(".")
    for owner in owners:
        value = value[owner]
    return value, key


def altered(value: object, change: object, other: dict) -> object:
    """The value that a change puts in place: a constant, or a function of value and of another
    line.
    """
    return change(value, other) if callable(change) else change


def fields(base: Path) -> Iterator[Tampering]:
    """Each field of the first, the last and of every line, nothing else changed."""
    folder = Folder(base)
    lines = folder.lines()
    for path, changes in (RECORD_FIELDS if folder.kind == "records" else VIEW_FIELDS).items():
        for number, change in enumerate(changes):
            for which in ("first", "last", "every"):
                places = {"first": [0], "last": [len(lines) - 1], "every": range(len(lines))}[which]
                others = {k: _unlike(lines, k, path) for k in places}
                holders = {k: at(lines[k], path) for k in places}
                if all(
                    altered(h[key], change, others[k]) == h[key] for k, (h, key) in holders.items()
                ):
                    continue

                def forge(folder, rng, path=path, change=change, places=places, others=others):
                    now = folder.lines()
                    for k in places:
                        holder, key = at(now[k], path)
                        holder[key] = altered(holder[key], change, others[k])
                    folder.write(now)

                yield Tampering(f"{which} line: {path}, change {number + 1}", forge)


def _unlike(lines, k, path):
    """A line with another value than line k has at a path, else the next line."""
    key = path.split(".")[0]
    rest = [line for j, line in enumerate(lines) if j != k]
    return next((line for line in rest if line.get(key) != lines[k].get(key)), rest[0])


def with_ids(base: Path) -> Iterator[Tampering]:
    """Each field that determines a picture, with the id and the files' names that follow from
    it.
    """
    folder = Folder(base)
    lines = folder.lines()
    chosen = IN_ID if folder.kind == "records" else [key for key in IN_ID if key in VIEW_FIELDS]
    for path in chosen:
        for number, change in enumerate(RECORD_FIELDS[path]):
            other = _unlike(lines, 0, path)
            holder, key = at(lines[0], path)
            new = altered(holder[key], change, other)
            if (
                new == holder[key]
                or new in (24, -1, 128, ["felt"])
                or (key == "materials" and len(new) != len(holder[key]))
            ):
                continue

            def forge(folder, rng, path=path, new=new):
                now = folder.lines()
                line = json.loads(json.dumps(now[0]))
                owner, key = at(line, path)
                owner[key] = new
                now[0] = folder.reidentify(line)
                folder.write(now)
                folder.without_unnamed_geometry()

            yield Tampering(
                f"first line, its id and names as well: {path}, change {number + 1}", forge
            )


def entries(base: Path) -> Iterator[Tampering]:
    """Each field of each kind of entry in dataset.json and materials.json."""
    folder = Folder(base)
    dataset, labels = folder.json("dataset.json"), folder.json("materials.json")
    side = {"train": "test", "test": "train"}
    changes = {
        "shapes": {
            "hash": "5" * 64,
            "category": "sofa",
            "side": side.get,
            "role": lambda v: "pretrain" if v != "test" else "train",
            "segments": lambda v: v + 1,
            "licence": "mine",
            "report": "fine",
        },
        "materials": {"hash": "5" * 16, "side": side.get, "licence": "mine", "source": "mine"},
        "lights": {
            "hash": "7" * 64,
            "file": "lights/x.npz",
            "file_hash": "0" * 64,
            "scale": lambda v: 2 * v,
            "licence": "mine",
            "source": "mine",
            "side": side.get,
        },
    }
    for kind, keys in changes.items():
        for name in (
            (next(iter(dataset[kind])), list(dataset[kind])[-1])
            if len(dataset[kind]) > 1
            else dataset[kind]
        ):
            for key, change in keys.items():

                def forge(folder, rng, kind=kind, name=name, key=key, change=change):
                    value = folder.json("dataset.json")
                    entry = value[kind][name]
                    entry[key] = change(entry.get(key)) if callable(change) else change
                    folder.write_json("dataset.json", value)

                yield Tampering(f"dataset.json: {kind} '{name}': {key}", forge)

            def drop(folder, rng, kind=kind, name=name):
                value = folder.json("dataset.json")
                del value[kind][name]
                folder.write_json("dataset.json", value)

            yield Tampering(f"dataset.json: {kind} '{name}': dropped", drop)

            def rename(folder, rng, kind=kind, name=name):
                value = folder.json("dataset.json")
                value[kind]["other name"] = value[kind].pop(name)
                folder.write_json("dataset.json", value)

            yield Tampering(f"dataset.json: {kind} '{name}': renamed", rename)

            def double(folder, rng, kind=kind, name=name):
                value = folder.json("dataset.json")
                value[kind]["one more"] = value[kind][name]
                folder.write_json("dataset.json", value)

            if kind != "shapes":
                yield Tampering(
                    f"dataset.json: {kind} '{name}': once more under another name", double
                )
    for path, new in {
        "samples": 999,
        "seed": 999,
        "repeats": 7,
        "tiers": ["shadow"],
        "light_resolutions": ["full"],
        "views": [5],
        "rotations": [99],
        "camera": {"size": [4, 4]},
        "shapes": ["cube"],
        "materials": ["gold-paint"],
        "lights": ["night"],
        "split": "paper",
        "mixed": False,
        "roles": ["test"],
        "segment_materials": 3,
        "name": "mine",
        "about": "mine",
        "pictures": None,
    }.items():

        def order(folder, rng, path=path, new=new):
            value = folder.json("dataset.json")
            job = value["orders"][0]["job"]
            job[path] = (not job["pictures"]) if path == "pictures" else new
            folder.write_json("dataset.json", value)

        yield Tampering(
            f"dataset.json: order: {path}",
            order,
            harmless="what was rendered is what its ids say; the next run writes its order",
        )
    for what, change in {
        "shots more": lambda v: v["orders"][0].update(shots=10**6),
        "shots fewer": lambda v: v["orders"][0].update(shots=1),
        "begun": lambda v: v["orders"][0].update(begun="1999-01-01T00:00:00+00:00"),
        "orders dropped": lambda v: v.update(orders=[]),
        "settings dropped": lambda v: v.update(settings={}),
        "settings renamed": lambda v: v.update(
            settings={"f" * 16: next(iter(v["settings"].values()))}
        ),
        "settings' values": lambda v: v.update(
            settings={key_0: {"cycles.samples": 1} for key_0 in v["settings"]}
        ),
        "versions": lambda v: v.update(versions={"blender": "9.9"}),
        "version": lambda v: v.update(version=2),
    }.items():

        def change_dataset(folder, rng, change=change):
            value = folder.json("dataset.json")
            change(value)
            folder.write_json("dataset.json", value)

        yield Tampering(f"dataset.json: {what}", change_dataset)
    yield from _labels(labels, in_no_id=folder.kind == "views")


def _labels(labels, in_no_id):
    """Each field of a material's label, as it is and with hashes that fit.

    in_no_id  whether no id is a hash of the materials' hashes: geometry shows no material
    """
    for number in range(len(labels["materials"])):
        name = labels["materials"][number]["name"]
        for key, change, reason in (
            ("label", lambda e: e["label"].__setitem__(0, e["label"][0] + 1e-6), None),
            ("label", lambda e: e.update(label=[*e["label"][36:], *e["label"][:36]]), None),
            (
                "mixture",
                lambda e: e["mixture"]["weights"][0][0].__setitem__(
                    0, e["mixture"]["weights"][0][0][0] * 1.001
                ),
                None,
            ),
            ("hash", lambda e: e.update(hash="5" * 16), None),
            ("split", lambda e: e.update(split="test" if e["split"] == "train" else "train"), None),
            ("licence", lambda e: e.update(licence="mine"), None),
            ("source", lambda e: e.update(source="mine"), None),
            ("family", lambda e: e.update(family="mine"), PEOPLE),
            ("errors", lambda e: e["errors"]["nodes_vs_label"].update(l1=[0.0] * 6), MEASURED),
            ("name", lambda e: e.update(name="other name"), None),
        ):
            for level in ("", ", its hash as well", ", its hash in both files as well"):
                if level and key not in ("label", "mixture"):
                    continue

                def forge(folder, rng, number=number, change=change, level=level):
                    value, dataset = folder.json("materials.json"), folder.json("dataset.json")
                    entry = value["materials"][number]
                    change(entry)
                    if level:
                        entry["hash"] = _own_hash(entry)
                    if "both" in level:
                        dataset["materials"][entry["name"]]["hash"] = entry["hash"]
                        folder.write_json("dataset.json", dataset)
                    folder.write_json("materials.json", value)

                fits = CONSISTENT if "both" in level and in_no_id else None
                yield Tampering(
                    f"materials.json: '{name}': {key}{level}",
                    forge,
                    fits,
                    harmless=reason or PEOPLE,
                )

    def drop(folder, rng):
        value = folder.json("materials.json")
        value["materials"].pop()
        folder.write_json("materials.json", value)

    yield Tampering("materials.json: the last entry dropped", drop)

    def swap(folder, rng):
        value = folder.json("materials.json")
        first, last = value["materials"][0], value["materials"][-1]
        first["name"], last["name"] = last["name"], first["name"]
        folder.write_json("materials.json", value)

    yield Tampering("materials.json: two names exchanged", swap)

    def double(folder, rng):
        value = folder.json("materials.json")
        value["materials"].append(dict(value["materials"][0]))
        folder.write_json("materials.json", value)

    yield Tampering("materials.json: an entry twice", double)

    def title(folder, rng):
        value = folder.json("materials.json")
        value["title"] = value["credit"] = "mine"
        folder.write_json("materials.json", value)

    yield Tampering("materials.json: title and credit", title)


def _own_hash(entry):
    from manifests.materials import MixtureData, material_hash

    return material_hash(
        tuple(map(float, entry["label"])), msgspec.convert(entry["mixture"], MixtureData)
    )


def _half(picture):
    return exr.encode({name: picture[..., k].astype(np.float16) for k, name in enumerate("RGB")})


def _flipped(picture, mask):
    """The picture with the brightness of the object turned upside down within the mask: figures
    stay as they are.
    """
    out = picture.copy()
    out[mask] = picture[mask][::-1]
    return out


# name: (function of picture and mask, what may make it undetectable once figures are written again)
PICTURES = {
    "half as bright": lambda p, m: 0.5 * p,
    "brighter by a per cent": lambda p, m: 1.01 * p,
    "one pixel set to 1": lambda p, m: np.where(_one(m)[..., None], 1.0, p),
    "channels exchanged": lambda p, m: p[..., ::-1],
    "pixels of the object in another order": _flipped,
    "noise": lambda p, m: p * np.random.default_rng(0).lognormal(0, 0.2, p.shape),
    "black": lambda p, m: 0 * p,
    "white everywhere": lambda p, m: np.ones_like(p),
    "negative": lambda p, m: -p,
    "NaN": lambda p, m: np.where(_one(m)[..., None], np.nan, p),
    "infinite": lambda p, m: np.where(_one(m)[..., None], np.inf, p),
    "smaller": lambda p, m: p[::2, ::2],
}
IMPOSSIBLE = ("black", "negative", "NaN", "infinite", "smaller")


def _one(mask):
    """A mask of one pixel of the object."""
    rows, columns = np.nonzero(mask)
    out = np.zeros_like(mask)
    out[rows[len(rows) // 2], columns[len(rows) // 2]] = True
    return out


GEOMETRIES = {  # name: function of normals, depth, segments → the same, as float64
    "normals turned away": lambda n, d, s: (n * [1, 1, -1], d, s),
    "normals half as long": lambda n, d, s: (n * 0.5, d, s),
    "normals mirrored sideways": lambda n, d, s: (n * [-1, 1, 1], d, s),
    "normals mirrored upwards": lambda n, d, s: (n * [1, -1, 1], d, s),
    "normals NaN": lambda n, d, s: (np.where(s[..., None] > 0, np.nan, n), d, s),
    "normals in the background": lambda n, d, s: (np.where(s[..., None] > 0, n, [0, 0, 1]), d, s),
    "normals not rounded": lambda n, d, s: (n * (1 + 1e-6), d, s),
    "depth nearer": lambda n, d, s: (n, np.where(s > 0, d - 3, 0), s),
    "depth turned over": lambda n, d, s: (n, -d, s),
    "depth infinite": lambda n, d, s: (n, np.where(s > 0, np.inf, 0), s),
    "segments 256": lambda n, d, s: (n, d, np.where(s > 0, 256, 0)),
    "segments 257": lambda n, d, s: (n, d, np.where(s > 0, 257, 0)),
    "segments one more": lambda n, d, s: (n, d, np.where(s > 0, s.max() + 1, 0)),
    "segments gone": lambda n, d, s: (0 * n, 0 * d, 0 * s),
    "half of the object gone": lambda n, d, s: tuple(_left(a) for a in (n, d, s)),
    "smaller": lambda n, d, s: (n[::2, ::2], d[::2, ::2], s[::2, ::2]),
}
PLAUSIBLE = {  # they are what another shape, or the same one in other places, could look like
    "normals a little off": lambda n, d, s: (
        _unit(n + 0.2 * (s[..., None] > 0) * np.array([0.0, 0.0, 1.0])),
        d,
        s,
    ),
    "segments exchanged": lambda n, d, s: (n, d, np.where(s > 0, s.max() + 1 - s, 0)),
    "depth flatter": lambda n, d, s: (n, 0.5 * d, s),
}


def _left(array):
    out = array.copy()
    out[:, : array.shape[1] // 2] = 0
    return out


def _unit(n):
    return n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-9)


def _encoded(normals, depth, segments, rounded):
    if rounded:
        steps = float(arrays.STEPS_PER_UNIT)
        normals, depth = np.rint(normals * steps) / steps, np.rint(depth * steps) / steps
    channels = {
        name: normals[..., k].astype(np.float32) for k, name in enumerate(arrays.NORMAL_CHANNELS)
    }
    return exr.encode(
        channels
        | {
            arrays.DEPTH_CHANNEL: depth.astype(np.float32),
            arrays.SEGMENT_CHANNEL: segments.astype(np.uint32),
        }
    )


def contents(base: Path) -> Iterator[Tampering]:
    """Files with other contents: hashes as they were, written again, and figures written again as
    well.
    """
    folder = Folder(base)
    if folder.kind == "records":
        for name, change in PICTURES.items():
            for level in ("", ", hash as well", ", hash and figures as well"):

                def forge(folder, rng, change=change, level=level):
                    lines = folder.lines()
                    line = lines[0]
                    mask = folder.geometry_of(line).segments > 0
                    content = _half(change(folder.picture_of(line), mask))
                    if not level:
                        (folder.path / line["image"]).write_bytes(content)
                        return
                    folder.rehash(line["image"], content)
                    if "figures" in level:
                        lines = folder.lines()
                        folder.figures(
                            lines, None if "smaller" in change.__name__ else lines[0]["geometry"]
                        )

                keeps = name in ("pixels of the object in another order",)
                fits = "figures" in level or (keeps and level)
                reason = CONSISTENT if fits and name not in IMPOSSIBLE else None
                if not (name == "smaller" and "figures" in level):
                    yield Tampering(f"picture: {name}{level}", forge, reason)
        for name, channels in (
            ("float32", "RGB"),
            ("named XYZ", "XYZ"),
            ("with alpha", "RGBA"),
            ("grey alone", "R"),
        ):

            def rename(folder, rng, channels=channels, name=name):
                line = folder.lines()[0]
                p = folder.picture_of(line)
                type_ = np.float32 if name == "float32" else np.float16
                folder.rehash(
                    line["image"],
                    exr.encode({c: p[..., k % 3].astype(type_) for k, c in enumerate(channels)}),
                )

            yield Tampering(f"picture: {name}, hash as well", rename, harmless=SAME)
    for name, change in (GEOMETRIES | PLAUSIBLE).items():
        for level in ("", ", hash as well", ", hash and figures as well"):

            def forge(folder, rng, change=change, level=level, name=name):
                lines = folder.lines()
                line = lines[0]
                arrays_ = (np.asarray(a, np.float64) for a in folder.geometry_of(line)[:3])
                content = _encoded(*change(*arrays_), rounded=name != "normals not rounded")
                if not level:
                    (folder.path / line["geometry"]).write_bytes(content)
                    return
                path = line["geometry"]
                folder.rehash(path, content)
                if "figures" in level:
                    folder.figures(folder.lines(), path)

            reason = (
                CONSISTENT
                if level
                and (
                    name in PLAUSIBLE or (name == "half of the object gone" and "figures" in level)
                )
                else None
            )
            if not (name == "smaller" and "figures" in level):
                yield Tampering(f"geometry: {name}{level}", forge, reason)
    for name, change, reason in (
        ("twice as bright", lambda L, s: {"L": 2 * L, "scale": s}, None),
        ("another scale", lambda L, s: {"L": L, "scale": 2 * s}, None),
        ("negative", lambda L, s: {"L": -L, "scale": s}, None),
        ("NaN", lambda L, s: {"L": np.where(L.max() == L, np.nan, L), "scale": s}, None),
        ("another size", lambda L, s: {"L": L[:32], "scale": s}, None),
        ("float64", lambda L, s: {"L": L.astype(np.float64), "scale": s}, None),
        ("one array more", lambda L, s: {"L": L, "scale": s, "M": L}, None),
        ("without scale", lambda L, s: {"L": L}, None),
        ("turned by a texel", lambda L, s: {"L": np.roll(L, 1, 1), "scale": s}, CONSISTENT),
        ("upside down", lambda L, s: {"L": np.ascontiguousarray(L[::-1]), "scale": s}, CONSISTENT),
        (
            "grey",
            lambda L, s: {"L": unit_mean(np.repeat(L @ LUMINANCE[:, None], 3, -1))[0], "scale": s},
            CONSISTENT,
        ),
    ):
        for level in ("", ", hash as well"):

            def forge(folder, rng, change=change, level=level):
                entry = next(iter(folder.json("dataset.json")["lights"].values()))
                with np.load(folder.path / entry["file"]) as stored:
                    content = npz_bytes(change(stored["L"], stored["scale"]))
                if level:
                    folder.rehash(entry["file"], content)
                else:
                    (folder.path / entry["file"]).write_bytes(content)

            known = _is_known_light(folder)
            yield Tampering(
                f"light: {name}{level}", forge, reason if level and not known else None, SAME
            )


def _is_known_light(folder):
    """Whether the program makes this light itself: it comes with it, or is computed."""
    from factory.commands.verify import reference_light

    name, entry = next(iter(folder.json("dataset.json")["lights"].items()))
    return reference_light(name, entry["hash"]) is not None


def _files_of(folder: Folder) -> list[str]:
    """A file of each kind."""
    line = folder.lines()[0]
    light = next(iter(folder.json("dataset.json")["lights"].values()))["file"]
    names = [
        line["geometry"],
        light,
        folder.lines_file.relative_to(folder.path).as_posix(),
        "dataset.json",
        "materials.json",
    ]
    names += [line["image"]] if "image" in line else []
    return names + [
        path.relative_to(folder.path).as_posix()
        for path in sorted((folder.path / "packed").glob("*.*"))
    ]


def files(base: Path) -> Iterator[Tampering]:
    """Each kind of file flipped, cut, emptied, exchanged, gone, and something else in its place."""
    folder = Folder(base)

    def flip(path, rng):
        data = bytearray(path.read_bytes())
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        path.write_bytes(data)

    def other(path, rng):
        same = [
            p
            for p in sorted(path.parent.parent.rglob(f"*{path.suffix}"))
            if p != path and p.read_bytes() != path.read_bytes()
        ]
        path.write_bytes(same[0].read_bytes() if same else b"other")

    def instead(put):
        def forge(path, rng):
            path.unlink()
            put(path)

        return forge

    changes = {
        "a bit flipped": flip,
        "cut in half": lambda path, rng: path.write_bytes(
            path.read_bytes()[: path.stat().st_size // 2]
        ),
        "emptied": lambda path, rng: path.write_bytes(b""),
        "a byte added": lambda path, rng: path.write_bytes(path.read_bytes() + b"\0"),
        "gone": lambda path, rng: path.unlink(),
        "another file's content": other,
        "a pipe": instead(os.mkfifo),
        "a link to itself": instead(lambda path: path.symlink_to(path.name)),
        "a link elsewhere": instead(lambda path: path.symlink_to("/etc/hostname")),
        "a folder": instead(os.mkdir),
    }
    for name in _files_of(folder):
        for what, change in changes.items():
            if what == "another file's content" and not name.startswith(("images", "geometry")):
                continue
            repeats = 3 if what == "a bit flipped" else 1
            for k in range(repeats):
                again = f" ({k + 1})" if repeats > 1 else ""
                cache = name.startswith("packed/")
                reason = SAME if not cache else "training makes a cache again that is not whole"
                yield Tampering(
                    f"file {_shown(name)}: {what}{again}",
                    lambda folder, rng, name=name, change=change: change(folder.path / name, rng),
                    harmless=reason,
                )


def _shown(name):
    """A file's kind, without the id in its name."""
    return (
        name
        if "/" not in name or name.startswith(("packed", "records", "views"))
        else name.split("/")[0]
    )


def lists(base: Path) -> Iterator[Tampering]:
    """Lines doubled, dropped, mixed up, added; files added; folders that are none."""
    folder = Folder(base)
    count = len(folder.lines())

    def on_lines(change):
        def forge(folder, rng):
            lines = folder.lines()
            folder.write(change(lines, folder))

        return forge

    def raw(change):
        return lambda folder, rng: folder.lines_file.write_bytes(
            change(folder.lines_file.read_bytes())
        )

    def dropped(folder, rng):
        lines = folder.lines()
        gone = lines.pop(1)
        folder.write(lines)
        if "image" in gone:
            (folder.path / gone["image"]).unlink()
        folder.without_unnamed_geometry()

    def added(name, put):
        def forge(folder, rng):
            path = folder.path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            put(path)

        return forge

    yield Tampering("lines: the first one twice", on_lines(lambda lines, _: [lines[0], *lines]))
    yield Tampering(
        "lines: the first one twice, with other seconds",
        on_lines(lambda lines, _: [*lines, lines[0] | {"seconds": 7.0}]),
    )
    yield Tampering(
        "lines: the first one again in a second file",
        lambda folder, rng: _second(folder, folder.lines()[:1]),
    )
    yield Tampering(
        "lines: one dropped, its files kept",
        on_lines(lambda lines, _: [*lines[:1], *lines[2:]]),
        UNFINISHED,
    )
    yield Tampering("lines: one dropped with its files", dropped, UNFINISHED)
    yield Tampering(
        "lines: in reverse",
        on_lines(lambda lines, _: lines[::-1]),
        harmless="readers sort them by id",
    )
    yield Tampering("lines: in two files", _parted, harmless="readers sort them by id")
    yield Tampering("lines: pictures of two exchanged", on_lines(_exchange("image", "image_hash")))
    yield Tampering(
        "lines: geometry of two exchanged", on_lines(_exchange("geometry", "geometry_hash"))
    )
    yield Tampering("lines: ids of two exchanged", on_lines(_exchange("id")))
    yield Tampering(
        "lines: all but the ids of two exchanged", on_lines(lambda lines, _: _but_ids(lines))
    )
    yield Tampering("lines: the last cut short", raw(lambda data: data[:-20]), UNFINISHED)
    yield Tampering(
        "lines: garbage between them", raw(lambda data: data.replace(b"\n", b"\nnot json\n", 1))
    )
    yield Tampering(
        "lines: an unknown key", on_lines(lambda lines, _: [lines[0] | {"weight": 2}, *lines[1:]])
    )
    yield Tampering(
        "lines: a key gone",
        on_lines(
            lambda lines, _: [{k: v for k, v in lines[0].items() if k != "camera"}, *lines[1:]]
        ),
    )
    yield Tampering("lines: all gone", raw(lambda data: b""), UNFINISHED)
    yield Tampering("lines: a byte-order mark", raw(lambda data: b"\xef\xbb\xbf" + data))
    if count:
        yield Tampering(
            "files: a picture more",
            added("images/ab/stray.exr", lambda path: path.write_bytes(b"x")),
            harmless="nothing names it",
        )
        yield Tampering(
            "files: geometry more",
            added("geometry/ab/stray.exr", lambda path: path.write_bytes(b"x")),
            harmless="nothing names it",
        )
        yield Tampering(
            "files: a light more",
            added("lights/stray.npz", lambda path: path.write_bytes(b"x")),
            harmless="nothing names it",
        )
        yield Tampering(
            "files: a draft left",
            added("partial/x.exr", lambda path: path.write_bytes(b"x")),
            harmless="nothing names it",
        )
        yield Tampering(
            "files: a note in the folder",
            added("notes.txt", lambda path: path.write_bytes(b"x")),
            harmless="it is the user's",
        )
        yield Tampering(
            "files: a note beside the lines",
            added(f"{folder.kind}/notes.txt", lambda path: path.write_bytes(b"x")),
        )
        yield Tampering(
            "files: a pipe at the top", added("pipe", os.mkfifo), harmless="nothing names it"
        )
        yield Tampering(
            "files: a circle of links",
            added("images/loop", lambda path: path.symlink_to("loop")),
            harmless="nothing names it",
        )
        yield Tampering("files: a pipe among the lines", added(f"{folder.kind}/x.jsonl", os.mkfifo))
        yield Tampering(
            "files: a failure that is none",
            added("failures.jsonl", lambda path: path.write_bytes(b"{}\n")),
            harmless=PEOPLE,
        )
    for name in ("images", "geometry", "lights", folder.kind):
        if (folder.path / name).exists():
            yield Tampering(
                f"folder {name}: a link to itself",
                _instead_of(name, lambda path: path.symlink_to(path.name)),
            )
            yield Tampering(
                f"folder {name}: a file", _instead_of(name, lambda path: path.write_bytes(b""))
            )
            yield Tampering(
                f"folder {name}: elsewhere, behind a link", _elsewhere(name), harmless=SAME
            )


def _second(folder, lines):
    path = folder.lines_file.with_name("worker-77.jsonl")
    path.write_bytes(b"".join(json.dumps(line).encode() + b"\n" for line in lines))


def _parted(folder, rng):
    lines = folder.lines()
    folder.write(lines[:1])
    _second(folder, lines[1:])


def _exchange(*keys):
    def change(lines, folder):
        first = lines[0]
        k = next(
            (
                j
                for j, line in enumerate(lines)
                if all(line.get(key) != first.get(key) for key in keys)
            ),
            1,
        )
        for key in keys:
            if key in first:
                first[key], lines[k][key] = lines[k][key], first[key]
        return lines

    return change


def _but_ids(lines):
    first, last = lines[0], lines[-1]
    own = ("id", "image", "image_hash")
    new = [
        {**theirs, **{key: ours[key] for key in own if key in ours}}
        for ours, theirs in ((first, last), (last, first))
    ]
    return [new[0], *lines[1:-1], new[1]]


def _instead_of(name, put):
    def forge(folder, rng):
        shutil.rmtree(folder.path / name)
        put(folder.path / name)

    return forge


def _elsewhere(name):
    def forge(folder, rng):
        away = folder.path.with_name(f"{folder.path.name}-{name}")
        shutil.rmtree(away, ignore_errors=True)
        (folder.path / name).rename(away)
        (folder.path / name).symlink_to(away)

    return forge


def masterly(base: Path) -> Iterator[Tampering]:
    """By a forger who knows the whole program, and makes everything fit: what no reading of the
    folder can find, and what can.
    """
    folder = Folder(base)
    if folder.kind == "records":

        def samples(folder, rng):
            """The order and every line say that twice the samples were taken."""
            value = folder.json("dataset.json")
            for order in value["orders"]:
                order["job"]["samples"] *= 2
            folder.write_json("dataset.json", value)
            folder.write(
                [
                    folder.reidentify(line | {"samples": 2 * line["samples"]})
                    for line in folder.lines()
                ]
            )

        def relabelled(folder, rng):
            """The place of one record is given to the picture of another, whose own record goes."""
            lines = folder.lines()
            k = next(
                j for j, line in enumerate(lines) if j and line["geometry"] == lines[0]["geometry"]
            )
            gone, kept = lines[0], lines.pop(k)
            shutil.copyfile(folder.path / kept["image"], folder.path / gone["image"])
            (folder.path / kept["image"]).unlink()
            lines[0] = gone | {"image_hash": kept["image_hash"], "statistics": kept["statistics"]}
            folder.write(lines)

        def label(folder, rng):
            """Another label and mixture, with their hash, ids, seeds and names of pictures."""
            value, dataset = folder.json("materials.json"), folder.json("dataset.json")
            entry = value["materials"][0]
            entry["label"][0] += 0.5
            entry["hash"] = dataset["materials"][entry["name"]]["hash"] = _own_hash(entry)
            folder.write_json("materials.json", value)
            folder.write_json("dataset.json", dataset)
            folder.write(
                [
                    (
                        folder.reidentify(line, seed=True)
                        if entry["name"] in line["materials"]
                        else line
                    )
                    for line in folder.lines()
                ]
            )

        single = folder.json("dataset.json")["orders"][0]["job"]["segment_materials"] is None
        yield Tampering("forged: samples in orders, lines, ids and names", samples, CONSISTENT)
        yield Tampering("forged: a picture under the name of another", relabelled, CONSISTENT)
        if single:
            yield Tampering("forged: a label, its hash, ids, seeds and names", label, CONSISTENT)

    def category(folder, rng):
        """The category of a shape, in its entry and in every line."""
        value = folder.json("dataset.json")
        name = next(iter(value["shapes"]))
        value["shapes"][name]["category"] = "sofa"
        folder.write_json("dataset.json", value)
        folder.write(
            [
                line | {"category": "sofa"} if line["shape"] == name else line
                for line in folder.lines()
            ]
        )

    def side(folder, rng):
        """The side of a shape, in its entry and in every line."""
        value = folder.json("dataset.json")
        name, entry = next(iter(value["shapes"].items()))
        entry["side"] = entry["role"] = "test" if entry["side"] == "train" else "train"
        folder.write_json("dataset.json", value)
        lines = folder.lines()
        for line in lines:
            if line["shape"] == name:
                materials = [value["materials"][m]["side"] for m in line.get("materials", ())]
                line.update(
                    {"side": entry["side"]}
                    if folder.kind == "views"
                    else {"split": _split(entry["side"], materials)}
                )
        folder.write(lines)

    def material_side(folder, rng):
        """The side of a material, in both files and in every line."""
        value, labels = folder.json("dataset.json"), folder.json("materials.json")
        entry = labels["materials"][0]
        entry["split"] = value["materials"][entry["name"]]["side"] = (
            "test" if entry["split"] == "train" else "train"
        )
        folder.write_json("dataset.json", value)
        folder.write_json("materials.json", labels)
        lines = folder.lines()
        for line in lines:
            if "split" in line:
                materials = [value["materials"][m]["side"] for m in line["materials"]]
                line["split"] = _split(value["shapes"][line["shape"]]["side"], materials)
        folder.write(lines)

    def light_hash(folder, rng):
        """The hash of a light, the name of its map, ids, seeds and names of pictures."""
        value = folder.json("dataset.json")
        name, entry = next(iter(value["lights"].items()))
        new = "7" * 64
        (folder.path / entry["file"]).rename(folder.path / light_path(name, new))
        from manifests.splits import light_side

        entry |= {"hash": new, "file": light_path(name, new), "side": light_side(new)}
        folder.write_json("dataset.json", value)
        lines = folder.lines()
        if folder.kind == "records":
            lines = [
                (
                    folder.reidentify(line | {"light_hash": new}, seed=True)
                    if line["light"] == name
                    else line
                )
                for line in lines
            ]
            folder.write(lines)

    dataset, labels = folder.json("dataset.json"), folder.json("materials.json")
    shape = next(iter(dataset["shapes"]))
    numbered = shape.split(":")[0] in ("chair", "car", "sofa", "monitor")
    built_in = labels["materials"][0]["source"] != "computed"
    drawn = dataset["orders"][0]["job"]["segment_materials"] is not None
    reason = (
        "the folder does not hold the mesh, and its file's folder is what its category came from"
    )
    yield Tampering("forged: a shape's category everywhere", category, None if numbered else reason)
    yield Tampering("forged: a shape's side everywhere", side)
    own = "the side of a material is its catalogue's word, and the catalogue is the user's own"
    yield Tampering(
        "forged: a material's side everywhere", material_side, None if built_in else own
    )
    if not drawn:
        yield Tampering("forged: a light's hash everywhere", light_hash, CONSISTENT)


def _split(shape, materials):
    return shape if all(side == shape for side in materials) else "mixed"


def tamperings(base: Path) -> list[Tampering]:
    """Everything that is done to one data set."""
    parts = (fields, with_ids, entries, contents, files, lists, masterly)
    return [
        replace(each, name=f"{base.name}: {each.name}") for part in parts for each in part(base)
    ]


# ------------------------------------------------------------------------------------------------
# the judging


def judged(
    base: Path, tampering: Tampering, room: Path, rng: np.random.Generator, readers: bool = True
) -> Verdict:
    """What becomes of a tampering with a copy of a data set; readers: look, too, whether learn
    refuses it.
    """
    data = room / "data"
    shutil.copytree(base, data)
    tampering.forge(Folder(data), rng)
    faults = faults_in(data)
    harmful = is_harmed(data, base)
    refused = readers and refuses(data)
    return Verdict(tampering, harmful, bool(faults), refused, faults[0] if faults else "")


def faults_in(data: Path) -> list[str]:
    """Lines that verify prints of a folder."""
    from factory.commands.verify import reference_light
    from factory.planning.fingerprint import render_fingerprint
    from manifests.errors import InputError
    from manifests.verification import faults_of

    try:
        result = [
            fault.text for fault in faults_of(Store(data), render_fingerprint(), reference_light)
        ]
    except InputError as problem:  # no dataset.json that can be read
        result = [str(problem)]
    assert all(line.isprintable() for line in result), result
    return result


def refuses(data: Path) -> bool:
    """Whether a reader of the data ends with an InputError, at the latest when it loads the
    files.
    """
    from learn.data.records import Records
    from manifests.errors import InputError

    try:
        records = Records(data)
        for record in records.records:
            records.load(record)
        for view in records.views():
            records.geometry(view)
        for name in records.dataset.lights:
            records.light(name)
        for name in records.dataset.materials:
            records.label(name)
    except (InputError, OSError):
        return True
    return False


def run(
    bases: list[Path],
    room: Path,
    seed: int = 0,
    only: Callable[[int], bool] = lambda k: True,
    readers: bool = True,
) -> Iterator[Verdict]:
    """The Verdict of each tampering with each data set; only: of which numbers."""
    number = 0
    for base in bases:
        for tampering in tamperings(base):
            number += 1
            if only(number):
                there = room / f"{number:04d}"
                rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
                yield judged(base, tampering, there, rng, readers)
                shutil.rmtree(there, ignore_errors=True)


def missed(verdict: Verdict) -> bool:
    """Whether harm was done that verify does not find, and could."""
    return verdict.harmful and not verdict.found and verdict.tampering.principle is None


# ------------------------------------------------------------------------------------------------
# what starts it


def synthetic(folder: Path) -> list[Path]:
    """Data sets that are computed here: pictures, segments in perspective, geometry alone with its
    cache.
    """
    from tests.support.whole_dataset import JOB, write_dataset

    perspective = Camera(size=(12, 16), fov_deg=45.0)
    jobs = {
        "pictures": (JOB, 1),
        "segments": (
            msgspec.structs.replace(
                JOB, camera=perspective, tiers=("direct", "full"), rotations=(3, 40), views=(1,)
            ),
            3,
        ),
        "views": (msgspec.structs.replace(JOB, pictures=False, views=(0, 6, 9)), 2),
    }
    for name, (job, segments) in jobs.items():
        if not (folder / name / "dataset.json").exists():
            write_dataset(folder / name, job, segments)
    _packed(folder / "views")
    return [folder / name for name in jobs]


def rendered(folder: Path) -> list[Path]:
    """Data sets by Cycles, of the smallest size: the same three kinds, one of them under a light
    file of the user's own.
    """
    from factory.execution.run import RunOptions, carry_out, make_plan
    from factory.planning.assets import resolve

    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "lamp.exr").exists():
        sky = np.exp(np.random.default_rng(5).standard_normal((16, 32, 3))).astype(np.float32)
        exr.write(folder / "lamp.exr", {name: sky[..., k] for k, name in enumerate("RGB")})
    jobs = {
        "pictures": Job(
            shapes=("chair:0", "sphere"),
            materials=("nickel", "white-diffuse-bball"),
            lights=("city",),
            views=(0, 6),
            tiers=("direct",),
            samples=4,
            camera=Camera(size=(24, 24)),
        ),
        "segments": Job(
            shapes=("chair:1", "sofa:2"),
            materials=("merl/train",),
            lights=(str(folder / "lamp.exr"),),
            views=(2, 9),
            rotations=(0, 40),
            tiers=("direct", "full"),
            samples=4,
            segment_materials=1,
            camera=Camera(size=(20, 24), fov_deg=40.0, pixel="centre"),
        ),
        "views": Job(
            shapes=("chair:0", "monitor:1"),
            materials=("nickel", "brass"),
            lights=("night",),
            views=(0, 5),
            pictures=False,
            camera=Camera(size=(24, 24)),
        ),
    }
    for name, job in jobs.items():
        if not (folder / name / "dataset.json").exists():
            carry_out(make_plan(job, resolve(job)), folder / name, RunOptions())
    _packed(folder / "views")
    return [folder / name for name in jobs]


def _packed(folder):
    """The cache of a data set, as training leaves it."""
    from learn.data.geometry import Geometry

    if not (folder / "packed").exists():
        Geometry(folder, progress=False)


def prepare(folder: Path) -> None:
    """The synthetic data sets, for the fuzzing driver."""
    synthetic(folder)


def case(index: int, rng: np.random.Generator, room: Room) -> Case:
    """A tampering, through the command `factory verify`."""
    bases = [room.seeds / name for name in ("pictures", "segments", "views")]
    every = [(base, tampering) for base in bases for tampering in tamperings(base)]
    # 7 is prime to their number: kinds take turns
    base, tampering = every[(index * 7) % len(every)]
    data = room.folder / "data"
    shutil.copytree(base, data)
    tampering.forge(Folder(data), rng)

    def check(result: Result) -> str | None:
        # after verify: this reads as training does
        if result.status == 0 and tampering.principle is None and is_harmed(data, base):
            return "what is learned from was altered, and verify calls it clean"
        return None

    names = (
        "data/.lock",
        *(f"data-{name}" for name in ("images", "geometry", "lights", "records", "views")),
    )
    return Case(
        label=tampering.name,
        command=["factory", "verify", str(data)],
        check=check,
        writes=names,
        statuses=(0, 1),
    )


def table(verdicts: list[Verdict]) -> str:
    """The table of all, and the lists of those that were not found."""
    lines = [
        f"{'harmful' if v.harmful else 'harmless':<9}{_told(v):<14}{v.tampering.name}"
        for v in verdicts
    ]
    groups = {
        "Not found, and harmful: faults of verify": [v for v in verdicts if missed(v)],
        "Not found, and harmful: what no reading of the folder can find": [
            v for v in verdicts if v.harmful and not v.found and v.tampering.principle
        ],
        "Not found, and harmless": [v for v in verdicts if not v.harmful and not v.found],
    }
    for title, group in groups.items():
        lines += ["", f"{title}: {len(group)}"]
        lines += [
            f"  {v.tampering.name}: {v.tampering.principle or v.tampering.harmless}" for v in group
        ]
    harm = [v for v in verdicts if v.harmful]
    findable = [v for v in harm if v.tampering.principle is None]
    lines += [
        "",
        f"{len(verdicts)} tamperings, {sum(v.found for v in verdicts)} found",
        (
            f"{len(harm)} alter what is learned from: {sum(v.found for v in harm)} found,"
            f" {len(harm) - sum(v.found for v in harm)} not; of the {len(findable)} that leave a"
            f" contradiction {sum(v.found for v in findable)} found"
        ),
        (
            f"{sum(v.refused for v in harm)} of these {len(harm)} are refused by the readers of"
            " learn, too"
        ),
    ]
    return "\n".join(lines)


def _told(verdict):
    return (
        "found" if verdict.found else "in principle" if verdict.tampering.principle else "not found"
    )


def main() -> int:
    """Print the table; 1 if harm was done that verify does not find, and could."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out",
        required=True,
        type=Path,
        help="data sets are kept in DIR/bases, the table is DIR/table.txt",
    )
    parser.add_argument(
        "--synthetic", action="store_true", help="data sets computed here instead of by Cycles"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", help="tamperings whose name holds this text")
    options = parser.parse_args()
    bases = (
        synthetic(options.out / "synthetic")
        if options.synthetic
        else rendered((options.out / "bases").absolute())
    )
    for base in bases:
        if result := faults_in(base):
            print(f"{base}: not clean before anything was done to it: {result[0]}", file=sys.stderr)
            return 2
    start, verdicts = time.perf_counter(), []
    room = options.out / "room"
    shutil.rmtree(room, ignore_errors=True)
    for base in bases:
        for number, tampering in enumerate(tamperings(base)):
            if options.only and options.only not in tampering.name:
                continue
            rng = np.random.default_rng(np.random.SeedSequence(options.seed, spawn_key=(number,)))
            verdicts.append(judged(base, tampering, room / f"{number}", rng))
            shutil.rmtree(room, ignore_errors=True)
    text = table(verdicts)
    (options.out / "table.txt").write_text(text + "\n", encoding="utf-8")
    print(text)
    kinds = Counter(v.tampering.name.split(":")[0] for v in verdicts)
    print(f"{dict(kinds)}, {time.perf_counter() - start:.0f} s")
    return 1 if any(map(missed, verdicts)) else 0


if __name__ == "__main__":
    sys.exit(main())
