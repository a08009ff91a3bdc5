"""Binary glTF: the triangles of its scene, each mesh as often as nodes show it.

Nothing outside of the file is opened. Source: Khronos, glTF 2.0 specification. Compressed geometry
is refused. Materials, normals, cameras, lights and animations are ignored, and so are deformations
by skins and morph targets, with a note.
"""

import struct
from collections import Counter
from pathlib import Path
from typing import BinaryIO

import msgspec
import numpy as np

from factory.shapes.gltf_arrays import Arrays
from factory.shapes.gltf_nodes import meshes_shown
from factory.shapes.gltf_schema import (
    DOWNLOAD,
    FAN,
    LINES,
    POINTS,
    STRIP,
    TRIANGLES,
    Accessor,
    Document,
    Primitive,
    item,
)
from factory.shapes.raw import Raw, glimpse, require_count
from manifests.errors import InputError

LARGEST_SCENE = 64 << 20  # bytes of JSON
HARMLESS = (
    "KHR_mesh_quantization",
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "MSFT_texture_",
    "KHR_lights_",
    "EXT_lights_",
    "KHR_xmp",
    "KHR_animation_",
    "KHR_techniques_",
)
IGNORED = {
    "skins": "skins left as they are bound",
    "morph targets": "morph targets left out",
    "instances": "instanced copies left out",
}


def read(file: BinaryIO, size: int, where: str | Path, maximum: int) -> Raw:
    """Return the Raw of a GLB file. See factory.shapes.raw."""
    document = _document(file, size, where)
    shown, ignored = meshes_shown(document, where)
    count = sum(_triangle_count(document, mesh, where) for mesh, _ in shown)
    require_count(count, maximum, where, size)
    meshes = _Meshes(document, Arrays(document, file, where), ignored, where)
    vertices, faces, start = [], [], 0
    for mesh, world_from_node in shown:
        for points, triangles in meshes.parts(mesh):
            if np.linalg.det(world_from_node[:3, :3]) < 0:  # a mirror reverses the winding
                triangles = triangles[:, ::-1]
            vertices.append(_moved(points, world_from_node))
            faces.append(triangles + start)
            start += len(points)
    return Raw(
        np.concatenate(vertices),
        np.concatenate(faces),
        notes=meshes.notes(),
        own_materials=len(document.materials),
    )


def _moved(points, world_from_node):
    if (world_from_node == np.eye(4)).all():
        return points
    with np.errstate(all="ignore"):  # what is not finite is refused later, by name
        return points @ world_from_node[:3, :3].T + world_from_node[:3, 3]


def _document(file: BinaryIO, size: int, where: str | Path) -> Document:
    """Return the scene's JSON; the file is then at the bytes after it."""
    head = file.read(20)
    if len(head) < 20 or head[:4] != b"glTF":
        raise InputError(
            where, "a binary glTF header", f"'{glimpse(head)}'", "check the file's ending"
        )
    version, total, length, kind = struct.unpack("<III4s", head[4:])
    if kind != b"JSON" or length > min(size, LARGEST_SCENE):
        raise InputError(
            where, "a JSON chunk of at most 64 MiB first", f"{kind!r} of {length:,} bytes", DOWNLOAD
        )
    if version != 2:
        raise InputError(where, "glTF of version 2", f"version {version}", "export it as glTF 2")
    if total > size:
        raise InputError(where, f"{total:,} bytes as its header says", f"{size:,}", DOWNLOAD)
    try:
        document = msgspec.json.decode(file.read(length), type=Document)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(where, "a readable glTF scene", f"'{error}'"[:160], DOWNLOAD) from None
    for name in document.extensionsRequired:
        if "draco" in name.lower() or "meshopt" in name.lower():
            raise InputError(
                where, "plain geometry", f"the compression {name}", "export it without compression"
            )
        if not name.startswith(HARMLESS):
            raise InputError(
                where,
                "geometry without further extensions",
                name,
                "export it without that extension",
            )
    for buffer in document.buffers:
        if buffer.uri is not None and not buffer.uri.startswith("data:"):
            raise InputError(
                where, "all data inside the file", "a buffer elsewhere", "export it as one .glb"
            )
    return document


