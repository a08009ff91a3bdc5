"""The page that comes with weights: what they learned from, and their errors on unseen pictures.

It is made from the run's own files and measured again: `python -m learn evaluate-network`.
"""

import json
from collections.abc import Mapping, Sequence, Sized
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np
import torch

from learn.data.batch import shape_and_material
from learn.data.data_split import DataSplit
from learn.data.settings import decode_run
from learn.evaluation import card_batches
from learn.metrics import bootstrap
from learn.networks import weights as checkpoint
from learn.training import montage as training_montage
from learn.training import validation
from manifests import files
from manifests.errors import InputError

SHEETS = {"relit": "sheet.jpg", "cycles": "sheet-cycles.jpg"}  # {kind of pictures: contact sheet}
WORDS = {
    "angle_deg": "normals, mean angle (°)",
    "cosine": "normals, mean cosine",
    "irradiance": "irradiance, relative error",
    "constant_irradiance": "the same of a constant light",
    "albedo": "material, log albedo, root mean square error",
    "constant_albedo": "the same of the training materials' mean",
    "image_l2": "I′, display L2 over the mask",
    "target_l2": "O′, display L2 over the mask",
    "plain_angle_deg": "normals without patterns, mean angle (°)",
    "printed_angle_deg": "normals under patterns, mean angle (°)",
    "ratio": "ratio of the two",
    "control_l2": "the same with predicted normals and a constant light",
}


def make(
    weights: Path,
    data_splits: dict[str, DataSplit],
    out: Path,
    batches: int,
    note: str = "",
    seeds: Sequence[Path] = (),
    device: str | torch.device = "cpu",
    seen: Sequence[str] = (),
    printed: bool = False,
    cluster: card_batches.Cluster | None = None,
) -> dict[str, dict[str, list[float]]]:
    """Measure weights on the test split: on relit pictures, and on all of its rendered ones.

    seeds    weights of the same run with other seeds, measured on the same pictures
    device   where networks and the layer compute
    seen     learn.evaluation.overlap.sentences of the weights and the test split
    printed  whether the relit pictures are measured again with patterns over their materials
    cluster  that measures the batches; None: this process does
    Writes   card.md, card.json, sheet.jpg and sheet-cycles.jpg into `out`
    Returns  {"figures", "cycles", "printed"} of what there is, each {figure: [mean, low, high]}
    Raises   InputError where one of the seeds is of another run, or a seed is there twice
    """
    network, metadata = checkpoint.load_network(weights, device)
    run, out, test = (
        decode_run(json.dumps(metadata["run"]).encode(), weights),
        Path(out),
        data_splits["test"],
    )
    others = [_same_run(path, weights, run, device) for path in seeds]
    _all_different([weights, *seeds], [run, *(other for _, _, other in others)])
    out.mkdir(parents=True, exist_ok=True)
    bench = card_batches.Bench(
        [network, *(other for other, _, _ in others)],
        run,
        test,
        validation.mean_albedo(data_splits["train"]),
    )
    report = {
        "run": metadata["run"],
        "step": metadata.get("step"),
        "sizes": _sizes(network, data_splits),
        "note": note,
        "seen": list(seen),
    }
    if others:
        report["seeds"] = [
            [run.seed, report["step"]],
            *([other.seed, step] for _, step, other in others),
        ]
    counts = {"relit": batches}
    if test.rendered_split:
        counts["cycles"] = len(cast(Sized, test.rendered_split))
        report["cycles_about"] = _of_split(test.rendered_split)
    for kind, count in counts.items():
        _draw_sheet(bench, kind, count, out / SHEETS[kind])
    if printed:
        counts |= dict.fromkeys(card_batches.PATTERNS, batches)
    results = card_batches.measure_batches(bench, counts, cluster)
    for kind in [kind for kind in counts if kind in SHEETS]:
        report |= _under("" if kind == "relit" else kind, results[kind])
    if printed:
        report["printed"] = _under_patterns(results)
    with files.transaction():
        files.write_json(out / "card.json", report)
        files.write_text(out / "card.md", _page(report))
    return {key: report[key] for key in ("figures", "cycles", "printed") if key in report}


