"""Chairs: eight constructions (STYLES) with proportions drawn per seed.

Segments: 1 seat, back and cushions; 2 frame and legs. Sizes are those of real chairs, in metres:
seat 0.40–0.54 wide, 0.40–0.50 deep, 0.42–0.48 high (bar stools 0.65–0.80), back to 0.78–1.10.
"""

import numpy as np

from factory.shapes.assembly import Assembly
from factory.shapes.chair_easy import armchair
from factory.shapes.chair_modern import cantilever, office, shell_chair, stool
from factory.shapes.chair_wooden import bentwood, dining, windsor
from factory.shapes.mesh import Mesh

FAMILY_KEY = 2  # spawn key: the same seed gives another family other numbers


def build(seed: int) -> Mesh:
    """Return the chair of a seed, a Mesh of category "chair"."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(FAMILY_KEY,)))
    style = STYLES[int(rng.choice(len(STYLES), p=WEIGHTS))]
    a = Assembly()
    style(a, rng)
    return a.finish(f"chair:{seed}", "chair")


STYLES = (dining, windsor, shell_chair, office, bentwood, cantilever, armchair, stool)
WEIGHTS = np.array([0.24, 0.1, 0.15, 0.15, 0.09, 0.08, 0.11, 0.08])
