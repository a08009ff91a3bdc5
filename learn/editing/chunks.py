"""Stores arrays of whole numbers as compressed chunks of one block of data, for a script to read.

Each chunk is compressed by zlib. Neighbours differ little, so arrays are stored as differences
modulo 2^8 or 2^16; those of 16 bits as all low bytes and then all high ones.
"""

import zlib

import numpy as np


class Chunks:
    """Compressed data, one after the other."""

    def __init__(self) -> None:
        self.data = bytearray()

    def add(self, data: bytes) -> tuple[int, int]:
        """Append data, and return where they begin and how many bytes they take."""
        packed = zlib.compress(data, 9)
        self.data += packed
        return len(self.data) - len(packed), len(packed)


def differences(values: np.ndarray, axes: int) -> np.ndarray:
    """Return an array (H, W, C) of whole numbers as differences between neighbours.

    axes  1: along columns; 2: along rows as well. Differences are modulo the type's range
    """
    result = np.diff(values, axis=1, prepend=values.dtype.type(0))
    if axes == 2:
        result = np.diff(result, axis=0, prepend=values.dtype.type(0))
    return result


def split_bytes(values: np.ndarray) -> bytes:
    """Return uint16 differences in zigzag coding: all low bytes, then all high ones.

    The sign is the lowest bit, so that small differences of either sign have a high byte of 0.
    """
    signed = values.astype(np.uint16).view(np.int16).astype(np.int32)
    zigzag = ((signed << 1) ^ (signed >> 15)).astype(np.uint16)
    return (zigzag & 255).astype(np.uint8).tobytes() + (zigzag >> 8).astype(np.uint8).tobytes()
