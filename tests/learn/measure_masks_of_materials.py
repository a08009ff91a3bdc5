"""Measure how a mask's edge changes the material that is read from a photograph.

The photographs are those of docs/results/photographs, unpacked below ROOT by
tests/learn/measure_photographs.py. The material is read, as `transfer` and `--material PICTURE`
read it, with the mask made by hand, and with the same mask made inaccurate, each as it is and with
its edge fitted. Differences are those of a sphere of the material from that of the mask made by
hand, as it is: squared differences of display values, averaged over the sphere.

PYTHONPATH=. python tests/learn/measure_masks_of_materials.py ROOT OUT

writes OUT/spheres.png, with a row for each photograph, and OUT/report.json; prints a table.
"""

import argparse
from pathlib import Path

import numpy as np

from learn.commands.options import EDITING_WEIGHTS
from learn.data import photographs
from learn.editing import decomposition, drawing, photograph
from learn.experiments.photographs.damaged_masks import DAMAGES, HARD
from learn.figures import montage, spheres
from learn.networks import weights
from learn.refinement import PHOTOGRAPHS
from manifests import files
from shaders import tone
from tests.learn.measure_photographs import sources

MASKS = (HARD, "2 pixels too narrow", "2 pixels too wide", "3 pixels too wide")
FIT = {"as given": False, "fitted": None}
TILE = 120


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("root", type=Path)
    parser.add_argument("out", type=Path)
    arguments = parser.parse_args()
    network, metadata = weights.load_full_network(EDITING_WEIGHTS, "cpu")
    inside = (spheres.sphere_normals(drawing.SPHERE) != 0).any(-1)
    report: dict[str, dict[str, float]] = {}
    rows = []
    for name, (path, mask, _) in sources(arguments.root).items():
        _, exact, _ = photographs.read_with_coverage(path, mask)
        shown, differences = {}, {}
        for damage in MASKS:
            for choice, fit_mask in FIT.items():
                opened = photograph.from_arrays(path, DAMAGES[damage](exact), fit_mask=fit_mask)
                read = decomposition.decompose(opened, network, metadata["size"], PHOTOGRAPHS)
                sphere = drawing.material_sphere(read.label[0], read)
                shown[f"{damage}, {choice}"] = np.asarray(sphere, np.float64)
        object_ = drawing.crop_to_object(tone.display(opened.radiance, 1.0), read)
        right = shown[f"{HARD}, as given"]
        for key, sphere in shown.items():
            differences[key] = float(((sphere - right) ** 2)[inside].mean())
        report[name] = differences
        print(name, {key: round(value, 1) for key, value in differences.items()}, flush=True)
        rows.append([(name, object_), *shown.items()])
    arguments.out.mkdir(parents=True, exist_ok=True)
    files.write_image(arguments.out / "spheres.png", montage.contact_sheet(rows, TILE), "PNG")
    files.write_json(arguments.out / "report.json", report)
    for damage in MASKS:
        cells = []
        for choice in FIT:
            values = np.array([each[f"{damage}, {choice}"] for each in report.values()])
            cells.append(f"{values.mean():.1f} | {np.median(values):.1f} | {values.max():.1f}")
        print(f"| {damage} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
