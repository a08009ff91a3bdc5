"""Photographs, masks and regions as people, programs and attackers make them: the domain of
radiance, formats, bombs, names.

First the list TRIALS in turn, each a pair of a name and what writes it; then damaged files of every
format that Pillow or OpenEXR writes, in every role, under options at the ends of their ranges. Most
are only opened and brought to the network's size; each EIGHTH is a whole command, whose results
must be finite.
"""

import io
import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from . import Case, Result, Room, mutation, seeds

SIZE = (48, 64)
EIGHTH = 8
ROLES = ("photograph", "mask", "regions", "material")
BALANCES = ("none", "grey", (1.5, 1.0, 0.5), (0.01, 1.0, 100.0), (100.0, 100.0, 0.01))
EXPOSURES = (None, None, None, None, 1.0, 1e-38, 1e-12, 1e-6, 30.0, 1e6, 1e12, 1e38)


def prepare(folder: Path) -> None:
    """The shared seeds, and a program under Ghostscript's name that leaves a trace where it is
    started.
    """
    seeds.shared(folder)
    program = folder / "bin" / "gs"
    program.parent.mkdir()
    program.write_text('#!/bin/sh\ntouch "$TRACE"\n')
    program.chmod(0o755)


def case(index: int, rng: np.random.Generator, room: Room) -> Case:
    """See the module."""
    if index < len(TRIALS):
        name, write = TRIALS[index]
        path, label = write(room.folder), name
        role = "mask" if "mask" in name else "regions" if "regions" in name else "photograph"
        exposure = {
            "tiny exposure": 1e-38,
            "huge exposure": 1e38,
            "NaN exposure": float("nan"),
        }.get(name)
        balance, whole = "grey" if "grey" in name else "none", index % 2 == 0
    else:
        path, label = damaged(room, rng)
        role = str(rng.choice(ROLES, p=(0.6, 0.2, 0.1, 0.1)))
        exposure = mutation.pick(rng, EXPOSURES) if role == "photograph" else None
        balance = mutation.pick(rng, BALANCES) if rng.random() < 0.2 else "none"
        whole = index % EIGHTH == 0
    trace = {
        "PATH": f"{room.seeds / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "TRACE": str(room.folder / "ghostscript"),
    }
    label = f"{label} as {role}, exposure {exposure}, white balance {balance}"
    if whole:
        words = command(role, path, room, exposure, balance, rng)
        return Case(
            label=label,
            command=words,
            check=lambda result: unsound(room, result, path, role),
            environment=trace,
        )
    return Case(
        label=label,
        run=lambda: opened(role, path, room, exposure, balance),
        check=not_finite,
        environment=trace,
    )


def command(role, path, room, exposure, balance, rng):
    """Words of a command that reads the file in its role."""
    there, mask = seeds.of(room), seeds.of(room) / "mask.png"
    words = {
        "photograph": ["edit", path, "--mask", mask, "--material", "brass"],
        "mask": ["edit", there / "photograph.png", "--mask", path, "--material", "brass"],
        "regions": ["edit", there / "photograph.png", "--regions", path, "--material", "brass"],
        "material": ["edit", there / "second.png", "--material", path],
    }[role]
    predicts = role in ("photograph", "mask") and rng.random() < 0.4
    if predicts:
        words = ["predict", *words[1:4]]
    options = [] if exposure is None else ["--exposure", exposure]
    options += ["--weights", there / "weights.safetensors", "--out", room.folder / "out"]
    if not predicts:
        text = balance if isinstance(balance, str) else ",".join(map(str, balance))
        options += ["--no-refine", "--white-balance", text]
    return ["learn", *map(str, words), *map(str, options)]


def opened(role, path, room, exposure, balance):
    """The Framed of a photograph that the file is, or is the mask or the regions of."""
    from learn.data import framing
    from learn.editing import photograph

    there = seeds.of(room)
    masks = [there / "mask.png"] if role == "photograph" else [path] if role == "mask" else []
    what = path if role in ("photograph", "material") else there / "photograph.png"
    result = photograph.open_photograph(
        what, masks, path if role == "regions" else None, balance, exposure
    )
    return framing.frame_object(result.balanced, result.mask, 32, result.exposure)


