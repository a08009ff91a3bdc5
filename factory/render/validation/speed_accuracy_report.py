"""The figures, the page and the drawing of factory.render.validation.speed_accuracy.

rows  dictionaries of one scene and setting each, with family, setting, seconds and error, and
      squared_bias where it was measured
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from manifests.files import write_figure

LEAST_ERROR = 0.05  # that references of some hundred samples can tell from none
LEAST_OF_LOGARITHMS = 1e-3  # errors, which the noise of references can make negative
LIMIT = "limit on the error"
CLOSED = "closed form"
PEER_NAME = "BlenderProc"
BARE_LOOP = "bare loop in Blender"
UNLIKE = "no denoiser"  # of a setting that differs in more than samples from its family
PEER_DEFAULTS = "defaults"  # of its settings
OURS = ("path tracing", "denoised", "ratio", CLOSED, LIMIT)
BIASED = ("denoised", "adaptive sampling, denoised", "ratio", CLOSED)


def by_error(rows: Sequence[dict[str, Any]]) -> tuple[np.ndarray, np.ndarray]:
    """Return the logarithms of settings' errors, rising, and of their seconds, which never rise."""
    pairs = sorted((max(row["error"], LEAST_OF_LOGARITHMS), row["seconds"]) for row in rows)
    x, y = (np.log([pair[k] for pair in pairs]) for k in (0, 1))
    return x, np.minimum.accumulate(y)  # a larger error never needs more time


def at_error(rows: list[dict[str, Any]], error: float, family: str = LIMIT) -> float:
    """Return the seconds that a family of settings takes for a scene at an error.

    Interpolated between the settings' achieved errors and times. Beyond them noise in proportion to
    1/samples is assumed, which holds for unbiased families only: infinity for the others.
    """
    of = [row for row in rows if row["family"] == family]
    if not of:
        return float("inf")
    x, y = by_error(of)
    target = np.log(max(error, LEAST_OF_LOGARITHMS))
    if target < x[0]:
        return float(np.exp(y[0] + x[0] - target)) if family not in BIASED else float("inf")
    return float(np.exp(np.interp(target, x, y)))


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a row for each family and setting: errors, seconds, and the speed at its error."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    by_scene: dict[int, list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["family"], row["setting"]), []).append(row)
        by_scene.setdefault(row["scene"], []).append(row)
    result = []
    for (family, setting), of in groups.items():
        errors = np.array([row["error"] for row in of])
        ratios = np.array(
            [row["seconds"] / at_error(by_scene[row["scene"]], row["error"]) for row in of]
        )
        best = np.array(
            [
                row["seconds"]
                / min(at_error(by_scene[row["scene"]], row["error"], each) for each in OURS)
                for row in of
            ]
        )
        result.append(
            {
                "family": family,
                "setting": setting,
                "scenes": len(of),
                "error_mean": float(errors.mean()),
                "error_worst": float(errors.max()),
                **_biases(of),
                "seconds": float(np.mean([row["seconds"] for row in of])),
                "speed_mean": float(np.exp(np.log(ratios).mean())),
                "speed_worst": float(ratios.min()),
                "best_mean": float(np.exp(np.log(best).mean())),
                "best_worst": float(best.min()),
            }
        )
    return result


def _of_rounds(result: dict[str, Any]) -> str:
    """Say that times are the least of several, where they are."""
    rounds = result.get("rounds", 1)
    return f", the least of {rounds} rounds" if rounds > 1 else ""