def _draw_sheet(bench: card_batches.Bench, kind: str, count: int, path: Path) -> None:
    """Draw the first pictures of a kind, with what the first network predicts of them."""
    rows: list[np.ndarray] = []
    shown = 0
    for k in range(count):
        batch, prediction = bench.predicted(
            bench.networks[0], bench.batch(kind, k), bench.run.parts
        )
        rows.append(training_montage.contact_sheet(batch, prediction))
        shown += len(batch.names)
        if shown >= training_montage.ROWS:
            break
    cells = np.concatenate(rows)[: training_montage.ROWS * bench.run.size]
    files.write_image(path, cells, "JPEG", quality=90)


def _under_patterns(results: Mapping[str, Sequence[card_batches.Measured]]) -> dict[str, list]:
    """Return the angle of normals on relit pictures without and with printed patterns.

    Both are the same pictures but for the patterns, which every one of the latter has.

    Returns  {"plain_angle_deg", "printed_angle_deg", "ratio"}, each [mean, low, high] over shapes
             and materials; ratio: of the mean angles, printed by plain
    """
    (plain, names), (under, _) = (results[kind][0] for kind in card_batches.PATTERNS)
    angles = [values["angle_deg"] for values in (plain, under)]
    resampled = _draws(names)
    return {
        "plain_angle_deg": bootstrap.interval(angles[0], resampled),
        "printed_angle_deg": bootstrap.interval(angles[1], resampled),
        "ratio": bootstrap.relative(angles[0], angles[1], resampled),
    }


def _same_run(path, first, run, device="cpu"):
    """(network, step, run) of weights that differ from the first in nothing but their seed."""
    network, metadata = checkpoint.load_network(path, device)
    other = decode_run(json.dumps(metadata["run"]).encode(), path)
    if msgspec.structs.replace(other, seed=run.seed, name=run.name, about=run.about) != run:
        raise InputError(
            path,
            f"weights of the run of {first} with another seed",
            "other settings",
            "measure them by a card of their own",
        )
    return network, metadata.get("step"), other


def _all_different(paths, runs):
    for path, run in zip(paths, runs, strict=True):
        if sum(other.seed == run.seed for other in runs) > 1:
            raise InputError(
                path,
                "a seed that no other of these weights has",
                f"seed {run.seed} twice",
                "leave one of them out",
            )


def _draws(names: Sequence[str]) -> np.ndarray:
    """Return weights (D, P) of draws of the shapes and materials of pictures of these names."""
    shapes, materials = zip(*map(shape_and_material, names), strict=True)
    return bootstrap.draws(bootstrap.groups_of(shapes, materials))


def _under(where, found):
    """Return the part of card.json about one kind of pictures, of the first network and of all.

    found  (values {figure: (P,)}, names (P,)) of each network, on the same pictures
    """
    (values, names), *_ = found
    resampled = _draws(names)
    report = {
        where or "figures": {key: _interval(value, resampled) for key, value in values.items()},
        f"{where}_pictures" if where else "pictures": len(names),
    }
    if len(found) > 1:
        report[f"{where}_seeds" if where else "figures_seeds"] = {
            key: {
                "mean": _interval(np.mean([values[key] for values, _ in found], 0), resampled),
                "each": [float(np.nanmean(values[key])) for values, _ in found],
            }
            for key in values
        }
    return report


def _interval(values, weights):
    """[mean, low, high] over the pictures that show what is measured."""
    there = np.isfinite(values)
    kept = weights[:, there]
    return bootstrap.interval(values[there], kept[kept.sum(1) > 0])


def _of_split(rendered_split):
    """How its pictures were made."""

    def of(get):
        return sorted({get(record) for record in rendered_split.chosen})

    counts = [len(of(get)) for get in (lambda r: r.shape, lambda r: r.materials, lambda r: r.light)]
    how = [
        ", ".join(map(str, of(get)))
        for get in (lambda r: r.tier, lambda r: r.samples, lambda r: r.camera.pixel)
    ]
    return "{} shapes, {} materials, {} lights; tier {}, {} samples, pixels: {}".format(
        *counts, *how
    )


