"""Meshes: bodies of known area and volume, written in every legal way, must be read as they are;
lies in their headers, refused.

A body is a prism over a random polygon (concave, with corners in a line, or convex), turned and
moved: its area and its volume follow from the polygon's. It is written as OBJ, OFF, PLY, STL or GLB
with all the freedom that the format leaves, and read by `factory.shapes`: the triangles must have
its area, close it, and enclose its volume.
"""

import json
import math
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.support.mesh_files import Glb, ply, stl_text

from . import Case, Result, Room, mutation

TEXT_LIES = (
    *(
        "nan",
        "inf",
        "-inf",
        "1e999",
        "-1e999",
        "1e-400",
        "1,5",
        "1_0",
        "0x1",
        "--1",
        "1e",
        "",
        "\0",
        "\ufeff",
        "\\",
        "#",
        "/",
        "//",
    ),
    *(
        "0",
        "-0",
        "-1",
        "00",
        "99999999",
        "-99999999",
        "4294967296",
        "9" * 40,
        "9" * 5000,
        "1.5",
        "\u0661",
        "nan(0)",
        "+",
        "a b",
    ),
)


@dataclass(frozen=True)
class Body:
    """A closed mesh: vertices (V, 3), polygons as lists of indices counter-clockwise from outside,
    and what it measures.
    """

    vertices: np.ndarray
    polygons: list[list[int]]
    area: float
    volume: float

    @property
    def triangles(self) -> int:
        return sum(len(polygon) - 2 for polygon in self.polygons)

    def turned(self, matrix: np.ndarray) -> np.ndarray:
        """The vertices after a map (3, 4)."""
        return self.vertices @ matrix[:, :3].T + matrix[:, 3]


def outline(rng: np.random.Generator) -> np.ndarray:
    """A simple polygon (C, 2), counter-clockwise: convex, a star, or with steps, and now and then
    corners in a line.
    """
    count = int(rng.integers(3, 30))
    kind = rng.integers(3)
    if kind == 2:
        width = rng.uniform(0.2, 1, count)
        edges = np.concatenate([[0], np.cumsum(width)])
        heights = rng.choice([1.0, 1.5, 2.0, 3.0], count)
        top = np.stack([np.repeat(edges, 2)[1:-1], np.repeat(heights, 2)], axis=1)
        # equal neighbours leave corners in a line
        return np.concatenate([[(0, 0), (edges[-1], 0)], top[::-1]])
    angle = (
        np.sort(rng.uniform(0, 2 * np.pi, count)) if kind else 2 * np.pi * np.arange(count) / count
    )
    if count < 4 or np.diff(np.append(angle, angle[0] + 2 * np.pi)).max() > 3:
        angle = 2 * np.pi * np.arange(count) / count
    radius = rng.uniform(0.2, 1, count) if kind else np.ones(count)
    polygon = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    if rng.random() < 0.3:
        k = int(rng.integers(count))
        polygon = np.insert(polygon, k, (polygon[k] + polygon[k - 1]) / 2, axis=0)
    return polygon


def body(rng: np.random.Generator) -> Body:
    """A prism over a random outline."""
    flat = outline(rng)
    count, height = len(flat), float(rng.uniform(0.3, 2))
    ahead = np.roll(flat, -1, axis=0)
    size = 0.5 * float((flat[:, 0] * ahead[:, 1] - ahead[:, 0] * flat[:, 1]).sum())
    around = float(np.linalg.norm(ahead - flat, axis=1).sum())
    vertices = np.concatenate([np.c_[flat, np.zeros(count)], np.c_[flat, np.full(count, height)]])
    first = int(rng.integers(count))
    top = [count + (first + k) % count for k in range(count)]
    bottom = [(first - k) % count for k in range(count)]
    sides = [[k, (k + 1) % count, count + (k + 1) % count, count + k] for k in range(count)]
    polygons = [bottom, top, *(np.roll(side, int(rng.integers(4))).tolist() for side in sides)]
    order = rng.permutation(len(polygons))
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    scale = 10.0 ** rng.integers(-2, 3)
    # as binary files hold them
    vertices = np.float32(scale * (vertices @ rotation.T + rng.normal(size=3))).astype(float)
    return Body(
        vertices,
        [polygons[k] for k in order],
        scale**2 * (2 * size + around * height),
        scale**3 * size * height,
    )


