"""Small valid files of every format that the program reads: what mutations start from.

mesh.obj, mesh.ply, mesh-binary.ply, mesh.glb, mesh.stl, mesh-binary.stl, mesh.off
light.exr, light.hdr, light.npz, maps.npz      library/ (two maps and lights.json)
job.json                                       names mesh.obj, light.exr and a material of
catalogue.json
catalogue.json, nbrdf.npz, merl.binary, abc.csv
data/                                          24 pictures of 32 × 32 pixels of a fake studio: clean
views/                                         geometry alone, of shapes for all sides
photograph.png, photograph.exr, mask.png, regions.png, material.json, pictures.txt
weights.safetensors                            the shipped network, to be shown pictures of 32 × 32
run.json, pictures.json                        training runs of two steps; trained/ is a folder that
the first has begun
"""

import io
import json
import os
import shutil
from pathlib import Path

import numpy as np

from . import Room

TESTS = Path(__file__).resolve().parents[1]
FAKE = "tests.fuzz.studio:Studio"
MATERIALS = ("brass", "gray-plastic", "white-acrylic")  # two for testing, one for training
RUN = {
    "name": "tiny",
    "size": 32,
    "parts": ["normals"],
    "data": {"sharing": 1, "materials": "built-in"},
    "losses": {"normals": 1, "material": 0},
    "schedule": {"steps": 2, "batch": 2, "warm_up": 1},
}


def shared(seeds: Path) -> Path:
    """The folder of all these files, which generators share: written by the first that asks.

    seeds  as `prepare` is given it
    """
    folder = seeds.parent / "shared"
    if not folder.exists():
        folder.mkdir()
        write(folder)
    return folder


def of(room: Room) -> Path:
    """The shared folder, for a case."""
    return room.seeds.parent / "shared"


def write(folder: Path) -> None:
    """Write all of them."""
    write_small(folder)
    datasets(folder)
    _weights(folder)
    _training(folder)


def write_small(folder: Path) -> None:
    """Write those that take no time: all but data sets, weights and trained/."""
    _meshes(folder)
    _lights(folder)
    _materials(folder)
    _photographs(folder)
    (folder / "job.json").write_text(json.dumps(job(folder), indent=1))


def job(folder: Path) -> dict:
    """A job of 24 pictures, with shapes for training, validation and testing."""
    return {
        "version": 1,
        "name": "fuzzed",
        "shapes": ["mesh.obj", "cube", "chair:13", "chair:1"],
        "materials": list(MATERIALS),
        "lights": ["light.exr"],
        "views": [3],
        "rotations": [0, 17],
        "tiers": ["direct"],
        "samples": 1,
        "camera": {"size": [32, 32], "elevation_deg": 20.0},
        "seed": 3,
    }


def fake_studio() -> None:
    """Let `factory render` in this process make its pictures with the fake studio instead of
    Blender.
    """
    import functools

    import factory.execution.run

    with_tests_on_path()
    factory.execution.run.RunOptions = functools.partial(
        factory.execution.run.RunOptions, studio=FAKE
    )


def with_tests_on_path() -> None:
    """Let worker processes import the fake studio."""
    folders = [str(TESTS.parent), os.environ.get("PYTHONPATH", "")]
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, folders))


def datasets(folder: Path) -> None:
    """data/ and views/ of the fake studio."""
    from factory.execution.run import RunOptions, carry_out, make_plan
    from factory.planning.assets import resolve
    from manifests.reading import decode
    from manifests.schema import Job

    with_tests_on_path()
    # 1 and 4 are for testing, 13 and 27 for validation
    shapes = [f"chair:{k}" for k in (0, 1, 2, 4, 13, 27)]
    for name, changes in (
        ("data", {}),
        ("views", {"shapes": shapes, "views": [3], "pictures": False, "materials": ["brass"]}),
    ):
        (folder / f"job-of-{name}.json").write_text(json.dumps(job(folder) | changes))
        chosen = decode((folder / f"job-of-{name}.json").read_bytes(), Job, name)
        carry_out(
            make_plan(chosen, resolve(chosen, folder)), folder / name, RunOptions(studio=FAKE)
        )


