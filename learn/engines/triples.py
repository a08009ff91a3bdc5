"""What all kernels do with vectors of three components, and with rows of sums.

A Vector has sixteen lanes, a Triple is the same in all of them; functions of vectors take both. A
row is sixteen floats side by side, one for each lane (learn.engines.layout).
"""

import numpy as np

from learn.engines.compilation import inlined
from learn.engines.layout import LANES
from learn.engines.vector import Lanes, Vector, fma, lane_sum, load, splat, store

Triple = tuple[float, float, float]  # a vector that all lanes share


@inlined
def vector_at(vectors: np.ndarray, p: int) -> Triple:
    """The vector whose three floats begin at place p of an array (P, 3)."""
    return vectors[p], vectors[p + 1], vectors[p + 2]


@inlined
def dot(a: Vector, b: Vector) -> Lanes:
    """The scalar product a·b."""
    return fma(a[0], b[0], fma(a[1], b[1], a[2] * b[2]))


@inlined
def combined(p: Lanes, a: Vector, q: Lanes, b: Vector) -> Vector:
    """p a + q b."""
    return fma(p, a[0], q * b[0]), fma(p, a[1], q * b[1]), fma(p, a[2], q * b[2])


@inlined
def difference(a: Vector, b: Vector) -> Vector:
    """a − b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def scaled(a: Lanes, b: Vector) -> Vector:
    """a b."""
    return a * b[0], a * b[1], a * b[2]


@inlined
def product(a: Vector, b: Vector) -> Vector:
    """The products of the components of a and b."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@inlined
def add_to(pointer: np.ndarray, o: int, value: Lanes) -> None:
    """Add sixteen floats to those at offset o."""
    store(pointer, o, load(pointer, o) + value)


@inlined
def add_vector(pointer: np.ndarray, o: int, value: Vector) -> None:
    """Add three rows of sixteen floats to those from offset o on."""
    add_to(pointer, o, value[0])
    add_to(pointer, o + LANES, value[1])
    add_to(pointer, o + 2 * LANES, value[2])


@inlined
def clear(pointer: np.ndarray, o: int, count: int) -> None:
    """Write zeros into `count` rows from offset o on."""
    for i in range(count):
        store(pointer, o + LANES * i, splat(0.0))


@inlined
def write_sums(sums: np.ndarray, o: int, count: int, out: np.ndarray, to: int) -> None:
    """Write the sums over lanes of `count` rows."""
    for i in range(count):
        out[to + i] = lane_sum(load(sums, o + LANES * i))