# -------------------------------------------------------------------------------------------- legal
# ways to write a body


def as_obj(shape: Body, rng: np.random.Generator) -> tuple[bytes, str]:
    """OBJ text with any line ends, indices, comments, names and numbers."""
    newline = mutation.pick(rng, ("\n", "\r\n", "\r"))
    style = mutation.pick(rng, ("{0}", "{0}/{0}", "{0}//{0}", "{0}/{0}/{0}", "{0}/"))
    backwards, early, number = (
        rng.random() < 0.3,
        rng.random() < 0.2,
        mutation.pick(rng, ("{!r}", "{:.17g}", "{:+.16e}")),
    )
    words = ["# a body \\", "mtllib nothing.mtl", "o \u00e9 f v #1"]
    vertices = [
        "v " + " ".join(number.format(x) for x in point) for point in shape.vertices.tolist()
    ]
    faces = []
    for k, polygon in enumerate(shape.polygons):
        indices = [
            index - len(shape.vertices) if backwards and not early else index + 1
            for index in polygon
        ]
        line = "f " + " ".join(style.format(index) for index in indices)
        if rng.random() < 0.2:
            line = (
                line.replace(" ", " \\" + newline, 1)
                if rng.random() < 0.5
                else line.replace(" ", "\t ")
            )
        faces.append(line + (" # a face" if rng.random() < 0.2 else ""))
        if rng.random() < 0.1:
            faces += [f"usemtl stuff {k} \\", f"g a b {k}", "s off", "vn 0 0 1", "vt 0 0 0"][
                : int(rng.integers(1, 6))
            ]
    words += [*faces, *vertices] if early else [*vertices, *faces]
    text = newline.join(words) + (newline if rng.random() < 0.8 else "")
    mark = rng.random() < 0.3
    return (
        text.encode("utf-8-sig" if mark else "utf-8"),
        f"OBJ, {style}, {newline!r}{', a mark' * mark}{', faces first' * early}",
    )


def as_off(shape: Body, rng: np.random.Generator) -> tuple[bytes, str]:
    """OFF text, perhaps with colours."""
    kind = mutation.pick(rng, ("OFF", "COFF", "NOFF"))
    newline = mutation.pick(rng, ("\n", "\r\n", "\r"))
    more = "" if kind == "OFF" else " 0.5 0.5 1" + " 1" * (kind == "COFF")
    between = " " if rng.random() < 0.3 else newline
    lines = [" ".join(map(repr, point)) + more for point in shape.vertices.tolist()]
    lines += [
        " ".join(map(str, (len(polygon), *polygon))) + " 255 0 0" * int(rng.integers(2))
        for polygon in shape.polygons
    ]
    head = f"{kind}{between}{len(shape.vertices)} {len(shape.polygons)} 0"
    lines = [line + " # so" * int(rng.integers(2)) for line in lines]
    return newline.join([head, *lines, ""]).encode(), f"{kind}, {newline!r}"


def as_ply(shape: Body, rng: np.random.Generator) -> tuple[bytes, str]:
    """PLY of any types, order and further properties."""
    keys = {
        "form": mutation.pick(rng, ("ascii", "binary_little_endian", "binary_big_endian")),
        "count": mutation.pick(rng, ("uchar", "char", "ushort", "int", "uint")),
        "index": mutation.pick(rng, ("uchar", "short", "ushort", "int", "uint", "uint64")),
        "scalar": mutation.pick(rng, ("float", "double")),
        "faces_first": bool(rng.integers(2)),
        "more": mutation.pick(
            rng,
            (
                (),
                ("uchar",),
                ("float", "short"),
                (("list", "uchar", "float"),),
                ("int", ("list", "uint", "double")),
            ),
        ),
    }
    return ply(shape.vertices, shape.polygons, **keys), f"PLY, {keys}"


