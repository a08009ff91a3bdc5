"""Mutations of bytes, text, JSON, and of the containers npz, safetensors, EXR and PNG: what went
wrong on the way, or was meant to.

Every function takes what is valid and a generator of random numbers, and returns (what it became,
what was done in a few words).
"""

import io
import json
import math
import os
import shutil
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

INTEGERS = (
    0,
    1,
    -1,
    2,
    127,
    128,
    255,
    256,
    257,
    32767,
    65535,
    65536,
    2**31 - 1,
    -(2**31),
    2**32 - 1,
    2**53 + 1,
    2**63 - 1,
    2**64,
)
FLOATS = (0.0, -0.0, -1.0, 1e-300, 5e-324, 1e37, 1e38, 3.4e38, 1e300, math.inf, -math.inf, math.nan)
WORDS = (
    *(
        "nan",
        "-inf",
        "inf",
        "1e400",
        "-1e400",
        "0x10",
        "1_000",
        "٣",
        "1e5",
        "1,5",
        "",
        " ",
        "-",
        "+",
        "true",
        "null",
        "None",
    ),
    *(
        "../../escaped",
        "/etc/passwd",
        "/dev/zero",
        "a/../b",
        "con.",
        "~",
        "-v",
        "--out",
        "\u202e\u0000",
        "\ud800".encode("utf-8", "surrogatepass").decode("latin1"),
    ),
    *("x" * 300, "9" * 400, "é" * 50, "%s%n{0}", "\n", "\t", "a\nb"),
)


def pick(rng: np.random.Generator, choices) -> Any:
    """One of them."""
    return choices[int(rng.integers(len(choices)))]


# ------------------------------------------------------------------------------------------------
# bytes


