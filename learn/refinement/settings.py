"""What refinement may do, and how hard it is held to the prediction."""

from dataclasses import dataclass

PROPERTIES = ("material", "light", "normals")


@dataclass(frozen=True)
class Level:
    """One step of coarse to fine.

    pixels      of the object, evenly spread, that the picture is compared at; 0: all
    light       (height, width) of the map that is summed, reduced from the refined one by solid angle
    method      of learn.layer.render
    rounds      through the properties
    iterations  of L-BFGS, each time for each property
    together    iterations of L-BFGS in all properties at once, after the rounds: one at a time creeps along valleys between two of them
    """

    pixels: int
    light: tuple
    method: str
    rounds: int
    iterations: int
    together: int = 0


@dataclass(frozen=True)
class Settings:
    """What holds the properties, weights of learn.refinement.energy's terms, and the way down.

    held        "near": by the distance from the prediction, Eq. 6; "likely": by the mistakes that were measured
    a, b, c     of normals, light and material; Eq. 6 has no c
    outlier     difference of compressed pictures from which on a pixel counts less and less; 0: squares throughout
    order       one property after another in each round; what is not named stays where it starts
    degree      of the spherical harmonics that the light's logarithm is changed by, where held near
    reach       the most that a normal may be moved, in the disk of learn.refinement.coordinates
    tolerance   of the layer in the finest energy, which decides what is kept
    """

    held: str = "near"
    a: float = 0.1
    b: float = 0.02
    c: float = 0.03
    outlier: float = 0.0
    order: tuple = PROPERTIES
    degree: int = 8
    reach: float = 0.3
    tolerance: float = 5e-3
    levels: tuple = (
        Level(pixels=600, light=(32, 64), method="exact", rounds=1, iterations=6, together=30),
        Level(pixels=1500, light=(64, 128), method="exact", rounds=0, iterations=0, together=8),
    )


PAPER = Settings(a=1.0, b=10.0, c=0.0)
LIKELY = Settings(
    held="likely",
    a=0.45,
    b=0.45,
    c=1.0,
    outlier=0.1,
    reach=0.5,
    levels=(
        Level(pixels=300, light=(16, 32), method="exact", rounds=0, iterations=0, together=80),
        Level(pixels=400, light=(32, 64), method="exact", rounds=0, iterations=0, together=40),
        Level(pixels=500, light=(64, 128), method="exact", rounds=0, iterations=0, together=20),
    ),
)
NAMED = {"default": Settings(), "paper": PAPER, "likely": LIKELY}
