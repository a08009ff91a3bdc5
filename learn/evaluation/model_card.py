"""The page that comes with weights: what they learned from, and their errors on unseen pictures.

It is made from the run's own files and measured again: `python -m learn evaluate-network`.
"""

from collections.abc import Mapping, Sequence, Sized
from pathlib import Path
from typing import Any, NamedTuple, cast

import msgspec
import numpy as np
import torch

from learn.data.batch import shape_and_material
from learn.data.data_split import DataSplit
from learn.data.rendered import RenderedSplit
from learn.data.settings import Run
from learn.evaluation import card_batches, card_page
from learn.metrics import bootstrap
from learn.training import contact_sheet, validation
from manifests import files
from manifests.errors import InputError

SHEETS = {"relit": "sheet.jpg", "cycles": "sheet-cycles.jpg"}  # {kind of pictures: contact sheet}

Figures = dict[str, list[float]]  # {figure: [mean, low, high]}


def write_card(
    weights: Path,
    data_splits: dict[str, DataSplit],
    out: Path,
    batches: int,
    *,
    note: str = "",
    other_seeds: Sequence[Path] = (),
    device: str | torch.device = "cpu",
    seen: Sequence[str] = (),
    printed: bool = False,
    cluster: card_batches.Cluster | None = None,
) -> dict[str, Figures]:
    """Measure weights on the test split: on relit pictures, and on all of its rendered ones.

    batches      number of batches of relit pictures
    note         a sentence for the page
    other_seeds  weights of the same run with other seeds, measured on the same pictures
    device       where networks and the layer compute
    seen         learn.evaluation.overlap.report_overlap of the weights and the test split
    printed      whether the relit pictures are measured again with patterns over their materials
    cluster      that measures the batches; None: this process does
    Writes       card.md, card.json, sheet.jpg and sheet-cycles.jpg into `out`
    Returns      {"figures", "cycles", "printed"} of what there is, each {figure: [mean, low, high]}
    Raises       InputError where one of the seeds is of another run, or a seed is there twice
    """
    out, test = Path(out), data_splits["test"]
    trained = [_load(path, device) for path in (weights, *other_seeds)]
    _require_seeds_of_one_run(trained)
    out.mkdir(parents=True, exist_ok=True)
    evaluator = card_batches.CardEvaluator(
        [each.network for each in trained],
        trained[0].run,
        test,
        validation.mean_albedo(data_splits["train"]),
    )
    counts = {"relit": batches}
    if test.rendered_split:
        counts["cycles"] = len(cast(Sized, test.rendered_split))
    for kind, count in counts.items():
        _draw_contact_sheet(evaluator, kind, count, out / SHEETS[kind])
    if printed:
        counts |= dict.fromkeys(card_batches.PATTERNS, batches)
    results = card_batches.measure_batches(evaluator, counts, cluster)

    report = {
        "run": trained[0].metadata["run"],
        "step": trained[0].metadata.get("step"),
        "sizes": _sizes(trained[0].network, data_splits),
        "note": note,
        "seen": list(seen),
    }
    if other_seeds:
        report["seeds"] = [[each.run.seed, each.metadata.get("step")] for each in trained]
    if test.rendered_split:
        report["cycles_about"] = _describe_pictures(test.rendered_split)
    for kind in [kind for kind in SHEETS if kind in counts]:
        report |= _summarise("" if kind == "relit" else kind, results[kind])
    if printed:
        report["printed"] = _compare_with_patterns(results)
    with files.transaction():
        files.write_json(out / "card.json", report)
        files.write_text(out / "card.md", card_page.markdown(report))
    return {key: report[key] for key in ("figures", "cycles", "printed") if key in report}


class _Trained(NamedTuple):
    """Weights that are measured: their file, the network with its metadata, and its run."""

    path: Path
    network: Any
    metadata: dict[str, Any]
    run: Run


def _load(path: Path, device: str | torch.device) -> _Trained:
    return _Trained(path, *card_batches.load_with_run(path, device))


def _require_seeds_of_one_run(trained: Sequence[_Trained]) -> None:
    """Raise InputError unless all weights differ from the first in their seed and nothing else."""
    first = trained[0]
    names = {"name": first.run.name, "about": first.run.about}
    for each in trained[1:]:
        if msgspec.structs.replace(each.run, seed=first.run.seed, **names) != first.run:
            raise InputError(
                each.path,
                f"weights of the run of {first.path} with another seed",
                "other settings",
                "measure them by a card of their own",
            )
    seeds = [each.run.seed for each in trained]
    for each in trained:
        if seeds.count(each.run.seed) > 1:
            raise InputError(
                each.path,
                "a seed that no other of these weights has",
                f"seed {each.run.seed} twice",
                "leave one of them out",
            )


