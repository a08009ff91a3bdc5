"""Which array library a formula runs in: numpy, or torch when a tensor is among its arguments.

torch is used only if the caller has already loaded it, so that a process without torch never
imports it. Formulas keep to names that both have: exp, log, sqrt, sin, cos, arccos, arctan2, clip,
where, einsum, stack, cumsum.
"""

import sys

import numpy as np


def namespace(*arrays):
    """The module whose functions apply to the arrays: torch if one of them is a tensor, else
    numpy.
    """
    torch = sys.modules.get("torch")
    if torch is not None and any(isinstance(a, torch.Tensor) for a in arrays):
        return torch
    return np


def like(values, array):
    """`values` (anything numpy can read) as a constant of the same library, dtype and device as
    `array`.
    """
    if namespace(array) is np:
        dtype = array.dtype if isinstance(array, np.ndarray | np.floating) else np.float64
        return np.asarray(values, dtype=dtype)
    return namespace(array).as_tensor(np.asarray(values), dtype=array.dtype, device=array.device)