def not_finite(result: Result) -> str | None:
    """What is wrong with a Framed."""
    if result.error is not None:
        return None
    framed = result.value
    if not (
        np.isfinite(framed.radiance).all() and np.isfinite(framed.exposure) and framed.exposure > 0
    ):
        return "what the network is shown is not finite"
    return None if framed.mask.any() else "the network is shown no object"


def unsound(room, result: Result, path: Path, role: str) -> str | None:
    """What is wrong with the files of a command: not readable, not finite, not of the photograph's
    size, or some after a refusal.
    """
    out = room.folder / "out"
    if result.status != 0:
        return f"{result.status} and files in out" if out.is_dir() and any(out.iterdir()) else None
    for file in sorted(out.iterdir()):
        if file.suffix == ".png":
            with Image.open(file) as picture:
                picture.load()
        if file.suffix == ".exr":
            channels = mutation.exr_channels(file.read_bytes())
            if not all(np.isfinite(values).all() for values in channels.values()):
                return f"{file.name} is not finite"
    return None


# ------------------------------------------------------------------------------------------------
# files


def damaged(room, rng):
    """(path, label) of a file of some format, damaged; one in eight is whole."""
    format_ = mutation.pick(rng, (*WRITERS, "EXR", "EXR", "EXR"))
    if format_ == "EXR":
        data, label = (seeds.of(room) / "photograph.exr").read_bytes(), "whole"
        known = mutation.some_exr
    else:
        data, label = WRITERS[format_](), "whole"
        known = (
            mutation.some_png
            if format_ == "PNG"
            else tiff_entry
            if format_.startswith("TIFF")
            else mutation.some_bytes
        )
    for _ in range(int(rng.choice([0, 1, 1, 1, 1, 2, 2, 3]))):
        try:
            data, label = (known if rng.random() < 0.8 else mutation.some_bytes)(data, rng)
        except Exception:  # what an earlier mutation left is none of this format any more
            data, label = mutation.some_bytes(data, rng)
    ending = {"EXR": ".exr", "PNG": ".png", "JPEG": ".jpg"}.get(format_, f".{format_[:4].lower()}")
    path = room.folder / f"picture{ending}"
    path.write_bytes(data)
    return path, f"{format_}: {label}"


def tiff_entry(data, rng):
    """A TIFF with one entry of its first directory changed: type, count or value."""
    first = struct.unpack("<I", data[4:8])[0]
    (count,) = struct.unpack("<H", data[first : first + 2])
    at = first + 2 + 12 * int(rng.integers(count))
    tag, kind, length, value = struct.unpack("<HHII", data[at : at + 12])
    which = int(rng.integers(4))
    if which == 0:
        tag = int(
            mutation.pick(
                rng,
                (
                    254,
                    256,
                    257,
                    258,
                    259,
                    262,
                    266,
                    274,
                    277,
                    278,
                    284,
                    317,
                    322,
                    323,
                    324,
                    330,
                    338,
                    339,
                    34665,
                ),
            )
        )
    elif which == 1:
        kind = int(rng.integers(20))
    elif which == 2:
        length = int(mutation.pick(rng, mutation.INTEGERS)) % 2**32
    else:
        value = (
            int(mutation.pick(rng, (*mutation.INTEGERS, 3, 5, 6, 7, 8, 9, 50_000, 100_000))) % 2**32
        )
    return (
        data[:at] + struct.pack("<HHII", tag, kind, length, value) + data[at + 12 :],
        f"entry {tag}: {kind} × {length}, {value}",
    )


