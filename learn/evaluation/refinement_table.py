"""The table of refinement's effect on its initialisations."""

from collections.abc import Iterable, Sequence
from functools import partial

import numpy as np

from learn.evaluation.table import Cell, Rows, Table, TableRow, column, table


def refinement_table(rows: Rows, edits: Rows | None = None) -> Table | None:
    """Return a table of refinement's effect on its initialisations, by method and all together.

    edits  of the same pictures, of which those that refinement made worse are counted
    """
    refined = [
        name
        for name in rows.methods()
        if any("refinement" in row["methods"].get(name, {}) for row in rows.rows)
    ]
    groups = {name: [name] for name in refined} | (
        {"all initialisations": refined} if len(refined) > 1 else {}
    )
    results: list[TableRow] = [
        {"name": title, "cells": _cells(rows, names, edits)} for title, names in groups.items()
    ]
    columns = [
        column("starts", "initialisations", 0),
        column("above", "ended above it", 0),
        column("worse_edits", "edits that got worse", 0),
        column("edits", "of edits", 0),
        column("not_finite", "not finite", 0),
        column("energy", "median energy before", 5),
        column("energy_after", "after", 5),
        column("l2", "median L2 of I′ before", 1),
        column("l2_after", "after", 1),
        column("drop", "share taken off", 3),
        column("worse_l2", "L2 higher than before", 0),
        column("seconds", "median s", 1),
        column("slowest", "slowest s", 1),
    ]
    return table(
        "Refinement",
        "Energy: Eq. 6 as learn.refinement states it; a step that raises it is not accepted, so"
        " that none can end above its initialisation. The edits that got worse all the same are"
        " counted beside it. I′: the picture rendered again from refined parts.",
        columns,
        results,
    )


def _cells(rows: Rows, names: Sequence[str], edits: Rows | None) -> dict[str, Cell]:
    """Return the cells of the refinements of some methods, which have their refined names."""
    get = partial(_gather, rows, names)
    before, after, seconds, finite = (
        get(("refinement", key)) for key in ("before", "after", "seconds", "finite")
    )
    plain = [name.removesuffix(", refined") for name in names]
    l2_before, l2_after = (_gather(rows, each, ("rendered_all", "l2")) for each in (plain, names))
    done = np.isfinite(before)
    cells: dict[str, Cell] = {
        "starts": int(done.sum()),
        "above": int((after[done] > before[done]).sum()),
        "not_finite": int((finite[done] != 1).sum()),
        "energy": float(np.median(before[done])),
        "energy_after": float(np.median(after[done])),
        "l2": float(np.nanmedian(l2_before)),
        "l2_after": float(np.nanmedian(l2_after)),
        "drop": float(1 - np.nanmedian(l2_after) / np.nanmedian(l2_before)),
        "worse_l2": int((l2_after > l2_before).sum()),
        "seconds": float(np.median(seconds[done])),
        "slowest": float(seconds[done].max()),
    }
    if edits is not None:
        of_plain, of_refined = (_gather(edits, each, ("l2",)) for each in (plain, names))
        cells |= {
            "worse_edits": int((of_refined > of_plain).sum()),
            "edits": int(np.isfinite(of_plain + of_refined).sum()),
        }
    return cells


def _gather(rows: Rows, names: Iterable[str], path: Sequence[str]) -> np.ndarray:
    """Return one figure of several methods, one after the other; NaN where a row has none."""
    return np.concatenate([rows.values(name, path) for name in names])