def some_bytes(data: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    """Bytes damaged in one of the ways in which files are."""
    how: Callable = pick(
        rng,
        (
            _flip,
            _flip,
            _overwrite,
            _overwrite,
            _integer,
            _integer,
            _cut,
            _behead,
            _drop,
            _repeat,
            _swap,
            _insert,
            _double,
            _blank,
        ),
    )
    return how(data or b"\0", rng)


def _span(data, rng):
    first = int(rng.integers(len(data)))
    length = int(min(len(data) - first, 2 ** rng.uniform(0, math.log2(len(data) + 1))))
    return first, max(1, length)


def _flip(data, rng):
    out, count = bytearray(data), int(2 ** rng.integers(0, 6))
    for at in rng.integers(0, len(data), count):
        out[at] ^= 1 << int(rng.integers(8))
    return bytes(out), f"{count} bits flipped"


def _overwrite(data, rng):
    first, length = _span(data, rng)
    length = min(length, 64)
    fill = pick(rng, (b"\0" * length, b"\xff" * length, b" " * length, rng.bytes(length)))
    return data[:first] + fill + data[first + length :], f"{length} bytes at {first} overwritten"


def _integer(data, rng):
    """A binary number of 1 to 8 bytes becomes an extreme one."""
    kind = pick(rng, ("<B", "<H", ">H", "<I", ">I", "<I", ">I", "<Q", "<f", "<d"))
    size = struct.calcsize(kind)
    at = int(rng.integers(max(1, min(len(data), pick(rng, (64, 1024, len(data)))) - size)))
    value = pick(rng, FLOATS) if kind[1] in "fd" else pick(rng, INTEGERS) % 256**size
    with np.errstate(over="ignore"):
        packed = np.float32(value).tobytes() if kind == "<f" else struct.pack(kind, value)
    return data[:at] + packed + data[at + size :], f"{value} as {kind} at {at}"


def _cut(data, rng):
    at = pick(rng, (0, 1, len(data) // 2, len(data) - 1, int(rng.integers(len(data)))))
    return data[:at], f"cut after {at} of {len(data)} bytes"


def _behead(data, rng):
    _, length = _span(data, rng)
    return data[length:], f"without its first {length} bytes"


def _drop(data, rng):
    first, length = _span(data, rng)
    return data[:first] + data[first + length :], f"without {length} bytes at {first}"


def _repeat(data, rng):
    first, length = _span(data, rng)
    times = int(min(pick(rng, (1, 1, 2, 100)), 1 + (1 << 20) // length))
    again = data[first : first + length] * times
    return data[:first] + again + data[first:], f"{length} bytes at {first} repeated {times} times"


def _swap(data, rng):
    a, b = sorted(int(x) for x in rng.integers(0, len(data), 2))
    length = min(int(2 ** rng.uniform(0, 10)), max(1, (b - a)), max(1, len(data) - b))
    out = bytearray(data)
    out[a : a + length], out[b : b + length] = data[b : b + length], data[a : a + length]
    return bytes(out), f"{length} bytes at {a} and {b} swapped"


def _insert(data, rng):
    at, extra = int(rng.integers(len(data) + 1)), rng.bytes(int(2 ** rng.integers(0, 10)))
    return data[:at] + extra + data[at:], f"{len(extra)} bytes inserted at {at}"


def _double(data, rng):
    return data + data, "twice, one behind the other"


def _blank(data, rng):
    fill = pick(rng, (b"\0", b"\xff", b" ", b"\n"))
    return fill * len(data), f"all bytes {fill!r}"


# ------------------------------------------------------------------------------------------------
# text


def some_text(data: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    """Lines and words of a text changed: numbers beyond measure, lines missing, repeated or
    swapped, other line ends.
    """
    how = pick(
        rng,
        (_word, _word, _word, _word, _number, _number, _number, _lines, _lines, _ends, _encoding),
    )
    return how(data or b"\n", rng)


def _tokens(data):
    """(start, end) of the words, by white space and commas."""
    import re

    return [match.span() for match in re.finditer(rb"[^\s,;:/\[\]{}\"]+", data)] or [(0, len(data))]


def _word(data, rng):
    first, end = pick(rng, _tokens(data))
    word = pick(rng, WORDS)
    return (
        data[:first] + word.encode(errors="replace") + data[end:],
        f"{data[first:end][:20]!r} at {first} → {word[:20]!r}",
    )


def _number(data, rng):
    numbers = [(a, b) for a, b in _tokens(data) if data[b - 1 : b].isdigit()] or _tokens(data)
    first, end = pick(rng, numbers)
    value = pick(
        rng, (*INTEGERS, *FLOATS, 10**400, "1e400", "1e-400", "00", "1.", ".5", "1e", "--1")
    )
    return (
        data[:first] + str(value).encode() + data[end:],
        f"{data[first:end][:20]!r} at {first} → {str(value)[:20]}",
    )


def _lines(data, rng):
    lines = data.splitlines(keepends=True)
    k, j = (int(x) for x in rng.integers(0, len(lines), 2))
    kind = int(rng.integers(5))
    if kind == 0:
        return b"".join(lines[:k] + lines[k + 1 :]), f"without line {k + 1}"
    if kind == 1:
        return b"".join([*lines[: k + 1], *lines[k:]]), f"line {k + 1} twice"
    if kind == 2:
        lines[k], lines[j] = lines[j], lines[k]
        return b"".join(lines), f"lines {k + 1} and {j + 1} swapped"
    if kind == 3:
        return (
            b"".join(lines[:k]) + lines[k].rstrip() * 2 + b"\n" + b"".join(lines[k + 1 :]),
            f"line {k + 1} doubled in itself",
        )
    return (
        b"".join(lines[:k]) + rng.bytes(40).replace(b"\n", b"") + b"\n" + b"".join(lines[k:]),
        f"noise before line {k + 1}",
    )


def _ends(data, rng):
    kind = int(rng.integers(4))
    if kind == 0:
        return data.replace(b"\n", b"\r\n"), "line ends of Windows"
    if kind == 1:
        return data.replace(b"\n", b"\r"), "line ends of old Macs"
    if kind == 2:
        return data.replace(b"\n", b" "), "one line"
    return data.rstrip(b"\n"), "no newline at the end"


def _encoding(data, rng):
    text = data.decode("utf-8", "replace")
    kind = int(rng.integers(4))
    if kind == 0:
        return b"\xef\xbb\xbf" + data, "a byte-order mark"
    if kind == 1:
        return text.encode("utf-16"), "UTF-16"
    if kind == 2:
        return data.replace(b" ", b"\xa0"), "Latin-1 spaces"
    return data.replace(b" ", b"\0", 3), "NUL for spaces"


# ------------------------------------------------------------------------------------------------
# JSON


def some_json(data: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    """A value, a key or the text of JSON changed; the result is JSON as a rule."""
    if rng.random() < 0.15:
        return some_text(data, rng) if rng.random() < 0.5 else some_bytes(data, rng)
    if rng.random() < 0.05:
        depth = int(pick(rng, (100, 1000, 100_000)))
        return b"[" * depth + data + b"]" * depth, f"nested {depth} deep"
    tree, label = some_value(json.loads(data), rng)
    text = json.dumps(tree, indent=1)
    if rng.random() < 0.1:
        return duplicate_key(text, rng), f"{label}, a key twice"
    return text.encode(), label


def some_value(tree: Any, rng: np.random.Generator) -> tuple[Any, str]:
    """One value inside a tree of dictionaries and lists replaced, removed, renamed, repeated or
    swapped.
    """
    place = pick(rng, places(tree))
    if not place:
        return odd_value(tree, rng), "everything replaced"
    return changed(tree, place, rng)


def places(tree: Any, prefix: tuple = ()) -> list[tuple]:
    """Where values stand, as tuples of keys and indices; of long lists only the first few, so that
    numbers do not drown keys.
    """
    result = [prefix]
    items = (
        list(tree.items())
        if isinstance(tree, dict)
        else list(enumerate(tree))[:4]
        if isinstance(tree, list)
        else []
    )
    for key, value in items:
        result += places(value, (*prefix, key))
    return result


def changed(tree: Any, place: tuple, rng: np.random.Generator) -> tuple[Any, str]:
    """The tree with something done at a place; the tree given is not altered."""
    tree = json.loads(json.dumps(tree))
    parent = tree
    for key in place[:-1]:
        parent = parent[key]
    last, name = place[-1], ".".join(map(str, place))
    old = parent[last]
    kind = rng.random()
    if kind < 0.62:
        parent[last] = odd_value(old, rng)
        return tree, f"{name}: {_short(old)} → {_short(parent[last])}"
    if kind < 0.76:
        del parent[last]
        return tree, f"{name} removed"
    if kind < 0.84 and isinstance(parent, dict):
        parent[pick(rng, (f"{last}s", last.upper(), last[:-1], "", "unknown", f" {last}"))] = (
            parent.pop(last)
        )
        return tree, f"{name} renamed"
    if kind < 0.92 and isinstance(parent, list):
        parent[last:last] = [old] * int(pick(rng, (1, 2, 1000)))
        return tree, f"{name} repeated"
    others = list(parent) if isinstance(parent, dict) else list(range(len(parent)))
    other = pick(rng, others)
    parent[last], parent[other] = parent[other], old
    return tree, f"{name} and {other} swapped"


def odd_value(old: Any, rng: np.random.Generator) -> Any:
    """Something else in a value's place: often of the same type, sometimes not."""
    if rng.random() < 0.25:
        return pick(
            rng,
            (
                None,
                True,
                False,
                0,
                -1,
                1.5,
                "",
                "x",
                [],
                {},
                [None],
                {"a": 1},
                10**400,
                1e300,
                math.nan,
            ),
        )
    if isinstance(old, bool):
        return not old
    if isinstance(old, int):
        return pick(rng, (*INTEGERS, old + 1, old - 1, -old, float(old), str(old), 10**30))
    if isinstance(old, float):
        return pick(
            rng,
            (
                *FLOATS,
                -old,
                2 * old,
                int(old) if math.isfinite(old) else 0,
                old * (1 + 1e-12),
                str(old),
            ),
        )
    if isinstance(old, str):
        return pick(
            rng,
            (
                *WORDS,
                old[:-1],
                old + "x",
                old.upper(),
                old[::-1],
                f"../{old}",
                f"/{old}",
                old + "\0",
            ),
        )
    if isinstance(old, list):
        return pick(
            rng,
            ([], old[:-1], old + old, old[::-1], [old], old * 500, dict(enumerate(map(str, old)))),
        )
    if isinstance(old, dict):
        return pick(
            rng,
            (
                {},
                list(old.items()),
                [old],
                None,
                {**old, "unknown": 1},
                dict(list(old.items())[:-1]),
            ),
        )
    return pick(rng, (0, "", [], {}))


def duplicate_key(text: str, rng: np.random.Generator) -> bytes:
    """The text of JSON with one of its keys twice; text that has none is left as it is."""
    import re

    keys = list(re.finditer(r'("[^"\n]*": [^{}\[\],\n]+),?\n', text))
    if not keys:
        return text.encode()
    result = pick(rng, keys)
    return (text[: result.start()] + result[1] + ",\n" + text[result.start() :]).encode()


def _short(value):
    text = repr(value)
    return text if len(text) < 40 else text[:37] + "…"


# ------------------------------------------------------------------------------------------------
# arrays


def some_array(array: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, str]:
    """An array with other values, type, shape or order."""
    kind = int(rng.integers(8))
    if kind <= 2:
        out = array.astype(np.float64 if array.dtype.kind in "biu" else array.dtype, copy=True)
        value = pick(rng, FLOATS)
        spot = rng.random(out.shape) < pick(rng, (0.0, 0.05, 1.0))
        if out.size and not spot.any():
            spot.reshape(-1)[int(rng.integers(out.size))] = True
        with np.errstate(over="ignore"):
            out[spot] = value
        return out, f"{int(spot.sum())} values {value}"
    if kind == 3:
        return _recast(
            array,
            pick(
                rng,
                ("f2", "f4", "f8", ">f4", "i1", "u1", "i8", "u8", "?", "c8", "S4", "U4", "M8[s]"),
            ),
        )
    if kind == 4:
        shape = pick(
            rng,
            (
                (),
                (0,),
                (1,),
                array.shape[1:],
                (1, *array.shape),
                array.shape[::-1],
                (0, *array.shape[1:]),
            ),
        )
        return np.resize(array, shape).astype(array.dtype), f"shape {shape}"
    if kind == 5:
        return array[: max(1, len(array) // 2)] if array.ndim else array, "half of it"
    if kind == 6:
        return -array if array.dtype.kind == "f" else array + 1, "negative"
    return np.asfortranarray(np.flip(array)), "reversed, in Fortran's order"


def _recast(array, dtype):
    with np.errstate(all="ignore"):
        try:
            return array.astype(dtype), f"as {dtype}"
        except (TypeError, ValueError):
            return np.zeros(array.shape, dtype), f"zeros as {dtype}"


# ------------------------------------------------------------------------------------------------
# npz


def some_npz(data: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    """An .npz with other arrays, members or directory."""
    if rng.random() < 0.3:
        return some_bytes(data, rng)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    name = pick(rng, list(members))
    kind = int(rng.integers(9))
    label = f"{name}: "
    if kind <= 2:
        array, how = some_array(np.load(io.BytesIO(members[name]), allow_pickle=False), rng)
        members[name] = npy(array)
        label += how
    elif kind == 3:
        members.pop(name)
        label += "removed"
    elif kind == 4:
        new = pick(
            rng,
            (
                "../../escaped.npy",
                "/tmp/escaped.npy",
                "x.npy",
                name.removesuffix(".npy"),
                f"{name}/",
                "ß\n.npy",
            ),
        )
        members[new] = members.pop(name)
        label += f"renamed to {new!r}"
    elif kind == 5:
        members[name] = pick(
            rng,
            (
                b"",
                members[name][:60],
                data,
                b"\x80\x04N.",
                object_header(),
                bomb_header((1 << 40,)),
                bomb_header((1 << 20, 1 << 20, 3)),
            ),
        )
        label += "another content"
    elif kind == 6:
        members[name], how = some_bytes(members[name], rng)
        label += how
    elif kind == 7:
        return directory_lies(data, rng)
    else:
        members |= {f"more-{k}.npy": members[name] for k in range(int(pick(rng, (1, 300))))}
        label = "more members"
    out = io.BytesIO()
    method = pick(
        rng, (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
    )
    with zipfile.ZipFile(out, "w", method) as archive:
        for each, content in members.items():
            archive.writestr(each, content)
    return out.getvalue(), label


def npy(array: np.ndarray) -> bytes:
    """The bytes of an .npy file."""
    out = io.BytesIO()
    np.save(out, array, allow_pickle=False)
    return out.getvalue()


def object_header() -> bytes:
    """An .npy that asks to be unpickled."""
    return _npy_header("|O", (1,)) + b"cos\nsystem\n(S'touch escaped'\ntR."


def bomb_header(shape: tuple) -> bytes:
    """An .npy that promises more than there is."""
    return _npy_header("<f8", shape) + b"\0" * 64


def _npy_header(descr, shape):
    text = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape!r}, }}"
    text += " " * (-(len(text) + 11) % 64) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode()


def directory_lies(data: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    """A zip whose central directory says other sizes, flags, methods or places than there are."""
    at = data.find(b"PK\x01\x02")
    fields = (
        ("flags: encrypted", 8, "<H", (1, 0x0800, 0xFFFF)),
        ("method", 10, "<H", (0, 8, 12, 14, 99)),
        ("checksum", 16, "<I", (0, 1)),
    )
    fields += (
        ("compressed size", 20, "<I", (0, 1, 2**31, 2**32 - 1)),
        ("size", 24, "<I", (0, 1, 2**31, 2**32 - 1)),
        ("place", 42, "<I", (1, 2**31)),
    )
    name, offset, kind, values = pick(rng, fields)
    value = pick(rng, values)
    out = bytearray(data)
    struct.pack_into(kind, out, at + offset, value)
    return bytes(out), f"directory: {name} {value}"


# ------------------------------------------------------------------------------------------------
# safetensors


def some_safetensors(data: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    """A .safetensors file with another header, other metadata or other numbers."""
    if rng.random() < 0.15:
        return some_bytes(data, rng)
    length = struct.unpack("<Q", data[:8])[0]
    header, body = json.loads(data[8 : 8 + length]), data[8 + length :]
    metadata, names = (
        header.get("__metadata__", {}),
        [name for name in header if name != "__metadata__"],
    )
    kind = rng.random()
    if kind < 0.3 and metadata:
        key = pick(rng, list(metadata))
        old = metadata[key]
        if old.startswith("{") and rng.random() < 0.7:
            tree, label = some_value(json.loads(old), rng)
            metadata[key] = json.dumps(tree)
        else:
            metadata[key] = pick(
                rng, (*map(str, INTEGERS), *WORDS[:20], "{}", "[]", "null", "{", old + old)
            )
            label = _short(metadata[key])
        return _safetensors(header, body), f"metadata {key}: {label}"
    if kind < 0.4 and metadata:
        header["__metadata__"] = {
            k: v for k, v in metadata.items() if k != (gone := pick(rng, list(metadata)))
        }
        return _safetensors(header, body), f"metadata {gone} removed"
    if kind < 0.7:
        name = pick(rng, names)
        first, end = header[name]["data_offsets"]
        size = {"F16": 2, "BF16": 2, "F32": 4, "F64": 8, "I64": 8}.get(header[name]["dtype"], 1)
        value = pick(rng, FLOATS)
        with np.errstate(over="ignore"):
            packed = {2: np.float16, 4: np.float32, 8: np.float64}.get(size, np.uint8)(
                value if size > 1 else 255
            ).tobytes()
        filled = (
            packed * ((end - first) // size)
            if rng.random() < 0.5
            else packed + body[first + size : end]
        )
        return _safetensors(header, body[:first] + filled + body[end:]), f"{name}: {value}"
    if kind < 0.78:
        header.pop(name := pick(rng, names))
        return _safetensors(header, body), f"{name} removed"
    if kind < 0.82:
        return struct.pack("<Q", pick(rng, INTEGERS) % 2**64) + data[8:], "another header length"
    name = pick(rng, names)
    header[name], label = some_value(header[name], rng)
    return _safetensors(header, body), f"{name}: {label}"


def _safetensors(header, body):
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    return struct.pack("<Q", len(text)) + text + body


# ------------------------------------------------------------------------------------------------
# EXR


def some_exr(data: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    """An EXR with other channels, types, values or size; or with damaged bytes, its header above
    all.
    """
    import OpenEXR

    kind = rng.random()
    if kind < 0.2:
        return some_bytes(data, rng)
    if kind < 0.4:
        end = min(len(data), 400)
        head, label = some_bytes(data[:end], rng)
        return head + data[end:], f"header: {label}"
    channels = exr_channels(data)
    name = pick(rng, list(channels))
    if kind < 0.6:
        old = channels[name]
        channels[name] = some_values_like(old, rng)
        label = f"{name}: other values"
    elif kind < 0.7:
        channels.pop(name)
        channels = channels or {"Q": np.zeros((2, 2), np.float32)}
        label = f"{name} removed"
    elif kind < 0.8:
        new = pick(rng, ("A", "x", f"{name}.{name}", "é", name.lower(), "layer.R", "n" * 200))
        channels[new] = channels.pop(name)
        label = f"{name} renamed to {new!r}"
    elif kind < 0.9:
        dtype = pick(rng, (np.float16, np.float32, np.uint32))
        with np.errstate(all="ignore"):
            channels = {
                each: np.nan_to_num(values).astype(dtype) for each, values in channels.items()
            }
        label = f"as {np.dtype(dtype).name}"
    else:
        size = pick(rng, ((1, 1), (1, 7), (3, 2), (17, 5), (64, 128), (300, 2)))
        channels = {each: np.resize(values, size) for each, values in channels.items()}
        label = f"{size[0]}×{size[1]}"
    return (
        exr(
            channels,
            pick(rng, (OpenEXR.ZIP_COMPRESSION, OpenEXR.NO_COMPRESSION, OpenEXR.PIZ_COMPRESSION)),
        ),
        label,
    )


def some_values_like(array: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The array, with one, some or all of its values extreme."""
    out = array.copy()
    spot = rng.random(out.shape) < pick(rng, (0.02, 0.3, 1.0))
    spot.reshape(-1)[int(rng.integers(out.size))] = True
    with np.errstate(all="ignore"):
        out[spot] = (
            pick(rng, (0, 1, 255, 256, 257, 2**31))
            if out.dtype.kind == "u"
            else np.asarray(pick(rng, FLOATS)).astype(out.dtype)
        )
    return out


def exr(channels: dict[str, np.ndarray], compression: Any = None) -> bytes:
    """The bytes of an EXR of these channels."""
    import tempfile

    import OpenEXR

    handle, path = tempfile.mkstemp(suffix=".exr")
    os.close(handle)
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION if compression is None else compression,
        "type": OpenEXR.scanlineimage,
    }
    try:
        with OpenEXR.File(
            header, {name: np.ascontiguousarray(array) for name, array in channels.items()}
        ) as file:
            file.write(path)
        with open(path, "rb") as file:
            return file.read()
    finally:
        os.unlink(path)


def exr_channels(data: bytes) -> dict[str, np.ndarray]:
    """{name: array} of an EXR."""
    import tempfile

    import OpenEXR

    handle, path = tempfile.mkstemp(suffix=".exr")
    with os.fdopen(handle, "wb") as file:
        file.write(data)
    try:
        with OpenEXR.File(path, separate_channels=True) as file:
            return {name: channel.pixels.copy() for name, channel in file.channels().items()}
    finally:
        os.unlink(path)


# ------------------------------------------------------------------------------------------------
# PNG


PNG_HOWS = ("damaged", "removed", "twice", "with a stranger", "IHDR made up")


def some_png(data: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    """A PNG with other chunks (checksums right), another header, mode or size; or a picture of
    another kind under its name.
    """
    kind = rng.random()
    if kind < 0.25:
        return some_bytes(data, rng)
    if kind < 0.6:
        chunks = png_chunks(data)
        k = int(rng.integers(len(chunks)))
        name, body = chunks[k]
        how = int(rng.integers(5))
        if how == 0:
            chunks[k] = (name, some_bytes(body, rng)[0]) if body else (name, b"x")
        elif how == 1:
            chunks.pop(k)
        elif how == 2:
            chunks.insert(k, chunks[k])
        elif how == 3:
            chunks.insert(
                1,
                (
                    pick(
                        rng,
                        (b"tEXt", b"zTXt", b"iCCP", b"gAMA", b"eXIf", b"PLTE", b"tRNS", b"acTL"),
                    ),
                    rng.bytes(30),
                ),
            )
        else:
            width, height = (
                int(pick(rng, (0, 1, 7, 20_000, 2**31 - 1, 2**32 - 1))) for _ in range(2)
            )
            chunks[0] = (
                b"IHDR",
                struct.pack(">II", width, height) + bytes(int(x) for x in rng.integers(0, 17, 5)),
            )
        return png(chunks), f"chunk {name.decode('latin1')} at {k}, {PNG_HOWS[how]}"
    from PIL import Image

    picture = Image.open(io.BytesIO(data))
    mode = pick(rng, ("1", "L", "LA", "P", "RGB", "RGBA", "I;16", "I", "F", "CMYK", "YCbCr"))
    size = pick(rng, (picture.size, (1, 1), (1, 50), (50, 1), (13, 7), (200, 3)))
    picture = picture.resize(size).convert("L" if mode == "I;16" else mode if mode != "F" else "F")
    if mode == "I;16":
        picture = Image.fromarray(np.asarray(picture).astype(np.uint16) * 257)
    out, format_ = (
        io.BytesIO(),
        {"CMYK": "JPEG", "YCbCr": "JPEG", "F": "TIFF"}.get(mode)
        or pick(rng, ("PNG", "PNG", "TIFF")),
    )
    if mode in ("1", "L", "P", "RGB") and rng.random() < 0.3:
        format_ = (
            pick(rng, ("GIF", "BMP", "PPM", "WEBP", "ICO", "EPS", "PDF", "JPEG2000"))
            if mode != "1"
            else "TIFF"
        )
        picture = picture.convert("RGB")
    picture.save(out, format=format_)
    return out.getvalue(), f"{format_} of mode {mode}, {size[0]}×{size[1]}"


def png_chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    """[(name, content)] of a PNG."""
    at, chunks = 8, []
    while at + 8 <= len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    return chunks


def png(chunks: list[tuple[bytes, bytes]]) -> bytes:
    """A PNG of chunks, with the checksums they should have."""
    parts = (
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        for name, body in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


# ------------------------------------------------------------------------------------------------
# file system


def put_instead(path: Path, rng: np.random.Generator) -> str:
    """Put something else where a file or a folder is; returns what."""
    was_folder = path.is_dir()
    shutil.rmtree(path) if was_folder else path.unlink(missing_ok=True)
    kind = pick(
        rng,
        (
            "gone",
            "empty",
            "folder",
            "pipe",
            "loop",
            "dangling",
            "device",
            "outside",
            "sparse",
            "locked",
        ),
    )
    if kind == "empty":
        path.write_bytes(b"")
    elif kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "loop":
        path.symlink_to(path.name)
    elif kind == "dangling":
        path.symlink_to("nowhere")
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "outside":
        path.symlink_to("/proc/tty" if was_folder else "/proc/version")  # which nothing can write
    elif kind == "sparse":
        with open(path, "wb") as file:
            file.truncate(8 << 30)
    elif kind == "locked":
        path.write_bytes(b"{}")
        path.chmod(0)
    words = {
        "pipe": "is a pipe",
        "loop": "is a link to itself",
        "device": "is a link to /dev/zero",
        "sparse": "has 8 GiB of zeros",
    }
    return words.get(kind, f"is {kind}")
