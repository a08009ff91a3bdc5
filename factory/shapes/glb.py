"""Binary glTF: the triangles of its scene, each mesh as often as nodes show it; nothing outside of
the file is opened.

Source: Khronos, glTF 2.0 specification. Every offset, count and index is checked against what holds
it before memory is taken. Accessors may be strided, sparse, or quantised (KHR_mesh_quantization);
compressed ones are refused. Materials, normals, cameras, lights and animations are passed over, as
are deformations by skins and morph targets, with a note.

world_from_node (4, 4): a point p of the node's mesh lies at world_from_node @ (p, 1)
"""

import base64
import binascii
import struct
from collections import Counter
from pathlib import Path
from typing import Annotated, Any, BinaryIO

import msgspec
import numpy as np
from msgspec import Meta, Struct, field

from factory.shapes.raw import Raw, glimpse, require_count
from manifests.errors import InputError

Count = Annotated[int, Meta(ge=0, le=2**53)]
LARGEST_SCENE = 64 << 20  # bytes of JSON
TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
POINTS, LINES, TRIANGLES, STRIP, FAN = (0,), (1, 2, 3), 4, 5, 6
HARMLESS = (
    "KHR_mesh_quantization",
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "MSFT_texture_",
    "KHR_lights_",
    "EXT_lights_",
)
HARMLESS += ("KHR_xmp", "KHR_animation_", "KHR_techniques_")
DOWNLOAD = "download or export it again"


class View(Struct):
    """A piece of a buffer."""

    buffer: Count
    byteLength: Count
    byteOffset: Count = 0
    byteStride: Count | None = None


class Buffer(Struct):
    """uri: None for the file's own binary chunk."""

    byteLength: Count
    uri: str | None = None


class Places(Struct):
    """Which values of a sparse accessor are replaced."""

    bufferView: Count
    componentType: int
    byteOffset: Count = 0


class Values(Struct):
    """What they are replaced by."""

    bufferView: Count
    byteOffset: Count = 0


class Sparse(Struct):
    """Values that stand apart from the others."""

    count: Count
    indices: Places
    values: Values


class Accessor(Struct):
    """An array: where it begins, how its values are written."""

    componentType: int
    count: Count
    type: str
    bufferView: Count | None = None
    byteOffset: Count = 0
    normalized: bool = False
    sparse: Sparse | None = None


class Primitive(Struct):
    """Triangles of one material."""

    attributes: dict[str, Count]
    indices: Count | None = None
    mode: int = TRIANGLES
    targets: list[Any] = field(default_factory=list)
    extensions: dict[str, Any] = field(default_factory=dict)


class Mesh(Struct):
    """Primitives that are shown together."""

    primitives: list[Primitive]


class Node(Struct):
    """A place in the scene. matrix: by columns; rotation: a quaternion x, y, z, w."""

    children: list[Count] = field(default_factory=list)
    mesh: Count | None = None
    skin: Count | None = None
    matrix: list[float] | None = None
    translation: list[float] | None = None
    rotation: list[float] | None = None
    scale: list[float] | None = None
    extensions: dict[str, Any] = field(default_factory=dict)


class Scene(Struct):
    """The nodes that it begins with."""

    nodes: list[Count] = field(default_factory=list)


class Document(Struct):
    """The JSON of a glTF file, as far as it is read."""

    scene: Count = 0
    scenes: list[Scene] = field(default_factory=list)
    nodes: list[Node] = field(default_factory=list)
    meshes: list[Mesh] = field(default_factory=list)
    accessors: list[Accessor] = field(default_factory=list)
    bufferViews: list[View] = field(default_factory=list)
    buffers: list[Buffer] = field(default_factory=list)
    extensionsRequired: list[str] = field(default_factory=list)


def read(file: BinaryIO, size: int, where: str | Path, maximum: int) -> Raw:
    """The Raw of a GLB file. See factory.shapes.raw."""
    document, rest = _document(file, size, where)
    scene = _Scene(document, where)
    shown = scene.shown()
    require_count(sum(scene.triangles(mesh) for mesh, _ in shown), maximum, where, size)
    scene.load(rest)
    vertices, faces, start = [], [], 0
    for mesh, world_from_node in shown:
        for points, triangles in scene.parts(mesh):
            if np.linalg.det(world_from_node[:3, :3]) < 0:  # a mirror turns the sense of winding
                triangles = triangles[:, ::-1]
            vertices.append(_moved(points, world_from_node))
            faces.append(triangles + start)
            start += len(points)
    return Raw(np.concatenate(vertices), np.concatenate(faces), notes=scene.notes())


def _moved(points, world_from_node):
    if (world_from_node == np.eye(4)).all():
        return points
    with np.errstate(all="ignore"):  # what is not finite is refused later, by name
        return points @ world_from_node[:3, :3].T + world_from_node[:3, 3]


def _document(file, size, where):
    """The scene's JSON, and the bytes after it."""
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
    return document, file


