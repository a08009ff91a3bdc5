"""The experiment of Section 4.3: does training through the layer help, for material alone and for
normals alone?

Each variant is trained with the same network, data and seed for the same processor time, and
measured on shapes, materials and lights that it never saw. What is not predicted is given true, so
that each part stands alone.

material   standalone: squared difference of codes; combined: with I' through the layer; control:
with the log-albedo term and no layer;
           both: the log-albedo term and the layer
normals    standalone: squared difference of normals; combined: with I' through the layer
"""

from pathlib import Path

import msgspec
from tqdm import tqdm

from learn.data.settings import Losses, Run, Schedule
from learn.experiments import variants
from manifests import files
from manifests.provenance import provenance

VARIANTS = {
    "material": {
        "standalone": {"material": 1.0},
        "combined": {"material": 1.0, "image": 10.0},
        "control": {"material": 1.0, "albedo": 0.3},
        "both": {"material": 1.0, "albedo": 0.3, "image": 10.0},
    },
    "normals": {"standalone": {"normals": 1.0}, "combined": {"normals": 1.0, "image": 3.0}},
}
RATES = {"material": 1e-3, "normals": 2e-3}
STEPS = 1_000_000  # a bound far beyond what the time allows


def settings(part, variant, data, size, seconds, seed):
    """The Run of one variant."""
    schedule = Schedule(
        steps=STEPS,
        batch=variants.BATCH,
        learning_rate=RATES[part],
        warm_up=50,
        ema_decay=0.99,
        seconds=seconds,
    )
    return Run(
        name=f"{part} {variant}",
        about=f"{seconds:g} s of processor time",
        size=size,
        parts=(part,),
        data=msgspec.structs.replace(data, photograph=False),
        losses=Losses(**{"normals": 0.0, "material": 0.0} | VARIANTS[part][variant]),
        schedule=schedule,
        seed=seed,
    )


def prove(data, data_splits, out, size, seconds, seeds, batches=12, workers=1):
    """Train and measure every variant; report.json and report.md in `out`. A variant that is there
    already is not trained again.
    """
    tests = variants.held_out(data_splits, data, size, batches)
    todo = [(s, p, v) for s in seeds for p, of_part in VARIANTS.items() for v in of_part]
    results = {}
    for seed, part, variant in tqdm(todo, "variants", unit="run"):
        run = settings(part, variant, data, size, seconds, seed)
        result = variants.trained(
            run, data_splits, tests, Path(out) / f"{part}-{variant}-{seed}", workers
        )
        results.setdefault(part, {}).setdefault(variant, []).append(result)
    return report(Path(out), results, {"seconds": seconds, "size": size, "seeds": len(seeds)})


def report(out, results, about):
    """Figures of each variant, and ratios of render L2 with 95 % intervals; report.json, report.md.

    results  {part: {variant: [result of variants.trained, a seed each]}}
    """
    summary = {}
    for part, of_part in results.items():
        summary[part] = {
            v: variants.figures(result) | {"steps": [r["steps"] for r in result]}
            for v, result in of_part.items()
        }
        pairs = [("standalone", v) for v in of_part if v != "standalone"]
        pairs += [("control", v) for v in ("combined", "both") if {"control", v} <= of_part.keys()]
        summary[part]["ratios"] = {
            f"{b} / {a}": variants.ratio(of_part[a], of_part[b]) for a, b in pairs
        }
    pictures = len(next(iter(next(iter(results.values())).values()))[0]["rows"])
    summary["about"] = provenance() | about | {"pictures": pictures}
    with files.transaction():
        files.write_json(out / "report.json", summary)
        files.write_text(out / "report.md", page(summary))
    return summary


def page(summary):
    """The report as a table for people."""
    about = summary["about"]
    lines = ["# Training through the layer against training without it (Section 4.3)", ""]
    metadata = (
        f"{about['seconds']:g} s of processor time a run, {about['seeds']} seeds,"
        f" {about['pictures']} pictures of {about['size']}² pixels"
    )
    lines += [
        metadata
        + " of shapes, materials and lights never seen; 95 % intervals over shapes, materials and"
        " seeds.",
        "",
    ]
    lines += [
        "| part | variant | render L2 | L2, frame | SSIM | others | steps |",
        "|---|---|---|---|---|---|---|",
    ]
    for part in VARIANTS:
        for variant in VARIANTS[part]:
            row = summary[part][variant]
            l2, low, high = row["l2"]
            others = ", ".join(
                f"{key} {row[key][0]:.4g}"
                for key in row
                if key not in ("l2", "l2_frame", "ssim", "steps")
            )
            cells = (
                f"{l2:.0f} [{low:.0f}, {high:.0f}] | {row['l2_frame'][0]:.0f} |"
                f" {row['ssim'][0]:.4f}"
            )
            lines.append(
                f"| {part} | {variant} | {cells} | {others} | {', '.join(map(str, row['steps']))} |"
            )
    lines += ["", "Ratios of render L2:", ""]
    for part in VARIANTS:
        lines += [
            f"- {part}: {pair} = {x:.2f} [{low:.2f}, {high:.2f}]"
            for pair, (x, low, high) in summary[part]["ratios"].items()
        ]
    lines += ["", " · ".join(f"{key}: {value}" for key, value in about.items())]
    return "\n".join(lines) + "\n"
