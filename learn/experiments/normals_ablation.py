"""What helps normals beyond their own squared difference, at equal processor time: every idea of
how a picture's error might.

Variants go on from one pre-training by L2 alone, a seed each, for the same processor time; those of
fewer shapes are pre-trained on them.

L2           squared difference of normals alone, all training shapes
pixels       and I' at sampled pixels, its pull bounded at each (learn.training.losses.bounded)
all pixels   and I' at every pixel of the mask
features     and I' by features of VGG16 (learn.networks.features), all pixels
matte first  as pixels, but materials are admitted in order of gloss
60, 120      L2 alone, so many shapes
"""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
from tqdm import tqdm

from learn.data.settings import Losses, Run, Schedule
from learn.data.sources import by_hash
from learn.experiments import variants
from manifests import files
from manifests.errors import InputError
from manifests.provenance import provenance

VARIANTS = {
    "L2": {},
    "pixels": {"image": 3.0},
    "all pixels": {"image": 3.0, "rendered": "all"},
    "features": {"image_features": 1.0},
    "matte first": {"image": 3.0},
    "60 shapes": {},
    "120 shapes": {},
}
SHAPES = {"60 shapes": 60, "120 shapes": 120}
STEPS = 1_000_000
# batches: about half of what L2 alone makes of 45 s at 64²; larger pictures make fewer
MATTE_FIRST = 150


def settings(name, data, size, seconds, seed, rate, start=None, losses=None, gloss_curriculum=0):
    """The Run of one variant, or of the pre-training."""
    return Run(
        name=f"normals {name}",
        about=f"{seconds:g} s of processor time",
        size=size,
        parts=("normals",),
        data=msgspec.structs.replace(data, photograph=False, gloss_curriculum=gloss_curriculum),
        losses=Losses(normals=1.0, material=0.0, **losses or {}),
        schedule=Schedule(
            steps=STEPS,
            batch=variants.BATCH,
            learning_rate=rate,
            warm_up=30,
            ema_decay=0.99,
            seconds=seconds,
        ),
        start=start,
        seed=seed,
    )


def run_ablation(
    data,
    data_splits,
    out,
    size,
    pretraining,
    seconds,
    seeds,
    names=tuple(VARIANTS),
    batches=12,
    workers=1,
    matte=MATTE_FIRST,
):
    """Train and measure; table.json, table.md and chart.png in `out`, written anew after each seed.
    What is there is not trained again.

    pretraining, seconds  of processor time; names: of VARIANTS, "L2" among them
    matte                 batches over which "matte first" admits its materials
    """
    out = Path(out)
    tests, results = (
        variants.held_out(data_splits, data, size, batches),
        {name: [] for name in names},
    )
    bar = tqdm(total=len(seeds) * len(names), desc="variants", unit="run")
    for done, seed in enumerate(seeds, 1):
        for name in names:
            of_shapes = _limited(data_splits, SHAPES.get(name))
            label = f"{name.split()[0]}-" if name in SHAPES else ""
            first = out / "runs" / f"{label}pretraining-{seed}"
            variants.trained(
                settings("pre-training", data, size, pretraining, seed, 2e-3),
                of_shapes,
                tests,
                first,
                workers,
            )
            run = settings(
                name,
                data,
                size,
                seconds,
                seed + 1000,
                1e-3,
                str(first / "weights.safetensors"),
                VARIANTS[name],
                _matte(name, matte),
            )
            result = variants.trained(
                run, of_shapes, tests, out / "runs" / f"{name.replace(' ', '-')}-{seed}", workers
            )
            results[name].append(result)
            bar.update()
        about = {
            "pretraining": pretraining,
            "seconds": seconds,
            "size": size,
            "seeds": done,
            "shapes": _count(data_splits),
        }
        about |= {"matte_first": matte} if "matte first" in names else {}
        summary = report(out, results, about)
    bar.close()
    return summary


def _matte(name, batches):
    return batches if name == "matte first" else 0


def _count(data_splits):
    return len({data_splits["train"].geometry.views[v].shape for v in data_splits["train"].views})


