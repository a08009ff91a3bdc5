"""Measure how much fitting a mask's edge to its photograph improves edits with inaccurate masks.

Photographs are those of `room-photographs`: Cycles' pictures of objects on tables, exposed, in 8
bits. The share of each pixel that the object covers is known (coverage.png). `damaged_masks`,
beside this file, makes inaccurate masks of it. With each mask, the object's true radiance in
another material is put into the photograph in the same way as `edit` does it, so that only the edge
can be wrong, and the result is compared with Cycles' picture of the object in that material.

rows.jsonl keeps a line per photograph: the same command continues an unfinished run, and a larger
--scenes adds to it.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from matplotlib.figure import Figure

    from learn.experiments.photographs.room_cases import Case

BAND = 5  # pixels on either side of the true edge, in which errors are measured
PLAIN, GIVEN = "as given, nearest background", "as given"
FITTED, MATTED = "fitted", "closed-form matting"
METHODS = (PLAIN, GIVEN, FITTED, MATTED)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scenes and how many are photographed, each in one of its materials."""
    options.add_data(parser, "a folder of factory.render.validation.objects_in_rooms")
    options.add_scenes(parser)


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows": results of `row_of`}. Raises InputError for no scenes or no coverage.png."""
    from learn.experiments.photographs import room_cases
    from manifests import outputs
    from manifests.errors import InputError
    from manifests.store_paths import file_hash

    by_scene: dict[Path, list[Case]] = {}
    for case in room_cases.cases_of(arguments.data, arguments.scenes, arguments.after):
        by_scene.setdefault(case.folder, []).append(case)
    for folder in by_scene:
        if not (folder / "coverage.png").is_file():
            remedy = "run factory.render.validation.objects_in_rooms again, which adds it"
            raise InputError(folder, "coverage.png", "none", remedy)
    # the first scene identifies the data: a larger --scenes does not change it
    about = {"data": file_hash(next(iter(by_scene)) / "scene.json")}
    outputs.pin_settings(arguments.out / "settings.json", about)
    cases = [of[number % len(of)] for number, of in enumerate(by_scene.values())]
    todo = [({"photograph": room_cases.name_of(case)}, case) for case in cases]
    return {"rows": runner.resume(arguments.out / "rows.jsonl", todo, row_of, "photograph")}


def row_of(case: Case) -> dict[str, Any]:
    """Return the errors of a photograph's masks.

    {"shape", "place", "material", "target", "refused": damages that left no object, "masks":
    {damage: {method: {"coverage": mean absolute error in the band, "band": display L2 there,
    "object": over object and band}}}}
    """
    import numpy as np

    from learn.data import photographs
    from learn.data.photographs import LEAST_PIXELS
    from learn.editing import mask_edges
    from learn.editing.backgrounds import fill_from_nearest
    from learn.experiments.photographs import damaged_masks, room_cases
    from learn.experiments.photographs.photographing import exposed
    from shaders import tone

    frame = room_cases.frame_of(case, case.source)
    coverage = photographs.read_mask(case.folder / "coverage.png", frame.shape[:2])
    photo = exposed(frame, coverage >= 0.5, room_cases.name_of(case))
    radiance = tone.linear_from_srgb(photo.pixels / 255.0).astype(np.float32)
    materials = case.scene.materials
    target = materials[(materials.index(case.source) + 1) % len(materials)]
    truth = photo.of(room_cases.frame_of(case, target))
    object_ = fill_from_nearest(truth, coverage > 0.99)
    band = np.abs(mask_edges.signed_distance(coverage >= 0.5)) <= BAND
    whole = band | (coverage > 0)
    masks, refused = {}, []
    for name, damage in damaged_masks.DAMAGES.items():
        given = damage(coverage).astype(np.float32)
        if (given >= 0.5).sum() < LEAST_PIXELS:
            refused.append(name)
            continue
        masks[name] = {
            method: {
                "coverage": round(float(np.abs(edge - coverage)[band].mean()), 5),
                "band": round(float(tone.display_l2(edited, truth, 1.0, band)), 2),
                "object": round(float(tone.display_l2(edited, truth, 1.0, whole)), 2),
            }
            for method in METHODS
            for edge in [edge_of(method, radiance, given)]
            for edited in [composed(method, radiance, edge, object_)]
        }
    return {
        "shape": case.scene.shape,
        "place": f"{case.scene.place}-{case.scene.seed}",
        "material": case.source,
        "target": target,
        "refused": refused,
        "masks": masks,
    }


