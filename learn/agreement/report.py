"""The whole comparison: every scene of a dataset, then the files that tell of it."""

import heapq
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np
from tqdm import tqdm

from learn.agreement import causes, page, plots
from learn.agreement.measure import measure, rendered
from learn.agreement.scenes import scenes
from learn.agreement.summary import summarise
from learn.data.records import Records
from manifests import files
from manifests.errors import InputError
from manifests.provenance import provenance

PANELS = 9  # pictures shown, the worst of the direct tier first


@dataclass(frozen=True)
class Options:
    """folder of the dataset; out; limit: pictures at most, None: all; tolerance of the converged
    integral; device: of the layer's pictures.

    What takes a disagreement apart (learn.agreement.causes) is computed on the CPU, in float64.
    """

    folder: Path
    out: Path
    limit: int | None = None
    tolerance: float = 4e-3
    device: object = "cpu"


class Worst:
    """The PANELS largest of what is offered; the rest is let go."""

    def __init__(self):
        self.heap, self.order = [], count()

    def offer(self, value, caption, pictures):
        item = (value, next(self.order), caption, [p.astype(np.float32) for p in pictures])
        (heapq.heappushpop if len(self.heap) >= PANELS else heapq.heappush)(self.heap, item)

    def panels(self):
        return [(caption, *pictures) for _, _, caption, pictures in sorted(self.heap, reverse=True)]


def limited(groups, limit):
    """Whole scenes, spread over the dataset, of at most `limit` pictures (at least one scene)."""
    if limit is None:
        return groups
    order = np.random.default_rng(0).permutation(len(groups))
    taken, total = [], 0
    for index in order:
        size = sum(len(condition.records) for condition in groups[index])
        if taken and total + size > limit:
            continue
        taken.append(index)
        total += size
    return [groups[index] for index in sorted(taken)]


def compare(options):
    """Rows of every condition and the panels to show. Raises InputError for a dataset without
    records, or a damaged file.
    """
    records = Records(options.folder)
    if not len(records):
        raise InputError(
            options.folder,
            "a dataset with records",
            "none",
            "render some with: python -m factory render JOB --out DIR",
        )
    groups = limited(scenes(records.records), options.limit)
    rows, worst = [], Worst()
    total = sum(len(condition.records) for group in groups for condition in group)
    with tqdm(total=total, unit="picture", desc="agree") as bar:
        for group in groups:
            sample = records.load(group[0].records[0])
            if not sample.mask.any():
                bar.update(sum(len(condition.records) for condition in group))
                continue
            layer = rendered(sample, options.tolerance, options.device)
            entries = [records.material(name) for name in group[0].records[0].materials]
            for condition in group:
                row, shown = compare_condition(condition, records, sample, layer, entries)
                rows.append(row)
                caption = (
                    f"{row.shape}, {' + '.join(dict.fromkeys(row.materials))}, {row.light} turned"
                    f" {row.rotation_texels}, {row.tier}"
                )
                l2 = f"L2 {row.l2:.3g}" + ("" if row.net is None else f", net {row.net:.3g}")
                worst.offer(
                    (condition.direct, row.net if row.net is not None else row.l2),
                    f"{caption}: {l2}, SSIM {row.ssim:.3f}",
                    shown,
                )
                bar.update(len(condition.records))
    return rows, worst.panels()


def compare_condition(condition, records, sample, layer, entries):
    """The Row of a condition, causes included where the layer claims to model it, and its display
    pictures.
    """
    pictures = np.stack([records.image(record) for record in condition.records])
    row, shown = measure(condition, pictures, layer, entries)
    if condition.direct:
        row.causes = causes.separate_causes(
            sample, pictures, layer, [entry.mixture for entry in entries], row.exposure
        )
    return row, shown


def about(options):
    """What made the report: command, commit, machine, date."""
    limit = "" if options.limit is None else f" --limit {options.limit}"
    return provenance(
        f"python -m learn agree {options.folder.name} --out {options.out.name}{limit} --tolerance"
        f" {options.tolerance:g}"
    )


def make(options):
    """Compare, and write report.json, report.md, index.html and the charts to options.out. Returns
    the summary.
    """
    rows, panels = compare(options)
    summary, origin = summarise(rows), about(options)
    options.out.mkdir(parents=True, exist_ok=True)
    drawn = plots.draw(summary, rows)
    report = {"about": origin, "summary": summary, "conditions": [row.to_json() for row in rows]}
    with files.transaction():
        for name, (png, _) in drawn.items():
            files.write_bytes(options.out / name, png)
        files.write_json(options.out / "report.json", report)
        files.write_text(options.out / "report.md", page.markdown(summary, origin))
        files.write_text(
            options.out / "index.html", page.web(summary, origin, drawn.values(), panels)
        )
    return summary
