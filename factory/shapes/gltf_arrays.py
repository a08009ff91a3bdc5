"""The arrays of a glTF file: buffers, buffer views and accessors.

Every offset, count and index is checked against its container before memory is taken. Accessors
may be strided, sparse, or quantised (KHR_mesh_quantization).
"""

import base64
import binascii
import struct
from pathlib import Path
from typing import BinaryIO

import numpy as np

from factory.shapes.gltf_schema import DOWNLOAD, Accessor, Buffer, Document, item
from manifests.errors import InputError

TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


class Arrays:
    """The data of a document's accessors, from an open file behind its JSON chunk."""

    def __init__(self, document: Document, file: BinaryIO, where: str | Path) -> None:
        self.document, self.where = document, where
        self.buffers: list[memoryview] = []
        self._load(file)

    def values(self, accessor: Accessor) -> np.ndarray:
        """Return the values (count, width) of an accessor, sparse replacements applied."""
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

    def _load(self, file: BinaryIO) -> None:
        """Find the data of the buffers: the binary chunk, or a data: URI."""
        chunk = memoryview(b"")
        while len(head := file.read(8)) == 8:
            length, kind = struct.unpack("<I4s", head)
            content = file.read(length)
            if len(content) < length:
                raise InputError(
                    self.where, f"a chunk of {length:,} bytes", f"{len(content):,}", DOWNLOAD
                )
            if kind == b"BIN\0":
                chunk = memoryview(content)
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

    def _inside(self, buffer: Buffer) -> memoryview:
        """Return the bytes of a data: URI."""
        head, _, text = (buffer.uri or "").partition(",")
        if not head.endswith(";base64"):
            raise InputError(self.where, "a buffer in base64", "none", "export it as one .glb")
        try:
            return memoryview(base64.b64decode(text, validate=True))
        except binascii.Error:
            raise InputError(
                self.where, "a buffer in base64", "other characters", DOWNLOAD
            ) from None

    def _view(
        self, index: int, offset: int, count: int, width: int, type_: np.dtype, strided: bool = True
    ) -> np.ndarray:
        """Return (count, width) numbers at an offset of a buffer view.

        Raises  InputError if they reach beyond it
        """
        view = item(self.document.bufferViews, index, "bufferViews", self.where)
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