def shade() -> np.ndarray:
    """(H, W, 3) uint8: a lit ball before a grey ground."""
    y, x = np.mgrid[-1 : 1 : SIZE[0] * 1j, -1 : 1 : SIZE[1] * 1j]
    inside = x**2 + y**2 < 0.6
    level = np.where(inside, np.sqrt(np.maximum(0.7 - x**2 - y**2, 0)), 0.2)
    return (255 * level[..., None] * np.array([1.0, 0.8, 0.5])).astype(np.uint8)


def written(format_: str, mode: str = "RGB", **options) -> Callable[[], bytes]:
    """A function that gives the bytes of the ball in a format."""

    def write():
        picture = Image.fromarray(shade())
        if mode == "I;16":
            picture = Image.fromarray(shade()[..., 0].astype(np.uint16) * 257)
        elif mode == "LAB":
            picture = Image.frombytes("LAB", picture.size, picture.tobytes())
        elif mode == "P":
            picture = picture.quantize(16)
        elif mode != "RGB":
            picture = picture.convert(mode)
        out = io.BytesIO()
        picture.save(out, format=format_, **options)
        return out.getvalue()

    return write


def animated(format_: str) -> Callable[[], bytes]:
    """The ball, and then two black pictures."""

    def write():
        out, more = io.BytesIO(), [Image.new("RGB", SIZE[::-1])] * 2
        Image.fromarray(shade()).save(out, format=format_, save_all=True, append_images=more)
        return out.getvalue()

    return write


WRITERS = {
    "PNG": written("PNG"),
    "PNG of 16 bits": written("PNG", "I;16"),
    "PNG with palette": written("PNG", "P"),
    "JPEG": written("JPEG"),
    "JPEG CMYK": written("JPEG", "CMYK"),
    "JPEG progressive": written("JPEG", progressive=True),
    "TIFF": written("TIFF"),
    "TIFF LZW": written("TIFF", compression="tiff_lzw"),
    "TIFF JPEG": written("TIFF", compression="jpeg"),
    "TIFF deflate": written("TIFF", "I;16", compression="tiff_adobe_deflate"),
    "TIFF F": written("TIFF", "F"),
    "TIFF I": written("TIFF", "I"),
    "TIFF LAB": written("TIFF", "LAB"),
    "WEBP": written("WEBP"),
    "AVIF": written("AVIF"),
    "GIF": animated("GIF"),
    "BMP": written("BMP"),
    "BMP with palette": written("BMP", "P"),
}
REFUSED = (
    "EPS",
    "PDF",
    "ICO",
    "ICNS",
    "DDS",
    "PCX",
    "PPM",
    "TGA",
    "JPEG2000",
    "SGI",
    "IM",
    "MSP",
    "XBM",
    "SPIDER",
    "BLP",
    "QOI",
)


# ------------------------------------------------------------------------------------------------
# trials


def _file(name: str, data: bytes | Callable[[], bytes]) -> Callable[[Path], Path]:
    def write(folder):
        path = folder / name
        path.write_bytes(data() if callable(data) else data)
        return path

    return write


def _refused(format_: str) -> Callable[[Path], Path]:
    mode = {"MSP": "1", "XBM": "1", "SPIDER": "F", "BLP": "P"}.get(format_, "RGB")

    def data():
        try:
            return written(format_, mode)()
        except (KeyError, OSError):  # this Pillow does not write it
            return b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 64 48\n%%EndComments\nshowpage\n"

    return _file("picture.png", data)


def _exr(
    change: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]], name: str = "picture.exr"
) -> Callable[[Path], Path]:
    """An EXR of the ball's radiance, changed."""

    def data():
        radiance = (shade() / np.float32(255)) ** 2.2
        channels = {
            key: np.ascontiguousarray(radiance[..., k], np.float32) for k, key in enumerate("RGB")
        }
        with np.errstate(all="ignore"):
            return mutation.exr(change(channels))

    return _file(name, data)


def _times(factor: float) -> Callable[[Path], Path]:
    return _exr(
        lambda channels: {
            name: (values.astype(np.float64) * factor).astype(np.float32)
            for name, values in channels.items()
        }
    )