def _limited(data_splits, count):
    """Pools whose training side has so many shapes, chosen by their names' hashes. Raises
    InputError if there are fewer.
    """
    if count is None:
        return data_splits
    data_split = data_splits["train"]
    shapes = sorted(
        {data_split.geometry.views[v].shape for v in data_split.views},
        key=lambda name: by_hash(name, 1 << 30),
    )
    if len(shapes) < count:
        raise InputError(
            data_split.geometry.folder,
            f"{count} training shapes",
            str(len(shapes)),
            "render more, or leave this variant out",
        )
    kept = set(shapes[:count])
    views = np.array([v for v in data_split.views if data_split.geometry.views[v].shape in kept])
    return data_splits | {"train": replace(data_split, views=views)}


def report(out, results, about):
    """table.json, table.md, chart.png. results: {variant: [result of variants.trained, a seed
    each]}.
    """
    rows = {}
    for name, outcome in results.items():
        rows[name] = variants.figures(outcome) | {"steps": [result["steps"] for result in outcome]}
        rows[name]["ratio"] = variants.ratio(results["L2"], outcome)
        rows[name]["angle_ratio"] = variants.ratio(results["L2"], outcome, "angle_deg")
    pictures = len(results["L2"][0]["rows"])
    summary = {"rows": rows, "about": provenance() | about | {"pictures": pictures}}
    with files.transaction():
        files.write_json(out / "table.json", summary)
        files.write_text(out / "table.md", page(summary))
        chart(out / "chart.png", summary)
    return summary


def page(summary):
    """The table for people."""
    about = summary["about"]
    lines = ["# Normals: what helps at equal processor time", ""]
    lines += [
        (
            f"{about['pretraining']:g} s of pre-training by L2, then {about['seconds']:g} s of each"
            f" variant, {about['seeds']} seeds, {about['shapes']} training shapes,"
            f" {about['pictures']} pictures of {about['size']}² pixels of shapes, materials and"
            " lights never seen. Means with 95 % intervals over shapes, materials and seeds;"
            " ratios against L2 alone, on the same pictures."
        ),
        "",
        (
            "| variant | render L2 | ratio | mean angle (°) | ratio | cosine | SSIM | L2, frame |"
            " steps |"
        ),
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, row in summary["rows"].items():
        cells = [
            _interval_text(row["l2"], 0),
            _interval_text(row["ratio"], 3),
            _interval_text(row["angle_deg"], 2),
            _interval_text(row["angle_ratio"], 3),
        ]
        cells += [
            f"{row['cosine'][0]:.4f}",
            f"{row['ssim'][0]:.4f}",
            f"{row['l2_frame'][0]:.0f}",
            ", ".join(map(str, row["steps"])),
        ]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    lines += ["", " · ".join(f"{key}: {value}" for key, value in about.items())]
    return "\n".join(lines) + "\n"


def _interval_text(interval, digits):
    mean, low, high = (f"{x:.{digits}f}" for x in interval)
    return f"{mean} [{low}, {high}]"


def chart(path, summary):
    """Ratios of render L2 and of the mean angle against L2 alone, a line a variant."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = [name for name in summary["rows"] if name != "L2"]
    figure, axes = pyplot.subplots(1, 2, figsize=(9, 0.5 * len(names) + 1.2), sharey=True)
    for axis, key, title in (
        (axes[0], "ratio", "render L2 against L2 alone"),
        (axes[1], "angle_ratio", "mean angle against L2 alone"),
    ):
        for i, name in enumerate(names):
            mean, low, high = summary["rows"][name][key]
            axis.plot([low, high], [i, i], color="#345", lw=2)
            axis.plot(mean, i, "o", color="#345")
        axis.axvline(1, color="#999", lw=1)
        axis.set_title(title, fontsize=10)
        axis.set_yticks(range(len(names)), names)
    axes[0].invert_yaxis()
    figure.tight_layout()
    files.write_figure(path, figure, dpi=120)
    pyplot.close(figure)
