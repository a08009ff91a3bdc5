"""What refinement may do, and how hard it is held to the prediction."""

from dataclasses import dataclass

PROPERTIES = ("material", "light", "normals")


@dataclass(frozen=True)
class Level:
    """One step of coarse to fine.

    pixels      of the object, evenly spread, that the picture is compared at; 0: all. Some hundreds
    leave normals between them to the
                grids' fancy: with 600 edits of eight development pictures are at 924, with all at
                741 (study.json)
    light       (height, width) of the map that is summed, reduced from the refined one by solid
    angle
    method      of learn.layer.render
    rounds      through the properties
    iterations  of L-BFGS, each time for each property
    tolerance   of the layer
    together    iterations of L-BFGS in all properties at once, after the rounds: one at a time
    creeps along valleys between two of them
    """

    pixels: int
    light: tuple
    method: str
    rounds: int
    iterations: int
    tolerance: float = 2e-2
    together: int = 0


@dataclass(frozen=True)
class Settings:
    """Weights of learn.refinement.energy's terms, what may move, and the way down.

    a, b, c     of normals, light and material; Eq. 6 has no c
    order       one property after another in each round; what is not named stays where it starts
    degree      of the spherical harmonics that the light's logarithm is changed by
    reach       the most that a normal may be moved in one pass, along either axis of the disk of
    learn.refinement.coordinates
    tolerance   of the layer in the finest energy, which decides what is kept
    passes      how often all levels are gone through, each time held to what was reached before
    """

    a: float = 0.05
    b: float = 0.02
    c: float = 0.05
    order: tuple = PROPERTIES
    degree: int = 8
    reach: float = 0.3
    tolerance: float = 5e-3
    passes: int = 3
    levels: tuple = (
        Level(pixels=0, light=(32, 64), method="auto", rounds=1, iterations=6, together=30),
        Level(pixels=0, light=(64, 128), method="auto", rounds=0, iterations=0, together=8),
    )


PAPER = Settings(a=1.0, b=10.0, c=0.0, passes=1)
NAMED = {"default": Settings(), "paper": PAPER}
