"""Checks of the types of arguments from Python, where the command line has texts alone.

Each function takes the argument's name for messages, and its value. It returns the value in the
type that its caller computes with, and raises InputError for a value of another type.
"""

import numbers
import operator
import os
from pathlib import Path
from typing import Any

import numpy as np

from manifests.errors import InputError

LONGEST = 60  # characters of a value that a message shows
ARRAY = "an array: numpy.asarray(picture) of a PIL image, tensor.numpy() of a tensor"


def shown(value: object) -> str:
    """Return what messages say of a value: a short text or number itself, the type of others."""
    if isinstance(value, str | bytes | bool | int | float | complex | None):
        text = repr(value)
        return text if len(text) <= LONGEST else f"{text[:LONGEST]}…"
    kind = type(value).__name__
    shape = getattr(value, "shape", None)
    return kind if shape is None else f"{kind} of shape {tuple(shape)}"


def require_number(name: str, value: Any, rule: str, remedy: str) -> float:
    """Return a number, of Python, of numpy or the only one of an array, as a float."""
    if not isinstance(value, numbers.Real) and getattr(value, "shape", None) in ((), (1,)):
        value = value.item()
    if not isinstance(value, numbers.Real) or isinstance(value, bool):
        raise InputError(name, rule, shown(value), remedy)
    try:
        return float(value)
    except OverflowError:  # a whole number beyond a float's range
        raise InputError(name, rule, shown(value), remedy) from None


def require_whole(name: str, value: Any, rule: str, remedy: str) -> int:
    """Return a whole number, of Python or of numpy."""
    try:
        if not isinstance(value, bool):
            return operator.index(value)
    except TypeError:
        pass
    raise InputError(name, rule, shown(value), remedy)


def require_flag(name: str, value: Any) -> bool:
    """Return True or False; "no" and 0 are neither."""
    if not isinstance(value, bool | np.bool_):
        raise InputError(name, "True or False", shown(value), "give one of them, without quotes")
    return bool(value)


def require_path(name: str, value: Any, rule: str, remedy: str) -> str:
    """Return a file's or a folder's path as text; an empty one is refused."""
    text = os.fspath(value) if isinstance(value, os.PathLike) else value
    if not isinstance(text, str) or not text or "\0" in text:
        raise InputError(name, rule, shown(value), remedy)
    return text


def require_picture(name: str, value: Any) -> str | np.ndarray:
    """Return an array, or a file's path as text."""
    if isinstance(value, np.ndarray):
        return value
    return require_path(name, value, "a file or an array", f"give a path, or {ARRAY}")


def require_floats(name: str, value: Any, rule: str, remedy: str) -> np.ndarray:
    """Return an array of real numbers as contiguous float32; lists and tensors are converted."""
    if isinstance(value, str | bytes | Path | None):
        raise InputError(name, rule, shown(value), remedy)
    try:
        values = np.asarray(value)
        if values.dtype.kind not in "biufO":
            raise TypeError
        # torch reads no array that runs backwards, as a mirrored one does
        return np.ascontiguousarray(values, np.float32)
    except (TypeError, ValueError, RuntimeError):  # RuntimeError: a tensor that needs gradients
        raise InputError(name, rule, shown(value), remedy) from None
