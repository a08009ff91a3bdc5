"""Tables of learn.experiments.editing.relighting, from its rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from learn.experiments import runner

if TYPE_CHECKING:
    import numpy as np


METHODS = {
    "unchanged": "the object's picture unchanged",
    "facing": "normals facing the viewer, mean training material",
    "predicted": "predicted normals and material",
    "normals": "predicted normals, true material",
    "material": "true normals, predicted material",
    "true": "true normals and material",
}


def count_values(rows: Sequence[Mapping[str, Any]], key: str, what: str) -> str:
    """Return how many values of `key` there are, with the word for them."""
    return f"{len({row[key] for row in rows})} {what}"


def by_method(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a row for each of METHODS, of one task's rows on one rung."""
    import numpy as np

    weights = _draws(rows)
    l2 = {key: np.array([row["l2"][key] for row in rows]) for key in METHODS}
    factor = {key: np.array([row["one_factor"][key] for row in rows]) for key in METHODS}
    lines = [
        [
            title,
            runner.mean_interval(l2[key], weights, 0),
            f"{np.median(l2[key]):.0f}",
            *_by_metal(rows, l2[key]),
            runner.mean_interval(factor[key], weights, 0),
            *_by_metal(rows, factor[key]),
            runner.ratio_interval(l2["unchanged"], l2[key], weights, 2),
            f"{(l2[key] < l2['unchanged']).sum()} of {len(rows)}",
        ]
        for key, title in METHODS.items()
    ]
    head = [
        "result",
        "display L2, mean",
        "median",
        "without metals",
        "metals",
        "one factor free, mean",
        "without metals",
        "metals",
        "ratio",
        "better than unchanged",
    ]
    return runner.table(head, lines)


def by_group(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a row of predictions for each group of objects, of one task's rows on one rung."""
    import numpy as np

    from learn.evaluation.ladder_design import GROUPS

    lines = []
    for group in GROUPS:
        chosen = [row for row in rows if row["group"] == group]
        if not chosen:
            continue
        l2 = {key: np.array([row["l2"][key] for row in chosen]) for key in METHODS}
        factor = np.array([row["one_factor"]["predicted"] for row in chosen])
        lines.append(
            [
                group,
                f"{len(chosen)}, {sum(row['metal'] for row in chosen)}",
                runner.mean_interval(l2["predicted"], _draws(chosen), 0),
                *_by_metal(chosen, l2["predicted"]),
                f"{factor.mean():.0f}",
                *_by_metal(chosen, factor),
                f"{l2['unchanged'].mean():.0f}",
                f"{l2['true'].mean():.0f}",
            ]
        )
    head = [
        "object",
        "pictures, of metals",
        "display L2, mean",
        "without metals",
        "metals",
        "one factor free, mean",
        "without metals",
        "metals",
        "unchanged",
        "true parts",
    ]
    return runner.table(head, lines)


def _draws(rows: Sequence[Mapping[str, Any]]) -> np.ndarray:
    """Bootstrap weights of rows: shapes, materials, and lights of both sides are drawn."""
    from learn.metrics import bootstrap

    kinds = ["shape", "material", "from_light", "to_light"]
    if any(row["shape"] != row["material_of"] for row in rows):
        kinds.append("material_of")
    return bootstrap.draws_of_rows(rows, kinds)


def _by_metal(rows: Sequence[Mapping[str, Any]], values: np.ndarray) -> list[str]:
    """Means of values (one per row) without metals and of metals."""
    import numpy as np

    metal = np.array([row["metal"] for row in rows])
    return [f"{values[each].mean():.0f}" if each.any() else "–" for each in (~metal, metal)]
