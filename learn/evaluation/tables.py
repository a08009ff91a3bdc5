"""Tables of the evaluation: means, 95 % intervals, and differences between methods.

Intervals are by learn.metrics.bootstrap over shapes, materials and lights; of edits, over their
target materials.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from learn.evaluation import breakdowns, layer_table, refinement_table
from learn.evaluation.breakdowns import Families, groupings, has_metal
from learn.evaluation.methods import OURS, OURS_REFINED
from learn.evaluation.table import Cell, Column, Rows, Table, TableRow, column, table
from learn.metrics import bootstrap

# path of the figures below a method, their columns, and a suffix of the cells' keys
Group = tuple[tuple[str, ...], list[Column], str]

LPIPS = column("lpips", "LPIPS ↓", 3)
ALIGNED = [
    column("l2", "L2 ↓", 0, True),
    column("l2_one_factor", "L2 after one factor ↓", 0, True),
    column("l2_three_factors", "after three ↓", 0, True),
]
DISPLAYED = [
    column("l2_own_exposure", "L2, each at its own exposure ↓", 1),
    column("l2_frame", "L2, frame ↓", 1),
    column("ssim", "SSIM ↑", 4, True),
    column("ssim_frame", "SSIM, frame ↑", 4),
    column("psnr", "PSNR ↑", 2),
    column("flip", "FLIP ↓", 3),
    LPIPS,
]
PICTURE = [
    column("l2", "L2 ↓", 1, True),
    column("l2_frame", "L2, frame ↓", 1),
    column("ssim", "SSIM ↑", 4, True),
    column("ssim_frame", "SSIM, frame ↑", 4),
    column("psnr", "PSNR ↑", 2),
    column("flip", "FLIP ↓", 3),
    LPIPS,
]
GIVEN = [
    column("l2_true_light", "L2, light given ↓", 1, True),
    column("l2_true_normals", "L2, normals given ↓", 1, True),
]
LIT = [column("l2", "L2, light given ↓", 1, True)]
NORMALS = [
    column("mean_deg", "mean ° ↓", 2, True),
    column("median_deg", "median ° ↓", 2, True),
    column("below_11.25", "< 11.25° ↑", 3),
    column("below_22.5", "< 22.5° ↑", 3),
    column("below_30", "< 30° ↑", 3),
    column("cosine", "cosine ↑", 4),
]
MATERIAL = [
    column("brdf_log", "BRDF, log error ↓", 3, True),
    column("log_l2", "coefficients L2 (log) ↓", 3, True),
    column("code_l2", "coefficients L2 (codes) ↓", 4),
]
LIGHT = [
    column("direction_deg", "brightest direction, ° ↓", 1, True),
    column("irradiance", "irradiance, relative ↓", 3, True),
    column("spheres_l2", "three spheres L2 ↓", 0, True),
    column("matte_sphere_l2", "matte ↓", 0),
    column("glossy_sphere_l2", "glossy ↓", 0),
    column("sharp_sphere_l2", "sharp ↓", 0),
]
PROBES = [
    column(f"{sphere}_{figure}", f"{words}, {label} ↓", digits)
    for sphere, words in (("diffuse", "diffuse"), ("silver", "matte silver"), ("mirror", "mirror"))
    for figure, label, digits in (
        ("rmse", "RMSE", 3),
        ("si_rmse", "scale-invariant", 3),
        ("angular_deg", "angular °", 1),
    )
]
SHORT = [
    column("l2", "rendered L2 ↓", 1, True),
    column("ssim", "rendered SSIM ↑", 4, True),
    column("flip", "rendered FLIP ↓", 3),
]
MEANS: dict[str, Callable[[np.ndarray], np.floating]] = {
    "mean": np.mean,
    "median": np.median,
    "geometric": lambda x: np.exp(np.log(x).mean()),
}


MAIN_NOTE = (
    "Mean display L2 over the mask. After one factor: were the edit's brightness forgiven; after"
    " three: its colour too. Metals: edits into a material of the family “metal”."
)
MATERIAL_NOTE = (
    "The method's material, with true normals and light, rendered again and compared with the"
    " picture (the paper's Table 1)."
)
NORMALS_NOTE = (
    "The method's normals, with true material and light, rendered again (the paper's Table 2)."
)
LIGHT_NOTE = "The method's light, with true normals and material, rendered again."
RERENDERED_NOTE = (
    "All three parts of the method. Light given: were the light not predicted but true."
)
DISPLAYED_NOTE = (
    "Each at its own exposure: the edit's own 99th percentile of luminance is brought to 1, as"
    " the truth's is. The other figures are under the truth's exposure, as L2 is."
)
PROBES_NOTE = (
    "The method's light on a diffuse, a matte silver and a mirror sphere, in linear radiance of"
    " maps of unit mean (learn.metrics.light_probes). Scale-invariant: after the one factor"
    " that makes the RMSE least. Angular: between the colours of a pixel."
)
GIVEN_NOTE = (
    "Light given, normals given: the same edits were that part not predicted but true. It shows"
    " where the error comes from."
)


def by_method(rows: Rows, title: str, note: str, groups: Sequence[Group]) -> Table | None:
    """Return a table with a row per method; rows without any figure are left out."""
    results: list[TableRow] = []
    for name in rows.methods():
        cells: dict[str, Cell] = {
            c["key"] + suffix: rows.cell(name, (*path, c["key"]))
            for path, columns, suffix in groups
            for c in columns
        }
        if any(cell is not None for cell in cells.values()):
            results.append({"name": name, "cells": cells})
    columns = [
        column(c["key"] + suffix, c["label"], c["digits"], c["interval"])
        for _, columns, suffix in groups
        for c in columns
    ]
    return table(title, note, columns, [row for row in results if not is_borrowed(row, results)])


def edits_by_method(rows: Rows, known: Families) -> Table | None:
    """Return the main table: L2 of edits, aligned, as a median, and with metals by themselves.

    known  as `gains_table` has them
    """
    result = by_method(rows, "Edits against their truth", MAIN_NOTE, [((), ALIGNED, "")])
    if result is None:
        return None
    metal = np.array([has_metal(row["wanted"], known) for row in rows.rows], bool)
    for row in result["rows"]:
        l2 = rows.values(row["name"], ("l2",))
        row["cells"] |= {
            "median": float(np.nanmedian(l2)),
            "without_metals": rows.interval(np.where(metal, np.nan, l2)),
            "metals": rows.interval(np.where(metal, l2, np.nan)),
        }
    more = [
        column("median", "median L2 ↓", 0),
        column("without_metals", "L2 without metals ↓", 0, True),
        column("metals", "L2 of metals ↓", 0, True),
    ]
    return table(result["title"], result["note"], [*result["columns"], *more], result["rows"])


def is_borrowed(row: TableRow, rows: Iterable[TableRow]) -> bool:
    """Return whether all figures of a method "… of another" are that other's."""
    return any(
        other is not row
        and row["name"].endswith(f"of {other['name']}")
        and other["cells"] == row["cells"]
        for other in rows
    )