def _one(value: float, where: tuple = (24, 32)) -> Callable[[Path], Path]:
    def change(channels):
        channels["R"][where] = value
        return channels

    return _exr(change)


def _alpha(value: float) -> Callable[[Path], Path]:
    return _exr(lambda channels: channels | {"A": np.full(SIZE, value, np.float32)})


def _shaped(height: int, width: int) -> Callable[[Path], Path]:
    return _exr(
        lambda channels: {
            name: np.resize(values, (height, width)) for name, values in channels.items()
        }
    )


def _constant(level: int) -> Callable[[Path], Path]:
    return _file("picture.png", lambda: _png(np.full((*SIZE, 3), level, np.uint8)))


def _png(array: np.ndarray, **options) -> bytes:
    out = io.BytesIO()
    Image.fromarray(array).save(out, format="PNG", **options)
    return out.getvalue()


def _with_chunk(name: bytes, body: bytes, times: int = 1) -> Callable[[], bytes]:
    def data():
        chunks = mutation.png_chunks(_png(shade()))
        return mutation.png([chunks[0], *[(name, body)] * times, *chunks[1:]])

    return data


def _header(width: int, height: int, depth: int = 8, colour: int = 2) -> Callable[[], bytes]:
    """A PNG whose header promises another size, with a little data."""
    body = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    return lambda: mutation.png(
        [(b"IHDR", body), (b"IDAT", zlib.compress(bytes(1000))), (b"IEND", b"")]
    )


def _turned(orientation: int, format_: str = "JPEG") -> Callable[[], bytes]:
    exif = Image.Exif()
    exif[0x0112] = orientation
    return written(format_, exif=exif)


def _exif(data: bytes) -> Callable[[], bytes]:
    return written("JPEG", exif=b"Exif\0\0" + data)


def _directories(loop: bool) -> Callable[[], bytes]:
    """A TIFF with 3,000 directories, or one that leads back to itself."""

    def data():
        whole = written("TIFF")()
        first = struct.unpack("<I", whole[4:8])[0]
        (count,) = struct.unpack("<H", whole[first : first + 2])
        end = first + 2 + 12 * count
        if loop:
            return whole[:end] + struct.pack("<I", first) + whole[end + 4 :]
        directory, at = whole[first:end], len(whole) + len(whole) % 2
        out = whole[:end] + struct.pack("<I", at) + whole[end + 4 :] + bytes(len(whole) % 2)
        for k in range(3000):
            following = 0 if k == 2999 else at + (k + 1) * (len(directory) + 4)
            out += directory + struct.pack("<I", following)
        return out

    return data


def _tiled(side: int) -> Callable[[], bytes]:
    """A TIFF of 48 × 64 pixels that says it has one tile of side × side."""

    def data():
        entries = [
            (256, 3, 1, 64),
            (257, 3, 1, 48),
            (258, 3, 1, 8),
            (259, 3, 1, 8),
            (262, 3, 1, 1),
            (277, 3, 1, 1),
        ]
        entries += [(322, 4, 1, side), (323, 4, 1, side), (324, 4, 1, 200), (325, 4, 1, 100)]
        directory = (
            struct.pack("<H", len(entries))
            + b"".join(struct.pack("<HHII", *each) for each in entries)
            + bytes(4)
        )
        whole = b"II*\0" + struct.pack("<I", 8) + directory
        return whole + bytes(200 - len(whole)) + zlib.compress(bytes(64 * 48))

    return data


def _scans(count: int) -> Callable[[], bytes]:
    """A progressive JPEG whose last scan comes over and over."""

    def data():
        picture, out = Image.new("RGB", (4000, 4000), (90, 80, 70)), io.BytesIO()
        picture.save(out, format="JPEG", progressive=True, quality=30)
        whole = out.getvalue()
        last = whole.rindex(b"\xff\xda")
        return whole[:last] + whole[last:-2] * count + whole[-2:]

    return data