def as_stl(shape: Body, rng: np.random.Generator) -> tuple[bytes, str]:
    """STL, which holds triangles alone."""
    from factory.shapes.polygons import triangulate

    lengths = np.array([len(polygon) for polygon in shape.polygons])
    faces, _, _ = triangulate(shape.vertices, np.concatenate(shape.polygons), lengths)
    if rng.random() < 0.5:
        text = stl_text(
            shape.vertices, faces, mutation.pick(rng, ("a", "vertex 1 2 3", "", "facet loop"))
        )
        text = text.upper() if rng.random() < 0.3 else text
        return (
            text.replace("\n", mutation.pick(rng, ("\n", "\r\n", "\n  \t", "\r"))).encode(),
            "STL text",
        )
    rows = np.zeros(
        len(faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    )
    rows["corners"] = shape.vertices[faces]
    head = mutation.pick(rng, (b"solid a", b"", b"\0", rng.bytes(80))).ljust(80, b" ")[:80]
    return head + struct.pack("<I", len(faces)) + rows.tobytes(), "STL binary"


def as_glb(shape: Body, rng: np.random.Generator) -> tuple[bytes, str]:
    """GLB with strides, sparse values, any index type, strips, a tree of nodes and mirrors that
    cancel.
    """
    from factory.shapes.polygons import triangulate

    lengths = np.array([len(polygon) for polygon in shape.polygons])
    faces, _, _ = triangulate(shape.vertices, np.concatenate(shape.polygons), lengths)
    made, matrix = Glb(), np.eye(4)
    nodes = int(rng.integers(1, 5))
    steps = []
    for _ in range(nodes):
        quaternion = rng.normal(size=4)
        quaternion /= np.linalg.norm(quaternion)
        scale = rng.choice([-1.0, 1.0], 3) * (2.0 ** rng.integers(-2, 3))
        keys = {
            "translation": rng.normal(size=3).tolist(),
            "rotation": quaternion.tolist(),
            "scale": scale.tolist(),
        }
        steps.append({name: value for name, value in keys.items() if rng.random() < 0.7})
        matrix = matrix @ _matrix(steps[-1])
    local = np.linalg.solve(matrix, np.c_[shape.vertices, np.ones(len(shape.vertices))].T).T[:, :3]
    if np.linalg.det(matrix) < 0:
        faces = faces[:, ::-1]
    sparse = (
        rng.choice(len(local), int(rng.integers(len(local) + 1)), replace=False)
        if rng.random() < 0.4
        else ()
    )
    points = made.accessor(
        local.astype(np.float32), stride=int(rng.choice([0, 12, 16, 24])), sparse=np.sort(sparse)
    )
    primitives = []
    for part in np.array_split(rng.permutation(len(faces)), int(rng.integers(1, 4))):
        if not len(part):
            continue
        kind = mutation.pick(rng, (np.uint8, np.uint16, np.uint32))
        mode, corners = (5, faces[part[:1]]) if len(part) == 1 else (4, faces[part])
        primitives.append(
            {
                "attributes": {"POSITION": points},
                "indices": made.accessor(corners.astype(kind).ravel()),
                "mode": mode,
            }
        )
    child = made.node(mesh=made.mesh(*primitives), **steps[-1])
    for step in reversed(steps[:-1]):
        child = made.node(children=[child], **step)
    scenes = None if rng.random() < 0.3 else [child]
    return (
        made.bytes(scenes),
        f"GLB, {nodes} nodes, {len(primitives)} primitives, {len(sparse)} sparse",
    )


def _matrix(step):
    matrix = np.eye(4)
    matrix[:3, 3] = step.get("translation", (0, 0, 0))
    x, y, z, w = step.get("rotation", (0, 0, 0, 1))
    turn = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, :3] = np.array(turn) * np.array(step.get("scale", (1, 1, 1)))
    return matrix


