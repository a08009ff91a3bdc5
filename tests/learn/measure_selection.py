"""Measure how well clicks, strokes and lines of a simulated user select known objects.

The user always marks the largest error: clicks on the point of it that is deepest inside, or
strokes along its long axis; or draws a line around the object, a tenth of its size away from it; or
gives a rectangle around it, or a polygon of ten corners at most around its convex hull, both a
fiftieth of its longer side away from it, as `brdfactory mask --around` takes them.
After each mark the intersection over union with the known mask is taken.

Pictures are of these groups:

photographs       those of docs/results/photographs, by other people, with the repository's masks;
                  the packages that hold them are unpacked below ROOT, which measure_photographs.py
                  --download does
look-alike walls  objects that `brdfactory render` rendered, put before a wall of the object's own
                  mean colour, with noise, a gradient of light, a floor and a soft shadow
other walls       the same before a wall of another colour
rooms             objects that factory.render.validation.objects_in_rooms rendered, in the first of
                  their materials, as learn.experiments room-photographs takes photographs of them,
                  enlarged and with grain; --rooms DIR, which may be repeated

Every second photograph, in order of their names, was looked at while the settings were chosen; they
are marked, and the others are summed up apart.

PYTHONPATH=. python tests/learn/measure_selection.py ROOT DATASET OUT [--rooms DIR] [--before FILE]

DATASET is what this rendered:

brdfactory render docs/jobs/selection.json --out DATASET

FILE is the report.json of an earlier version of the program, to be shown beside this one.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import distance_transform_edt, gaussian_filter, label
from scipy.spatial import ConvexHull
from skimage.draw import polygon2mask
from skimage.measure import approximate_polygon

from learn.data.records import Records
from learn.experiments.photographs import room_cases
from learn.selection.marks import Selection
from learn.selection.superpixels import BACKGROUND
from manifests import files
from manifests.provenance import provenance
from manifests.reading import read
from shaders import tone
from tests.learn.measure_photographs import sources

LONGEST = 480  # pixels of a picture's longer side, to which it is reduced
THICKEST = 16  # pixels: radius of the brush at most
LOOSE = 0.1  # of the object's size: how far from it the line is drawn
PLANS = {
    "one click": "c",
    "one click and two strokes": "css",
    "five clicks": "ccccc",
    "a line": "l",
    "a line and two strokes": "lss",
    "a rectangle": "r",
    "a rectangle and two points": "rcc",
    "a polygon": "p",
    "a polygon and two points": "pcc",
}
CLOSE = 0.02  # of the object's longer side: how far from it the rectangle and the polygon are
MOST_CORNERS = 10  # of the polygon
ROUNDS = 2000  # of the bootstrap


def deepest(wrong: np.ndarray) -> tuple[np.ndarray, int, int]:
    """Return how deep pixels (H, W) bool are inside (H, W), and the deepest one."""
    depth = distance_transform_edt(np.pad(wrong, 1))[1:-1, 1:-1]
    row, column = np.unravel_index(int(depth.argmax()), depth.shape)
    return depth, int(row), int(column)


def stroke_along(wrong: np.ndarray) -> tuple[np.ndarray, int, int]:
    """Return strokes (H, W) bool along the largest error, and a pixel of them."""
    depth, row, column = deepest(wrong)
    parts, _ = label(wrong)
    at = np.stack(np.nonzero(parts == parts[row, column])).astype(float)
    _, axes = np.linalg.eigh(np.cov(at) if at.shape[1] > 1 else np.eye(2))
    step, least = axes[:, -1], max(2.0, 0.4 * depth[row, column])
    free = np.ones(wrong.shape, bool)
    free[row, column] = False
    for sign in (1, -1):
        for far in range(1, 200):
            y, x = round(row + sign * far * step[0]), round(column + sign * far * step[1])
            if not (0 <= y < len(wrong) and 0 <= x < wrong.shape[1]) or depth[y, x] < least:
                break
            free[y, x] = False
    radius = np.clip(0.4 * depth[row, column], 1, THICKEST)
    return distance_transform_edt(free) <= radius, row, column


def line_around(truth: np.ndarray) -> np.ndarray:
    """Return a line (H, W) bool that is drawn loosely around an object (H, W) bool."""
    size = np.sqrt(truth.sum())
    near = (distance_transform_edt(~truth) <= LOOSE * size).astype(float)
    inside = gaussian_filter(near, LOOSE / 2 * size) > 0.5
    return inside & (distance_transform_edt(np.pad(inside, 1))[1:-1, 1:-1] <= 3)


def rectangle_around(truth: np.ndarray) -> np.ndarray:
    """Return pixels (H, W) bool of a rectangle close around an object (H, W) bool."""
    rows, columns = np.nonzero(truth)
    gap = round(CLOSE * max(np.ptp(rows), np.ptp(columns)))
    inside = np.zeros_like(truth)
    inside[
        max(rows.min() - gap, 0) : rows.max() + gap + 1,
        max(columns.min() - gap, 0) : columns.max() + gap + 1,
    ] = True
    return inside


def polygon_around(truth: np.ndarray) -> np.ndarray:
    """Return pixels (H, W) bool of a polygon of few corners close around the convex hull of an
    object (H, W) bool.
    """
    rows, columns = np.nonzero(truth)
    gap = CLOSE * max(np.ptp(rows), np.ptp(columns))
    near = np.argwhere(distance_transform_edt(~truth) <= gap)
    corners = near[ConvexHull(near).vertices].astype(float)
    tolerance = 1.0
    while len(corners) > MOST_CORNERS:
        whole = np.concatenate([corners, corners[:1]])
        corners = approximate_polygon(whole, tolerance)[:-1]
        tolerance *= 1.3
    return polygon2mask(truth.shape, corners)


def overlap(one: np.ndarray, other: np.ndarray) -> float:
    """Return the intersection over union of two masks (H, W) bool."""
    return float((one & other).sum() / max(1, (one | other).sum()))


def after(selection: Selection, truth: np.ndarray, plan: str) -> float:
    """Return the intersection over union after the marks of a plan."""
    labels = np.zeros(truth.shape, bool)
    for mark in plan:
        wrong = labels != truth
        if not wrong.any():
            break
        if mark == "c":
            _, row, column = deepest(wrong)
            selection.click(column, row, int(truth[row, column]))
        elif mark == "s":
            covered, row, column = stroke_along(wrong)
            selection.paint(covered, int(truth[row, column]))
        elif mark in "rp":
            around = rectangle_around if mark == "r" else polygon_around
            selection.enclose_pixels(around(truth), 1, "the line", "")
        else:
            selection.enclose(line_around(truth), 1)
        labels = selection.labels() > BACKGROUND
    selection.clear()
    return overlap(labels, truth)


def reduced(display: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a picture (H, W, 3) uint8 and a mask (H, W) bool of LONGEST pixels at most."""
    scale = min(1.0, LONGEST / max(truth.shape))
    size = round(scale * truth.shape[1]), round(scale * truth.shape[0])
    both = (display, np.uint8(255) * truth)
    small, mask = (
        np.asarray(Image.fromarray(each).resize(size, Image.Resampling.BOX)) for each in both
    )
    return small, mask >= 128


