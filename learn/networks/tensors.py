"""Tensors of a .safetensors file, judged by its header before memory is taken for any of them.

The header names each tensor's type and shape. What a reader expects is compared with it first, then the tensors that
are wanted are read, and values that are not finite are refused. Nothing is ever unpickled.
"""

import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open

from manifests.inputs import require_file
from manifests.problems import Problem, closest

EXPECTED = "weights in a .safetensors file"
AGAIN = "copy the file again, or make it again"
REMEDY = "train some: python -m learn train RUN.json"
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

    def __init__(self, path: Path, file):
        self.path, self._file = path, file
        self.metadata: dict[str, str] = file.metadata() or {}
        slices = {name: file.get_slice(name) for name in file.keys()}  # noqa: SIM118 -- not a dict
        self.shapes = {name: tuple(each.get_shape()) for name, each in slices.items()}
        self.kinds = {name: each.get_dtype() for name, each in slices.items()}

    def require(self, shapes: Mapping[str, tuple], whose: str, alone: bool = True) -> None:
        """Raises Problem unless the file holds tensors of these names and shapes.

        shapes  {name: shape}
        whose   what has such tensors, with its article: "this compact network"
        alone   whether tensors of other names are refused
        """
        remedy = f"these tensors are not of {whose}"
        for name, shape in shapes.items():
            if self.shapes.get(name) != tuple(shape):
                found = str(self.shapes[name]) if name in self.shapes else "none"
                raise Problem(f"{self.path}: {name}", f"a tensor of shape {tuple(shape)}", found, remedy)
            if self.kinds[name] not in NUMBERS:
                raise Problem(f"{self.path}: {name}", f"numbers as {', '.join(NUMBERS)}", self.kinds[name], remedy)
        for name in sorted(self.shapes.keys() - shapes.keys()) if alone else ():
            raise Problem(f"{self.path}: {name}", f"only tensors of {whose}", "this one", closest(name, shapes))

    def tensor(self, name: str) -> torch.Tensor:
        """The tensor of that name. Raises Problem if it holds NaN or infinity."""
        try:
            values = self._file.get_tensor(name)
        except SafetensorError as error:
            raise Problem(f"{self.path}: {name}", "a whole tensor", str(error), AGAIN) from None
        if not values.isfinite().all():
            raise Problem(f"{self.path}: {name}", "finite numbers", "NaN or infinity", AGAIN)
        return values


@contextmanager
def opened(
    path: str | Path,
    expected: str = EXPECTED,
    remedy: str = REMEDY,
    maximum_bytes: int = LARGEST_FILE,
) -> Iterator[Stored]:
    """The Stored of a file, as long as the block lasts.

    expected  what the file should be, with its article, for messages
    remedy    what to do where nothing of this kind lies there
    Raises    Problem: no ordinary file, too large, damaged, of another format
    """
    require_file(path, expected, remedy, maximum_bytes)
    other = "tensors in other formats are never read; make the file again, or convert it"
    try:
        with open(path, "rb") as file:
            length = file.read(8)
        if len(length) == 8 and struct.unpack("<Q", length)[0] > LARGEST_HEADER:
            raise Problem(path, expected, f"no header of at most {LARGEST_HEADER >> 20} MiB", other)
        stored = safe_open(path, "pt")
    except SafetensorError as error:
        raise Problem(path, expected, str(error), other) from None
    except OSError as error:
        raise Problem(path, expected, str(error.strerror or error), remedy) from None
    with stored as file:
        yield Stored(Path(path), file)


def read(path: str | Path, expected: str = EXPECTED, remedy: str = REMEDY):
    """({name: tensor}, metadata) of a whole file, for formats without fixed names. Raises as `opened`."""
    with opened(path, expected, remedy) as stored:
        return {name: stored.tensor(name) for name in stored.shapes}, stored.metadata
