"""The table of `learn.experiments engine-speed`, in Markdown and JSON, with the command, commit,
machine and date that made it.
"""

import dataclasses

from manifests import files
from manifests.provenance import provenance


def markdown(rows, settings, made):
    head = (
        "| material | camera | task | threads | engine, s | plain torch, s | plain ÷ engine | tuned"
        " ÷ engine | by processor time |"
    )
    lines = [
        "# The exact engine against plain torch",
        "",
        f"`{made['command']}`, commit {made['commit']}, {made['date']}; {made['machine']}; "
        + ", ".join(f"{name} {version}" for name, version in made["versions"].items()),
        "",
        (
            "One 256 × 256 picture, 40 % mask, 64 × 128 light, float32; medians of"
            f" {settings.rounds} rounds in turns. Plain torch renders {settings.eager_pixels} of"
            " the pixels, its time is scaled to all of them. *Plain* is the general formula as"
            " `shaders.dsbrdf` writes it, *tuned* the same by log2 and exp2"
            " (`learn/experiments/eager_sum.py`), both in chunks of the best size found."
        ),
        "",
        head,
        "|" + "---|" * (head.count("|") - 1),
    ]
    for row in rows:
        by_processor = " / ".join(
            f"{row.processor_ratio[name]:.0f}" for name in ("torch, plain", "torch, tuned")
        )
        lines.append(
            f"| {row.material} | {row.camera} | {row.task} | {row.threads} |"
            f" {row.wall['engine']:.3f} | {row.wall['torch, plain']:.0f} |"
            f" {row.ratio['torch, plain']:.0f} | {row.ratio['torch, tuned']:.0f} | {by_processor} |"
        )
    return "\n".join(lines) + "\n"


def write(rows, settings, folder):
    """Writes bench.md and bench.json into the folder; returns the Markdown."""
    folder.mkdir(parents=True, exist_ok=True)
    made = provenance()
    text = markdown(rows, settings, made)
    content = {
        "made_by": made,
        "settings": dataclasses.asdict(settings),
        "rows": [dataclasses.asdict(row) for row in rows],
    }
    with files.transaction():
        files.write_text(folder / "bench.md", text)
        files.write_json(folder / "bench.json", content)
    return text