def photographs_of(root: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return {name: (picture, mask)} of the photographs, each object once."""
    result = {}
    for name, (path, mask, _) in sorted(sources(root).items()):
        if " as " in name:  # the same object with its shape named
            continue
        with Image.open(path) as picture, Image.open(mask) as known:
            display, truth = np.asarray(picture.convert("RGB")), np.asarray(known.convert("L"))
        result[name] = reduced(display, truth >= 128)
    return result


def before_walls(dataset: Path) -> dict[str, dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Return {group: {name: (picture, mask)}} of rendered objects before walls."""
    result: dict[str, dict] = {"look-alike walls": {}, "other walls": {}}
    records = Records(dataset)
    for number in range(len(records)):
        sample, record = records[number], records.records[number]
        radiance = sample.image.numpy().astype(np.float64)
        mask = sample.mask.numpy()
        name = f"{record.shape.replace(':', ' ')}, {record.materials[0]}"
        own = radiance[mask].mean(0)
        exposure = 0.45 / own.mean()
        for group, colour in (("look-alike walls", own), ("other walls", own[[1, 2, 0]] * 0.5)):
            if group == "other walls":
                colour = colour * np.array([0.5, 0.8, 1.4])
            linear = wall(mask, colour, np.random.default_rng(number))
            linear[mask] = radiance[mask]
            grain = np.random.default_rng(number).normal(0, 3, linear.shape)
            display = tone.display(gaussian_filter(linear, (0.6, 0.6, 0)), exposure) + grain
            result[group][name] = np.clip(display, 0, 255).astype(np.uint8), mask
    return result


def in_rooms(folder: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return {name: (picture, mask)} of objects that were rendered in rooms."""
    result = {}
    for path in sorted(folder.glob("[0-9]*/scene.json")):
        scene = read(path, room_cases.RoomScene)
        case = room_cases.Case(path.parent, scene, scene.materials[0])
        taken = room_cases.photograph_of(case)
        size = LONGEST, LONGEST
        large = Image.fromarray(taken.pixels).resize(size, Image.Resampling.BICUBIC)
        mask = Image.fromarray(taken.mask).resize(size, Image.Resampling.NEAREST)
        grain = np.random.default_rng(len(result)).normal(0, 3, (LONGEST, LONGEST, 3))
        name = f"{path.parent.name} {Path(scene.shape).stem}, {case.source}"
        result[name] = np.clip(large + grain, 0, 255).astype(np.uint8), np.asarray(mask)
    return result


def wall(mask: np.ndarray, colour: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return linear radiance (H, W, 3) of a wall and a floor behind an object, with its shadow."""
    rows, columns = np.mgrid[: mask.shape[0], : mask.shape[1]] / mask.shape[0]
    light = 1.1 - 0.35 * columns + 0.1 * gaussian_filter(rng.normal(size=mask.shape), 40) * 40
    floor = np.flatnonzero(mask.any(1)).max() / len(mask) - 0.12
    light = light * np.where(rows > floor, 0.8, 1.0)
    cast = np.roll(mask, (6, 18), (0, 1)).astype(float)
    light = light * (1 - 0.35 * gaussian_filter(cast, 8))
    return light[..., None] * colour


def interval(values: list[float]) -> tuple[float, float, float]:
    """Return the mean, and the bounds that 95 of 100 bootstrapped means keep."""
    each, rng = np.array(values), np.random.default_rng(0)
    means = each[rng.integers(0, len(each), (ROUNDS, len(each)))].mean(1)
    low, high = np.percentile(means, (2.5, 97.5))
    return float(each.mean()), float(low), float(high)


def table(title: str, rows: dict[str, dict], before: dict[str, dict]) -> list[str]:
    """Return Markdown lines about a group; rows, before: {name: {plan: overlap}}."""
    lines = [f"## {title}, {len(rows)} pictures", "", "| marks | before | now | worst now |"]
    lines += ["|---|---|---|---|"]
    for plan in PLANS:
        cells = ["–"] if not before else []
        for group in filter(None, (before, rows)):
            values = [row[plan] for row in group.values()]
            cells.append("{:.2f} [{:.2f}, {:.2f}]".format(*interval(values)))
        worst = min(rows, key=lambda name: rows[name][plan])
        lines.append(f"| {plan} | {' | '.join(cells)} | {worst}: {rows[worst][plan]:.2f} |")
    return [*lines, ""]


def main() -> None:
    """Measure, print and write the report."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("root", "dataset", "out"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--rooms", type=Path, action="append", default=[])
    parser.add_argument("--before", type=Path)
    arguments = parser.parse_args()
    known = photographs_of(arguments.root)
    groups = {
        "Photographs that were looked at": {name: known[name] for name in list(known)[::2]},
        "The other photographs": {name: known[name] for name in list(known)[1::2]},
    }
    groups |= {
        f"Rendered objects before {name}": pictures
        for name, pictures in before_walls(arguments.dataset).items()
    }
    groups |= {f"Objects in rooms, {path.name}": in_rooms(path) for path in arguments.rooms}
    before = json.loads(arguments.before.read_text())["results"] if arguments.before else {}
    results: dict[str, dict] = {}
    for title, pictures in groups.items():
        results[title] = {}
        for name, (display, truth) in pictures.items():
            selection = Selection(display)
            results[title][name] = {
                text: after(selection, truth, plan) for text, plan in PLANS.items()
            }
            print(title, name, results[title][name], flush=True)
    report = {"made": provenance(), "results": results}
    arguments.out.mkdir(parents=True, exist_ok=True)
    files.write_json(arguments.out / "report.json", report)
    lines = ["# Selecting an object by marks", ""]
    lines += [" ".join(__doc__.split("\n\n")[1].split()), ""]
    for title, rows in results.items():
        lines += table(title, rows, before.get(title, {}))
    files.write_text(arguments.out / "report.md", "\n".join(lines))
    print(json.dumps({k: len(v) for k, v in results.items()}))


if __name__ == "__main__":
    main()