def _biases(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Return the mean and the largest squared bias of a setting's rows; {} if not measured."""
    biases = [row["squared_bias"] for row in rows if "squared_bias" in row]
    if not biases:
        return {}
    return {"bias_mean": float(np.mean(biases)), "bias_worst": float(np.max(biases))}


def report(result: dict[str, Any]) -> str:
    """Return the page of a measurement."""
    figures = result["figures"]
    noise = max(row["reference_noise"] for row in result["rows"])
    biased = any("bias_mean" in each for each in figures)
    lines = [
        "# Error against time per picture",
        "",
        f"    {result['command']}",
        "",
        f"Commit {result['commit']}, {result['date']}, {result['machine']}.",
        f"{result['scenes']} scenes of {result['size']}×{result['size']}, {result['tier']};"
        f" references of {2 * result['reference']} samples, whose own display error is at most"
        f" {noise:.2g}.{_of_doubt(result['rows'])}",
        f"Times are processor seconds in one thread{_of_rounds(result)}; the speed is the time"
        " divided by the one that a limit on the error takes at the same error, per scene; and by"
        " the one of our family of settings that is fastest there, as one chooses who knows the"
        " errors.",
        "",
        "![chart](chart.png)",
        "",
        "| method | setting | error: mean | worst |"
        + (" squared bias: mean | worst |" if biased else "")
        + " seconds | speed of a limit: mean | worst | of our best: mean | worst |",
        "|---|---|---|---|---|---|---|---|---|" + ("---|---|" if biased else ""),
    ]
    for each in figures:
        speed = f"{each['speed_mean']:.1f} | {each['speed_worst']:.1f}"
        if each["family"] == LIMIT:
            speed = "– | –"
        best = "– | –"
        if each["family"] not in OURS:
            best = f"{each['best_mean']:.1f} | {each['best_worst']:.1f}"
        lines.append(
            f"| {each['family']} | {each['setting']}{_scenes(each, result)}"
            f" | {each['error_mean']:.3g}"
            f" | {each['error_worst']:.3g} |{_bias_cells(each) if biased else ''}"
            f" {each['seconds']:.3f} | {speed} | {best} |"
        )
    tiers = list(dict.fromkeys(row["tier"] for row in result["rows"]))
    if len(tiers) > 1 and any(row["family"] == PEER_NAME for row in result["rows"]):
        lines += by_tier(result["rows"], tiers)
    if again := [row for row in result["rows"] if "longer" in row]:
        lines += by_longer_reference(again)
    if direct := [row for row in result["rows"] if row["tier"] == "direct"]:
        lines += against_path_tracing(direct)
    return "\n".join(lines) + "\n"


def _of_doubt(rows: list[dict[str, Any]]) -> str:
    """Say what standard errors the references' noise gives the errors, where they are known."""
    if not any("standard_error" in row for row in rows):
        return ""
    shares = [
        row["standard_error"] / max(row["error"], LEAST_ERROR)
        for row in rows
        if row["family"] in (PEER_NAME, BARE_LOOP)
    ]
    most = max(row["standard_error"] for row in rows)
    of_peers = (
        f"; of other programs' errors it is {100 * float(np.median(shares)):.2g} % in the median"
        f" and {100 * max(shares):.2g} % at most"
        if shares
        else ""
    )
    return f" The standard error that this gives an error is at most {most:.2g}{of_peers}."


def by_longer_reference(rows: list[dict[str, Any]]) -> list[str]:
    """Return lines on the errors and speeds that a longer reference shows.

    rows  of scenes that have both
    """
    noise = max(row["longer"]["reference_noise"] for row in rows)
    count = len({row["scene"] for row in rows})
    lines = [
        "",
        f"{count} of the scenes with a longer reference, too, whose own display error is at most"
        f" {noise:.2g}; ± is the standard error that the reference's noise gives, in the mean:",
        "",
        "| method | setting | error: mean | by the longer reference | speed of a limit: mean |"
        " by the longer reference |",
        "|---|---|---|---|---|---|",
    ]
    again = [{**row, **row["longer"]} for row in rows]
    for short, long in zip(summary(rows), summary(again), strict=True):
        names = short["family"], short["setting"]
        doubts = [
            float(
                np.mean([r["standard_error"] for r in of if (r["family"], r["setting"]) == names])
            )
            for of in (rows, again)
        ]
        speeds = [f"{each['speed_mean']:.2f}" for each in (short, long)]
        if names[0] == LIMIT:
            speeds = ["–", "–"]
        lines.append(
            f"| {names[0]} | {names[1]}"
            f" | {short['error_mean']:.3g} ± {doubts[0]:.2g}"
            f" | {long['error_mean']:.3g} ± {doubts[1]:.2g} | {speeds[0]} | {speeds[1]} |"
        )
    return lines


def _bias_cells(figures: dict[str, Any]) -> str:
    """Return two cells of the table; a squared bias below 0 is one below the noise."""
    return f" {max(figures['bias_mean'], 0):.2g} | {max(figures['bias_worst'], 0):.2g} |"


def _scenes(figures: dict[str, Any], result: dict[str, Any]) -> str:
    """Return on how many scenes a setting was measured, where it was not on all."""
    return "" if figures["scenes"] == result["scenes"] else f", on {figures['scenes']} of them"


def by_tier(rows: list[dict[str, Any]], tiers: Sequence[str]) -> list[str]:
    """Return lines on the speed beside BlenderProc's defaults at their error, tier by tier."""
    lines = [
        "",
        "At the error of BlenderProc's defaults:",
        "",
        "| tier | scenes | error: mean | speed of a limit: mean | worst |"
        " of our best: mean | worst |",
        "|---|---|---|---|---|---|---|",
    ]
    for tier in tiers:
        here = [row for row in rows if row["tier"] == tier]
        (each,) = (
            each
            for each in summary(here)
            if (each["family"], each["setting"]) == (PEER_NAME, PEER_DEFAULTS)
        )
        lines.append(
            f"| {tier} | {each['scenes']} | {each['error_mean']:.2f}"
            f" | {each['speed_mean']:.1f} | {each['speed_worst']:.1f}"
            f" | {each['best_mean']:.1f} | {each['best_worst']:.1f} |"
        )
    return lines


def against_path_tracing(rows: list[dict[str, Any]]) -> list[str]:
    """Return lines on how much longer path tracing takes to reach the closed form's error.

    The closed form counts with the most points for a pixel, and errors below LEAST_ERROR count as
    that. Beyond path tracing's most samples its error is continued in two ways: as 1/time, and at
    the rate of its last two settings, which is mostly faster, since Cycles' samples lie between
    each other.
    """
    lines = [
        "",
        "Direct light by the closed form, and how many times as long path tracing takes for the"
        " same error, which it is continued to beyond its most samples:",
        "",
        "| scene | error | seconds | path tracing: error | times as long, by 1/time | at the rate"
        " of its last settings | that rate |",
        "|---|---|---|---|---|---|---|",
    ]
    speeds = []
    for scene in sorted({row["scene"] for row in rows}):
        of = [row for row in rows if row["scene"] == scene]
        closed = [row for row in of if row["family"] == CLOSED][-1]
        few, many = sorted(
            (row for row in of if row["family"] == "path tracing"), key=lambda row: row["seconds"]
        )[-2:]
        errors = [max(row["error"], LEAST_ERROR) for row in (few, many, closed)]
        power = np.log(errors[0] / errors[1]) / np.log(many["seconds"] / few["seconds"])
        factor, longer = errors[1] / errors[2], many["seconds"] / closed["seconds"]
        speeds.append((factor * longer, factor ** (1 / power) * longer))
        lines.append(
            f"| {closed['shape']}, {closed['material']} | {closed['error']:.2f}"
            f" | {closed['seconds']:.2f} | {many['error']:.2f} | {speeds[-1][0]:.0f}"
            f" | {speeds[-1][1]:.0f} | −{power:.2f} |"
        )
    mean, least = np.exp(np.log(speeds).mean(0)), np.min(speeds, axis=0)
    both = " | ".join(f"{m:.0f}, {w:.0f}" for m, w in zip(mean, least, strict=True))
    return [*lines, f"| geometric mean, worst | | | | {both} | |"]


def chart(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw mean and worst errors over pictures per second, tier by tier."""
    from matplotlib.figure import Figure

    tiers = list(dict.fromkeys(row["tier"] for row in rows))
    drawing = Figure(figsize=(11, 0.4 + 4.4 * len(tiers)), layout="constrained")
    families = list(dict.fromkeys(row["family"] for row in rows))
    colours = {family: f"C{k % 10}" for k, family in enumerate(families)}
    grid = drawing.subplots(len(tiers), 2, sharex="row", sharey="row", squeeze=False)
    for line, tier in zip(grid, tiers, strict=True):
        figures = summary([row for row in rows if row["tier"] == tier])
        for axes, key, title in zip(
            line, ("error_mean", "error_worst"), ("mean over scenes", "worst scene"), strict=True
        ):
            _draw(axes, figures, key, colours)
            axes.set_title(f"{tier}: {title}" if len(tiers) > 1 else title)
        line[0].set_ylabel("display L2 over the object")
        line[0].legend(fontsize=7, title="numbers: samples per pixel", title_fontsize=7)
    write_figure(path, drawing, dpi=110)


def _draw(axes: Any, figures: list[dict[str, Any]], key: str, colours: dict[str, str]) -> None:
    """Draw a line for each family, of its settings that all scenes have."""
    from matplotlib.ticker import LogLocator, NullFormatter

    most = max(each["scenes"] for each in figures)
    figures = [each for each in figures if each["scenes"] == most]
    for family in dict.fromkeys(each["family"] for each in figures):
        of = sorted(
            (each for each in figures if each["family"] == family),
            key=lambda each: each["seconds"],
        )
        # more samples, and whether they are denoised, are two things: one line has the first
        alike = [each for each in of if UNLIKE not in each["setting"]]
        others = [each for each in of if each not in alike]
        colour, width = colours[family], 2.5 if family == LIMIT else 1.2
        axes.plot(*_places(alike, key), "o-", label=family, color=colour, lw=width, ms=5)
        if others:
            filled = {"mfc": "white", "mec": colour}
            label = f"{family}, {UNLIKE}"
            axes.plot(*_places(others, key), "o", label=label, ms=5, ls="none", **filled)
        if family in (PEER_NAME, BARE_LOOP):
            for each, x, y in zip(alike, *_places(alike, key), strict=True):
                axes.annotate(
                    each["setting"].removesuffix(" samples"),
                    (x, y),
                    xytext=(5, 4) if family == PEER_NAME else (-5, -11),
                    ha="left" if family == PEER_NAME else "right",
                    textcoords="offset points",
                    fontsize=7,
                    color=colour,
                )
    axes.set(xscale="log", yscale="log", xlabel="pictures per second and core")
    for axis in (axes.xaxis, axes.yaxis):  # plain numbers, few enough for less than a decade
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    axes.grid(alpha=0.3, which="both")


def _places(of: list[dict[str, Any]], key: str) -> tuple[list[float], list[float]]:
    """Return pictures per second and the errors `key` of settings."""
    return [1 / each["seconds"] for each in of], [max(each[key], 1e-2) for each in of]