def difference_table(rows: Rows) -> Table | None:
    """Return a table of L2 differences on the same edits: ours, refined or not, minus the others.

    A difference is called better or worse if its interval excludes 0.
    """
    results: list[TableRow] = []
    for mine in (OURS, OURS_REFINED):
        a = rows.values(mine, ("l2",))
        for other in rows.methods() if np.isfinite(a).any() else ():
            b = rows.values(other, ("l2",))
            if (
                other == mine
                or (mine == OURS and other == OURS_REFINED)
                or not np.isfinite(b).any()
            ):
                continue
            both = np.isfinite(a + b)
            difference = rows.interval(a - b)
            cells: dict[str, Cell] = {
                "difference": difference,
                "ratio": bootstrap.relative(b[both], a[both], rows.draws(both)),
                "won": float((a < b)[both].mean()),
                "verdict": _verdict(difference, rows.enough),
            }
            results.append({"name": f"{mine} − {other}", "cells": cells})
    columns = [column("difference", "L2 difference", 1, True), column("ratio", "L2 ratio", 3, True)]
    columns += [column("won", "edits won", 2), column("verdict", "at 95 %")]
    note = "Mean over the same edits; the interval of a difference that leaves out 0 decides."
    return table("Differences on the same edits", note, columns, results)


def _verdict(difference: list[float] | None, enough: bool) -> str:
    if not enough:
        return "undecided: two shapes and two materials are needed"
    if difference is None or difference[1] <= 0 <= difference[2]:
        return "undecided: 0 is inside"
    return "better" if difference[2] < 0 else "worse"


