"""Files of tensors: weights of every network, priors, VGG16 and LPIPS, with metadata, names,
shapes, types and numbers changed.

First each key of the metadata in turn gets each of VALUES, then each of SURGERY is done to each
file, then chance. What is accepted must predict finite parts; no file may take more memory than a
network does.
"""

import json
import struct
from pathlib import Path

import numpy as np

from . import Case, Result, Room, mutation

KEYS = ("format", "network", "size", "run", "step", "fitted")
VALUES = (
    None,  # removed
    *(
        "",
        "0",
        "-1",
        "31",
        "33",
        "64",
        "1024",
        "1040",
        "20000",
        "10" * 200,
        "1e2",
        "128.0",
        "nan",
        "inf",
        "null",
        "[]",
        "{}",
        "{",
        "\0",
    ),
    *(
        "compact",
        "paper",
        "separate",
        "encoder-decoder",
        "Compact",
        "../compact",
        "brdfactory weights 2",
        "brdfactory priors 1",
    ),
    *(
        '{"name": 5}',
        '{"parts": []}',
        '{"parts": ["normals"]}',
        '{"parts": "normals"}',
        '{"parts": ["light", "sound"]}',
        '{"parts": null}',
    ),
    *(
        '{"name": 1e400}',
        '{"size": 1' + "0" * 400 + "}",
        "[" * 100_000,
        '{"name": "' + "x" * 100_000 + '"}',
        "x" * 200_000,
        "é\u202e",
    ),
)
FILES = ("compact", "separate", "encoder-decoder", "priors", "vgg16", "lpips")
SURGERY = (
    *(
        "header of 2^63",
        "header beyond the file",
        "header of 0",
        "header of 100 MB",
        "header not UTF-8",
        "header no JSON",
        "header of lists",
    ),
    *(
        "offsets overlap",
        "offsets backwards",
        "offsets beyond the file",
        "offsets of 2^60",
        "a gap",
        "bytes behind the end",
    ),
    *(
        "another type",
        "a type that is none",
        "a shape of more",
        "a shape of 2^60",
        "a shape of text",
        "an empty shape",
        "a negative shape",
    ),
    *(
        "a tensor more",
        "a tensor of 1 GB more, which is not there",
        "a tensor less",
        "a tensor renamed",
        "all NaN",
        "all infinite",
    ),
    *(
        "one NaN",
        "one infinite",
        "all 0",
        "all 1e30",
        "all negative",
        "ranges of 1e30",
        "ranges of 0",
        "ranges negative",
        "ranges of κ",
    ),
    *(
        "a key twice",
        "metadata of numbers",
        "metadata of a list",
        "10,000 tensors of nothing",
        "cut in the middle",
        "empty",
        "a pickle",
    ),
    *("a zip", "a pipe", "a folder", "a device", "a circle of links", "5 GB of nothing"),
)
MEMORY_MB = 1024


def prepare(folder: Path) -> None:
    """Small files of each kind; of the networks freshly drawn, to be shown pictures of 32 × 32."""
    import torch
    from safetensors.torch import save

    from learn.baselines import priors
    from learn.metrics import lpips
    from learn.networks import features, weights
    from learn.networks.coding import Ranges
    from manifests.materials import load_catalogue

    torch.manual_seed(0)
    labels = [entry.label.reshape(-1) for entry in load_catalogue().values()]
    ranges = Ranges.of(torch.from_numpy(np.stack(labels)).float())
    for name in FILES[:3]:
        network = weights.NETWORKS[name](ranges)
        run = json.dumps({"name": "fuzzed", "parts": ["normals", "material", "light"]})
        weights.save_weights(
            folder / f"{name}.safetensors", network, network.state_dict(), run, 32, 7
        )
    rng = np.random.default_rng(0)
    maps = [np.exp(rng.normal(size=(64, 128, 3))) for _ in range(3)]
    priors.save(folder / "priors.safetensors", priors.fit(labels, maps), {"maps": 3})
    shapes, before = {}, 3
    for number, width in zip(
        features.NUMBERS, (w for block in features.WIDTHS for w in block), strict=True
    ):
        shapes |= {
            f"features.{number}.weight": (width, before, 3, 3),
            f"features.{number}.bias": (width,),
        }
        before = width
    (folder / "vgg16.safetensors").write_bytes(
        save({name: 0.1 * torch.randn(shape) for name, shape in shapes.items()})
    )
    shapes = {}
    for (k, *_), shape in zip(lpips.LAYERS, lpips.SHAPES, strict=True):
        shapes |= {f"features.{k}.weight": shape, f"features.{k}.bias": shape[:1]}
    shapes |= {f"lin{i}.weight": (1, shape[0], 1, 1) for i, shape in enumerate(lpips.SHAPES)}
    (folder / "lpips.safetensors").write_bytes(
        save({name: 0.1 * torch.rand(shape) for name, shape in shapes.items()})
    )


