"""The ladder's report: tables of the rungs, the alignments, the families and refinement.

Brackets are 95 % intervals by bootstrap in which whole shapes, target materials and lights are
drawn with replacement.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from learn.evaluation.ladder_chart import chart
from learn.evaluation.ladder_design import (
    GROUPS,
    HEADLINE,
    OTHER_ELEVATION_DEG,
    OTHER_FOV_DEG,
)
from learn.evaluation.ladder_lines import Figures, figure_of, groups, rungs, select
from learn.evaluation.page import table_lines, text_of
from learn.evaluation.table import Cell, Column, Table, TableRow, column, table
from learn.metrics import bootstrap
from manifests import files
from manifests.wording import number_of

TITLE = "The ladder: from direct light to a photograph"
COLUMNS = (
    column("normals", "normals ° ↓", 1, True),
    column("median", "median ° ↓", 1),
    column("facing", "facing the viewer °", 1),
    column("irradiance", "irradiance error ↓", 3, True),
    column("constant", "of a constant light", 3),
    column("edit", "edit L2 ↓", 0, True),
    column("edit_median", "median ↓", 0),
    column("dielectrics", "without metals ↓", 0, True),
    column("metals", "metals ↓", 0, True),
    column("aligned", "one factor free ↓", 0, True),
    column("floor", "true parts", 0),
    column("unchanged", "input unchanged", 0),
)
ALIGNMENTS = {  # {figure of a line: what its columns are called}
    "edit_l2": "absolute",
    "edit_l2_aligned": "one factor",
    "edit_l2_three_factors": "three factors",
}
ALIGNED_COLUMNS = tuple(
    column(f"{key}_{part}", f"{name}: {words} ↓", 0, part != "median")
    for key, name in ALIGNMENTS.items()
    for part, words in (
        ("mean", "mean"),
        ("median", "median"),
        ("dielectrics", "without metals"),
        ("metals", "metals"),
    )
)
REFINED_COLUMNS = (
    column("scenes", "edits", 0),
    column("before", "predicted L2 ↓", 0, True),
    column("after", "refined L2 ↓", 0, True),
    column("ratio", "ratio ↓", 2, True),
    column("aligned_before", "one factor free: predicted ↓", 0, True),
    column("aligned_after", "refined ↓", 0, True),
    column("aligned_ratio", "ratio ↓", 2, True),
    column("normals_before", "normals, predicted ° ↓", 1, True),
    column("normals_after", "refined ° ↓", 1, True),
    column("light_before", "irradiance error, predicted ↓", 3, True),
    column("light_after", "refined ↓", 3, True),
)


def cells(lines: Sequence[Mapping]) -> dict[str, Cell]:
    """Return the cells of COLUMNS of the lines of one rung and group."""
    figures = Figures(lines)
    metal = np.array([line["metal"] for line in lines])

    def mean(key: str) -> float | None:
        values = figures.values(lambda line: line[key])
        return float(np.nanmean(values)) if np.isfinite(values).any() else None

    def median(key: str) -> float:
        return float(np.median(figures.values(lambda line: line["predicted"][key])))

    def edit(line: Mapping) -> float:
        return line["predicted"]["edit_l2"]

    return {
        "normals": figures.interval(lambda line: line["predicted"]["normals_mean_deg"]),
        "median": median("normals_mean_deg"),
        "facing": mean("facing_deg"),
        "irradiance": figures.interval(lambda line: line["predicted"]["irradiance"]),
        "constant": mean("constant_irradiance"),
        "edit": figures.interval(edit),
        "edit_median": median("edit_l2"),
        "dielectrics": figures.interval(edit, ~metal),
        "metals": figures.interval(edit, metal),
        "aligned": figures.interval(lambda line: line["predicted"]["edit_l2_aligned"]),
        "floor": mean("floor_l2"),
        "unchanged": mean("unchanged_l2"),
    }


def ladder_table(lines: Sequence[Mapping]) -> Table | None:
    """Return the table of all rungs and groups."""
    rows: list[TableRow] = []
    for group in groups(lines):
        for rung in rungs(lines):
            if here := select(lines, rung.name, group):
                rows.append({"name": f"{group}: {rung.name}", "cells": cells(here)})
    other_camera = (
        f" (elevation {OTHER_ELEVATION_DEG:g}°, field of view {OTHER_FOV_DEG:g}°, where the"
        " networks assume 20° and a distant viewer)"
        if any(rung.cameras == "camera" for rung in rungs(lines))
        else ""
    )
    note = (
        "Rungs: "
        + "; ".join(f"*{rung.name}*, {rung.title}" for rung in rungs(lines))
        + f"{other_camera}. A rung has what the rungs above it have. The"
        f" rung *direct* is what the layer itself can compute; the headline is *{HEADLINE}*."
        " Predictions are not refined here. *True parts*: the edit from true normals, light and"
        " label, which is the error that the layer's missing shadows and interreflections leave."
        " *One factor free*: L2 after the factor on the edit's radiance that makes it least."
    )
    return table("The ladder", note, COLUMNS, rows)


def aligned_table(lines: Sequence[Mapping], kind: str, title: str) -> Table | None:
    """Return display L2 of edits under each alignment, with and without metals, and medians.

    kind  "predicted" or "refined"; lines without it, or without its three factors, have no part
    """
    key = "edit_l2_three_factors"
    lines = [line for line in lines if line[kind] and line[kind].get(key) is not None]
    rows: list[TableRow] = []
    for group in groups(lines):
        for rung in rungs(lines):
            if here := select(lines, rung.name, group):
                row = {name: cell for key in ALIGNMENTS for name, cell in _parts(here, kind, key)}
                rows.append({"name": f"{group}: {rung.name}", "cells": row})
    note = (
        "Display L2 of the same edits, absolute and after the factors on their radiance that make"
        " it least: one for the whole edit, which forgives brightness, or one for each channel,"
        " which forgives colour too. *Mean* and *median* are of all target materials; the means"
        " beside them are of edits into metals alone and of all others."
    )
    return table(title, note, ALIGNED_COLUMNS, rows)


def _parts(lines: Sequence[Mapping], kind: str, key: str) -> list[tuple[str, Cell]]:
    """Return the cells of one alignment in `aligned_table`."""
    figures = Figures(lines)
    metal = np.array([line["metal"] for line in lines])
    get = figure_of(kind, key)
    return [
        (f"{key}_mean", figures.interval(get)),
        (f"{key}_median", float(np.median(figures.values(get)))),
        (f"{key}_dielectrics", figures.interval(get, ~metal)),
        (f"{key}_metals", figures.interval(get, metal)),
    ]


def family_table(lines: Sequence[Mapping]) -> Table | None:
    """Return the mean angle of normals of every family on every rung."""
    names = dict.fromkeys((line["group"], line["family"]) for line in lines)
    columns: list[Column] = [
        column("shapes", "shapes", 0),
        column("facing", "facing the viewer °", 1),
    ]
    columns += [column(rung.name, rung.name, 1, True) for rung in rungs(lines)]
    rows: list[TableRow] = []
    for group, family in sorted(names, key=lambda pair: (GROUPS.index(pair[0]), pair[1])):
        own = [line for line in lines if (line["group"], line["family"]) == (group, family)]
        facing = [line["facing_deg"] for line in own if line["rung"] == HEADLINE]
        row: dict[str, Cell] = {
            "shapes": float(len({line["shape"] for line in own})),
            "facing": float(np.mean(facing)) if facing else None,
        }
        for rung in rungs(lines):
            if here := [line for line in own if line["rung"] == rung.name]:
                row[rung.name] = Figures(here).interval(
                    lambda line: line["predicted"]["normals_mean_deg"]
                )
        rows.append({"name": f"{group}: {family}", "cells": row})
    note = (
        "Mean angle in degrees between predicted and true normals. *Facing the viewer*: of normals"
        f" that all point to the camera, on the rung {HEADLINE}. Families of three shapes or fewer"
        " say little by themselves."
    )
    return table("Normals by family", note, columns, rows)


def refined_table(lines: Sequence[Mapping]) -> Table | None:
    """Return predicted and refined figures of the scenes that were refined; None without any."""
    refined = [line for line in lines if line["refined"] is not None]
    rows: list[TableRow] = []
    for group in groups(refined):
        for rung in rungs(lines):
            if not (here := select(refined, rung.name, group)):
                continue
            figures = Figures(here)
            row: dict[str, Cell] = {"scenes": float(len(here))}
            for kind, after in (("predicted", "before"), ("refined", "after")):
                for key, name in (
                    ("edit_l2", after),
                    ("edit_l2_aligned", f"aligned_{after}"),
                    ("normals_mean_deg", f"normals_{after}"),
                    ("irradiance", f"light_{after}"),
                ):
                    row[name] = figures.interval(figure_of(kind, key))
            for key, name in (("edit_l2", "ratio"), ("edit_l2_aligned", "aligned_ratio")):
                before, end = (
                    figures.values(figure_of(kind, key)) for kind in ("predicted", "refined")
                )
                row[name] = (
                    bootstrap.relative(before, end, figures.weights)
                    if figures.enough
                    else float(end.mean() / before.mean())
                )
            rows.append({"name": f"{group}: {rung.name}", "cells": row})
    note = (
        "The same edits from the network's prediction and after refinement. *One factor free*: L2"
        " after the factor on the edit's radiance that makes it least."
    )
    return table("Refinement on the ladder", note, REFINED_COLUMNS, rows)


def counts(lines: Sequence[Mapping]) -> dict[str, int]:
    """Return the numbers of scenes, shapes, target materials and lights of the lines."""
    keys = {"scenes": "scene", "shapes": "shape", "targets": "target", "lights": "light"}
    return {name: len({line[key] for line in lines}) for name, key in keys.items()}


def headline(lines: Sequence[Mapping]) -> list[str]:
    """Return one sentence per group on the rung HEADLINE; none where it was not measured."""
    result = []
    for group in groups(lines):
        if not (here := select(lines, HEADLINE, group)):
            continue
        of_rung = cells(here)
        shown = {key: _text(of_rung[key], key) for key in ("normals", "irradiance", "edit")}
        result.append(
            f"{group.capitalize()}, full transport, 8-bit PNG: normals {shown['normals']}°,"
            f" irradiance error {shown['irradiance']}, edits {shown['edit']} display L2"
            f" (median {of_rung['edit_median']:.0f}); {len(here)} edits of"
            f" {len({line['shape'] for line in here})} shapes, not refined."
        )
    return result


def _text(cell: Cell, key: str) -> str:
    return text_of(cell, next(c for c in COLUMNS if c["key"] == key))


def write(out: Path, lines: Sequence[Mapping], about: Mapping) -> dict:
    """Write report.json, report.md and chart.png into `out`, and return the first of them."""
    made = {
        "ladder": ladder_table(lines),
        "alignment": aligned_table(lines, "predicted", "Edits under each alignment"),
        "families": family_table(lines),
        "refinement": refined_table(lines),
        "refined_alignment": aligned_table(lines, "refined", "Refined edits under each alignment"),
    }
    report = {
        "headline": headline(lines),
        "tables": {name: each for name, each in made.items() if each is not None},
        "about": {**about, "measured": counts(lines)},
    }
    with files.transaction():
        files.write_json(Path(out) / "report.json", report)
        files.write_text(Path(out) / "report.md", markdown(report))
        files.write_figure(Path(out) / "chart.png", chart(lines, about["side"]))
    return report


def markdown(report: Mapping) -> str:
    """Return report.md."""
    about = report["about"]
    lines = [f"# {TITLE}", ""]
    for sentence in about["seen"]:
        lines += [f"**{sentence}**", ""]
    lines += [*(f"- {sentence}" for sentence in report["headline"]), ""]
    lines += ["![Normals, light and edits on every rung](chart.png)", ""]
    for each in report["tables"].values():
        lines += table_lines(each)
    return "\n".join([*lines, "## How it was made", "", *(f"- {s}" for s in origin(about))]) + "\n"


def origin(about: Mapping) -> list[str]:
    """Return sentences about the run that made the report."""
    made, job, measured = about["made"], about["job"], about["measured"]
    lines = [
        (
            f"Side: {about['side']}. Measured: {number_of(measured['scenes'], 'scene')} of"
            f" {number_of(measured['shapes'], 'shape')} in"
            f" {number_of(measured['targets'], 'target material')} under"
            f" {number_of(measured['lights'], 'light')}. The design has"
            f" {number_of(about['designed'], 'scene')} beside those"
            f" of outside meshes: shapes {', '.join(job['shapes'])}; materials"
            f" {', '.join(job['materials'])}; lights {', '.join(job['lights'])};"
            f" {number_of(job['samples'], 'sample')}."
        ),
        (
            "Brackets: 95 % intervals; whole shapes, target materials and lights are drawn with"
            " replacement. A material and a light belong to a third of the shapes each."
        ),
        f"`{made['command']}`, commit {made['commit']}, {made['date']}; {made['machine']}; weights"
        f" {about['weights_name']} {about['weights']}",
    ]
    if not about["outside"]:
        lines.append(
            "Outside meshes: skipped, since the data set has none"
            " (`python -m learn evaluate-ladder --jobs DIR --meshes FOLDER` adds them to the jobs)."
        )
    return lines