def _mask(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], Path]:
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    return _file(
        "mask.png", lambda: _png(change(np.uint8(255 * ((x - 32) ** 2 + (y - 24) ** 2 < 300))))
    )


def _pixels(count: int) -> Callable[[np.ndarray], np.ndarray]:
    def change(mask):
        mask[:] = 0
        mask[20].flat[:count] = 255
        return mask

    return change


def _place(make: Callable[[Path], object]) -> Callable[[Path], Path]:
    """Something that is no file, under a picture's name."""

    def write(folder):
        path = folder / "picture.png"
        make(path)
        return path

    return write


def _loop(path):
    path.symlink_to(path.with_name("other.png"))
    path.with_name("other.png").symlink_to(path)


TRIALS: list[tuple[str, Callable[[Path], Path]]] = [
    *(
        (f"EXR times {factor:g}", _times(factor))
        for factor in (1e37, 1e38, 1e20, 1e10, 1e6, 1e3, 1, 1e-3, 1e-6, 1e-30, 1e-44, 0, -1)
    ),
    *(
        (f"one value {value:g}", _one(value))
        for value in (1e37, 3e38, 1e10, 1e9, np.nan, np.inf, -np.inf, -1, -3e38, 1e-45)
    ),
    *(
        (f"one value {value:g} beside the object", _one(value, (0, 0)))
        for value in (1e37, 1e10, np.nan, -1e9)
    ),
    *(
        (f"alpha {value:g}", _alpha(value))
        for value in (0, 1, 0.5, 2, -1, np.nan, np.inf, 1e-3, 1e30)
    ),
    *(
        (f"EXR of {h}×{w}", _shaped(h, w))
        for h, w in ((1, 1), (1, 64), (64, 1), (1, 1000), (2, 2), (4, 4), (5, 300), (300, 5))
    ),
    (
        "EXR of whole numbers",
        _exr(lambda c: {name: (1000 * values).astype(np.uint32) for name, values in c.items()}),
    ),
    (
        "EXR of half floats beyond them",
        _exr(lambda c: {name: (1e6 * values).astype(np.float16) for name, values in c.items()}),
    ),
    ("EXR of grey", _exr(lambda c: {"Y": c["R"]})),
    (
        "EXR with a hundred channels",
        _exr(lambda c: c | {f"layer{k}.R": c["R"] for k in range(100)}),
    ),
    ("regions in an EXR", _exr(lambda c: c, "regions.exr")),
    ("mask in an EXR", _exr(lambda c: c, "mask.exr")),
    (
        "mask in an EXR with NaN",
        _exr(
            lambda c: {name: values * np.float32(np.nan) for name, values in c.items()}, "mask.exr"
        ),
    ),
    (
        "mask in an EXR of 1e37",
        _exr(lambda c: {name: values * np.float32(1e37) for name, values in c.items()}, "mask.exr"),
    ),
    *((f"constant {level}", _constant(level)) for level in (0, 1, 2, 3, 10, 128, 254, 255)),
    ("tiny exposure", _constant(128)),
    ("huge exposure", _constant(128)),
    ("NaN exposure", _constant(128)),
    (
        "grey balance before black",
        _file("picture.png", lambda: _png(shade() * (shade()[..., :1] > 51))),
    ),
    *((f"mask of {count} pixels", _mask(_pixels(count))) for count in (0, 1, 15, 16, 17, 64)),
    ("mask that is all", _mask(lambda mask: np.full_like(mask, 255))),
    ("mask of grey below half", _mask(lambda mask: mask // 3)),
    (
        "mask of noise",
        _mask(lambda mask: np.random.default_rng(0).integers(0, 256, mask.shape).astype(np.uint8)),
    ),
    ("mask of another size", _mask(lambda mask: mask[:20])),
    (
        "mask of wires",
        _mask(lambda mask: mask * (np.indices(mask.shape).sum(0) % 7 == 0).astype(np.uint8)),
    ),
    ("regions of nine", _mask(lambda mask: (np.indices(mask.shape)[1] // 7 * 20).astype(np.uint8))),
    *(
        (f"{name}, whole", _file(f"picture.{name[:4].lower()}", data))
        for name, data in WRITERS.items()
    ),
    *((f"{name} under the name of a PNG", _refused(name)) for name in REFUSED),
    *(
        (f"animated {name}", _file("picture.png", animated(name)))
        for name in ("PNG", "GIF", "WEBP", "TIFF", "MPO", "AVIF")
    ),
    *(
        (f"orientation {k}", _file("picture.jpg", _turned(k)))
        for k in (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 65535)
    ),
    *((f"orientation {k} of a TIFF", _file("picture.tiff", _turned(k, "TIFF"))) for k in (3, 6, 9)),
    *(
        (f"Exif {name}", _file("picture.jpg", _exif(data)))
        for name, data in (
            ("of noise", bytes(range(200))),
            ("that ends early", b"II*\0\x08\0\0\0\x01\0\x12\x01"),
            (
                "that leads back to itself",
                b"II*\0\x08\0\0\0\x01\0\x69\x87\x04\0\x01\0\0\0\x08\0\0\0\x08\0\0\0",
            ),
            (
                "with an orientation of text",
                b"II*\0\x08\0\0\0\x01\0\x12\x01\x02\0\x04\0\0\0abc\0\0\0\0\0",
            ),
            (
                "with an orientation of many",
                b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\xff\xff\xff\x7f\0\0\0\0\0\0\0\0",
            ),
        )
    ),
    (
        "PNG with a text of 100 MB",
        _file("picture.png", _with_chunk(b"zTXt", b"k\0\0" + zlib.compress(bytes(100 << 20)))),
    ),
    (
        "PNG with a profile of 100 MB",
        _file("picture.png", _with_chunk(b"iCCP", b"k\0\0" + zlib.compress(bytes(100 << 20)))),
    ),
    (
        "PNG with 100 texts of 1 MB",
        _file("picture.png", _with_chunk(b"zTXt", b"k\0\0" + zlib.compress(bytes(1_000_000)), 100)),
    ),
    ("PNG with 50,000 texts", _file("picture.png", _with_chunk(b"tEXt", b"k\0v", 50_000))),
    *(
        (f"PNG that promises {w} × {h}", _file("picture.png", _header(w, h)))
        for w, h in (
            (0, 0),
            (0, 48),
            (8000, 8000),
            (8001, 8000),
            (30_000, 30_000),
            (2**31 - 1, 2**31 - 1),
            (2**32 - 1, 1),
            (64, 2**31 - 1),
            (1, 60_000_000),
        )
    ),
    ("PNG of 1 bit that promises 8000 × 8000", _file("picture.png", _header(8000, 8000, 1, 0))),
    ("TIFF with 3,000 directories", _file("picture.tiff", _directories(False))),
    ("TIFF with a circle of directories", _file("picture.tiff", _directories(True))),
    *(
        (f"TIFF with a tile of {side}²", _file("picture.tiff", _tiled(side)))
        for side in (64, 1024, 20_000, 46_000, 65_520, 2**31 - 1, 0)
    ),
    ("JPEG of many scans", _file("picture.jpg", _scans(200))),
    ("JPEG cut off", _file("picture.jpg", lambda: written("JPEG")()[:700])),
    ("nothing", _file("picture.png", b"")),
    ("a byte", _file("picture.png", b"\x89")),
    ("a folder", _place(Path.mkdir)),
    ("a pipe", _place(os.mkfifo)),
    ("a pipe as mask", _place(os.mkfifo)),
    ("a pipe as regions", _place(os.mkfifo)),
    ("an endless device", _place(lambda path: path.symlink_to("/dev/zero"))),
    ("a circle of links", _place(_loop)),
    ("a link to nothing", _place(lambda path: path.symlink_to("nowhere.png"))),
    ("a file of 3 GB of nothing", _place(lambda path: (path.touch(), os.truncate(path, 3 << 30)))),
    ("missing", _place(lambda path: None)),
]
