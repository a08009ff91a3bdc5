"""Mesh files written by hand, for tests: PLY of any types and lists, glTF with strides, sparse
values and trees of nodes.
"""

import json
import struct

import numpy as np

CODES = {
    "char": "b",
    "uchar": "B",
    "short": "h",
    "ushort": "H",
    "int": "i",
    "uint": "I",
    "float": "f",
    "double": "d",
    "uint64": "Q",
}
COMPONENTS = {
    "int8": 5120,
    "uint8": 5121,
    "int16": 5122,
    "uint16": 5123,
    "uint32": 5125,
    "float32": 5126,
}


def obj_text(vertices, polygons):
    """An OBJ of vertices (V, 3) and lists of indices from 0."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.asarray(vertices, float).tolist()]
    return (
        "\n".join(lines + ["f " + " ".join(str(k + 1) for k in polygon) for polygon in polygons])
        + "\n"
    )


def off_text(vertices, polygons):
    """An OFF of the same."""
    lines = [
        "OFF",
        f"{len(vertices)} {len(polygons)} 0",
        *(f"{x!r} {y!r} {z!r}" for x, y, z in np.asarray(vertices, float).tolist()),
    ]
    return (
        "\n".join(lines + [" ".join(map(str, (len(polygon), *polygon))) for polygon in polygons])
        + "\n"
    )


def stl_text(vertices, faces, name="a"):
    """A text STL of triangles (F, 3)."""
    lines = [f"solid {name}"]
    for corners in np.asarray(vertices, float)[faces].tolist():
        lines += [
            "facet normal 0 0 0",
            "outer loop",
            *(f"vertex {x!r} {y!r} {z!r}" for x, y, z in corners),
            "endloop",
            "endfacet",
        ]
    return "\n".join([*lines, f"endsolid {name}"]) + "\n"


def ply(
    vertices,
    polygons,
    form="binary_little_endian",
    count="uchar",
    index="int",
    scalar="float",
    more=(),
    faces_first=False,
):
    """A PLY's bytes. more: further properties of a face, before its list: names of types, or
    ("list", count, type).
    """
    order = ">" if "big" in form else "<"

    def put(type_, *values):
        if form == "ascii":
            return (
                " ".join(
                    repr(float(v)) if type_ in ("float", "double") else str(int(v)) for v in values
                )
                + " "
            ).encode()
        return struct.pack(f"{order}{len(values)}{CODES[type_]}", *values)

    end = b"\n" if form == "ascii" else b""
    vertex = [f"element vertex {len(vertices)}", *(f"property {scalar} {axis}" for axis in "xyz")]
    face = [f"element face {len(polygons)}"]
    face += [
        f"property {' '.join(each) if isinstance(each, tuple) else each} extra{k}"
        for k, each in enumerate(more)
    ]
    face += [f"property list {count} {index} vertex_indices"]
    vertex_data = b"".join(
        put(scalar, *point) + end for point in np.asarray(vertices, float).tolist()
    )
    face_data = b""
    for k, polygon in enumerate(polygons):
        for each in more:
            face_data += (
                (put(each[1], k % 3) + put(each[2], *range(k % 3)))
                if isinstance(each, tuple)
                else put(each, 7)
            )
        face_data += put(count, len(polygon)) + put(index, *polygon) + end
    parts = [(vertex, vertex_data), (face, face_data)][:: -1 if faces_first else 1]
    head = [
        "ply",
        f"format {form} 1.0",
        "comment a test",
        *parts[0][0],
        *parts[1][0],
        "end_header",
        "",
    ]
    return "\n".join(head).encode() + parts[0][1] + parts[1][1]


class Glb:
    """A binary glTF that grows by accessors, meshes and nodes."""

    def __init__(self):
        self.data = bytearray()
        self.scene = {key: [] for key in ("nodes", "meshes", "accessors", "bufferViews")}

    def view(self, data, **keys):
        """A buffer view of bytes; its number."""
        self.data += b"\0" * (-len(self.data) % 4)
        self.scene["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **keys}
        )
        self.data += data
        return len(self.scene["bufferViews"]) - 1

    def accessor(self, values, stride=0, sparse=(), **keys):
        """An accessor of values (count,) or (count, width); its number.

        stride  bytes from one value to the next, 0: packed;  sparse  places whose values stand
        apart; the others are 0 if all lie there
        """
        values = np.asarray(values)
        table = values.reshape(len(values), -1)
        described = {
            "count": len(values),
            "componentType": COMPONENTS[values.dtype.name],
            "type": {1: "SCALAR", 2: "VEC2", 3: "VEC3"}[table.shape[1]],
        }
        sparse = np.asarray(sparse, np.uint16)
        if len(sparse) < len(values):
            plain = table.copy()
            plain[sparse] = 99
            rows = [row.tobytes() for row in plain]
            described["bufferView"] = self.view(
                b"".join(row.ljust(stride, b"\x55") for row in rows),
                **({"byteStride": stride} if stride else {}),
            )
        if len(sparse):
            indices, replaced = self.view(sparse.tobytes()), self.view(table[sparse].tobytes())
            described["sparse"] = {
                "count": len(sparse),
                "indices": {"bufferView": indices, "componentType": 5123},
                "values": {"bufferView": replaced},
            }
        self.scene["accessors"].append({**described, **keys})
        return len(self.scene["accessors"]) - 1

    def mesh(self, *primitives):
        """A mesh of primitives, each {attributes, indices, mode}; its number."""
        self.scene["meshes"].append({"primitives": list(primitives)})
        return len(self.scene["meshes"]) - 1

    def node(self, **keys):
        """A node; its number."""
        self.scene["nodes"].append(keys)
        return len(self.scene["nodes"]) - 1

    def bytes(self, roots=None, **changes):
        """The file; roots: the nodes of its scene, None: no scenes. changes: top keys of the
        JSON.
        """
        scene = {
            "asset": {"version": "2.0"},
            "buffers": [{"byteLength": len(self.data)}],
            **self.scene,
        }
        if roots is not None:
            scene |= {"scene": 0, "scenes": [{"nodes": list(roots)}]}
        return glb({**scene, **changes}, bytes(self.data))


def glb(scene, binary=b""):
    """The bytes of a binary glTF: a JSON chunk, and one of data."""
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if binary:
        binary += b"\0" * (-len(binary) % 4)
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