WAYS = {".obj": as_obj, ".off": as_off, ".ply": as_ply, ".stl": as_stl, ".glb": as_glb}


# ------------------------------------------------------------------------------------------------
# cases


def case(index: int, rng: np.random.Generator, room: Room) -> Case:
    """Two bodies that must be read rightly, then one that lies."""
    kind = list(WAYS)[index // 3 % len(WAYS)]
    shape = body(rng)
    data, label = WAYS[kind](shape, rng)
    path = room.folder / f"mesh{kind if rng.random() < 0.9 else kind.upper()}"
    if index % 3 < 2:
        path.write_bytes(data)
        return Case(
            label=label, run=lambda: opened(path), check=lambda result: wrong(shape, result)
        )
    data, lie = LIES[kind](data, rng)
    path.write_bytes(data)
    return Case(label=f"{label}: {lie}", run=lambda: opened(path), check=sound)


def opened(path: Path):
    """What `factory.shapes` makes of a file: the triangles as they stand there, and the mesh."""
    from factory.shapes.files import read
    from factory.shapes.mesh_import import open_mesh

    return read(path), open_mesh(path)


def wrong(shape: Body, result: Result) -> str | None:
    """How a body that was read differs from the one that was written."""
    if result.error is not None:
        return f"refused: {result.error}"
    raw, mesh = result.value
    a, b, c = (raw.vertices[raw.faces[:, k]] for k in range(3))
    area = 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
    centre = raw.vertices.mean(axis=0)
    volume = float(np.einsum("fi,fi->f", a - centre, np.cross(b - centre, c - centre)).sum() / 6)
    if len(raw.faces) != shape.triangles:
        return f"expected {shape.triangles} triangles, found {len(raw.faces)}"
    # float32 files; thin outlines amplify their rounding
    if not math.isclose(area, shape.area, rel_tol=1e-4):
        return f"expected an area of {shape.area:.9g}, found {area:.9g}"
    if not math.isclose(volume, shape.volume, rel_tol=1e-4):
        return f"expected a volume of {shape.volume:.9g}, found {volume:.9g}"
    report = mesh.report
    # corners in a line: their triangles are dropped
    flat = any("of no area" in note for note in report.cleaned)
    if report.components != 1 or not (report.watertight or flat):
        return f"expected one closed piece, found {report.line()}"
    if any("cross themselves" in note or "passed over" in note for note in report.cleaned):
        return f"expected nothing to tell, found {report.line()}"
    return sound(result)


def sound(result: Result) -> str | None:
    """What is wrong with a mesh that was taken, whatever its file."""
    if result.error is not None:
        return None
    mesh = result.value[1]
    if not (np.isfinite(mesh.vertices).all() and np.isfinite(mesh.corner_normals).all()):
        return "values that are not finite"
    radius = float(np.linalg.norm(mesh.vertices, axis=1).max())
    if abs(radius - 1) > 1e-9:
        return f"a radius of {radius}"
    lengths = np.linalg.norm(mesh.corner_normals, axis=2)
    if np.abs(lengths - 1).max() > 1e-5:
        return f"normals of length {lengths.min():g} to {lengths.max():g}"
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        return "faces beyond the vertices"
    return None


# ------------------------------------------------------------------------------------------------
# lies


def text_lie(data: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    """A word, or several, of a text changed into what means nothing, or too much."""
    words = mutation._tokens(data)
    labels = []
    for _ in range(int(rng.choice([1, 1, 3]))):
        first, end = words[int(rng.integers(len(words)))]
        lie = mutation.pick(rng, TEXT_LIES)
        labels.append(f"{data[first:end][:12]!r} at {first} → {lie[:12]!r}")
        data = data[:first] + lie.encode() + data[end:]
        words = mutation._tokens(data)
    return data, ", ".join(labels)


def ply_lie(data: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    """A header's counts, types, names or lines changed; the data as they were."""
    head, mark, rest = data.partition(b"end_header\n")
    if not mark or rng.random() < 0.3:
        return mutation.some_bytes(data, rng)
    if rng.random() < 0.5:
        head, label = text_lie(head, rng)
    else:
        swaps = (
            (b"uchar", b"uint64"),
            (b"int", b"uint"),
            (b"float", b"double"),
            (b"list ", b""),
            (b"little", b"big"),
            (b"ascii", b"binary_big_endian"),
        )
        swaps += (
            (b"property", b"element"),
            (b"vertex_indices", b"x"),
            (b"face", b"vertex"),
            (b"element vertex ", b"element vertex 1"),
            (b"\n", b"\r"),
        )
        old, new = mutation.pick(rng, swaps)
        head, label = head.replace(old, new, int(rng.choice([1, -1]))), f"{old!r} → {new!r}"
    return head + mark + rest, label


def stl_lie(data: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    """Another count, not finite corners, or text damaged."""
    if b"endsolid" in data.lower():
        return text_lie(data, rng)
    if rng.random() < 0.4:
        count = mutation.pick(rng, (0, 1, 2**31, 2**32 - 1, int(rng.integers(2**32))))
        return data[:80] + struct.pack("<I", count) + data[84:], f"a count of {count}"
    return mutation.some_bytes(data, rng)


def glb_lie(data: bytes, rng: np.random.Generator) -> tuple[bytes, str]:
    """A value of the scene, or its chunks' headers, changed."""
    length = struct.unpack("<I", data[12:16])[0]
    if rng.random() < 0.25:
        place = mutation.pick(rng, (4, 8, 12, 16, 20 + length, 24 + length))
        value = mutation.pick(rng, (0, 1, 3, length + 1, 2**31, 2**32 - 1))
        return data[:place] + struct.pack("<I", value) + data[place + 4 :], f"{value} at {place}"
    scene = json.loads(data[20 : 20 + length])
    label = "nothing"
    for _ in range(int(rng.choice([1, 1, 2]))):
        scene, label = (
            mutation.some_value(scene, rng) if rng.random() < 0.5 else _scene_lie(scene, rng)
        )
        if not isinstance(scene, dict):
            break
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    return (
        struct.pack(
            "<4sIII4s", b"glTF", 2, 20 + len(text) + len(data) - 20 - length, len(text), b"JSON"
        )
        + text
        + data[20 + length :],
        label,
    )


def _scene_lie(scene, rng):
    """A number of a scene that leads elsewhere: offsets, counts, indices, types."""
    places = [
        place
        for place in mutation.places(scene)
        if place and isinstance(_at(scene, place), int | str | list)
    ]
    if not places:
        return scene, "nothing"
    place = mutation.pick(rng, places)
    old = _at(scene, place)
    if isinstance(old, list):
        new = mutation.pick(
            rng, ([], old * 2, [0], [-1], [1e308] * 4, [float("nan")] * 3, {}, None)
        )
    elif isinstance(old, str):
        new = mutation.pick(
            rng,
            (
                "VEC2",
                "VEC3",
                "VEC4",
                "SCALAR",
                "MAT4",
                "",
                "data:;base64,AAAA",
                "../x.bin",
                "KHR_draco_mesh_compression",
            ),
        )
    else:
        new = mutation.pick(
            rng,
            (
                0,
                1,
                2,
                3,
                4,
                5,
                6,
                7,
                -1,
                old + 1,
                old - 1,
                2 * old,
                2**31,
                2**32,
                2**53,
                2**63,
                5120,
                5121,
                5123,
                5125,
                5126,
                12,
            ),
        )
    parent = _at(scene, place[:-1])
    parent[place[-1]] = new
    return scene, f"{'.'.join(map(str, place))}: {old} → {new}"[:100]


def _at(tree, place):
    for key in place:
        tree = tree[key]
    return tree


LIES = {".obj": text_lie, ".off": text_lie, ".ply": ply_lie, ".stl": stl_lie, ".glb": glb_lie}