def case(index: int, rng: np.random.Generator, room: Room) -> Case:
    """See the module."""
    path = room.folder / "weights.safetensors"
    planned = len(KEYS) * len(VALUES)
    if index < planned:
        key, value = KEYS[index // len(VALUES)], VALUES[index % len(VALUES)]
        name = "priors" if key == "fitted" else FILES[index % 3]
        header, body = parted(room.seeds / f"{name}.safetensors")
        report = header.setdefault("__metadata__", {})
        report.pop(key, None)
        if value is not None:
            report[key] = value
        path.write_bytes(joined(header, body))
        label = f"{name}: metadata {key}: {'removed' if value is None else value[:40]!r}"
    elif index < planned + len(FILES) * len(SURGERY):
        name, how = FILES[(index - planned) % len(FILES)], SURGERY[(index - planned) // len(FILES)]
        operate(path, room.seeds / f"{name}.safetensors", how, rng)
        label = f"{name}: {how}"
    else:
        name = mutation.pick(rng, FILES)
        data, label = mutation.some_safetensors(
            (room.seeds / f"{name}.safetensors").read_bytes(), rng
        )
        path.write_bytes(data)
        label = f"{name}: {label}"
    if name in FILES[:2] and index % 9 == 0:
        shared = room.folder / "photo.png"
        photograph(shared)
        words = [
            "learn",
            "predict",
            str(shared),
            "--weights",
            str(path),
            "--out",
            str(room.folder / "out"),
        ]
        return Case(label=label, command=words)
    return Case(
        label=label, run=lambda: used(name, path), check=lambda result: unsound(result, name)
    )


def used(name, path):
    """What a reader of such files makes of it."""
    import torch

    from learn.baselines import priors
    from learn.evaluation import baseline_methods as methods
    from learn.metrics import lpips
    from learn.networks import features, weights

    if name == "priors":
        known = priors.load(path)
        return known.label(torch.zeros(len(known.directions)).double()), known.light(
            torch.zeros_like(known.light_mean), 16, 32
        )
    if name == "vgg16":
        return tuple(features.load(path)(torch.rand(1, 3, 32, 32)))
    if name == "lpips":
        picture = 255 * np.random.default_rng(0).random((64, 64, 3))
        return (torch.tensor(lpips.load(path)(picture, picture[::-1].copy())),)
    if name == "encoder-decoder":
        return methods.load("Baseline 1", path).net(
            torch.rand(1, 3, 32, 32), torch.ones(1, 1, 32, 32), torch.zeros(1, 1, 108)
        )[:4]
    network, metadata = weights.load_full_network(path)
    size = metadata["size"]
    if not (isinstance(size, int) and 32 <= size <= 1024):
        raise AssertionError(f"a size of {size!r} was accepted")
    with torch.no_grad():
        return network(torch.rand(1, 3, 32, 32), torch.ones(1, 1, 32, 32))


def unsound(result: Result, name: str) -> str | None:
    """What is wrong with what accepted weights predict. Finite but senseless ones may well
    overflow: commands refuse that.
    """
    if result.error is not None:
        return None
    parts = [part for part in result.value if part is not None]
    return None if parts else f"{name}: nothing predicted"


def photograph(path: Path) -> None:
    """A picture of 40 × 40 with transparency about its object."""
    from PIL import Image

    y, x = np.mgrid[-1:1:40j, -1:1:40j]
    inside = x**2 + y**2 < 0.6
    values = np.dstack([np.uint8(120 + 100 * x)] * 3 + [np.uint8(255 * inside)])
    Image.fromarray(values).save(path)


# ------------------------------------------------------------------------------------------------
# surgery


def parted(path: Path) -> tuple[dict, bytes]:
    """(header, bytes of the tensors) of a file."""
    data = path.read_bytes()
    length = struct.unpack("<Q", data[:8])[0]
    return json.loads(data[8 : 8 + length]), data[8 + length :]


def joined(header, body: bytes) -> bytes:
    """The bytes of a file."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    return struct.pack("<Q", len(text)) + text + body


def operate(path: Path, seed: Path, how: str, rng: np.random.Generator) -> None:
    """Write the seed to `path` with one thing done to it."""
    import os

    header, body = parted(seed)
    data = seed.read_bytes()
    names = [name for name in header if name != "__metadata__"]
    first, second = names[0], names[1]
    name = mutation.pick(rng, names)
    start, end = header[name]["data_offsets"]
    size = {"F16": 2, "BF16": 2, "F32": 4, "F64": 8, "I64": 8}[header[name]["dtype"]]
    {2: np.float16, 4: np.float32, 8: np.float64}[size]
    if how.startswith("ranges"):
        _ranges(path, header, body, how)
        return
    if how.startswith(("all", "one")):
        value = {"NaN": np.nan, "infinite": np.inf, "0": 0, "1e30": 1e30, "negative": -1}[
            how.split()[1]
        ]
        every = how.startswith("all")
        out = bytearray(body)
        for each in names if every else [name]:
            a, b = header[each]["data_offsets"]
            width = {"F16": 2, "BF16": 2, "F32": 4, "F64": 8, "I64": 8}[header[each]["dtype"]]
            with np.errstate(over="ignore"):
                packed = {2: np.float16, 4: np.float32, 8: np.float64}[width](value).tobytes()
            if header[each]["dtype"] != "I64":
                out[a:b] = (
                    packed * ((b - a) // width) if every else packed + bytes(out[a + width : b])
                )
        path.write_bytes(joined(header, bytes(out)))
        return
    length = len(data) - len(body) - 8
    other = {
        "header of 2^63": struct.pack("<Q", 1 << 63) + data[8:],
        "header beyond the file": struct.pack("<Q", len(data)) + data[8:],
        "header of 0": struct.pack("<Q", 0) + data[8:],
        "header of 100 MB": (
            struct.pack("<Q", 99_000_000)
            + b'{"__metadata__":{"a":"'
            + b"x" * 98_999_975
            + b'"}}'
            + b" "
        ),
        "header not UTF-8": joined(
            json.dumps(header).encode().replace(b"dtype", b"dt\xffpe", 1), body
        ),
        "header no JSON": joined(b"{" + bytes(length - 1), body),
        "header of lists": joined(b"[" * 5000 + b"]" * 5000, body),
        "bytes behind the end": data + bytes(100),
        "a key twice": joined(
            json.dumps(header).encode().replace(b"{", b'{"__metadata__":{},', 1), body
        ),
        "metadata of numbers": joined({**header, "__metadata__": {"size": 32, "network": 5}}, body),
        "metadata of a list": joined({**header, "__metadata__": [1]}, body),
        "cut in the middle": data[: len(data) // 2],
        "empty": b"",
        "a pickle": b"\x80\x04\x95" + bytes(64),
        "a zip": b"PK\3\4" + bytes(200),
    }
    places = {
        "a pipe": os.mkfifo,
        "a folder": os.mkdir,
        "a device": lambda p: os.symlink("/dev/zero", p),
        "a circle of links": lambda p: os.symlink(p, p),
        "5 GB of nothing": lambda p: (p.touch(), os.truncate(p, 5 << 30)),
    }
    if how in places:
        places[how](path)
        return
    if how in other:
        path.write_bytes(other[how])
        return
    entry = header[name]
    if how == "offsets overlap":
        header[second]["data_offsets"] = header[first]["data_offsets"]
    elif how == "offsets backwards":
        entry["data_offsets"] = [end, start]
    elif how == "offsets beyond the file":
        entry["data_offsets"] = [start + len(body), end + len(body)]
    elif how == "offsets of 2^60":
        entry["data_offsets"] = [1 << 60, (1 << 60) + end - start]
    elif how == "a gap":
        body = body + bytes(64)
        header["a-gap"] = {
            "dtype": "F32",
            "shape": [8],
            "data_offsets": [len(body) - 32, len(body)],
        }
    elif how == "another type":
        entry["dtype"] = {2: "I16", 4: "I32", 8: "U64"}[size]
    elif how == "a type that is none":
        entry["dtype"] = "F7"
    elif how == "a shape of more":
        entry["shape"] = [1, *entry["shape"]]
    elif how == "a shape of 2^60":
        entry["shape"] = [1 << 60, 1 << 10]
    elif how == "a shape of text":
        entry["shape"] = ["3"]
    elif how == "an empty shape":
        entry["shape"] = []
    elif how == "a negative shape":
        entry["shape"] = [-1]
    elif how == "a tensor more":
        header["strange.weight"] = {
            "dtype": "F32",
            "shape": [4],
            "data_offsets": [len(body), len(body) + 16],
        }
        body += bytes(16)
    elif how == "a tensor of 1 GB more, which is not there":
        header["strange.weight"] = {
            "dtype": "F32",
            "shape": [1 << 28],
            "data_offsets": [len(body), len(body) + (1 << 30)],
        }
    elif how == "a tensor less":
        header.pop(names[-1])
        body = body[: min(header[each]["data_offsets"][1] for each in [names[-2]])]
    elif how == "a tensor renamed":
        header[f"{name}x"] = header.pop(name)
    elif how == "10,000 tensors of nothing":
        header |= {
            f"nothing.{k}": {"dtype": "F32", "shape": [0], "data_offsets": [0, 0]}
            for k in range(10_000)
        }
    else:
        raise ValueError(how)
    path.write_bytes(joined(header, body))


def _ranges(path, header, body, how):
    """The ranges of labels that the network reads its codes by, replaced; of files without them a
    tensor.
    """
    out = bytearray(body)
    names = [name for name in ("label_centre", "label_half") if name in header] or [
        n for n in header if n != "__metadata__"
    ][:1]
    for name in names:
        a, b = header[name]["data_offsets"]
        kind = np.float64 if header[name]["dtype"] == "F64" else np.float32
        count = (b - a) // kind().nbytes
        value = {"1e30": 1e30, "0": 0.0, "negative": -1.0, "κ": 6.0}[how.split()[-1]]
        out[a:b] = np.full(count, value, kind).tobytes()[: b - a]
    path.write_bytes(joined(header, bytes(out)))
