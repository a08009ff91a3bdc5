"""Reflectance maps for the page to edit in: as fine as needed, if there is room for them.

Each map is the coarsest whose error at the page's own pixels is small (reflectance_store.LIMIT). If
all of them together are too large, those are reduced first whose error then stays below TOLERABLE.
"""

import heapq
import zlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

from learn.data.devices import to_numpy
from learn.editing import reflectance_store
from learn.editing.chunks import Chunks, differences, split_bytes
from learn.figures import html, montage

TOLERABLE = 2.0  # grey levels, root mean square, by which a map may be off


class TriedMap(NamedTuple):
    """A reflectance map of a material, of one of the sides that were tried.

    side    intervals across the disk
    error   grey levels
    packed  the differences of its codes in the order of split_bytes, compressed
    """

    side: int
    error: float
    packed: bytes


def try_maps(label: np.ndarray, scene: reflectance_store.Scene) -> list[TriedMap]:
    """Return the maps of a label (108,), from coarse to fine, each with a smaller error."""
    result: list[TriedMap] = []
    for values, error in reflectance_store.maps_of(label, scene):
        codes = differences(reflectance_store.codes_of(values), 2).ravel()
        if not result or error < result[-1].error:
            result.append(TriedMap(len(values) - 5, error, zlib.compress(split_bytes(codes), 9)))
    return result


def reduce_maps(maps: Sequence[list[TriedMap]], bytes_left: int) -> None:
    """Remove the finest of some maps until all together have at most so many bytes.

    Those are removed first without which the error stays below TOLERABLE; among these, and then
    among the others, those without which the squared error grows least per byte.

    maps  each material's maps, from coarse to fine; the last will be stored
    """

    def loss(number: int) -> tuple[bool, float]:
        coarse, fine = maps[number][-2:]
        saved = max(len(fine.packed) - len(coarse.packed), 1)
        return coarse.error > TOLERABLE, (coarse.error**2 - fine.error**2) / saved

    total = sum(len(each[-1].packed) for each in maps)
    queue = [(loss(number), number) for number, each in enumerate(maps) if len(each) > 1]
    heapq.heapify(queue)
    while total > bytes_left and queue:
        _, number = heapq.heappop(queue)
        total -= len(maps[number].pop().packed) - len(maps[number][-1].packed)
        if len(maps[number]) > 1:
            heapq.heappush(queue, (loss(number), number))


def add_light_maps(maps: Sequence[list[TriedMap]], light: torch.Tensor, chunks: Chunks) -> dict:
    """Add the finest maps of all materials under a light (1, 3, Hl, Wl); return their header."""
    chosen = [each[-1] for each in maps]
    parts = [np.frombuffer(zlib.decompress(map_.packed), np.uint8) for map_ in chosen]
    low, high = zip(*(np.split(part, 2) for part in parts), strict=True)
    picture = montage.light_picture(to_numpy(light[0].movedim(0, -1)))
    return {
        "sides": [map_.side for map_ in chosen],
        "errors": [round(map_.error, 2) for map_ in chosen],
        "data": chunks.add(np.concatenate([*low, *high]).tobytes()),
        "picture": html.encode_picture(picture[:: len(picture) // 32, :: len(picture) // 32]),
    }
