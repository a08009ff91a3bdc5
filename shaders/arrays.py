"""Selection of the array library in which a formula runs: numpy, or torch for tensors.

torch is used only if the caller has already loaded it, so that a process without torch never
imports it. Formulas keep to names that both libraries have: exp, log, sqrt, sin, cos, arccos,
arctan2, clip, where, einsum, stack, cumsum.
"""

import sys
from typing import Any, TypeAlias

import numpy as np

# numpy.ndarray or torch.Tensor; torch itself may not be imported here, so that its type is open
Array: TypeAlias = Any


def namespace(*arrays: object) -> Any:
    """Return the library whose functions apply: torch if one array is a tensor, else numpy."""
    torch = sys.modules.get("torch")
    if torch is not None and any(isinstance(a, torch.Tensor) for a in arrays):
        return torch
    return np


def like(values: Any, array: Array) -> Array:
    """Return `values` as a constant of the same library, dtype and device as `array`.

    values  anything that numpy can read, or a tensor, which may be on another device
    """
    torch = sys.modules.get("torch")
    if torch is not None and isinstance(values, torch.Tensor):
        return values.to(array)
    if namespace(array) is np:
        dtype = array.dtype if isinstance(array, np.ndarray | np.floating) else np.float64
        return np.asarray(values, dtype=dtype)
    return namespace(array).as_tensor(np.asarray(values), dtype=array.dtype, device=array.device)