def _draw_contact_sheet(
    evaluator: card_batches.CardEvaluator, kind: str, count: int, path: Path
) -> None:
    """Draw the first pictures of a kind, with what the first network predicts of them."""
    rows: list[np.ndarray] = []
    shown = 0
    for k in range(count):
        batch, prediction = evaluator.predict(
            evaluator.networks[0], evaluator.batch(kind, k), evaluator.run.parts
        )
        rows.append(contact_sheet.draw(batch, prediction))
        shown += len(batch.names)
        if shown >= contact_sheet.ROWS:
            break
    cells = np.concatenate(rows)[: contact_sheet.ROWS * evaluator.run.size]
    files.write_image(path, cells, "JPEG", quality=90)


def _compare_with_patterns(results: Mapping[str, Sequence[card_batches.Measured]]) -> Figures:
    """Return the angle of normals on relit pictures without and with printed patterns.

    Both are the same pictures but for the patterns, which every one of the latter has.

    Returns  {"plain_angle_deg", "printed_angle_deg", "ratio"}, each [mean, low, high] over shapes
             and materials; ratio: of the mean angles, printed by plain
    """
    (plain, names), (under, _) = (results[kind][0] for kind in card_batches.PATTERNS)
    angles = [values["angle_deg"] for values in (plain, under)]
    resampled = _draw_weights(names)
    return {
        "plain_angle_deg": bootstrap.interval(angles[0], resampled),
        "printed_angle_deg": bootstrap.interval(angles[1], resampled),
        "ratio": bootstrap.relative(angles[0], angles[1], resampled),
    }


def _draw_weights(names: Sequence[str]) -> np.ndarray:
    """Return weights (D, P) of draws of the shapes and materials of pictures of these names."""
    shapes, materials = zip(*map(shape_and_material, names), strict=True)
    return bootstrap.draws(bootstrap.groups_of(shapes, materials))


def _summarise(kind: str, measured: Sequence[card_batches.Measured]) -> dict[str, Any]:
    """Return the part of card.json about one kind of pictures, of the first network and of all.

    A figure that no picture shows, as the albedo of a second region where all have one, is left
    out.

    kind      "" for relit pictures, whose keys have no prefix
    measured  (values {figure: (P,)}, names (P,)) of each network, on the same pictures
    """
    (first, names), *_ = measured
    weights = _draw_weights(names)
    shown = {key: values for key, values in first.items() if np.isfinite(values).any()}
    report: dict[str, Any] = {
        kind or "figures": {key: _interval(values, weights) for key, values in shown.items()},
        f"{kind}_pictures" if kind else "pictures": len(names),
    }
    if len(measured) > 1:
        report[f"{kind}_seeds" if kind else "figures_seeds"] = {
            key: {
                "mean": _interval(np.mean([values[key] for values, _ in measured], 0), weights),
                "each": [float(np.nanmean(values[key])) for values, _ in measured],
            }
            for key in shown
        }
    return report


def _interval(values: np.ndarray, weights: np.ndarray) -> list[float]:
    """Return [mean, low, high] over the pictures that show what is measured, at least one."""
    there = np.isfinite(values)
    kept = weights[:, there]
    return bootstrap.interval(values[there], kept[kept.sum(1) > 0])


def _describe_pictures(split: RenderedSplit) -> str:
    """Return what Cycles' pictures show, in numbers, and how they were made."""
    chosen = split.chosen
    shown = [
        len({record.shape for record in chosen}),
        len({record.materials for record in chosen}),
        len({record.light for record in chosen}),
    ]
    settings = [
        ", ".join(map(str, sorted(values)))
        for values in (
            {record.tier for record in chosen},
            {record.samples for record in chosen},
            {record.camera.pixel for record in chosen},
        )
    ]
    return "{} shapes, {} materials, {} lights; tier {}, {} samples, pixels: {}".format(
        *shown, *settings
    )


def _sizes(network: Any, data_splits: dict[str, DataSplit]) -> dict[str, Any]:
    """Return the network's number of parameters, and {side: DataSplit.sizes} of all sides."""
    report = {"parameters": sum(p.numel() for p in network.parameters())}
    report |= {side: data_splits[side].sizes() for side in ("train", "validation", "test")}
    return report
