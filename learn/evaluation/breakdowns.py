"""Tables of the evaluation by family, and by distance to the nearest training item."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from learn.evaluation.methods import OURS, OURS_REFINED
from learn.evaluation.table import Cell, Rows, Table, TableRow, column, table
from learn.metrics import bootstrap

METAL = "metal"  # family of the catalogue; metallic paints are another
THIRDS_FROM = 9  # items; fewer are split into halves
TITLES = {"shapes": "shape", "materials": "input material", "lights": "light"}
ITEMS = {"shapes": "shape", "lights": "light"}  # keys of a row
# columns of a picture's figures: {key: (label, digits, path below the method)}
OF_PICTURES = {
    "normals": ("normals, mean °", 1, ("normals", "mean_deg")),
    "irradiance": ("irradiance, relative", 3, ("light", "irradiance")),
}

Families = Mapping[str, str]  # {material: its family in the catalogue}


def family(names: Sequence[str], known: Families) -> str:
    """Return the family of a picture's materials, or that there are several or none known."""
    families = {known.get(name, "of no known family") for name in names}
    return families.pop() if len(families) == 1 else "several families"


def has_metal(names: Sequence[str], known: Families) -> bool:
    """Return whether one of a picture's materials is a metal."""
    return any(known.get(name) == METAL for name in names)


def groupings(known: Families) -> dict[str, Callable[[dict], str]]:
    """Return {title: function of an edit's row}, by which edits are grouped."""
    return {
        "light": lambda row: row["light"],
        "shape": lambda row: row["category"],
        "into": lambda row: family(row["wanted"], known),
    }


def worst_edits(edits: Rows, pictures: Rows, known: Families) -> Table | None:
    """Return a table of the mean and the worst edit of each family, and its normals."""
    mine = OURS_REFINED if np.isfinite(edits.values(OURS_REFINED, ("l2",))).any() else OURS
    l2, factor = (edits.values(mine, (key,)) for key in ("l2", "l2_one_factor"))
    angles = pictures.values(mine, ("normals", "mean_deg"))
    results: list[TableRow] = []
    for title, of in groupings(known).items():
        names = np.array([of(row) for row in edits.rows])
        for name in np.unique(names):
            group = np.flatnonzero((names == name) & np.isfinite(l2))
            if not len(group):
                continue
            top = edits.rows[int(group[np.argmax(l2[group])])]
            cells: dict[str, Cell] = {
                "edits": len(group),
                "l2": edits.interval(np.where(names == name, l2, np.nan)),
                "one_factor": _mean(factor[group]),
                "worst": float(l2[group].max()),
                "which": (
                    f"{'+'.join(dict.fromkeys(top['materials']))} →"
                    f" {'+'.join(dict.fromkeys(top['wanted']))}, {top['shape']}, {top['light']}"
                ),
            }
            if title != "into":
                here = np.array([of(row) == name for row in pictures.rows], bool)
                here &= np.isfinite(angles)
                if here.any():
                    cells |= {
                        "normals": float(angles[here].mean()),
                        "normals_worst": float(angles[here].max()),
                    }
            results.append({"name": f"{title}: {name}", "cells": cells})
    columns = [
        column("edits", "edits", 0),
        column("l2", "mean L2", 0, True),
        column("one_factor", "after one factor", 0),
        column("worst", "worst L2", 0),
        column("which", "the worst edit"),
        column("normals", "normals, mean °", 1),
        column("normals_worst", "worst picture °", 1),
    ]
    note = f"“{mine}”: the mean over the edits of each light and family, and the worst of them."
    return table("Each family and its worst edit", note, columns, results)


def distance_table(
    edits: Rows, pictures: Rows, distances: Mapping[str, Mapping[str, float]]
) -> Table | None:
    """Return a table of edits and pictures by their distance to the nearest training item.

    distances  {"shapes", "materials", "lights": {name: distance, 0 for an item of training}}
               (learn.evaluation.distances); of materials the input's count
    """
    results = [
        row for kind, known in distances.items() for row in _rows_of(kind, known, edits, pictures)
    ]
    columns = [
        column("items", "items", 0),
        column("distance", "mean distance", 2),
        column("edits", "edits", 0),
        column("l2", f"{OURS}, L2", 0, True),
        column("refined", f"{OURS_REFINED}, L2", 0, True),
        column("ratio", "ratio of means", 3),
        *(column(key, label, digits, True) for key, (label, digits, _) in OF_PICTURES.items()),
    ]
    note = (
        "Shapes: mean angle between the normals of the shape's views and the nearest views of one"
        " training shape, in degrees, 90° where only one of the two is. Materials: log error of the"
        " BRDF against the nearest training label in the weights; of"
        " weights without labels, against all of the training side that --materials names, of which"
        " validation materials are a part, so that “of training” may include these. Lights:"
        " relative error of irradiance against the nearest training map, turned and mirrored"
        " freely. “Of training” is the paper's own protocol: maps of training at other"
        " rotations. Normals and irradiance are those predicted, over the pictures. A row of a"
        " difference has the interval of the difference."
    )
    return table("By distance to the nearest training item", note, columns, results)


