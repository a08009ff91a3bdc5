"""A .safetensors file, written whole or not at all, whose header is checked before memory is taken.

The format: eight bytes that give the length of the header, little-endian; the header, JSON padded
with spaces to a multiple of eight, which names each tensor's type, shape and place; the tensors'
bytes. Nothing is ever unpickled.

Reading   The reader's expectations are compared with the header first; then the tensors are read,
          and numbers that are not finite are refused.
Writing   Tensor by tensor: the library either writes to a path, where the error of a full disk may
          come too late, or makes all bytes in memory first. Names, order and bytes are those of the
          library.
"""

import json
import os
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open

from manifests.errors import InputError, closest
from manifests.files import replacing
from manifests.inputs import require_file

EXPECTED = "weights in a .safetensors file"
AGAIN = "copy the file again, or make it again"
REMEDY = "check the path, or train some: python -m learn train RUN.json"
LARGEST_FILE = 4 << 30  # bytes: ten times the largest checkpoint of this package's networks
LARGEST_HEADER = 8 << 20  # bytes: 300 tensors take 30 KiB, and a run's settings a few
NUMBERS = ("F16", "BF16", "F32", "F64", "I64")


class Stored:
    """The open file: its metadata, and its tensors by name.

    path      of the file, for messages
    metadata  {key: text}
    shapes    {name: shape} of all tensors
    kinds     {name: type as the format names it, "F32"}
    """

    def __init__(self, path: Path, file: Any):
        self.path, self._file = path, file
        self.metadata: dict[str, str] = file.metadata() or {}
        slices = {name: file.get_slice(name) for name in file.keys()}  # noqa: SIM118 -- not a dict
        self.shapes = {name: tuple(each.get_shape()) for name, each in slices.items()}
        self.kinds = {name: each.get_dtype() for name, each in slices.items()}

    def require(self, shapes: Mapping[str, tuple], whose: str, alone: bool = True) -> None:
        """Raise InputError unless the file holds tensors of these names and shapes.

        shapes  {name: shape}
        whose   the owner of such tensors, with its article: "this compact network"
        alone   whether tensors of other names are refused
        """
        remedy = f"these tensors are not of {whose}"
        for name, shape in shapes.items():
            if self.shapes.get(name) != tuple(shape):
                result = str(self.shapes[name]) if name in self.shapes else "none"
                raise InputError(
                    f"{self.path}: {name}", f"a tensor of shape {tuple(shape)}", result, remedy
                )
            if self.kinds[name] not in NUMBERS:
                raise InputError(
                    f"{self.path}: {name}",
                    f"numbers as {', '.join(NUMBERS)}",
                    self.kinds[name],
                    remedy,
                )
        for name in sorted(self.shapes.keys() - shapes.keys()) if alone else ():
            raise InputError(
                f"{self.path}: {name}",
                f"only tensors of {whose}",
                "this one",
                closest(name, shapes),
            )

    def tensor(self, name: str) -> torch.Tensor:
        """Return the tensor of that name. Raises InputError if it holds NaN or infinity."""
        try:
            values = self._file.get_tensor(name)
        except SafetensorError as error:
            raise InputError(f"{self.path}: {name}", "a whole tensor", str(error), AGAIN) from None
        if not values.isfinite().all():
            raise InputError(f"{self.path}: {name}", "finite numbers", "NaN or infinity", AGAIN)
        return values


@contextmanager
def open_tensor_file(
    path: str | Path,
    expected: str = EXPECTED,
    remedy: str = REMEDY,
    maximum_bytes: int = LARGEST_FILE,
) -> Iterator[Stored]:
    """Open a file as Stored, for as long as the block lasts.

    expected  the kind of file, with its article, for messages
    remedy    of a file that is missing or of another kind
    Raises    InputError: no ordinary file, too large, damaged, of another format
    """
    require_file(path, expected, remedy, maximum_bytes)
    other = "tensors in other formats are never read; make the file again, or convert it"
    try:
        with open(path, "rb") as file:
            length = file.read(8)
        if len(length) == 8 and struct.unpack("<Q", length)[0] > LARGEST_HEADER:
            raise InputError(
                path, expected, f"no header of at most {LARGEST_HEADER >> 20} MiB", other
            )
        stored = safe_open(path, "pt")
    except SafetensorError as error:
        raise InputError(path, expected, str(error), other) from None
    except OSError as error:
        raise InputError(path, expected, str(error.strerror or error), remedy) from None
    with stored as file:
        yield Stored(Path(path), file)


_TYPES = {  # in the library's order of tensors, names within a type by the alphabet
    torch.int64: "I64",
    torch.float64: "F64",
    torch.float32: "F32",
    torch.int32: "I32",
    torch.bfloat16: "BF16",
    torch.float16: "F16",
    torch.int16: "I16",
    torch.int8: "I8",
    torch.uint8: "U8",
    torch.bool: "BOOL",
}


def write(
    path: str | os.PathLike, tensors: Mapping[str, torch.Tensor], metadata: Mapping[str, str]
) -> None:
    """Write tensors and text. One tensor at a time is copied, at most.

    Raises  OSError with the earlier file still there; ValueError for a type of numbers that the
    format lacks
    """
    for name, tensor in tensors.items():
        if tensor.dtype not in _TYPES:
            raise ValueError(
                f"{name}: expected a type of numbers of safetensors, found {tensor.dtype}"
            )
    order = list(_TYPES)
    names = sorted(tensors, key=lambda name: (order.index(tensors[name].dtype), name))
    header: dict[str, dict[str, Any]] = {}
    if metadata:
        header["__metadata__"] = dict(sorted(metadata.items()))
    end = 0
    for name in names:
        tensor = tensors[name]
        begin, end = end, end + tensor.numel() * tensor.element_size()
        header[name] = {
            "dtype": _TYPES[tensor.dtype],
            "shape": list(tensor.shape),
            "data_offsets": [begin, end],
        }
    text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    with replacing(path) as file:
        file.write(len(text).to_bytes(8, "little"))
        file.write(text)
        for name in names:
            if tensors[name].numel():
                file.write(_bytes(tensors[name]))


def _bytes(tensor):
    """Return the numbers of a tensor, row by row, as a flat array of bytes."""
    return tensor.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy()