def _triangle_count(document: Document, mesh: int, where: str | Path) -> int:
    """Return at most how many triangles a mesh has, or a quarter of its vertices if more."""
    total = 0
    for primitive in item(document.meshes, mesh, "meshes", where).primitives:
        if primitive.mode in (*POINTS, *LINES):
            continue
        vertices = _positions(document, primitive, where).count
        corners = (
            vertices
            if primitive.indices is None
            else item(document.accessors, primitive.indices, "accessors", where).count
        )
        total += max(corners // 3 if primitive.mode == TRIANGLES else corners, vertices // 4)
    return total


def _positions(document: Document, primitive: Primitive, where: str | Path) -> Accessor:
    """Return the accessor of a primitive's vertices."""
    if "KHR_draco_mesh_compression" in primitive.extensions:
        raise InputError(
            where,
            "plain geometry",
            "the compression KHR_draco_mesh_compression",
            "export it without compression",
        )
    if "POSITION" not in primitive.attributes:
        raise InputError(where, "vertices with a POSITION", "none", DOWNLOAD)
    accessor = item(document.accessors, primitive.attributes["POSITION"], "accessors", where)
    if accessor.type != "VEC3" or accessor.componentType == 5125:
        raise InputError(
            where,
            "positions of type VEC3",
            f"{accessor.type} of {accessor.componentType}",
            DOWNLOAD,
        )
    return accessor


class _Meshes:
    """The triangles of a document's meshes, and counts of what is ignored."""

    def __init__(
        self, document: Document, arrays: Arrays, ignored: Counter[str], where: str | Path
    ) -> None:
        self.document, self.arrays, self.ignored, self.where = document, arrays, ignored, where
        self.read: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}

    def parts(self, mesh: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return [(points (V, 3), triangles (F, 3))] of a mesh's primitives."""
        if mesh not in self.read:
            self.read[mesh] = [
                self._part(primitive)
                for primitive in item(self.document.meshes, mesh, "meshes", self.where).primitives
                if primitive.mode not in (*POINTS, *LINES)
            ]
        return self.read[mesh]

    def _part(self, primitive: Primitive) -> tuple[np.ndarray, np.ndarray]:
        positions = _positions(self.document, primitive, self.where)
        # an extension that is not required holds them
        if positions.bufferView is None and positions.sparse is None:
            raise InputError(
                self.where, "positions with data", "none", "export it without compression"
            )
        points = self.arrays.values(positions).astype(float)
        if primitive.indices is None:
            corners = np.arange(len(points))
        else:
            accessor = item(self.document.accessors, primitive.indices, "accessors", self.where)
            if accessor.type != "SCALAR" or accessor.componentType not in (5121, 5123, 5125):
                result = f"{accessor.type} of {accessor.componentType}"
                raise InputError(self.where, "indices as unsigned whole numbers", result, DOWNLOAD)
            corners = self.arrays.values(accessor).astype(np.int64).reshape(-1)
        if len(corners) and corners.max() >= len(points):
            raise InputError(
                self.where,
                f"faces among its {len(points)} vertices",
                f"vertex {corners.max() + 1}",
                DOWNLOAD,
            )
        self.ignored["morph targets"] += bool(primitive.targets)
        return points, self._faces(corners, primitive.mode)

    def _faces(self, corners: np.ndarray, mode: int) -> np.ndarray:
        """Return triangles (F, 3) of a list, a strip or a fan of corners."""
        if mode == TRIANGLES:
            if len(corners) % 3:
                raise InputError(
                    self.where,
                    "three corners for each triangle",
                    f"{len(corners)} corners",
                    DOWNLOAD,
                )
            return corners.reshape(-1, 3)
        if mode not in (STRIP, FAN):
            raise InputError(self.where, "triangles, strips or fans", f"mode {mode}", DOWNLOAD)
        if mode == FAN:
            return np.stack(
                [np.broadcast_to(corners[:1], len(corners[2:])), corners[1:-1], corners[2:]], axis=1
            )
        faces = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
        faces[1::2] = faces[1::2, [1, 0, 2]]
        return faces

    def notes(self) -> tuple[str, ...]:
        """Return notes on what was ignored."""
        meshes = [self.document.meshes[mesh] for mesh in self.read]
        plain = sum(
            primitive.mode in (*POINTS, *LINES) for mesh in meshes for primitive in mesh.primitives
        )
        notes = [f"{count} {IGNORED[name]}" for name, count in self.ignored.items() if count]
        return (*notes, *([f"{plain} primitives of points or lines left out"] if plain else []))
