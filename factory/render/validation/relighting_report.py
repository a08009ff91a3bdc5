"""Figures, page and chart of factory.render.validation.relighting, from its rows.

A row has scene, shape, material, number_of_light, family, samples, error, and seconds: `once` for a
view and material, 0 of what renders light by light, and `each` for every picture.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from factory.render.validation.speed_accuracy_report import at_error
from manifests.files import write_figure

COUNTS = (1, 4, 16, 64)  # pictures of a view and material
OTHERS = ("path tracing", "denoised", "ratio")


def by_scene(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a row for each scene, family and number of samples: means over the lights."""
    groups: dict[tuple, list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["scene"], row["family"], row["samples"]), []).append(row)
    return [
        {
            **{key: of[0][key] for key in ("scene", "shape", "material", "family", "samples")},
            **{key: float(np.mean([row[key] for row in of])) for key in ("error", "once", "each")},
        }
        for of in groups.values()
    ]


def speeds(row: dict[str, Any], scene: list[dict[str, Any]]) -> list[float]:
    """Return for each of COUNTS how much faster a basis is than what is fastest at its error.

    row    of `by_scene`, of a basis
    scene  all rows of that scene
    """
    others = [dict(each, seconds=each["each"]) for each in scene if each["family"] in OTHERS]
    fastest = min(at_error(others, row["error"], family) for family in OTHERS)
    return [fastest / (row["once"] / count + row["each"]) for count in COUNTS]


def pays_from(row: dict[str, Any], scene: list[dict[str, Any]]) -> float:
    """Return the least number of pictures from which a basis is faster; infinity if none is."""
    others = [dict(each, seconds=each["each"]) for each in scene if each["family"] in OTHERS]
    left = min(at_error(others, row["error"], family) for family in OTHERS) - row["each"]
    return max(1, math.ceil(row["once"] / left)) if left > 0 else math.inf


def figures(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a row for each family and number of samples; speeds and `pays_from` of bases only."""
    means, result = by_scene(rows), []
    for key in dict.fromkeys((row["family"], row["samples"]) for row in means):
        of = [row for row in means if (row["family"], row["samples"]) == key]
        errors = np.array([row["error"] for row in of])
        once, each = (float(np.mean([row[name] for row in of])) for name in ("once", "each"))
        figure: dict[str, Any] = {
            "family": key[0],
            "samples": key[1],
            "error_median": float(np.median(errors)),
            "error_mean": float(errors.mean()),
            "error_worst": float(errors.max()),
            "seconds": [once / count + each for count in COUNTS],
        }
        if key[0] not in OTHERS:
            scenes = [[row for row in means if row["scene"] == at["scene"]] for at in of]
            every = np.array([speeds(row, scene) for row, scene in zip(of, scenes, strict=True)])
            figure["speed_mean"] = np.exp(np.log(every).mean(0)).tolist()
            figure["faster"] = (every > 1).sum(0).tolist()
            least = [pays_from(row, scene) for row, scene in zip(of, scenes, strict=True)]
            figure["pays_from"] = [count if count < math.inf else None for count in least]
        result.append(figure)
    return result


def report(result: dict[str, Any]) -> str:
    """Return the page of a measurement."""
    counts = " | ".join(f"N = {count}" for count in COUNTS)
    lines = [
        "# Relighting by a basis of lights",
        "",
        f"    {result['command']}",
        "",
        f"Commit {result['commit']}, {result['date']}, {result['machine']};"
        f" {result['scenes']} scenes of {result['size']}×{result['size']}, full transport,"
        f" references of {2 * result['reference']} samples.",
        "Seconds are of a processor, per picture, where N pictures are made of a view and material;"
        " the speed is that of the basis beside the fastest of path tracing, denoiser and ratio at"
        " the same error (geometric mean; in brackets the scenes on which it is above 1).",
        "",
        "![chart](chart.png)",
        "",
        f"| method | samples | error: median | mean | worst | seconds: {counts}"
        f" | speed: {counts} |",
        "|" + "---|" * (5 + 2 * len(COUNTS)),
    ]
    for each in result["figures"]:
        seconds = " | ".join(f"{value:.2f}" for value in each["seconds"])
        speed = " | ".join("–" for _ in COUNTS)
        if "faster" in each:
            pairs = zip(each["speed_mean"], each["faster"], strict=True)
            speed = " | ".join(f"{mean:.2f} ({count})" for mean, count in pairs)
        lines.append(
            f"| {each['family']} | {each['samples']} | {each['error_median']:.3g}"
            f" | {each['error_mean']:.3g} | {each['error_worst']:.3g} | {seconds} | {speed} |"
        )
    means = by_scene(result["rows"])
    lines += [
        "",
        "The setting of a basis that is fastest at N = 64 on each scene, and the number of pictures"
        " from which it pays:",
        "",
        "| scene | setting | error | speed at N = 64 | pays from |",
        "|---|---|---|---|---|",
    ]
    for number in sorted({row["scene"] for row in means}):
        scene = [row for row in means if row["scene"] == number]
        bases = [row for row in scene if row["family"] not in OTHERS]
        best = max(bases, key=lambda row: speeds(row, scene)[-1])
        least = pays_from(best, scene)
        lines.append(
            f"| {best['shape']}, {best['material']} | {best['family']}, {best['samples']} samples"
            f" | {best['error']:.3g} | {speeds(best, scene)[-1]:.2f}"
            f" | {least if least < math.inf else 'never'} |"
        )
    return "\n".join(lines) + "\n"


def chart(of: list[dict[str, Any]], path: Path) -> None:
    """Draw the mean error over pictures per second, a panel for each of COUNTS."""
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(15, 4.4), layout="constrained")
    panels = drawing.subplots(1, len(COUNTS), sharex=True, sharey=True)
    for number, (axes, count) in enumerate(zip(panels, COUNTS, strict=True)):
        for family in dict.fromkeys(each["family"] for each in of):
            at = [each for each in of if each["family"] == family]
            x = [1 / each["seconds"][number] for each in at]
            y = [max(each["error_mean"], 1e-2) for each in at]
            other = family in OTHERS
            axes.plot(x, y, "o-" if other else "s--", label=family, lw=2 if other else 1, ms=4)
        axes.set(xscale="log", yscale="log", title=f"{count} pictures of a view and material")
        axes.set_xlabel("pictures per second and core")
        axes.grid(alpha=0.3, which="both")
    panels[0].set_ylabel("display L2 over the object, mean")
    panels[-1].legend(fontsize=7)
    write_figure(path, drawing, dpi=100)
