"""The table of docs/shapes.md: time, triangles, distinctness. Run it: PYTHONPATH=. python
tests/factory/measure_shapes.py
"""

import time

import numpy as np

from factory.shapes.catalogue import FAMILIES, load, specs
from factory.shapes.raster import silhouette

SIDES = ((0.0, 0.1), (1.571, 0.1), (0.7, 0.35), (2.5, 0.35))  # azimuth and elevation, radians


def overlaps(meshes, size=48):
    """Intersection over union (N, N) of the meshes' silhouettes from four sides; 0 on the
    diagonal.
    """
    masks = np.array(
        [
            np.concatenate([silhouette(mesh, *side, size).ravel() for side in SIDES])
            for mesh in meshes
        ],
        float,
    )
    both, each = masks @ masks.T, masks.sum(1)
    iou = both / (each[:, None] + each - both)
    np.fill_diagonal(iou, 0)
    return iou


def row(family):
    """One line of the table."""
    meshes, seconds = [], []
    for spec in specs(family):
        start = time.process_time()
        meshes.append(load(spec))
        seconds.append(time.process_time() - start)
    iou, triangles = overlaps(meshes), [mesh.report.triangles for mesh in meshes]
    hashes, tight = (
        len({mesh.hash for mesh in meshes}),
        sum(mesh.report.watertight for mesh in meshes),
    )
    cells = [
        family,
        len(meshes),
        hashes,
        tight,
        f"{min(triangles):,} / {np.median(triangles):,.0f} / {max(triangles):,}",
    ]
    cells += [
        f"{np.mean(seconds):.2f} / {max(seconds):.2f}",
        f"{iou.max():.3f}",
        f"{np.median(iou.max(1)):.3f}",
    ]
    return "| " + " | ".join(map(str, cells)) + " |"


def main():
    heads = (
        "family",
        "seeds",
        "different hashes",
        "watertight",
        "triangles: least / median / most",
        "seconds: mean / most",
        "overlap of the two most similar",
        "overlap with the most similar, median",
    )
    print("| " + " | ".join(heads) + " |\n|" + "---|" * len(heads))
    for family in FAMILIES:
        print(row(family), flush=True)


if __name__ == "__main__":
    main()
