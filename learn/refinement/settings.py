"""Settings of refinement: what may move, how far, and how strongly the prediction holds it."""

from dataclasses import dataclass, replace

PROPERTIES = ("material", "light", "normals")


@dataclass(frozen=True)
class Level:
    """One level of the descent, which goes from coarse to fine.

    pixels      number of the object's pixels, evenly spread, at which the picture is compared; 0:
                all. A few hundred leave the normals between them undetermined, and edits are worse
    light       (height, width) of the light map in the sum, reduced from the refined one by solid
                angle
    method      of learn.layer.render
    rounds      number of rounds through the properties
    iterations  of L-BFGS for each property in each round
    tolerance   of the layer
    joint_iterations  of L-BFGS in all properties at once, after the rounds: one property at a time
                creeps along valleys between two of them
    """

    pixels: int
    light: tuple[int, int]
    method: str
    rounds: int
    iterations: int
    tolerance: float = 2e-2
    joint_iterations: int = 0


@dataclass(frozen=True)
class RefinementSettings:
    """Weights of learn.refinement.energy's terms, the properties that may move, and the levels.

    a, b, c     weights of normals, light and material; Eq. 6 has no c
    b_colour    weight of changes of the light's colour, beside that of all its changes
    unexplained_share_at_half_weight  a pixel's misfit counts half where this share of the pixel is
                neither its region's colour nor white; None: all pixels count alike
    order       of the properties in a round; a property that is not named stays where it starts
    degree      of the spherical harmonics by which the light's logarithm is changed
    trust_region  the most that a normal may move in one outer iteration, along either axis of the
                disk of learn.refinement.coordinates
    method      of the layer in the finest energy, which accepts or rejects a step: "auto" is the
                paper's sum over texels, "quadrature" the integral, which narrow lobes need
    tolerance   of the layer in that energy
    most_trials  evaluations in one line search, after which the step of the descent ends; None: as
                many as scipy allows, which then tries once more from the gradient
    outer_iterations  how often all levels are run, each time held to the result of the time before
    """

    a: float = 0.05
    b: float = 0.02
    b_colour: float = 0.0
    unexplained_share_at_half_weight: float | None = None
    c: float = 0.05
    order: tuple[str, ...] = PROPERTIES
    degree: int = 8
    trust_region: float = 0.3
    method: str = "auto"
    tolerance: float = 5e-3
    most_trials: int | None = None
    outer_iterations: int = 2
    levels: tuple[Level, ...] = (
        Level(pixels=0, light=(32, 64), method="auto", rounds=1, iterations=6, joint_iterations=30),
        Level(pixels=0, light=(64, 128), method="auto", rounds=0, iterations=0, joint_iterations=8),
    )

    def with_method(self, method: str) -> "RefinementSettings":
        """Return these settings with one method of the layer in all levels and the energy."""
        levels = tuple(replace(level, method=method) for level in self.levels)
        return replace(self, method=method, levels=levels)


PAPER = RefinementSettings(a=1.0, b=10.0, c=0.0, outer_iterations=1)
# Of users' photographs. On 8-bit pictures the second outer iteration doubles the time and gains
# nothing (docs/results/edit-cost). Objects have colours that no material of the catalogue has, and
# prints: unless the light is held to its colours it takes them on, and prints become relief
# (docs/results/painted-photographs). Where the layer changes its plan, the energy jumps by two per
# cent, and a line search may take smaller and smaller steps in vain
PHOTOGRAPHS = replace(
    RefinementSettings(),
    b_colour=0.2,
    unexplained_share_at_half_weight=0.1,
    most_trials=5,
    outer_iterations=1,
)
NAMED = {"default": RefinementSettings(), "paper": PAPER}
