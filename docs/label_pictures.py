"""Draw the picture of docs/labels.md: what the 108 numbers of a material do to a sphere.

python docs/label_pictures.py docs/results/labels.jpg
"""

import sys
from pathlib import Path

import numpy as np

import brdfactory as bf
from learn.figures import montage
from learn.figures.spheres import material_sphere
from manifests import files
from shaders.frames import ELEVATION

TILE = 150
NOTHING = -14.0  # the logarithm of a κ that cannot be seen
LIGHT, EXPOSURE = "drei_studio_small_03", 0.8


def one_lobe(kappa: float, gamma: float) -> np.ndarray:
    """Return a grey label (3, 3, 2, 6) of one lobe that does not change with the angle."""
    label = np.full((3, 3, 2, 6), NOTHING, np.float32)
    label[:, 0, 0], label[:, :, 1] = np.log(kappa), np.log(gamma)
    return label


def rows() -> list[list[tuple[str, np.ndarray]]]:
    """Return the captions and labels of every row of spheres."""
    whole = np.asarray(bf.material("red-plastic").label).reshape(3, 3, 2, 6)
    lobes = []
    for lobe in range(3):
        label = whole.copy()
        others = [each for each in range(3) if each != lobe]
        label[:, others, 0] = NOTHING
        lobes.append((f"lobe {lobe + 1} alone", label))
    grazing = []
    for height in (0.1, 0.5, 1.0, 2.0):
        label = one_lobe(0.1, 20.0)
        label[:, 0, 0, 3:] = np.log(height)
        grazing.append((f"kappa 0.1, last three {height:g}", label))
    return [
        [*lobes, ("red-plastic: their sum", whole)],
        [(f"kappa {kappa:g}, gamma 1", one_lobe(kappa, 1.0)) for kappa in (0.02, 0.05, 0.1, 0.2)],
        [
            (f"kappa {kappa:g}, gamma {gamma:g}", one_lobe(kappa, gamma))
            for kappa, gamma in ((0.1, 1), (0.3, 10), (1.2, 100), (3.2, 1000))
        ],
        grazing,
    ]


def draw(path: Path) -> None:
    """Write the picture as JPEG."""
    light = bf.light(LIGHT)
    tiles = [
        [
            (caption, material_sphere(label.ravel(), light, TILE, float(ELEVATION), EXPOSURE))
            for caption, label in row
        ]
        for row in rows()
    ]
    files.write_image(path, montage.eight_bit(montage.contact_sheet(tiles, TILE)), "JPEG")


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