def _rows_of(kind: str, known: Mapping[str, float], edits: Rows, pictures: Rows) -> list[TableRow]:
    """Return the rows of one kind of items: one per group, and the farthest less the nearest."""
    before, after = (edits.values(name, ("l2",)) for name in (OURS, OURS_REFINED))
    figures = {key: pictures.values(OURS, path) for key, (_, _, path) in OF_PICTURES.items()}
    groups = _groups(known)
    of_edits, of_pictures = (
        {
            words: np.array([_item(row, kind, known) in names for row in rows.rows], bool)
            for words, names in groups.items()
        }
        for rows in (edits, pictures)
    )
    results: list[TableRow] = []
    for words, names in groups.items():
        chosen = of_edits[words]
        if not chosen.any():
            continue
        cells: dict[str, Cell] = {
            "items": len(names),
            "distance": float(np.mean([known[name] for name in names])),
            "edits": int(chosen.sum()),
            "l2": edits.interval(np.where(chosen, before, np.nan)),
            "refined": edits.interval(np.where(chosen, after, np.nan)),
        }
        both = chosen & np.isfinite(before + after)
        if both.any():
            cells["ratio"] = float(after[both].mean() / before[both].mean())
        for key, values in figures.items():
            cells[key] = pictures.interval(np.where(of_pictures[words], values, np.nan))
        results.append({"name": f"{TITLES[kind]}: {words}", "cells": cells})
    near, far = _nearest_and_farthest(groups)
    if near and far and of_edits[near].any() and of_edits[far].any():
        ends = (of_edits[near], of_edits[far])
        cells = {
            "l2": _difference(edits, before, ends),
            "refined": _difference(edits, after, ends),
        }
        ends = (of_pictures[near], of_pictures[far])
        cells |= {key: _difference(pictures, each, ends) for key, each in figures.items()}
        results.append({"name": f"{TITLES[kind]}: {far} − {near}", "cells": cells})
    return results


def _nearest_and_farthest(groups: Mapping[str, Sequence[str]]) -> tuple[str, str]:
    """Return the titles of the nearest and the farthest group; "", "" if one has all items."""
    words = [each for each, names in groups.items() if names]
    return (words[0], words[-1]) if len(words) > 1 else ("", "")


def _difference(
    rows: Rows, values: np.ndarray, ends: tuple[np.ndarray, np.ndarray]
) -> list[float] | None:
    """Return [mean, low, high] of a far group's mean less a near one's; None without both.

    values  (P,) of all rows; ends: the near and the far group, (P,) bool each
    """
    here = [each & np.isfinite(values) for each in ends]
    if not all(each.any() for each in here):
        return None
    weights = [rows.weights[:, each] for each in here]
    drawn = (weights[0].sum(1) > 0) & (weights[1].sum(1) > 0)
    near, far = (
        weight[drawn] @ values[each] / weight[drawn].sum(1)
        for weight, each in zip(weights, here, strict=True)
    )
    mean = float(values[here[1]].mean() - values[here[0]].mean())
    return [mean, *(float(x) for x in np.percentile(far - near, bootstrap.LEVELS))]


def _item(row: Mapping, kind: str, known: Mapping[str, float]) -> str:
    """Return a row's shape or light, or of its input's materials the farthest from training."""
    if kind != "materials":
        return str(row[ITEMS[kind]])
    return max(row["materials"], key=lambda name: known.get(name, 0.0))


def _groups(known: Mapping[str, float]) -> dict[str, list[str]]:
    """Return {title: names}: items of training, and the others in equal halves or thirds."""
    seen = [name for name, distance in known.items() if distance == 0]
    others = sorted((name for name in known if name not in seen), key=known.__getitem__)
    words: tuple[str, ...] = ("nearest third", "middle third", "farthest third")
    if len(others) < THIRDS_FROM:
        words = ("nearer half", "farther half") if len(others) > 1 else ("not of training",)
    parts = [[str(name) for name in part] for part in np.array_split(others, len(words))]
    return {"of training": seen} | dict(zip(words, parts, strict=True))


def _mean(values: np.ndarray) -> float | None:
    return float(np.nanmean(values)) if np.isfinite(values).any() else None
