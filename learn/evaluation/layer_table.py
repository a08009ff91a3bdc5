"""The table of edits from true parts: how near the layer comes to Cycles."""

import numpy as np

from learn.agreement.summary import LIMIT
from learn.evaluation.table import Cell, Rows, Table, TableRow, column, table


def layer_table(rows: Rows) -> Table | None:
    """Return a table of the layer's edits from true parts, by target material."""
    # {target material: {truth: figures}}: edits that share a truth count once
    by_material: dict[str, dict[str, dict]] = {}
    for row in rows.rows:
        by_material.setdefault(" + ".join(dict.fromkeys(row["wanted"])), {})[row["truth"]] = row[
            "layer"
        ]
    results: list[TableRow] = [
        {"name": name, "cells": _layer_cells(list(by_material[name].values()))}
        for name in sorted(by_material)
    ]
    judged = [name["cells"] for name in results if "within" in name["cells"]]
    every = _layer_cells([each for truths in by_material.values() for each in truths.values()])
    if judged:
        every |= {
            key: f"{sum(cells[key] == 'yes' for cells in judged)} of {len(judged)}"
            for key in ("within", "within_here")
        }
    results.append({"name": "all", "cells": every})
    columns = [
        column("truths", "truths", 0),
        column("l2", "L2 over the mask", 2),
        column("l2_inner", "L2 inside", 2),
        column("judged", "with a second seed", 0),
        column("net_inner", "L2 inside − noise", 2),
        column("net_error", "± standard error", 2),
        column("fit_here", "node fit at these pixels", 2),
        column("node_fit", "node fit, catalogue", 2),
        column("coarse", "tolerance of the integral", 2),
        column("rest", "Cycles against its nodes − noise", 2),
        column("within", f"within {LIMIT:g} × node fit, catalogue"),
        column("within_here", f"within {LIMIT:g} × node fit at these pixels"),
    ]
    note = (
        "Inside: away from silhouettes, segment borders and creases, where a pixel of Cycles sees"
        " one surface. Noise is known, and the row judged, where Cycles rendered the truth with a"
        " second seed. Node fit: display L2 between label and nodes, the two forms of a material;"
        " the catalogue's is of spheres under its own lights. Cycles against its nodes: what is"
        " left where a converged integral is taken of the nodes instead of the label: it is this,"
        " and the tolerance, that the loop adds to the fit."
    )
    return table("True normals, light and label through the layer", note, columns, results)


def _layer_cells(truths: list[dict]) -> dict[str, Cell]:
    def mean(key: str, among: list[dict]) -> float | None:
        values = [each[key] for each in among if each.get(key) is not None]
        return float(np.mean(values)) if values else None

    judged = [each for each in truths if each.get("net_inner") is not None]
    cells: dict[str, Cell] = {"truths": len(truths), "judged": len(judged)}
    cells |= {key: mean(key, truths) for key in ("l2", "l2_inner", "node_fit")}
    cells |= {key: mean(key, judged) for key in ("net_inner", "fit_here", "coarse", "rest")}
    if judged:
        cells["net_error"] = float(
            np.sqrt(sum(each["net_error"] ** 2 for each in judged)) / len(judged)
        )
        net = mean("net_inner", judged)
        for key, fit in (("within", "node_fit"), ("within_here", "fit_here")):
            if net is not None and (limit := mean(fit, judged)) is not None:
                cells[key] = "yes" if net <= LIMIT * limit else "no"
    return cells
