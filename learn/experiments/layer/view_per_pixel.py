"""Time method="auto" for a view per pixel against a distant viewer, and count kept tolerances.

Times: each material measured by MERL on a sphere, and on a sphere with dents, that cover 40 % of 96
× 96 pixels: seen by a distant viewer, and by a camera with a field of view of 40°. Forward and
backward with the gradients of normals, material and light; once more with that of the views. Both
cameras take turns; a time is the least of five, of one thread.

Kept tolerances: random materials, lights, shapes and fields of view of 20° to 90°, with the same
gradients requested. The error is the mean absolute difference from the exact sum over its mean.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner
from manifests.option_types import whole

if TYPE_CHECKING:
    import numpy as np
    import torch

ROUNDS, SIZE, FIELD_OF_VIEW, TOLERANCE = 5, 96, 40, 1e-2
DEPTHS = {"sphere": 0.0, "dented sphere": 0.15}
TOLERANCES = (5e-2, 1e-2, 1e-3)
LIMIT = 3.0  # times the distant viewer's time
INPUTS = ("n", "material", "light", "view")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the materials, the light, the number of random cases, their size and the seed."""
    options.add_count(parser, "--every", 1, "only each N-th material")
    parser.add_argument(
        "--light",
        default="lamps",
        metavar="NAME",
        help="of the times: sky, lamps, 'sun in a texel' or 'one texel' (default lamps)",
    )
    parser.add_argument(
        "--cases",
        type=whole,
        default=500,
        metavar="N",
        help="number of random cases (default 500; 0: only times)",
    )
    options.add_size(parser, 64)
    options.add_seed(parser, "seed of the random cases")


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"light", "times": [row], "cases": [row]}."""
    from learn.experiments.layer import chart_cases
    from manifests import materials as catalogue
    from manifests.progress import tqdm

    light = chart_cases.lights(names=[arguments.light])[arguments.light]
    materials = list(catalogue.load_catalogue(catalogue.BUILT_IN[0]).items())
    times = [
        {"shape": shape, "material": name} | _times(material.label, light, depth)
        for name, material in tqdm(materials[:: arguments.every], desc="times", unit="material")
        for shape, depth in DEPTHS.items()
    ]
    labels = [material.label for _, material in materials]
    cases = [
        row
        for case in tqdm(range(arguments.cases), desc="tolerances", unit="case")
        for row in _rows_by_tolerance(case, labels, arguments.size, arguments.seed)
    ]
    return {"light": arguments.light, "times": times, "cases": cases}


def _time_rendering(
    n: torch.Tensor,
    label: np.ndarray,
    light: np.ndarray,
    view: torch.Tensor | None,
    by_view: bool = False,
    method: str = "auto",
) -> tuple[float, torch.Tensor, list[torch.Tensor]]:
    """Seconds of a picture and its derivatives on one thread, the picture, and the derivatives."""
    import time

    import numpy as np
    import torch

    from learn.layer import render

    given = [n, torch.as_tensor(np.exp(label)).float().reshape(1, 108)]
    given += [torch.as_tensor(light).float()[None]]
    if view is not None and by_view:
        given.append(view)
    leaves = [x.detach().requires_grad_() for x in given]
    view = leaves[3] if len(leaves) > 3 else view
    by_picture = torch.ones_like(n)
    start = time.thread_time()
    n, m, L = leaves[:3]
    picture = render(n, m, L, view=view, tolerance=TOLERANCE, method=method)
    gradients = torch.autograd.grad(picture, leaves, by_picture)
    return time.thread_time() - start, picture.detach(), list(gradients)


def _times(label: np.ndarray, light: np.ndarray, depth: float) -> dict[str, Any]:
    """A material's times in seconds, and its errors where the views' gradients are requested."""
    import math

    import torch

    from learn.experiments.layer import near_shapes

    torch.set_num_threads(1)
    far = near_shapes.far(SIZE, depth)
    n, view = near_shapes.near(SIZE, math.radians(FIELD_OF_VIEW), depth)
    seconds: dict[str, list[float]] = {"far": [], "near": [], "with view": []}
    for _ in range(ROUNDS):
        seconds["far"].append(_time_rendering(far, label, light, None)[0])
        seconds["near"].append(_time_rendering(n, label, light, view)[0])
        took, picture, gradients = _time_rendering(n, label, light, view, True)
        seconds["with view"].append(took)
    _, truth, right = _time_rendering(n, label, light, view, True, "exact")
    pairs = [(picture, truth), *zip(gradients, right, strict=True)]
    errors = [((a - b).abs().mean() / b.abs().mean()).item() for a, b in pairs]
    return {
        "pixels": int((n != 0).any(-1).sum()),
        **{key: min(values) for key, values in seconds.items()},
        "error": errors[0],
        "gradient errors": dict(zip(INPUTS, errors[1:], strict=True)),
    }


def _rows_by_tolerance(
    case: int, labels: list[np.ndarray], size: int, seed: int
) -> list[dict[str, Any]]:
    """Rows of a random case, one for each tolerance."""
    import numpy as np
    import torch

    from learn.experiments.layer import near_shapes, random_scenes
    from learn.layer import render

    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(case,)))
    label, light = random_scenes.random_label(rng, labels), random_scenes.random_light(rng)
    fov, depth = rng.uniform(20, 90), max(rng.uniform(-0.1, 0.25), 0.0)
    n, view = near_shapes.near(size, np.radians(fov), depth, case)
    m = torch.as_tensor(np.exp(label)).float().reshape(1, 108).requires_grad_()
    L = torch.as_tensor(light).float()[None].requires_grad_()
    n.requires_grad_()
    with torch.no_grad():
        truth = render(n, m, L, view=view, method="exact")
    rows = []
    for tolerance in TOLERANCES:
        picture = render(n, m, L, view=view, tolerance=tolerance).detach()
        error = ((picture - truth).abs().mean() / truth.mean()).item()
        rows.append({"case": case, "fov": fov, "depth": depth, "tolerance": tolerance})
        rows[-1] |= {"error": error, "kept": error <= tolerance}
    return rows


def tables(report: runner.Report) -> str:
    """Return ratios of times by shape, errors of gradients, and shares of kept tolerances."""
    parts = ['# A view per pixel under method="auto"', ""]
    parts += [f"Light of the times: {report['light']}; tolerance {TOLERANCE:g}.", ""]
    parts += [_ratios(report["times"]), _gradients(report["times"])]
    if report["cases"]:
        parts.append(_shares(report["cases"]))
    return "\n".join(parts)


def _ratios(rows: list[dict[str, Any]]) -> str:
    import numpy as np

    head = ["shape", "gradients", "materials", "distant viewer, ms", "view per pixel, ms"]
    lines = []
    for shape in DEPTHS:
        here = [row for row in rows if row["shape"] == shape]
        for key, gradients in (("near", "three inputs"), ("with view", "and the views")):
            ratios = np.array([row[key] / row["far"] for row in here])
            lines.append(
                [
                    shape,
                    gradients,
                    len(here),
                    *(f"{1e3 * np.median([row[k] for row in here]):.1f}" for k in ("far", key)),
                    f"{np.median(ratios):.2f}",
                    f"{np.quantile(ratios, 0.8):.2f}",
                    f"{ratios.max():.2f}",
                    int((ratios <= LIMIT).sum()),
                ]
            )
    head += ["median ratio", "80th percentile", "largest", f"materials within {LIMIT:g}"]
    return runner.table(head, lines)


def _gradients(rows: list[dict[str, Any]]) -> str:
    import numpy as np

    lines = []
    for shape in DEPTHS:
        here = [row for row in rows if row["shape"] == shape]
        for name in ("picture", *INPUTS):
            errors = [
                row["error"] if name == "picture" else row["gradient errors"][name] for row in here
            ]
            figures = [np.median(errors), np.quantile(errors, 0.9), max(errors)]
            lines.append([shape, name, *(f"{figure:.1e}" for figure in figures)])
    return runner.table(["shape", "error of", "median", "90th percentile", "largest"], lines)


def _shares(rows: list[dict[str, Any]]) -> str:
    lines = []
    for tolerance in TOLERANCES:
        here = [row for row in rows if row["tolerance"] == tolerance]
        errors = [row["error"] for row in here if not row["kept"]]
        share = 100 * (1 - len(errors) / len(here))
        worst = f"{max(errors) / tolerance:.2f}" if errors else "–"
        lines.append([f"{tolerance:g}", len(here), f"{share:.1f} %", len(errors), worst])
    return runner.table(["tolerance", "cases", "kept", "misses", "worst miss ÷ tolerance"], lines)
