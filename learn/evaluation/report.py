"""The evaluation's report: report.json holds every table, report.md and index.html show them."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from learn.data.records import Records
from learn.evaluation import page, tables
from learn.evaluation.methods import OURS, OURS_REFINED, ComparedMethods
from learn.evaluation.table import Cell, Table
from learn.metrics.pictures import Perceptual
from manifests import files
from manifests.provenance import provenance
from manifests.schema import Record
from manifests.store_paths import file_hash
from manifests.wording import number_of

if TYPE_CHECKING:
    from learn.evaluation.run import Options

CURVE = (
    "radiance × exposure, clipped to [0, 1], sRGB curve (IEC 61966-2-1), × 255; exposure: the"
    " truth's 99th percentile of luminance → 1"
)

PATHS = ("data", "weights", "out", "baselines", "lpips", "lights", "geometry")  # of Options


def about(
    options: "Options",
    records: Records,
    used: Sequence[Record],
    left_out: Mapping[str, str],
    perceptual: Perceptual | None,
) -> dict:
    """Return what the figures were made from, and what is missing from them.

    used      records that edits were drawn from
    left_out  {method: why it is missing}
    """
    splits = {record.split for record in used}
    held_out = (
        "shapes and materials of the test side"
        if splits == {"test"}
        else "no test side: what networks were trained on is among it"
    )
    missing = dict(left_out)
    if perceptual is None:
        missing["LPIPS"] = "no weights were given (--lpips FILE); nothing is downloaded"
    asked = {
        key: str(value) if isinstance(value, Path) else value
        for key, value in asdict(options).items()
    }
    return {
        "made": provenance(),
        "asked": {
            key: (Path(value).name if key in PATHS and value else value)
            for key, value in asked.items()
        },
        "data": (
            f"{number_of(len(used), 'picture')},"
            f" {number_of(len({r.shape for r in used}), 'shape')},"
            f" {number_of(len({r.light for r in used}), 'light')}; {held_out}"
        ),
        "tiers": sorted(
            {
                f"{r.tier}, light {r.light_resolution}, {number_of(r.samples, 'sample')}"
                for r in used
            }
        ),
        "jobs": msgspec.to_builtins([order.job for order in records.dataset.orders]),
        "weights": file_hash(options.weights)[:12],
        "lpips": None if options.lpips is None else file_hash(options.lpips)[:12],
        "tone curve": CURVE,
        "missing": missing,
    }


def write(
    out: Path,
    pictures: Sequence[dict],
    edits: Sequence[dict],
    shown: Iterable[str],
    about: dict,
    methods: ComparedMethods,
    families: Mapping[str, str],
    distances: Mapping[str, Mapping[str, float]],
) -> dict:
    """Write report.json, report.md and index.html into `out`, and return the first of them.

    pictures, edits  rows of the two files of lines
    shown            ids of the edits whose gallery pictures are shown
    families         {name: family} of the dataset's materials
    distances        to the nearest training items (learn.evaluation.distances)
    """
    result = tables.make_tables(pictures, edits, families, distances)
    commits = sorted({row.get("commit", "none") for row in (*pictures, *edits)})
    report = {
        "about": about | {"edits": len(edits), "pictures": len(pictures), "lines": commits},
        "headline": headline(result),
        "distances": distances,
        "tables": result,
    }
    names = [method.name for method in methods.edits]
    by_id = {row["id"]: row for row in edits}
    gallery = [(by_id[id_], out / "gallery" / f"{id_}.png") for id_ in shown if id_ in by_id]
    texts = {
        "report.json": json.dumps(report, indent=1, ensure_ascii=False) + "\n",
        "report.md": page.markdown(report),
        "index.html": page.web(
            report, [(row, path) for row, path in gallery if path.exists()], names
        ),
    }
    with files.transaction():
        for name, text in texts.items():
            files.write_text(out / name, text)
    return report


def headline(results: Mapping[str, Table]) -> list[str]:
    """Return the main results in sentences, each from the tables alone."""
    edits = results["edits"]["rows"] if "edits" in results else []
    rows = {row["name"]: row["cells"] for row in edits}
    report: list[str] = []
    if OURS in rows:
        mean, low, high = _interval(rows[OURS]["l2"])
        sentence = (
            f"An edit differs from its truth by a display L2 of {mean:.0f} [{low:.0f}, {high:.0f}]"
            " over the mask"
        )
        if OURS_REFINED in rows:
            after, low, high = _interval(rows[OURS_REFINED]["l2"])
            change = 100 * (after / mean - 1)
            sentence += (
                f"; after refinement by {after:.0f} [{low:.0f}, {high:.0f}]: {change:+.0f} %"
            )
        report.append(f"{sentence}.")
        of_factor = _sentence_on_alignment(rows)
        report += [of_factor] if of_factor else []
        given = {row["name"]: row["cells"] for row in results.get("given", {"rows": []})["rows"]}
        report += [
            f"With true {key} instead of predicted it would be {_interval(cell)[0]:.0f}."
            for key in ("light", "normals")
            if (cell := given.get(OURS, {}).get(f"l2_true_{key}"))
        ]
    if "gains" in results:
        every = results["gains"]["rows"][0]["cells"]
        report.append(f"Refinement made {every['worse']} of {every['edits']} edits worse.")
    if "differences" not in results:
        return report
    return [
        *report,
        _sentence_on_intervals(results, OURS_REFINED if OURS_REFINED in rows else OURS),
    ]


def _sentence_on_alignment(rows: Mapping[str, Mapping[str, Cell]]) -> str | None:
    """A sentence on the best of our rows after one and three factors; None without them."""
    cells = rows.get(OURS_REFINED, rows[OURS])
    if cells.get("l2_one_factor") is None:
        return None
    one, three = (_interval(cells[f"l2_{key}"])[0] for key in ("one_factor", "three_factors"))
    return (
        f"After one factor on the brightness of each edit it is {one:.0f}, after three on its"
        f" colour {three:.0f}; the brightness of a light cannot be determined from one picture."
    )


def _interval(cell: Cell) -> list[float]:
    """The [mean, low, high] that a cell of a display L2 is."""
    if not isinstance(cell, list):
        raise ValueError(f"cell: expected [mean, low, high], found {cell!r}")
    return cell


def _sentence_on_intervals(results: Mapping[str, Table], mine: str) -> str:
    """A sentence on which methods `mine` is better or worse than by the intervals."""
    said: dict[str, list[str]] = {}
    for row in results["differences"]["rows"]:
        name, other = row["name"].split(" − ")
        if name == mine and other != "the layer alone":
            verdict = str(row["cells"]["verdict"]).split(":")[0]
            said.setdefault(verdict, []).append(f"“{other}”")
    words = {"better": "better than", "worse": "worse than", "undecided": "not separable from"}
    judged = "; ".join(f"{words[verdict]} {', '.join(others)}" for verdict, others in said.items())
    return f"By 95 % intervals of the difference on the same edits, “{mine}” is {judged}."


def summary_line(report: Mapping) -> str:
    """Return the report's first sentence for the terminal; without one, the number of edits."""
    return (
        report["headline"][0] if report["headline"] else number_of(report["about"]["edits"], "edit")
    )
