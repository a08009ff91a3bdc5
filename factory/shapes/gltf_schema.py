"""The JSON of a glTF file, as far as it is read.

Source: Khronos, glTF 2.0 specification.
"""

from pathlib import Path
from typing import Annotated, Any, TypeVar

from msgspec import Meta, Struct, field

from manifests.errors import InputError

Count = Annotated[int, Meta(ge=0, le=2**53)]
Item = TypeVar("Item")
POINTS, LINES, TRIANGLES, STRIP, FAN = (0,), (1, 2, 3), 4, 5, 6
DOWNLOAD = "download or export it again"


class View(Struct):
    """A slice of a buffer."""

    buffer: Count
    byteLength: Count
    byteOffset: Count = 0
    byteStride: Count | None = None


class Buffer(Struct):
    """uri: None for the file's own binary chunk."""

    byteLength: Count
    uri: str | None = None


class Places(Struct):
    """The indices of a sparse accessor's values that are replaced."""

    bufferView: Count
    componentType: int
    byteOffset: Count = 0


class Values(Struct):
    """The values that replace them."""

    bufferView: Count
    byteOffset: Count = 0


class Sparse(Struct):
    """Replaced values of an accessor."""

    count: Count
    indices: Places
    values: Values


class Accessor(Struct):
    """An array: its offset and the type of its values."""

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
    """Primitives of one object."""

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
    """The root nodes of a scene."""

    nodes: list[Count] = field(default_factory=list)


class Document(Struct):
    """The JSON of a glTF file, as far as it is read."""

    scene: Count = 0
    scenes: list[Scene] = field(default_factory=list)
    nodes: list[Node] = field(default_factory=list)
    meshes: list[Mesh] = field(default_factory=list)
    accessors: list[Accessor] = field(default_factory=list)
    materials: list[Any] = field(default_factory=list)
    bufferViews: list[View] = field(default_factory=list)
    buffers: list[Buffer] = field(default_factory=list)
    extensionsRequired: list[str] = field(default_factory=list)


def item(items: list[Item], index: int, name: str, where: str | Path) -> Item:
    """Return an item of the document's list `name`. Raises InputError if there is none."""
    if index >= len(items):
        raise InputError(where, f"{name} below {len(items)}", str(index), DOWNLOAD)
    return items[index]