class _Scene:
    """A document, its data, and what was passed over."""

    def __init__(self, document, where):
        self.document, self.where = document, where
        self.passed_over = Counter()
        self.buffers, self.meshes = [], {}

    def shown(self):
        """[(mesh, world_from_node)] of each node of the scene that shows a mesh. Raises InputError:
        a node reached twice.
        """
        document, shown, seen = self.document, [], set()
        waiting = [(node, np.eye(4)) for node in reversed(self._roots())]
        while waiting:
            index, world_from_parent = waiting.pop()
            node = self._item("nodes", index)
            if index in seen:  # in a circle, or twice as many on each level: a bomb
                raise InputError(
                    self.where,
                    "a tree of nodes",
                    f"a node with two parents, number {index}",
                    DOWNLOAD,
                )
            seen.add(index)
            with np.errstate(all="ignore"):
                world_from_node = world_from_parent @ self._parent_from(node)
            waiting += [(child, world_from_node) for child in reversed(node.children)]
            if node.mesh is not None:
                self._item("meshes", node.mesh)
                shown.append((node.mesh, world_from_node))
                self.passed_over["skins"] += node.skin is not None
                self.passed_over["instances"] += "EXT_mesh_gpu_instancing" in node.extensions
        if not document.nodes:  # a file of meshes alone
            shown = [(mesh, np.eye(4)) for mesh in range(len(document.meshes))]
        return shown

    def _roots(self):
        document = self.document
        if document.scenes:
            return self._item("scenes", document.scene).nodes
        children = {child for node in document.nodes for child in node.children}
        return [index for index in range(len(document.nodes)) if index not in children]

    def _parent_from(self, node):
        """parent_from_node (4, 4): its matrix, then translation, rotation and scale."""
        matrix = np.eye(4)
        for name, count in (("matrix", 16), ("translation", 3), ("rotation", 4), ("scale", 3)):
            value = getattr(node, name)
            if value is None:
                continue
            if len(value) != count:
                raise InputError(
                    self.where, f"{count} numbers in a node's {name}", str(len(value)), DOWNLOAD
                )
            step = np.eye(4)
            if name == "matrix":
                step = np.reshape(value, (4, 4)).T
            elif name == "translation":
                step[:3, 3] = value
            elif name == "scale":
                step[:3, :3] = np.diag(value)
            else:
                step[:3, :3] = _rotation(np.array(value, float))
            with np.errstate(all="ignore"):
                matrix = matrix @ step
        return matrix

    def triangles(self, mesh):
        """How many triangles a mesh has at most, or a quarter of its vertices if that is more."""
        total = 0
        for primitive in self._item("meshes", mesh).primitives:
            if primitive.mode in (*POINTS, *LINES):
                continue
            vertices = self._positions(primitive).count
            corners = (
                vertices
                if primitive.indices is None
                else self._item("accessors", primitive.indices).count
            )
            total += max(corners // 3 if primitive.mode == TRIANGLES else corners, vertices // 4)
        return total

    def _positions(self, primitive):
        """The accessor of a primitive's vertices."""
        if "KHR_draco_mesh_compression" in primitive.extensions:
            raise InputError(
                self.where,
                "plain geometry",
                "the compression KHR_draco_mesh_compression",
                "export it without compression",
            )
        if "POSITION" not in primitive.attributes:
            raise InputError(self.where, "vertices with a POSITION", "none", DOWNLOAD)
        accessor = self._item("accessors", primitive.attributes["POSITION"])
        if accessor.type != "VEC3" or accessor.componentType == 5125:
            raise InputError(
                self.where,
                "positions of type VEC3",
                f"{accessor.type} of {accessor.componentType}",
                DOWNLOAD,
            )
        return accessor

    def load(self, file):
        """Find the data of the buffers: the binary chunk, or what is written into the scene
        itself.
        """
        chunk = memoryview(b"")
        while len(head := file.read(8)) == 8:
            length, kind = struct.unpack("<I4s", head)
            data = file.read(length)
            if len(data) < length:
                raise InputError(
                    self.where, f"a chunk of {length:,} bytes", f"{len(data):,}", DOWNLOAD
                )
            if kind == b"BIN\0":
                chunk = memoryview(data)
                break
        for index, buffer in enumerate(self.document.buffers):
            data = chunk if buffer.uri is None and index == 0 else self._inside(buffer)
            if buffer.byteLength > len(data):
                raise InputError(
                    self.where,
                    f"a buffer of {buffer.byteLength:,} bytes",
                    f"{len(data):,}",
                    DOWNLOAD,
                )
            self.buffers.append(data[: buffer.byteLength])

    def _inside(self, buffer):
        """The bytes of a data: URI."""
        head, _, text = (buffer.uri or "").partition(",")
        if not head.endswith(";base64"):
            raise InputError(self.where, "a buffer in base64", "none", "export it as one .glb")
        try:
            return memoryview(base64.b64decode(text, validate=True))
        except binascii.Error:
            raise InputError(
                self.where, "a buffer in base64", "other characters", DOWNLOAD
            ) from None

    def parts(self, mesh):
        """[(points (V, 3), triangles (F, 3))] of a mesh's primitives."""
        if mesh not in self.meshes:
            self.meshes[mesh] = [
                self._part(primitive)
                for primitive in self._item("meshes", mesh).primitives
                if primitive.mode not in (*POINTS, *LINES)
            ]
        return self.meshes[mesh]

    def _part(self, primitive):
        positions = self._positions(primitive)
        # an extension that is not required holds them
        if positions.bufferView is None and positions.sparse is None:
            raise InputError(
                self.where, "positions with data", "none", "export it without compression"
            )
        points = self._array(positions).astype(float)
        if primitive.indices is None:
            corners = np.arange(len(points))
        else:
            accessor = self._item("accessors", primitive.indices)
            if accessor.type != "SCALAR" or accessor.componentType not in (5121, 5123, 5125):
                result = f"{accessor.type} of {accessor.componentType}"
                raise InputError(self.where, "indices as unsigned whole numbers", result, DOWNLOAD)
            corners = self._array(accessor).astype(np.int64).reshape(-1)
        if len(corners) and corners.max() >= len(points):
            raise InputError(
                self.where,
                f"faces among its {len(points)} vertices",
                f"vertex {corners.max() + 1}",
                DOWNLOAD,
            )
        self.passed_over["morph targets"] += bool(primitive.targets)
        return points, self._faces(corners, primitive.mode)

    def _faces(self, corners, mode):
        """Triangles (F, 3) of a list, a strip or a fan of corners."""
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

    def _array(self, accessor):
        """The values (count, width) of an accessor, those of a sparse one put in."""
        if accessor.componentType not in TYPES or accessor.type not in WIDTHS:
            raise InputError(
                self.where,
                "a known type of numbers",
                f"{accessor.type} of {accessor.componentType}",
                DOWNLOAD,
            )
        type_, width = np.dtype(TYPES[accessor.componentType]), WIDTHS[accessor.type]
        if accessor.bufferView is None:
            values = np.zeros((accessor.count, width), type_)
        else:
            values = self._view(
                accessor.bufferView, accessor.byteOffset, accessor.count, width, type_
            )
        if sparse := accessor.sparse:
            values = values.copy()
            kind = TYPES.get(sparse.indices.componentType, "")
            if kind not in ("u1", "<u2", "<u4"):
                raise InputError(
                    self.where,
                    "sparse indices as unsigned whole numbers",
                    str(sparse.indices.componentType),
                    DOWNLOAD,
                )
            places = self._view(
                sparse.indices.bufferView,
                sparse.indices.byteOffset,
                sparse.count,
                1,
                np.dtype(kind),
                False,
            )[:, 0]
            if len(places) and places.max() >= accessor.count:
                raise InputError(
                    self.where,
                    f"sparse indices below {accessor.count}",
                    str(places.max()),
                    DOWNLOAD,
                )
            values[places] = self._view(
                sparse.values.bufferView,
                sparse.values.byteOffset,
                sparse.count,
                width,
                type_,
                False,
            )
        if accessor.normalized and type_.kind in "iu":
            values = np.maximum(values / np.iinfo(type_).max, -1.0)
        return values

    def _view(self, index, offset, count, width, type_, strided=True):
        """(count, width) numbers at an offset of a buffer view. Raises InputError if they reach
        beyond it.
        """
        view = self._item("bufferViews", index)
        if view.buffer >= len(self.buffers):
            raise InputError(
                self.where, f"buffers below {len(self.buffers)}", str(view.buffer), DOWNLOAD
            )
        data = self.buffers[view.buffer]
        row = width * type_.itemsize
        step = view.byteStride if strided and view.byteStride is not None else row
        end = offset + (count - 1) * step + row if count else offset
        if step < row or end > view.byteLength or view.byteOffset + view.byteLength > len(data):
            expected = f"{count:,} × {row} bytes within a buffer view of {view.byteLength:,}"
            result = (
                f"a step of {step}"
                if step < row
                else f"an end at {max(end, view.byteOffset + view.byteLength):,}"
            )
            raise InputError(self.where, expected, result, DOWNLOAD)
        return np.ndarray(
            (count, width), type_, data, view.byteOffset + offset, (step, type_.itemsize)
        )

    def _item(self, name, index):
        """One of the document's lists' items. Raises InputError if there is none."""
        items = getattr(self.document, name)
        if index >= len(items):
            raise InputError(self.where, f"{name} below {len(items)}", str(index), DOWNLOAD)
        return items[index]

    def notes(self):
        """What was passed over, in words."""
        meshes = [self.document.meshes[mesh] for mesh in self.meshes]
        plain = sum(
            primitive.mode in (*POINTS, *LINES) for mesh in meshes for primitive in mesh.primitives
        )
        words = {
            "skins": "skins left as they are bound",
            "morph targets": "morph targets left out",
            "instances": "instanced copies left out",
        }
        notes = [f"{count} {words[what]}" for what, count in self.passed_over.items() if count]
        return (*notes, *([f"{plain} primitives of points or lines left out"] if plain else []))


def _rotation(q):
    """Rotation (3, 3) of a quaternion x, y, z, w of any length but 0; one of length 0 turns
    nothing.
    """
    length = np.linalg.norm(q)
    if not length > 0:
        return np.eye(3)
    x, y, z, w = q / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
