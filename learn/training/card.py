"""The page that goes with weights: what they learned from, what they do on pictures never seen, and what they do not.

Made from the run's own files, and measured anew: `python -m learn card`.
"""

import json
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from learn import intervals
from learn.training import checkpoint, measures, sheet
from learn.training.cycles import Cycles
from learn.training.relit import Relit
from learn.training.settings import Run
from manifests.reading import decode

BATCH, SEED = 16, 77
WORDS = {
    "angle_deg": "normals, mean angle (°)",
    "cosine": "normals, mean cosine",
    "irradiance": "irradiance, relative error",
    "constant_irradiance": "the same of a constant light",
    "albedo": "material, log albedo, root mean square error",
    "constant_albedo": "the same of the training materials' mean",
    "image_l2": "I′, display L2 over the mask",
    "target_l2": "O′, display L2 over the mask",
    "control_l2": "the same with predicted normals and a constant light",
}


def make(weights, pools, out, batches, note=""):
    """Measure weights on the test side, on relit pictures and, where the pool has an album, on all of its rendered ones.

    pools  learn.training.sources.pools
    Writes card.md, card.json, sheet.jpg, and sheet-cycles.jpg, to `out`. Returns {"figures", "cycles"}, {figure: [mean, low, high]} each
    """
    network, metadata = checkpoint.load_network(weights)
    run, out, test = decode(json.dumps(metadata["run"]).encode(), Run, weights), Path(out), pools["test"]
    out.mkdir(parents=True, exist_ok=True)
    relit = Relit(test, run.data, BATCH, run.size, SEED)
    constant = measures.mean_albedo(pools["train"])
    figures, count = measured(network, run, (relit[k] for k in range(batches)), out / "sheet.jpg", constant)
    told = {
        "run": metadata["run"],
        "step": metadata.get("step"),
        "pictures": count,
        "figures": figures,
        "sizes": _sizes(network, pools),
        "note": note,
    }
    if test.album:
        cycles = Cycles(test, run.data, 1, run.size, SEED)
        figures, count = measured(network, run, (cycles[k] for k in range(len(test.album))), out / "sheet-cycles.jpg", constant)
        told |= {"cycles": figures, "cycles_pictures": count, "cycles_about": _of_album(test.album)}
    (out / "card.json").write_text(json.dumps(told, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    (out / "card.md").write_text(_page(told), encoding="utf-8")
    return {key: told[key] for key in ("figures", "cycles") if key in told}


def measured(network, run, batches, sheet_path, constant_albedo):
    """({figure: [mean, low, high]}, pictures) over batches; 95 % intervals over shapes and materials. The first ones go on a sheet."""
    rows, names, shown = [], [], []
    for batch in batches:
        with torch.no_grad():
            prediction = network(batch.image, batch.mask, batch.segments if run.data.regions > 1 else None, run.parts)
        rows.append(measures.of(prediction, batch, constant_albedo))
        names += batch.names
        if sum(len(each.names) for each, _ in shown) < sheet.ROWS:
            shown.append((batch, prediction))
    Image.fromarray(np.concatenate([sheet.cells(*each) for each in shown])[: sheet.ROWS * run.size]).save(sheet_path, quality=90)
    values = {key: np.concatenate([row[key] for row in rows]) for key in rows[0]}
    resampled = intervals.draws(intervals.groups_of(*([name.split(" ")[place] for name in names] for place in (0, -1))))
    return {key: _interval(value, resampled) for key, value in values.items()}, len(names)


def _interval(values, weights):
    """[mean, low, high] over the pictures that show what is measured."""
    there = np.isfinite(values)
    kept = weights[:, there]
    return intervals.interval(values[there], kept[kept.sum(1) > 0])


def _of_album(album):
    """How its pictures were made."""

    def of(get):
        return sorted({get(record) for record in album.chosen})

    counts = [len(of(get)) for get in (lambda r: r.shape, lambda r: r.materials, lambda r: r.light)]
    how = [", ".join(map(str, of(get))) for get in (lambda r: r.tier, lambda r: r.samples, lambda r: r.camera.pixel)]
    return "{} shapes, {} materials, {} lights; tier {}, {} samples, pixels: {}".format(*counts, *how)


def _sizes(network, pools):
    told = {"parameters": sum(p.numel() for p in network.parameters())}
    told |= {side: pools[side].sizes() for side in ("train", "validation", "test")}
    return told


def _steps(told):
    planned = f"{told['run']['schedule']['steps']} steps"
    return f"{told['step']} of {planned}" if told["step"] else f"up to {planned}"


def _page(told):
    run, sizes = told["run"], told["sizes"]
    lines = [f"# {run['name']}: {run.get('about', '')}", ""]
    lines += [
        f"{sizes['parameters'] / 1e6:.1f} M parameters, {run['size']} × {run['size']} pixels, {_steps(told)} of "
        f"{run['schedule']['batch']} relit pictures.",
        "",
        "| side | shapes | views | materials | light maps |",
        "|---|---|---|---|---|",
    ]
    for side in ("train", "validation", "test"):
        s = sizes[side]
        lines.append(f"| {side} | {s['shapes']} | {s['views']} | {s['materials']} | {s['lights']} |")
    lines += [
        "",
        f"On {told['pictures']} pictures of the test side (shapes, materials and lights never seen; relit by the layer, so without "
        "shadows, interreflection or a camera's faults), mean and 95 % interval over shapes and materials:",
        "",
        "| | mean | 95 % |",
        "|---|---|---|",
    ]
    lines += _rows(told["figures"])
    if "cycles" in told:
        lines += [
            "",
            f"On {told['cycles_pictures']} pictures that Cycles rendered ({told['cycles_about']}), where I and O are Cycles' pictures, O "
            "the same shape, view and light in another material:",
            "",
            "| | mean | 95 % |",
            "|---|---|---|",
            *_rows(told["cycles"]),
        ]
    lines += [
        "",
        told["note"],
        "",
        "Rows of sheet.jpg: picture, predicted and true normals, predicted and true light, true and predicted material, I′, O′, true O.",
    ]
    return "\n".join(lines) + "\n"


def _words(key):
    name, _, region = key.rpartition("_")
    return f"{WORDS[name]}, region {region}" if region.isdigit() and name in WORDS else WORDS.get(key, key)


def _rows(figures):
    return [f"| {_words(key)} | {mean:.4g} | {low:.4g} – {high:.4g} |" for key, (mean, low, high) in figures.items()]