def gains_table(rows: Rows, known: Families) -> Table | None:
    """Return a table of what refinement takes off the edits' mean, median and geometric mean.

    It has rows of all edits, and by light, by shape and by the family of the target material.

    known  {name: family} of the dataset's materials
    """
    before, after = (rows.values(name, ("l2",)) for name in (OURS, OURS_REFINED))
    both = np.isfinite(before + after)
    if not both.any():
        return None

    groups = {"all edits": both}
    for title, of in groupings(known).items():
        names = np.array([of(row) for row in rows.rows])
        groups |= {f"{title}: {name}": both & (names == name) for name in np.unique(names)}
    results: list[TableRow] = []
    for title, group in groups.items():
        if group.any():
            a, b = before[group], after[group]
            cells: dict[str, Cell] = {
                "edits": int(group.sum()),
                "ratio": bootstrap.relative(a, b, rows.draws(group)),
                "won": float((b < a).mean()),
                "worse": int((b > a).sum()),
            }
            for name, mean in MEANS.items():
                cells |= {name: float(mean(a)), f"{name}_after": float(mean(b))}
            results.append({"name": title, "cells": cells})
    columns = [column("edits", "edits", 0), column("ratio", "ratio of means", 3, True)]
    for name, label in (("mean", "mean"), ("median", "median"), ("geometric", "geometric mean")):
        columns += [column(name, f"{label} before", 0), column(f"{name}_after", "after", 0)]
    columns += [column("won", "edits better", 3), column("worse", "edits worse", 0)]
    note = "Display L2 of ours over the mask, as predicted and refined."
    return table("What refinement takes off edits", note, columns, results)


def make_tables(
    pictures: Sequence[dict],
    edits: Sequence[dict],
    families: Families,
    distances: Mapping[str, Mapping[str, float]],
) -> dict[str, Table]:
    """Return {key: table} of rows of pictures.jsonl and edits.jsonl, without empty tables.

    families   as `gains_table` has them
    distances  as learn.evaluation.breakdowns.distance_table has them
    """
    P, E = Rows(pictures, "materials"), Rows(edits, "wanted")
    result = {
        "edits": edits_by_method(E, families),
        "differences": difference_table(E),
        "gains": gains_table(E, families),
        "worst": breakdowns.worst_edits(E, P, families),
        "distance": breakdowns.distance_table(E, P, distances),
        "displayed": by_method(
            E, "The same edits by other measures", DISPLAYED_NOTE, [((), DISPLAYED, "")]
        ),
        "given": by_method(
            E, "Edits with one part given", GIVEN_NOTE, [((), ALIGNED[:1] + GIVEN, "")]
        ),
        "refinement": refinement_table.refinement_table(P, E),
        "rerendered": by_method(
            P,
            "Pictures rendered again",
            RERENDERED_NOTE,
            [(("rendered_all",), PICTURE, ""), (("rendered_all_true_light",), LIT, "_lit")],
        ),
        "material": by_method(
            P,
            "Material",
            MATERIAL_NOTE,
            [(("material",), MATERIAL, ""), (("rendered_material",), SHORT, "_rendered")],
        ),
        "normals": by_method(
            P,
            "Normals",
            NORMALS_NOTE,
            [(("normals",), NORMALS, ""), (("rendered_normals",), SHORT, "_rendered")],
        ),
        "light": by_method(
            P,
            "Light",
            LIGHT_NOTE,
            [(("light",), LIGHT, ""), (("rendered_light",), SHORT, "_rendered")],
        ),
        "probes": by_method(P, "Light on three spheres", PROBES_NOTE, [(("light",), PROBES, "")]),
        "layer": layer_table.layer_table(E),
    }
    return {key: value for key, value in result.items() if value is not None}