def _sizes(network: Any, data_splits: dict[str, DataSplit]) -> dict[str, Any]:
    report = {"parameters": sum(p.numel() for p in network.parameters())}
    report |= {side: data_splits[side].sizes() for side in ("train", "validation", "test")}
    return report


def _overlaps(report):
    return any(sentence.startswith("Overlap") for sentence in report.get("seen", ()))


def _steps(report):
    planned = f"{report['run']['schedule']['steps']} steps"
    return f"{report['step']} of {planned}" if report["step"] else f"up to {planned}"


def _page(report):
    run, sizes = report["run"], report["sizes"]
    lines = [f"# {run['name']}: {run.get('about', '')}", ""]
    for sentence in report.get("seen", ()):
        lines += [f"**{sentence}**", ""]
    unseen = "not all of them unseen, as said above" if _overlaps(report) else "never seen"
    lines += [
        (
            f"{sizes['parameters'] / 1e6:.1f} M parameters, {run['size']} × {run['size']} pixels,"
            f" {_steps(report)} of {run['schedule']['batch']} relit pictures."
        ),
        "",
        "| side | shapes | views | materials | light maps |",
        "|---|---|---|---|---|",
    ]
    for side in ("train", "validation", "test"):
        s = sizes[side]
        lines.append(
            f"| {side} | {s['shapes']} | {s['views']} | {s['materials']} | {s['lights']} |"
        )
    lines += [
        "",
        (
            f"On {report['pictures']} pictures of the test side (shapes, materials and lights"
            f" {unseen}; relit by the layer, so without shadows, interreflection or a camera's"
            " faults), mean and 95 % interval over shapes and materials:"
        ),
        "",
        "| | mean | 95 % |",
        "|---|---|---|",
    ]
    lines += _rows(report["figures"])
    lines += _rows_of_seeds(report, "figures_seeds")
    if "cycles" in report:
        lines += [
            "",
            (
                f"On {report['cycles_pictures']} pictures that Cycles rendered"
                f" ({report['cycles_about']}), where I and O are Cycles' pictures, O the same"
                " shape, view and light in another material:"
            ),
            "",
            "| | mean | 95 % |",
            "|---|---|---|",
            *_rows(report["cycles"]),
            *_rows_of_seeds(report, "cycles_seeds"),
        ]
    if "printed" in report:
        lines += [
            "",
            "Normals on the same relit pictures without and with a pattern printed on each object:",
            "",
            "| | mean | 95 % |",
            "|---|---|---|",
            *_rows(report["printed"]),
        ]
    lines += [
        "",
        report["note"],
        "",
        (
            "Rows of sheet.jpg: picture, predicted and true normals, predicted and true light, true"
            " and predicted material, I′, O′, true O."
        ),
    ]
    return "\n".join(lines) + "\n"


def _words(key):
    name, _, region = key.rpartition("_")
    return (
        f"{WORDS[name]}, region {region}"
        if region.isdigit() and name in WORDS
        else WORDS.get(key, key)
    )


def _rows(figures):
    return [
        f"| {_words(key)} | {mean:.4g} | {low:.4g} – {high:.4g} |"
        for key, (mean, low, high) in figures.items()
    ]


def _rows_of_seeds(report, key):
    """A table of several seeds on the same pictures."""
    if key not in report:
        return []
    seeds = [f"seed {seed}" + (f", {step} steps" if step else "") for seed, step in report["seeds"]]
    lines = [
        "",
        (
            f"The same of {len(seeds)} seeds: the mean over them with its 95 % interval over shapes"
            " and materials, and each."
        ),
        "",
    ]
    lines += [
        f"| | mean of {len(seeds)} | 95 % | {' | '.join(seeds)} |",
        "|" + "---|" * (3 + len(seeds)),
    ]
    for name, of in report[key].items():
        mean, low, high = of["mean"]
        lines.append(
            f"| {_words(name)} | {mean:.4g} | {low:.4g} – {high:.4g} | "
            + " | ".join(f"{each:.4g}" for each in of["each"])
            + " |"
        )
    return lines