# ------------------------------------------------------------------------------------------------
# one function a format


def _meshes(folder):
    import trimesh

    box = trimesh.creation.box((1.0, 0.8, 0.6))
    lines = ["# a box", "mtllib mesh.mtl", "o box"]
    lines += [f"v {x:g} {y:g} {z:g}" for x, y, z in box.vertices]
    lines += ["vn 0 0 1", "vt 0.5 0.5", "usemtl wood", "s off"]
    for k, (a, b, c) in enumerate(box.faces + 1):
        lines.append(f"f {a}/1/1 {b}/1/1 {c}/1/1" if k % 2 else f"f {a} {b} {c}")
    (folder / "mesh.obj").write_text("\n".join(lines) + "\n")
    (folder / "mesh.mtl").write_text("newmtl wood\nKd 1 0 0\n")
    for name, options in (
        ("mesh.ply", {"file_type": "ply", "encoding": "ascii"}),
        ("mesh-binary.ply", {"file_type": "ply"}),
        ("mesh.glb", {"file_type": "glb"}),
        ("mesh.stl", {"file_type": "stl_ascii"}),
        ("mesh-binary.stl", {"file_type": "stl"}),
        ("mesh.off", {"file_type": "off"}),
    ):
        data = box.export(**options)
        (folder / name).write_bytes(data.encode() if isinstance(data, str) else data)


def _lights(folder):
    from . import mutation

    L = light()
    (folder / "light.exr").write_bytes(
        mutation.exr({name: L[..., k] for k, name in enumerate("RGB")})
    )
    (folder / "light.hdr").write_bytes(hdr(L))
    np.savez(folder / "light.npz", lamp=L)
    rng = np.random.default_rng(5)
    np.savez(
        folder / "maps.npz",
        **{
            f"map-{k}": np.exp(rng.standard_normal((64, 128, 3))).astype(np.float32)
            for k in range(3)
        },
    )
    library = folder / "library"
    library.mkdir()
    shutil.copy(folder / "light.exr", library / "lamp.exr")
    (library / "second.hdr").write_bytes(hdr(L[:, ::-1] * 2 + 0.1))
    (library / "lights.json").write_text(
        json.dumps(
            {"lamp": {"file": "lamp.exr", "hash": "", "licence": "CC0", "source": "tests"}},
            indent=1,
        )
    )


def light() -> np.ndarray:
    """(16, 32, 3) float32: a ramp with one bright texel."""
    L = np.linspace(0.1, 2.0, 16 * 32, dtype=np.float32).reshape(16, 32, 1) * np.array(
        [1, 2, 3], np.float32
    )
    L[4, 9] = 50
    return L