def edge_of(method: str, radiance: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Return the coverage (H, W) that one of METHODS makes of a given mask (H, W)."""

    from learn.editing import mask_edges
    from learn.editing.mask_preparation import soften
    from learn.experiments.photographs.closed_form_matting import matted

    methods: dict[str, Callable[..., np.ndarray]] = {FITTED: mask_edges.fit, MATTED: matted}
    return methods[method](radiance, given) if method in methods else soften(given)


def composed(
    method: str, radiance: np.ndarray, coverage: np.ndarray, object_: np.ndarray
) -> np.ndarray:
    """Return the photograph (H, W, 3) with an object's radiance (H, W, 3) in it.

    method  PLAIN has the nearest pixel as the background behind an edge
    """
    import numpy as np

    from learn.editing.backgrounds import background_behind, fill_from_nearest
    from learn.editing.photograph import CLEAR

    share = coverage[..., None]
    if method == PLAIN:
        behind = fill_from_nearest(radiance, coverage < CLEAR)
    else:
        behind = background_behind(radiance, coverage)
    behind = np.where((share > 0) & (share < 1 - CLEAR), behind, radiance)
    return share * object_ + (1 - share) * behind


def tables(report: runner.Report) -> str:
    """Return the errors by damage and method, with intervals over shapes and places."""
    import numpy as np

    from learn.metrics import bootstrap

    rows = report["rows"]
    page = (
        "# Edits with masks that are off, and with their edges fitted\n\n"
        f"{len(rows)} photographs, each with masks damaged in {len(_damages(report))} ways."
        f" The band is {BAND} pixels wide on either side of the true edge.\n"
    )
    titles = {
        "coverage": "Mean absolute error of coverage in the band",
        "band": "Display L2 of edits in the band",
        "object": "Display L2 of edits over object and band",
    }
    for key, title in titles.items():
        digits = 3 if key == "coverage" else 0
        methods = METHODS if key != "coverage" else METHODS[1:]
        lines = []
        for damage in _damages(report):
            having = [row for row in rows if damage in row["masks"]]
            weights = bootstrap.draws(
                bootstrap.groups_of(*([row[k] for row in having] for k in ("shape", "place")))
            )
            cells = [
                runner.interval(
                    bootstrap.interval(_values(having, damage, m, key), weights), digits
                )
                for m in methods
            ]
            before, after = (_values(having, damage, m, key) for m in (GIVEN, FITTED))
            difference = bootstrap.interval(after - before, weights)
            worse = float(np.mean(after > before))
            lines.append([damage, *cells, runner.interval(difference, digits), f"{worse:.0%}"])
        head = ["mask", *methods, "fitted minus given", "photographs that fitting makes worse"]
        page += f"\n## {title}\n\n{runner.table(head, lines)}"
    refused = sum(len(row["refused"]) for row in rows)
    return page + (f"\n{refused} masks left no object and are not counted.\n" if refused else "")


def _damages(report: runner.Report) -> list[str]:
    from learn.experiments.photographs.damaged_masks import DAMAGES

    return [name for name in DAMAGES if any(name in row["masks"] for row in report["rows"])]


def _values(rows: list[dict[str, Any]], damage: str, method: str, key: str) -> np.ndarray:
    import numpy as np

    return np.array([row["masks"][damage][method][key] for row in rows])


def figure(report: runner.Report) -> Figure:
    """Return the chart of the display L2 of edits in the band, by damage and method."""
    from matplotlib.figure import Figure

    damages = _damages(report)
    drawn = Figure(figsize=(8, 4.5), layout="constrained")
    axes = drawn.subplots()
    for number, method in enumerate(METHODS[1:]):
        means = []
        for damage in damages:
            having = [row for row in report["rows"] if damage in row["masks"]]
            means.append(float(_values(having, damage, method, "band").mean()))
        at = [place + 0.27 * (number - 1) for place in range(len(damages))]
        axes.barh(at, means, 0.27, label=method)
    axes.set_yticks(range(len(damages)), damages)
    axes.invert_yaxis()
    axes.set_xlabel(f"display L2 of edits within {BAND} pixels of the true edge, mean")
    axes.legend()
    return drawn
