"""The mesh of a general family's seed.

Each family is a function (Assembly, Generator) that adds named, closed surfaces. What comes out is
checked here, and a draw that fails (two sheets that touch, nothing left after a cut) is drawn again
from the next sub-seed.
"""

from collections.abc import Callable
from importlib import import_module

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.creases import edge_pairs
from factory.shapes.general import FAMILIES, TEST_ONLY
from factory.shapes.mesh import Mesh
from manifests.errors import InputError

ATTEMPTS = 20
FEWEST_TRIANGLES = 300
MOST_CROWDED = 0.002


def build(family: str, seed: int) -> Mesh:
    """Return the mesh of a general family's seed, its category the family's name.

    Raises InputError where none of ATTEMPTS draws gives a sound surface.
    """
    module, key = (FAMILIES | TEST_ONLY)[family]
    draw: Callable[[Assembly, np.random.Generator], None] = getattr(
        import_module(f"factory.shapes.general.{module}"), family
    )
    for attempt in range(ATTEMPTS):
        sequence = np.random.SeedSequence(seed, spawn_key=(key, attempt))
        assembly = Assembly()
        try:
            draw(assembly, np.random.default_rng(sequence))
        except ValueError:  # a field without a surface
            continue
        assembly.drop_unused_vertices()
        if is_sound(assembly):
            return assembly.finish(f"{family}:{seed}", family)
    raise InputError(
        f"{family}:{seed}", "a closed surface", f"none in {ATTEMPTS} attempts", "take another seed"
    )


def is_sound(assembly: Assembly) -> bool:
    """Whether the surfaces close, up to a few edges where two sheets touch within a cell.

    Every edge has two faces, or four where a surface net joins two sheets (at most MOST_CROWDED of
    all edges); all numbers are finite.
    """
    surface = assembly.surface()
    if len(surface.faces) < FEWEST_TRIANGLES or not np.isfinite(surface.vertices).all():
        return False
    counts = edge_pairs(surface.faces)[3]
    return bool((counts % 2 == 0).all() and (counts > 2).mean() <= MOST_CROWDED)
