"""Measure how close labels come to principled materials, and how long their fits take.

Draws materials, fits each to a label on one core, and reports the relative L1 of f · cos at view
angles that no fit sees: medians and 90 % quantiles, by kind of material and by range of each
number, and the worst materials. For some of the materials the least error that any function of a
label's two angles could have is computed as well: what a fit leaves above it, a label of more
numbers could take off.

The materials: base_color uniform, roughness uniform in [.05, 1], metallic one of 0, 1 and uniform,
specular uniform; sheen in 30 % of them, a coat in 30 %.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner
from manifests.option_types import positive

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure

    from shaders.principled import PrincipledMaterial
    from shaders.samples import Samples

LIMIT = 0.02  # the aim of the median
WORST = 8  # materials that are listed
MATRIX = 1000  # a fit's time is stated beside that of a product of two matrices of this size
RESAMPLES = 2000
NODES = 16  # of the free curve over θ_d, for each θ_h
ROUNDS = 12  # of reweighting, by which the free curve approaches least L1
Row = Mapping[str, Any]

KINDS: Mapping[str, Callable[[Row], bool]] = {
    "all": lambda m: True,
    "dielectric, no coat, no sheen": lambda m: m["sheen"] == m["coat"] == m["metallic"] == 0,
    "metal, no coat, no sheen": lambda m: m["sheen"] == m["coat"] == 0 and m["metallic"] == 1,
    "mixture of both, no coat, no sheen": lambda m: (
        m["sheen"] == m["coat"] == 0 and 0 < m["metallic"] < 1
    ),
    "coat, no sheen": lambda m: m["coat"] > 0 and m["sheen"] == 0,
    "sheen, no coat": lambda m: m["sheen"] > 0 and m["coat"] == 0,
    "sheen and coat": lambda m: m["sheen"] > 0 and m["coat"] > 0,
}
RANGES: Mapping[str, tuple[Callable[[Row], bool], str, Sequence[float]]] = {
    "roughness": (lambda m: True, "roughness", (0.05, 0.2, 0.4, 0.7, 0.9, 1)),
    "roughness of metals": (
        lambda m: m["metallic"] == 1,
        "roughness",
        (0.05, 0.2, 0.4, 0.7, 0.9, 1),
    ),
    "darkest channel of metals": (lambda m: m["metallic"] == 1, "darkest", (0, 0.1, 0.3, 1)),
    "metallic": (lambda m: True, "metallic", (0, 1e-9, 0.5, 1, 1)),
    "specular of dielectrics": (lambda m: m["metallic"] == 0, "specular", (0, 0.3, 0.7, 1)),
    "coat": (lambda m: True, "coat", (0, 1e-9, 0.3, 0.7, 1)),
    "coat roughness, of coats": (lambda m: m["coat"] > 0, "coat_roughness", (0.05, 0.2, 0.4, 0.6)),
    "sheen": (lambda m: True, "sheen", (0, 1e-9, 0.3, 0.7, 1)),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the numbers of materials and of iterations."""
    from shaders import principled_fit

    options.add_count(parser, "--count", 500, "number of materials")
    options.add_count(
        parser, "--every", 5, "compute the least possible error of every N-th material"
    )
    parser.add_argument(
        "--iterations",
        type=positive,
        default=principled_fit.ITERATIONS,
        metavar="N",
        help=f"iterations of a fit (default {principled_fit.ITERATIONS}, which the program uses)",
    )
    options.add_seed(parser, "seed by which materials are drawn")


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows", "product_ms", "views_deg", "view_medians", "iterations", "every"}.

    A row has the numbers of `row_of`, "error", "ms", and for every N-th material "least".
    """
    import time

    import numpy as np

    from manifests.progress import tqdm
    from shaders import principled_fit
    from shaders.samples import HELD_OUT_DEG, held_out_samples

    rng = np.random.default_rng(arguments.seed)
    materials = [draw_material(rng) for _ in range(arguments.count)]
    principled_fit.fit(materials[0])  # tables of the held-out samples
    samples = held_out_samples()
    matrix = rng.random((MATRIX, MATRIX))
    rows, views, product = [], [], []
    for number, material in enumerate(tqdm(materials, unit="material")):
        start = time.process_time()
        result = principled_fit.fit(material, arguments.iterations)
        row = row_of(material) | {
            "error": result.error,
            "ms": 1e3 * (time.process_time() - start),
        }
        if number % arguments.every == 0:
            row["least"] = least_error(material, samples)
            start = time.process_time()
            _ = matrix @ matrix
            product.append(1e3 * (time.process_time() - start))
        views.append(result.views)
        rows.append(row)
    return {
        "rows": rows,
        "product_ms": float(np.median(product)),
        "views_deg": list(HELD_OUT_DEG),
        "view_medians": np.median(views, axis=0).tolist(),
        "iterations": arguments.iterations,
        "every": arguments.every,
    }


def draw_material(rng: np.random.Generator) -> PrincipledMaterial:
    """Return a random material of the distribution that the module describes."""
    from shaders.principled import PrincipledMaterial

    sheen, coat = rng.random(2) < 0.3
    red, green, blue = rng.random(3).tolist()
    return PrincipledMaterial(
        (red, green, blue),
        roughness=rng.uniform(0.05, 1),
        metallic=float(rng.choice([0.0, 1.0, rng.random()])),
        specular=rng.random(),
        sheen=rng.random() * float(sheen),
        sheen_roughness=rng.uniform(0.1, 1),
        coat=rng.random() * float(coat),
        coat_roughness=rng.uniform(0.05, 0.6),
    )


def row_of(material: PrincipledMaterial) -> dict[str, Any]:
    """Return the numbers of a material, rounded, and its darkest channel."""
    numbers = asdict(material)
    color = [round(float(value), 4) for value in numbers.pop("base_color")]
    rest = {name: round(float(value), 4) for name, value in numbers.items()}
    return {"base_color": color, **rest, "darkest": min(color)}


def least_error(material: PrincipledMaterial, samples: Samples) -> float:
    """Return the mean over views of the least relative L1 of any function of θ_h and θ_d.

    For each θ_h of the samples and each channel, one curve over θ_d (NODES values, linear between
    them) is fitted to all views at once, by weighted least squares that are reweighted towards
    least L1. A label follows the same values by three lobes with six control values each. It is
    an upper bound, since the nodes and the rounds are finite.

    samples  shaders.samples.held_out_samples
    """
    import numpy as np

    from shaders.samples import HELD_OUT_POINTS

    f = material.evaluate(*samples.cosines)  # (V, P, 3)
    views = len(samples.theta_o)
    heights, _ = HELD_OUT_POINTS
    measure = samples.measure[..., None]
    weight = measure / (measure * f).sum((1, 2), keepdims=True) / views

    def by_height(values: np.ndarray) -> np.ndarray:
        """Values (V, P, C) as (θ_h, C, V · φ_h)."""
        split = values.reshape(views, heights, -1, values.shape[-1])
        return split.transpose(1, 3, 0, 2).reshape(heights, values.shape[-1], -1)

    theta_d = np.arccos(np.clip(samples.cos_d, 0, 1))
    place = theta_d * (NODES - 1) / (np.pi / 2)
    hats = np.maximum(0, 1 - np.abs(place[..., None] - np.arange(NODES)))
    basis = by_height(hats).transpose(0, 2, 1)[:, None]  # (θ_h, 1, points, NODES)
    target, weight = by_height(f), by_height(weight)
    off = np.ones_like(target)
    least = np.full(target.shape[:2], np.inf)
    for _ in range(ROUNDS):
        root = weight / off
        A = basis.swapaxes(-1, -2) @ (root[..., None] * basis)
        scale = np.trace(A, axis1=-2, axis2=-1)[..., None, None] / NODES
        A = A + (1e-9 * scale + 1e-30) * np.eye(NODES)
        b = basis.swapaxes(-1, -2) @ (root * target)[..., None]
        error = np.abs((basis @ np.linalg.solve(A, b))[..., 0] - target)
        least = np.minimum(least, (weight * error).sum(-1))
        off = error + 1e-4 * np.abs(target).mean(-1, keepdims=True) + 1e-12
    return float(least.sum())


def quantile(values: np.ndarray, share: float) -> list[float]:
    """Return [quantile, low, high] of values (P,), with a 95 % interval over draws of values."""
    import numpy as np

    from learn.metrics.bootstrap import LEVELS

    chosen = np.random.default_rng(0).integers(len(values), size=(RESAMPLES, len(values)))
    low, high = np.percentile(np.quantile(values[chosen], share, axis=1), LEVELS)
    return [float(np.quantile(values, share)), float(low), float(high)]


def tables(report: runner.Report) -> str:
    """Return the errors by kind of material and by range, the worst materials, and the time."""
    import numpy as np

    rows = report["rows"]
    errors = np.array([row["error"] for row in rows])
    bounded = [row for row in rows if "least" in row]
    times = np.array([row["ms"] for row in rows])
    median, above = quantile(errors, 0.5), (errors > LIMIT).mean()
    share = [np.median([row[key] for row in bounded]) for key in ("error", "least")]
    products = np.median(times) / report["product_ms"]
    views = ", ".join(f"{angle:g}" for angle in report["views_deg"])
    medians = ", ".join(f"{value:.3f}" for value in report["view_medians"])
    head = ["materials", "count", "median", "90 %", "worst", "any function of both angles, median"]
    kinds = [_line(name, [row for row in rows if of(row)]) for name, of in KINDS.items()]
    ranges = [
        _line(
            f"{name} {_range(edges, k)}", [r for r in rows if of(r) and _within(r[key], edges, k)]
        )
        for name, (of, key, edges) in RANGES.items()
        for k in range(len(edges) - 1)
    ]
    worst = [
        [
            f"{rows[i]['error']:.3f}",
            ", ".join(f"{value:.2f}" for value in rows[i]["base_color"]),
            *(f"{rows[i][key]:.2f}" for key in ("roughness", "metallic", "specular")),
            *(
                f"{rows[i][key]:.2f}, {rows[i][key + '_roughness']:.2f}" if rows[i][key] else "–"
                for key in ("coat", "sheen")
            ),
        ]
        for i in np.argsort(-errors)[:WORST]
    ]
    labels = ["relative L1", "base colour", "roughness", "metallic", "specular"]
    return (
        "# Labels of principled materials\n\n"
        f"Relative L1 of f·cos, mean of the views from {views}°, which no fit sees, of"
        f" {len(rows)} random materials after {report['iterations']} iterations: median"
        f" {runner.interval(median)}, 90 % quantile {runner.interval(quantile(errors, 0.9))},"
        f" worst {errors.max():.3f}. Brackets are 95 % intervals over draws of materials."
        f" {100 * above:.0f} % of the materials are above {LIMIT:g}. Medians of single views, in"
        f" their order: {medians}.\n\n"
        f"A fit takes {np.median(times):.0f} ms of one core's processor in the median,"
        f" {np.quantile(times, 0.9):.0f} ms at the 90 % quantile. The median is {products:.2f}"
        f" times a product of two matrices of {MATRIX:,}² numbers, which took"
        f" {report['product_ms']:.0f} ms in the same process.\n\n"
        f"Last column, of every {report['every']}th material: the least error that any function of"
        " θ_h and θ_d can have, with a free curve over θ_d for each θ_h and each channel. Over"
        f" these {len(bounded)} materials labels are at {share[0]:.3f} in the median and free"
        f" functions at {share[1]:.3f}.\n\n## By kind\n\n"
        + runner.table(head, [each for each in kinds if each])
        + "\n## By range of each number\n\n"
        + runner.table(head, [each for each in ranges if each])
        + "\n## The worst materials\n\nA coat and a sheen are stated with their roughness.\n\n"
        + runner.table([*labels, "coat", "sheen"], worst)
    )


def _line(name: str, rows: Sequence[Row]) -> list[object]:
    """A line of a table; empty where there are no materials."""
    import numpy as np

    if not rows:
        return []
    errors = np.array([row["error"] for row in rows])
    least = [row["least"] for row in rows if "least" in row]
    shares = [runner.interval(quantile(errors, share)) for share in (0.5, 0.9)]
    bound = f"{np.median(least):.3f} ({len(least)})" if least else "–"
    return [name, len(rows), *shares, f"{errors.max():.3f}", bound]


def _within(value: float, edges: Sequence[float], k: int) -> bool:
    """Whether a value lies in the k-th range: the last edge belongs to the last range."""
    if edges[k] == edges[k + 1] or k == len(edges) - 2:
        return edges[k] <= value <= edges[k + 1]
    return edges[k] <= value < edges[k + 1]


def _range(edges: Sequence[float], k: int) -> str:
    low, high = edges[k], edges[k + 1]
    if high - low < 1e-6:
        return f"{low:g}"
    return f"{low:g} to {high:g}" if low > 1e-6 else f"up to {high:g}"


def figure(report: runner.Report) -> Figure:
    """Return a chart: each material's error against its roughness, and the least possible one."""
    from matplotlib.figure import Figure as Drawing

    drawing = Drawing(figsize=(8, 4.6), layout="constrained")
    axes = drawing.subplots()
    rows = report["rows"]
    for name, color in {
        "metal, no coat, no sheen": "#b3402a",
        "dielectric, no coat, no sheen": "#2f6f9f",
        "mixture of both, no coat, no sheen": "#8a6fb0",
    }.items():
        chosen = [row for row in rows if KINDS[name](row)]
        x, y = [row["roughness"] for row in chosen], [row["error"] for row in chosen]
        axes.plot(x, y, "o", ms=4, color=color, label=name)
    rest = [row for row in rows if row["coat"] or row["sheen"]]
    x, y = [row["roughness"] for row in rest], [row["error"] for row in rest]
    axes.plot(x, y, "o", ms=3, color="0.7", label="with coat or sheen", zorder=0)
    bounded = [row for row in rows if "least" in row]
    x, y = [row["roughness"] for row in bounded], [row["least"] for row in bounded]
    axes.plot(x, y, "k+", ms=5, label="the least error of any function of θ_h and θ_d")
    axes.axhline(LIMIT, color="k", lw=0.8, ls="--")
    axes.set(xlabel="roughness", ylabel="relative L1 of f·cos", ylim=(0, None))
    axes.legend(fontsize=8, frameon=False)
    return drawing
