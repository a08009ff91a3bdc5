"""The page that goes with weights: what they learned from, what they do on pictures never seen, and what they do not.

Made from the run's own files, and measured anew: `python -m learn card`.
"""

import json
from pathlib import Path

import numpy as np
import torch

from learn import intervals
from learn.training import checkpoint, measures, sheet
from learn.training.relit import Relit
from learn.training.settings import Run
from manifests.reading import decode

WORDS = {
    "angle_deg": "normals, mean angle (°)",
    "cosine": "normals, mean cosine",
    "irradiance": "irradiance, relative error",
    "constant_irradiance": "the same of a constant light",
    "image_l2": "I′, display L2 over the mask",
    "target_l2": "O′, display L2 over the mask",
    "control_l2": "the same with predicted normals and a constant light",
}


def make(weights, pools, out, batches, note=""):
    """Measure weights on the test side; card.md, card.json, sheet.jpg in `out`. pools: learn.training.sources.pools. Returns figures."""
    network, metadata = checkpoint.load_network(weights)
    run, out = decode(json.dumps(metadata["run"]).encode(), Run, weights), Path(out)
    out.mkdir(parents=True, exist_ok=True)
    source, rows, names = Relit(pools["test"], run.data, 16, run.size, 77), [], []
    for batch in (source[k] for k in range(batches)):
        with torch.no_grad():
            prediction = network(batch.image, batch.mask, batch.segments if run.data.regions > 1 else None, run.parts)
        rows.append(measures.of(prediction, batch))
        names += batch.names
        if len(rows) == 1:
            sheet.write(out / "sheet.jpg", batch, prediction)
    values = {key: np.concatenate([row[key] for row in rows]) for key in rows[0]}
    resampled = intervals.draws(intervals.groups_of(*([name.split(" ")[place] for name in names] for place in (0, -1))))
    figures = {key: intervals.interval(value, resampled) for key, value in values.items()}
    told = {"run": metadata["run"], "pictures": len(names), "figures": figures, "sizes": _sizes(network, pools), "note": note}
    (out / "card.json").write_text(json.dumps(told, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    (out / "card.md").write_text(_page(told), encoding="utf-8")
    return figures


def _sizes(network, pools):
    told = {"parameters": sum(p.numel() for p in network.parameters())}
    for side in ("train", "validation", "test"):
        views = pools[side].views
        shapes = {pools[side].geometry.views[v].shape for v in views}
        told[side] = {"shapes": len(shapes), "views": len(views), "materials": len(pools[side].labels), "lights": len(pools[side].maps)}
    return told


def _page(told):
    run, sizes = told["run"], told["sizes"]
    lines = [f"# {run['name']}: {run.get('about', '')}", ""]
    lines += [
        f"{sizes['parameters'] / 1e6:.1f} M parameters, {run['size']} × {run['size']} pixels, {run['schedule']['steps']} steps of "
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
    for key, (mean, low, high) in told["figures"].items():
        lines.append(f"| {WORDS.get(key, key)} | {mean:.4g} | {low:.4g} – {high:.4g} |")
    lines += [
        "",
        told["note"],
        "",
        "Rows of sheet.jpg: picture, predicted and true normals, predicted and true light, true and predicted material, I′, O′, true O.",
    ]
    return "\n".join(lines) + "\n"
