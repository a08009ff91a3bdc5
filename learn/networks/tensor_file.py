"""A .safetensors file written tensor by tensor, whole or not at all.

The library either writes to a path, where the error of a full disk may come too late, or first makes all bytes in memory.
The format: eight bytes that say how long the header is, little-endian; the header, JSON padded with spaces to a multiple
of eight; the tensors' bytes, as the header says where. Names and order are those of the library, and so are the bytes.
"""

import json
import os
from collections.abc import Mapping

import torch

from manifests.files import replacing

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
    path: str | os.PathLike,
    tensors: Mapping[str, torch.Tensor],
    metadata: Mapping[str, str],
) -> None:
    """Write tensors and text. One tensor at a time is copied, at most.

    Raises  OSError with the earlier file still there; ValueError for a type of numbers that the format lacks
    """
    for name, tensor in tensors.items():
        if tensor.dtype not in _TYPES:
            raise ValueError(f"{name}: a type of numbers of safetensors expected, found {tensor.dtype}")
    order = list(_TYPES)
    names = sorted(tensors, key=lambda name: (order.index(tensors[name].dtype), name))
    header, end = {"__metadata__": dict(sorted(metadata.items()))} if metadata else {}, 0
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
    """The numbers of a tensor, row by row, as a flat array of bytes."""
    return tensor.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy()
