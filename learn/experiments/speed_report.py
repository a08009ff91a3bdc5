"""The table of `learn bench`, in Markdown and JSON, with the command, commit, machine and date that made it."""

import dataclasses
import datetime
import importlib.metadata
import os
import platform
import subprocess
import sys
from pathlib import Path

from manifests import files


def made_by():
    """What has to stand beside any published figure."""
    here = Path(__file__).parent
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=here, check=False).stdout.strip()
    versions = {name: importlib.metadata.version(name) for name in ("torch", "numba", "llvmlite")}
    return {
        "command": " ".join(["python -m learn", *(named(argument) for argument in sys.argv[1:])]),
        "commit": commit or "none",
        "date": datetime.date.today().isoformat(),
        "machine": f"{processor()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}",
        "versions": versions,
    }


def named(argument):
    """An argument as it is published: of a path on this machine the last part alone."""
    return f"…/{Path(argument).name}" if os.path.isabs(argument) else argument


def processor():
    """The processor's name, and the widest vectors it has."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    found = dict(line.replace("\t", "").split(":", 1) for line in lines if ":" in line)
    flags = found.get("flags", "").split()
    width = next((name for name in ("avx512f", "avx2", "sse2") if name in flags), platform.machine())
    return f"{found.get('model name', platform.machine()).strip()} ({width})"


def markdown(rows, settings, made):
    head = "| material | camera | task | threads | engine, s | plain torch, s | plain ÷ engine | tuned ÷ engine | by processor time |"
    lines = [
        "# The exact engine against plain torch",
        "",
        f"`{made['command']}`, commit {made['commit']}, {made['date']}; {made['machine']}; "
        + ", ".join(f"{name} {version}" for name, version in made["versions"].items()),
        "",
        f"One 256 × 256 picture, 40 % mask, 64 × 128 light, float32; medians of {settings.rounds} rounds in turns. Plain torch renders "
        f"{settings.eager_pixels} of the pixels, its time is scaled to all of them. *Plain* is the general formula as `shaders.dsbrdf` "
        "writes it, *tuned* the same by log2 and exp2 (`learn/experiments/eager_sum.py`), both in chunks of the best size found.",
        "",
        head,
        "|" + "---|" * (head.count("|") - 1),
    ]
    for row in rows:
        by_processor = " / ".join(f"{row.processor_ratio[name]:.0f}" for name in ("torch, plain", "torch, tuned"))
        lines.append(
            f"| {row.material} | {row.camera} | {row.task} | {row.threads} | {row.wall['engine']:.3f} | {row.wall['torch, plain']:.0f} "
            f"| {row.ratio['torch, plain']:.0f} | {row.ratio['torch, tuned']:.0f} | {by_processor} |"
        )
    return "\n".join(lines) + "\n"


def write(rows, settings, folder):
    """Writes bench.md and bench.json into the folder; returns the Markdown."""
    folder.mkdir(parents=True, exist_ok=True)
    made = made_by()
    text = markdown(rows, settings, made)
    content = {"made_by": made, "settings": dataclasses.asdict(settings), "rows": [dataclasses.asdict(row) for row in rows]}
    with files.together():
        files.write_text(folder / "bench.md", text)
        files.write_json(folder / "bench.json", content)
    return text
