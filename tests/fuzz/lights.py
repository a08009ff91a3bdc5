"""Light maps written in every legal way must be read pixel for pixel; headers, run lengths and
directories that lie, refused.

A map is random radiance over a wide range. It is written as Radiance .hdr (flat, old and new run
lengths), OpenEXR (types, compressions, tiles, windows, further channels, parts) or .npz (types,
orders, compressions, headers), then read by `factory.lights`: the pixels as they stand in the file,
and the Light made of them.
"""

import io
import json
import struct
import zipfile
from pathlib import Path

import numpy as np

from . import Case, Result, Room, mutation

BOX = struct.Struct("<4i")
WINDOW = (0, 1, -1, 2, 7, 4095, 8191, 32767, 2**30, 2**31 - 1, -(2**31), -(2**30))


def radiance(rng: np.random.Generator) -> np.ndarray:
    """(H, 2H, 3) float32: textured, with lamps, repeats and black parts."""
    height = int(mutation.pick(rng, (4, 5, 8, 16, 33)))
    L = rng.gamma(0.5, 2, (height, 2 * height, 3)) * 10.0 ** rng.integers(-2, 3)
    L[rng.random((height, 2 * height)) < 0.2] = 0
    L[int(rng.integers(height)), int(rng.integers(2 * height))] = 1000 * L.max()
    if rng.random() < 0.5:
        L[:, height // 2 : height] = L[:, height // 2 : height // 2 + 1]
    return L.astype(np.float32)


# ------------------------------------------------------------------------------------------------
# legal ways


def as_hdr(L: np.ndarray, rng: np.random.Generator) -> tuple[bytes, np.ndarray, str]:
    """Radiance bytes, the pixels that they stand for, and what was done."""
    brightest = L.max(-1)
    exponent = np.where(
        brightest > 0, np.floor(np.log2(np.maximum(brightest, 1e-30))) + 1, -128
    ).astype(int)
    mantissa = np.floor(L / 2.0 ** exponent[..., None] * 256).clip(0, 255)
    bytes_ = np.concatenate([mantissa, exponent[..., None] + 128], axis=-1).astype(np.uint8)
    bytes_[brightest <= 0] = 0
    # in the old style three ones are a repeat: no pixel may have them
    bytes_[..., :3][(bytes_[..., :3] == 1).all(-1)] = (2, 1, 1)
    style = mutation.pick(rng, ("flat", "old", "new") if L.shape[1] >= 8 else ("flat", "old"))
    if style == "flat":  # two twos and a small number would announce the new style
        bytes_[:, 0][(bytes_[:, 0, :2] == 2).all(-1), 0] = 3
    exposures = [float(x) for x in rng.choice([0.5, 2.0, 4.0], int(rng.integers(3)))]
    lines = [
        "#?RADIANCE",
        "# made by a test",
        "FORMAT=32-bit_rle_rgbe",
        "GAMMA=1.0",
        "PRIMARIES=0.64 0.33 0.3 0.6 0.15 0.06 0.3 0.3",
    ]
    lines = lines[:3] + [f"EXPOSURE={x}" for x in exposures] + lines[3 : 3 + int(rng.integers(3))]
    head = "\n".join([*lines, "", f"-Y {L.shape[0]} +X {L.shape[1]}", ""]).encode()
    rows = {
        "flat": lambda row: row.tobytes(),
        "old": _old_row,
        "new": lambda row: _new_row(row, rng),
    }[style]
    mantissas, exponents = bytes_[..., :3].astype(float), bytes_[..., 3:].astype(int)
    pixels = np.where(exponents > 0, mantissas * 2.0 ** (exponents - 136), 0) / np.prod(
        exposures or [1.0]
    )
    return (
        head + b"".join(rows(row) for row in bytes_),
        pixels.astype(np.float32),
        f"{style}, {len(exposures)} exposures",
    )


def _old_row(row):
    out, column = bytearray(), 0
    while column < len(row):
        end = column + 1
        while end < len(row) and (row[end] == row[column]).all():
            end += 1
        out += row[column].tobytes()
        repeats = end - column - 1
        while repeats:
            out += bytes([1, 1, 1, repeats & 255])
            repeats >>= 8
        column = end
    # a row must not begin as one of the new style does
    return bytes(out)


def _new_row(row, rng):
    out = bytearray([2, 2, len(row) >> 8, len(row) & 255])
    for component in row.T:
        column = 0
        while column < len(component):
            end = column + 1
            while (
                end < len(component) and end - column < 127 and component[end] == component[column]
            ):
                end += 1
            if end - column > 1:
                out += bytes([128 + end - column, component[column]])
            else:
                end = min(len(component), column + int(rng.integers(1, 128)))
                out += bytes([end - column]) + component[column:end].tobytes()
            column = end
    return bytes(out)


def as_exr(L: np.ndarray, rng: np.random.Generator) -> tuple[bytes, np.ndarray, str]:
    """OpenEXR bytes of any kind without loss."""
    import OpenEXR

    compression = mutation.pick(
        rng,
        (
            OpenEXR.NO_COMPRESSION,
            OpenEXR.RLE_COMPRESSION,
            OpenEXR.ZIPS_COMPRESSION,
            OpenEXR.ZIP_COMPRESSION,
            OpenEXR.PIZ_COMPRESSION,
        ),
    )
    header = {"type": OpenEXR.scanlineimage, "compression": compression}
    if rng.random() < 0.3:
        header |= {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    if rng.random() < 0.4:
        corner = rng.integers(-50, 50, 2).astype(np.int32)
        window = corner, corner + np.array([L.shape[1] - 1, L.shape[0] - 1], np.int32)
        header |= {"dataWindow": window, "displayWindow": window}
    type_ = mutation.pick(rng, (np.float16, np.float32))
    L = np.minimum(L, 60000).astype(type_)
    planes = {name: np.ascontiguousarray(L[..., k]) for k, name in enumerate("RGB")}
    style = mutation.pick(rng, ("RGB", "RGBA", "planes", "more", "grey", "mixed"))
    if style == "grey":
        name = mutation.pick(rng, "YV")
        channels, L = {name: planes["G"]}, np.repeat(L[..., 1:2], 3, axis=-1)
    elif style == "RGBA":
        channels = {"RGBA": np.concatenate([L, np.ones_like(L[..., :1])], axis=-1)}
    elif style == "mixed":
        channels = {
            **planes,
            "R": planes["R"].astype(np.float32),
            "A": planes["B"].astype(np.float16),
        }
    else:
        more = {
            "Z": planes["R"].astype(np.float32),
            "left.R": planes["B"],
            "id": np.arange(planes["R"].size, dtype=np.uint32).reshape(planes["R"].shape),
        }
        channels = (
            {"RGB": L} if style == "RGB" else planes if style == "planes" else {**planes, **more}
        )
    stream = io.BytesIO()
    with OpenEXR.File(header, channels) as file:
        file.write(stream)
    return stream.getvalue(), L.astype(np.float32), f"{style}, {np.dtype(type_)}, {compression}"


def as_npz(L: np.ndarray, rng: np.random.Generator) -> tuple[bytes, np.ndarray, str]:
    """An .npz of any float type, order, compression and version of header."""
    type_ = mutation.pick(rng, ("<f2", "<f4", "<f8", ">f4", ">f8"))
    with np.errstate(over="ignore"):
        values = np.asarray(np.minimum(L, 60000).astype(type_), order=mutation.pick(rng, "CF"))
    stream = io.BytesIO()
    version = mutation.pick(rng, ((1, 0), (2, 0), (3, 0)))
    np.lib.format.write_array(stream, values, version=version)
    compression = mutation.pick(
        rng, (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
    )
    out = io.BytesIO()
    name = mutation.pick(rng, ("L.npy", "arr_0.npy", "\u00e9.npy", "folder/L.npy", "L"))
    with zipfile.ZipFile(out, "w", compression) as archive:
        archive.writestr(name, stream.getvalue())
    return (
        out.getvalue(),
        values.astype(np.float32),
        f"{type_}, version {version}, compression {compression}, {name}",
    )


WAYS = {".hdr": as_hdr, ".exr": as_exr, ".npz": as_npz}


# ------------------------------------------------------------------------------------------------
# cases


def case(index: int, rng: np.random.Generator, room: Room) -> Case:
    """A map that must be read rightly, one that lies, and one put into a library, in turn."""
    kind = list(WAYS)[index // 3 % len(WAYS)]
    data, pixels, label = WAYS[kind](radiance(rng), rng)
    label = f"{kind}: {label}"
    path = room.folder / f"map{kind}"
    if index % 3 == 0:
        path.write_bytes(data)
        return Case(
            label=label, run=lambda: opened(path), check=lambda result: wrong(pixels, result)
        )
    if index % 3 == 1:
        data, lie = LIES[kind](data, rng)
        path.write_bytes(data)
        return Case(label=f"{label}: {lie}", run=lambda: opened(path), check=sound)
    return listed(rng, room, path, data, label)


def opened(path: Path):
    """The pixels of a file, and the Light that they make."""
    from factory.lights import files, load

    return files.read(path)[0], load(path)


def wrong(pixels: np.ndarray, result: Result) -> str | None:
    """How what was read differs from what was written."""
    if result.error is not None:
        return f"refused: {result.error}"
    results = result.value[0]
    if results.shape != pixels.shape or results.dtype != np.float32:
        return f"expected pixels {pixels.shape}, found {results.shape} of {results.dtype}"
    apart = np.abs(results - pixels) > 1e-6 * np.abs(
        pixels
    )  # of exposures, which float32 divides by
    if apart.any():
        return f"{int(apart.sum())} values differ, the first at {tuple(np.argwhere(apart)[0])}"
    return sound(result)


def sound(result: Result) -> str | None:
    """What is wrong with a Light that was taken."""
    from shaders import envmap

    if result.error is not None:
        return None
    light = result.value[1]
    for name, L in (("L64", light.L64), ("L_full", light.L_full)):
        if L.dtype != np.float32 or not np.isfinite(L).all() or L.min() < 0:
            return f"{name} is {L.dtype} from {L.min()} to {L.max()}"
        mean = float(envmap.mean_radiance(L) @ envmap.LUMINANCE)
        if abs(mean - 1) > 1e-4:  # float32 texels, one of them far above the others
            return f"{name} has a mean of {mean}"
    return (
        None
        if light.L64.shape == (64, 128, 3) and light.L_full.shape[1] % 4 == 0
        else f"sizes {light.L64.shape}, {light.L_full.shape}"
    )


def listed(rng, room, path, data, label) -> Case:
    """`lights list` of a folder with a map and a list that tells something odd of it."""
    folder = room.folder / "library"
    folder.mkdir()
    (folder / path.name).write_bytes(data)
    words = (
        "CC0",
        "",
        None,
        5,
        [],
        "x" * 5000,
        "a\nb",
        "\ud800",
        "\x1b[31m",
        {"licence": "CC0"},
        True,
    )
    entry = {
        key: mutation.pick(rng, words)
        for key in ("file", "hash", "licence", "source", "more")
        if rng.random() < 0.5
    }
    tree = mutation.pick(
        rng,
        ({"map": entry}, {"map": entry, "other": {}}, {"map": mutation.pick(rng, words)}, [entry]),
    )
    (folder / "lights.json").write_text(json.dumps(tree))
    action = mutation.pick(
        rng,
        (
            ["list", str(folder)],
            [
                "preview",
                "map",
                "--library",
                str(folder),
                "--size",
                "16",
                "--out",
                str(room.folder / "out.png"),
            ],
        ),
    )
    return Case(
        label=f"{label}, listed as {json.dumps(tree)[:60]}",
        command=["factory", "lights", *action],
        writes=("out.png",),
    )


# ------------------------------------------------------------------------------------------------
# lies


def hdr_lie(data: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    """Another size, format or exposure, or runs that are longer or shorter than their row."""
    head, mark, rest = data.partition(b"\n\n")
    size, _, pixels = rest.partition(b"\n")
    kind = int(rng.integers(5))
    if kind == 0:
        numbers = [
            str(
                mutation.pick(
                    rng, (0, 1, 4, 8, 4096, 8192, 4097, 10**6, 10**9, 10**12, -1, "08", "1e3", "")
                )
            )
            for _ in range(2)
        ]
        return (
            head + mark + f"-Y {numbers[0]} +X {numbers[1]}\n".encode() + pixels,
            f"size {numbers}",
        )
    if kind == 1:
        line = mutation.pick(
            rng,
            (
                "EXPOSURE=0",
                "EXPOSURE=1e38",
                "EXPOSURE=nan",
                "EXPOSURE=",
                "FORMAT=32-bit_rle_xyze",
                "\0",
                "\xff" * 9,
            ),
        )
        return head + b"\n" + line.encode("latin-1") + mark + rest, f"a line {line!r}"
    if kind == 2:
        turned = mutation.pick(rng, (b"+Y", b"-X", b"Y", b"-Y 4 -Y"))
        return head + mark + size.replace(b"-Y", turned) + b"\n" + pixels, f"{turned!r} for -Y"
    changed, label = mutation.some_bytes(pixels, rng)
    return head + mark + size + b"\n" + changed, label


def exr_lie(data: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    """An attribute of the header changed: windows, channels, compression, type, tiles; or the table
    of offsets.
    """
    attributes = _attributes(data)
    kind = rng.random()
    if kind < 0.35 and b"dataWindow" in attributes:
        start, _ = attributes[b"dataWindow"]
        window = list(BOX.unpack_from(data, start))
        for k in rng.integers(0, 4, int(rng.integers(1, 4))):
            window[k] = mutation.pick(rng, WINDOW)
        return data[:start] + BOX.pack(*window) + data[start + 16 :], f"a window {window}"
    if kind < 0.8 and attributes:
        name = mutation.pick(rng, sorted(attributes))
        start, size = attributes[name]
        changed, label = mutation.some_bytes(data[start : start + size], rng)
        changed = changed[:size].ljust(size, b"\0")
        return data[:start] + changed + data[start + size :], f"{name.decode()}: {label}"
    if kind < 0.9:
        flags = int(mutation.pick(rng, (0, 2, 0x200, 0x400, 0x800, 0x1000, 0x1A00, 0xFFFF00)))
        return data[:4] + struct.pack("<I", 2 | flags) + data[8:], f"flags {flags:#x}"
    changed, label = mutation.some_bytes(data[8:], rng)
    return data[:8] + changed, label


def _attributes(data):
    """{name: (where its value starts, its size)} of the first header."""
    result, place = {}, 8
    while place < len(data) and data[place]:
        name_end = data.index(b"\0", place)
        type_end = data.index(b"\0", name_end + 1)
        size = struct.unpack_from("<i", data, type_end + 1)[0]
        result[data[place:name_end]] = type_end + 5, size
        place = type_end + 5 + size
    return result


def npz_lie(data: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    """An array's header, a member's name or flags, or the directory changed."""
    kind = rng.random()
    if kind < 0.5:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            name = archive.namelist()[0]
            array = archive.read(name)
        shape = mutation.pick(
            rng,
            (
                "(4096, 8192, 3)",
                "(16, 32, 3)",
                "()",
                "(-4, -8, 3)",
                "(4, 8, 3, 1)",
                "(4, 8, 4)",
                "(10**9, 2, 3)",
                "x",
                "(4.0, 8.0, 3)",
            ),
        )
        descr = mutation.pick(
            rng,
            (
                "'<f4'",
                "'<f8'",
                "'|O'",
                "'<c8'",
                "'<i4'",
                "'<U9'",
                "'|V12'",
                "'<f16'",
                "[('a','<f4')]",
                "'<f4', 'x': 1",
                "None",
            ),
        )
        head = (
            f"{{'descr': {descr}, 'fortran_order':"
            f" {mutation.pick(rng, ('False', 'True', '7', 'None'))}, 'shape': {shape}, }}".encode()
        )
        head += b" " * (-(len(head) + 11) % 64) + b"\n"
        out = io.BytesIO()
        with zipfile.ZipFile(
            out, "w", mutation.pick(rng, (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
        ) as archive:
            for k in range(int(rng.choice([1, 1, 2]))):
                archive.writestr(
                    f"{k}{name}",
                    b"\x93NUMPY\1\0" + struct.pack("<H", len(head)) + head + array[128:],
                )
        return out.getvalue(), f"{shape} of {descr}"
    if kind < 0.8:
        signature, offset = mutation.pick(
            rng,
            (
                (b"PK\3\4", 4),
                (b"PK\3\4", 6),
                (b"PK\3\4", 8),
                (b"PK\1\2", 8),
                (b"PK\1\2", 10),
                (b"PK\1\2", 20),
                (b"PK\1\2", 24),
                (b"PK\1\2", 42),
                (b"PK\5\6", 8),
                (b"PK\5\6", 16),
            ),
        )
        place = data.rindex(signature) + offset
        value = mutation.pick(rng, (0, 1, 8, 9, 12, 14, 99, 2**15, 2**16 - 1))
        return (
            data[:place] + struct.pack("<H", value) + data[place + 2 :],
            f"{value} at {signature!r} + {offset}",
        )
    return mutation.some_bytes(data, rng)


LIES = {".hdr": hdr_lie, ".exr": exr_lie, ".npz": npz_lie}