def hdr(L: np.ndarray) -> bytes:
    """The bytes of a Radiance file, scan lines run-length coded as programs write them."""
    mantissa, exponent = np.frexp(L.max(-1))
    scale = mantissa * 256 / np.maximum(L.max(-1), 1e-30)
    pixels = (
        np.concatenate([L * scale[..., None], exponent[..., None] + 128], -1)
        .clip(0, 255)
        .astype(np.uint8)
    )
    out = io.BytesIO()
    out.write(f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {L.shape[0]} +X {L.shape[1]}\n".encode())
    for row in pixels:
        out.write(bytes([2, 2, L.shape[1] >> 8, L.shape[1] & 255]))
        for channel in row.T:
            for first in range(0, len(channel), 128):
                out.write(
                    bytes([len(channel[first : first + 128])])
                    + channel[first : first + 128].tobytes()
                )
    return out.getvalue()


def _materials(folder):
    from manifests.materials import Catalogue, encode, read_catalogue

    built_in = read_catalogue(TESTS.parent / "manifests" / "materials.json").materials
    chosen = [entry for entry in built_in if entry.name in MATERIALS]
    own = Catalogue(
        title="own", credit="none", materials=tuple(_renamed(entry) for entry in chosen)
    )
    (folder / "catalogue.json").write_bytes(encode(own))
    rng = np.random.default_rng(7)
    np.savez(
        folder / "nbrdf.npz",
        names=np.array(["brass", "own-wood"]),
        weights=rng.normal(0, 0.2, (2, 675)).astype(np.float32),
    )
    cells = np.abs(rng.normal(500, 50, (3, 12, 9, 6)))
    (folder / "merl.binary").write_bytes(
        np.array([12, 9, 6], "<i4").tobytes() + cells.astype("<f8").tobytes()
    )
    row = "brass,0.1,0.1,0.1,5,5,5,100,1.5,1.5\n"
    (folder / "abc.csv").write_text("name,kd_r,kd_g,kd_b,A_r,A_g,A_b,B,C,ior\n" + row)


def _renamed(entry):
    import msgspec

    return msgspec.structs.replace(entry, name=f"own-{entry.name}")


def _photographs(folder):
    from PIL import Image

    from . import mutation

    y, x = np.mgrid[-1:1:18j, -1:1:24j]
    inside = x**2 + y**2 < 0.6
    shade = np.where(inside, np.sqrt(np.maximum(0.7 - x**2 - y**2, 0)), 0.2)
    picture = (255 * shade[..., None] * np.array([1.0, 0.8, 0.5])).astype(np.uint8)
    Image.fromarray(picture).save(folder / "photograph.png")
    Image.fromarray(np.uint8(255 * inside)).save(folder / "mask.png")
    Image.fromarray(np.where(inside, np.where(x < 0, 100, 200), 0).astype(np.uint8)).save(
        folder / "regions.png"
    )
    for name in ("photograph.mask.png", "second.mask.png"):
        Image.fromarray(np.uint8(255 * inside)).save(folder / name)
    second = folder / "second.png"
    Image.fromarray(np.dstack([picture[:, ::-1], np.uint8(255 * inside)])).save(second)
    channels = {name: (picture[..., k] / 255).astype(np.float16) for k, name in enumerate("RGB")}
    (folder / "photograph.exr").write_bytes(
        mutation.exr(channels | {"A": inside.astype(np.float16)})
    )
    (folder / "pictures.txt").write_text("photograph.png\nsecond.png\n")
    label = json.loads((folder / "catalogue.json").read_text())["materials"][0]["label"]
    (folder / "material.json").write_text(json.dumps({"label": label, "nearest": ["brass"]}))


def _weights(folder):
    from safetensors import safe_open
    from safetensors.torch import save_file

    with safe_open(TESTS.parent / "learn" / "weights" / "joint-compact.safetensors", "pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 -- not a dictionary
        metadata = file.metadata() | {"size": "32"}
    run = json.loads(metadata["run"])
    # what the small data sets do not have
    run["data"] |= {"validation_lights": [], "test_lights": []}
    run["size"] = 32
    metadata["run"] = json.dumps(run)
    save_file(tensors, folder / "weights.safetensors", metadata)


def _training(folder):
    """trained/ is the run's folder as a kill after its first step of two leaves it."""
    from learn.__main__ import COMMANDS, main
    from learn.training import loop

    (folder / "run.json").write_text(json.dumps(RUN, indent=1))
    (folder / "pictures.json").write_text(
        json.dumps(RUN | {"data": RUN["data"] | {"source": "pictures"}}, indent=1)
    )
    save = loop.Training._save_checkpoint

    def watched(self):
        save(self)
        if self.step == 1:
            shutil.copytree(self.out, folder / "trained")

    loop.Training._save_checkpoint = watched
    words = [
        "train",
        str(folder / "run.json"),
        "--data",
        str(folder / "views"),
        "--out",
        str(folder / "whole"),
    ]
    status = main("learn", "", COMMANDS, [*words, "--workers", "0", "--checkpoint-every", "1"])
    if status:
        raise RuntimeError(f"{' '.join(words)}: status {status}")
    shutil.rmtree(folder / "whole")
    shutil.rmtree(folder / "views" / "packed")
