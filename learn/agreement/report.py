"""`learn agree`: the comparison of every scene of a dataset, and its report."""

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np
import torch

from learn.agreement import causes, facets, page, plots
from learn.agreement.measure import Layer, Row, measure, render_sample
from learn.agreement.scenes import Condition, scenes
from learn.agreement.summary import summarise
from learn.data.records import Records, Sample
from manifests import files
from manifests.errors import InputError
from manifests.materials import Material
from manifests.progress import tqdm
from manifests.provenance import provenance

PANELS = 9  # pictures shown, the worst of the direct tier first

Panel = tuple[str, np.ndarray, np.ndarray]  # caption, and display pictures of Cycles and the layer


@dataclass(frozen=True)
class Options:
    """What is compared.

    folder     of the dataset
    out        folder of the report
    limit      largest number of pictures; None: all
    tolerance  of the converged integral
    device     of the layer's pictures; causes (learn.agreement.causes) are measured on the CPU, in
               float64
    """

    folder: Path
    out: Path
    limit: int | None = None
    tolerance: float = 4e-3
    device: str | torch.device = "cpu"


class Worst:
    """Keeps the PANELS pictures of the largest values that it is offered."""

    def __init__(self) -> None:
        self.heap: list[tuple] = []
        self.order = count()

    def offer(
        self, value: tuple[bool, float], caption: str, pictures: Sequence[np.ndarray]
    ) -> None:
        """Keep a caption and two display pictures if their value is among the largest."""
        item = (value, next(self.order), caption, [p.astype(np.float32) for p in pictures])
        (heapq.heappushpop if len(self.heap) >= PANELS else heapq.heappush)(self.heap, item)

    def panels(self) -> list[Panel]:
        """Return what was kept, the largest value first."""
        return [(caption, *pictures) for _, _, caption, pictures in sorted(self.heap, reverse=True)]


def limit_scenes(groups: list[list[Condition]], limit: int | None) -> list[list[Condition]]:
    """Return scenes, spread over the dataset, of at most `limit` pictures; at least one scene."""
    if limit is None:
        return groups
    order = np.random.default_rng(0).permutation(len(groups))
    chosen: list[int] = []
    total = 0
    for index in order:
        size = sum(len(condition.records) for condition in groups[index])
        if chosen and total + size > limit:
            continue
        chosen.append(index)
        total += size
    return [groups[index] for index in sorted(chosen)]


def compare(options: Options) -> tuple[list[Row], list[Panel]]:
    """Return the rows of every condition, and the panels to show.

    Raises  InputError for a dataset without records, or a damaged file
    """
    records = Records(options.folder)
    if not len(records):
        raise InputError(
            options.folder,
            "a dataset with records",
            "none",
            "render some with: python -m factory render JOB --out DIR",
        )
    groups = limit_scenes(scenes(records.records), options.limit)
    rows, worst = [], Worst()
    total = sum(len(condition.records) for group in groups for condition in group)
    with tqdm(total=total, unit="picture", desc="agree") as bar:
        for group in groups:
            sample = records.load(group[0].records[0])
            if not sample.mask.any():
                bar.update(sum(len(condition.records) for condition in group))
                continue
            layer = render_sample(sample, options.tolerance, options.device)
            entries = [records.material(name) for name in group[0].records[0].materials]
            forms = None
            if any(condition.direct and len(condition.records) > 1 for condition in group):
                forms = facets.closed_forms(sample, [entry.mixture for entry in entries])
            for condition in group:
                row, shown = compare_condition(condition, records, sample, layer, entries, forms)
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


def compare_condition(
    condition: Condition,
    records: Records,
    sample: Sample,
    layer: Layer,
    entries: Sequence[Material],
    forms: facets.ClosedForms | None = None,
) -> tuple[Row, tuple[np.ndarray, np.ndarray]]:
    """Return the Row of a condition, and its display pictures.

    The causes are measured where the layer models the condition.
    """
    pictures = np.stack([records.image(record) for record in condition.records])
    row, shown = measure(condition, pictures, layer, entries)
    if condition.direct:
        row.causes = causes.separate_causes(
            sample, pictures, layer, [entry.mixture for entry in entries], row.exposure
        )
        if forms is not None:
            row.whole = facets.figures(pictures, layer.mask, layer.integral, forms, row.exposure)
    return row, shown


def about(options: Options) -> dict[str, str]:
    """Return the report's provenance: command, commit, machine and date."""
    limit = "" if options.limit is None else f" --limit {options.limit}"
    return provenance(
        f"python -m learn agree {options.folder.name} --out {options.out.name}{limit} --tolerance"
        f" {options.tolerance:g}"
    )


def make(options: Options) -> dict:
    """Compare, write report.json, report.md, index.html and the charts, and return the summary."""
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
