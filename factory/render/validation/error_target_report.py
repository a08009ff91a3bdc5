"""Figures and page of factory.render.validation.error_target, from its rows."""

from __future__ import annotations

from typing import Any

import numpy as np

from factory.render.estimators import choice
from factory.render.estimators.blends import MOST_BIAS
from factory.render.estimators.halves import CONFIDENCE

FIXED = 64  # samples of the pictures that are made as without an error


def group(rows: list[dict[str, Any]], requested: float | None) -> dict[str, Any]:
    """Return the figures of the shots that requested an error; None: of all."""
    of = [row for row in rows if requested in (None, row["requested"])]
    column = {
        name: np.array([row[name] for row in of])
        for name in ("requested", "achieved", "estimated", "predicted", "squared_bias", "seconds")
    }
    kept = column["achieved"] <= column["requested"]
    fixed = np.array([row["fixed"] for row in of])
    per_sample = float(np.mean([row["fixed_seconds"] for row in of])) / FIXED
    result = {
        "requested": requested,
        "shots": len(of),
        "estimators": {name: sum(row["estimator"] == name for row in of) for name in choice.ALL},
        "kept": int(kept.sum()),
        "missed_beyond_doubt": sum(
            row["achieved"] - CONFIDENCE * row["achieved_standard_error"] > row["requested"]
            for row in of
        ),
        "bias_above_a_third": sum(_is_biased(row) for row in of),
        "biased_beyond_doubt": sum(_is_biased(row, CONFIDENCE) for row in of),
        "both_kept": sum(row["achieved"] <= row["requested"] and not _is_biased(row) for row in of),
        "achieved_over_requested": float((column["achieved"] / column["requested"]).mean()),
        "bias_over_requested": float((column["squared_bias"] / column["requested"]).mean()),
        "estimated_over_achieved": _percentiles(column["estimated"] / column["achieved"]),
        "predicted_over_achieved": _percentiles(column["predicted"] / column["achieved"]),
        "samples": float(np.mean([row["samples"] for row in of])),
        "seconds": float(column["seconds"].mean()),
    }
    if requested is not None:
        equal = FIXED * float(fixed.mean() / column["achieved"].mean())
        keeping = FIXED * float(np.quantile(fixed / requested, kept.mean()))
        result |= {
            "fixed_samples_of_the_same_mean": equal,
            "fixed_seconds_of_the_same_mean": equal * per_sample,
            "fixed_samples_that_keep_as_often": keeping,
            "fixed_seconds_that_keep_as_often": keeping * per_sample,
        }
    return result


def _is_biased(row: dict[str, Any], errors: float = 0.0) -> bool:
    """Return whether a squared bias is above its part of the limit by so many standard errors."""
    # rows of older checks have no uncertainty of the bias
    uncertainty = row.get("squared_bias_standard_error", row["achieved_standard_error"])
    return bool(row["squared_bias"] - errors * uncertainty > MOST_BIAS * row["requested"])


def _percentiles(values: np.ndarray) -> list[float]:
    """Return the 5th percentile, the median and the 95th percentile."""
    return [float(v) for v in np.percentile(values, [5, 50, 95])]


def cause(row: dict[str, Any]) -> str:
    """Return why a shot's error was not kept."""
    if row["estimated"] + CONFIDENCE * row["standard_error"] > row["requested"]:
        return "the most samples did not suffice"
    if row["achieved"] - CONFIDENCE * row["achieved_standard_error"] <= row["requested"]:
        return "within the uncertainty of the reference"
    if row["squared_bias"] > row["achieved"] / 2:
        return "bias that the estimate missed"
    return "noise that the halves' difference missed"


def report(result: dict[str, Any]) -> str:
    """Return the page of a `check`."""
    lines = [
        "# Errors to which jobs limit pictures",
        "",
        f"    {result['command']}",
        "",
        f"Commit {result['commit']}, {result['date']}, {result['machine']};"
        f" pictures of {result['size']}×{result['size']}.",
        "",
        "| requested | shots | path traced, denoised, ratio, closed form | kept"
        " | beyond doubt not | achieved ÷ requested, mean"
        " | squared bias ÷ requested, mean | bias above a third | beyond doubt | both kept"
        " | estimated ÷ achieved, 5 %, median, 95 % | predicted ÷ achieved |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]

    def three(values: list[float]) -> str:
        return ", ".join(f"{v:.2f}" for v in values)

    for g in result["figures"]["groups"]:
        lines.append(
            f"| {'all' if g['requested'] is None else format(g['requested'], 'g')} | {g['shots']}"
            f" | {', '.join(str(n) for n in g['estimators'].values())}"
            f" | {g['kept']} ({g['kept'] / g['shots']:.1%})"
            f" | {g['missed_beyond_doubt']} | {g['achieved_over_requested']:.2f}"
            f" | {g['bias_over_requested']:.3f} | {g['bias_above_a_third']}"
            f" | {g['biased_beyond_doubt']} | {g['both_kept']} ({g['both_kept'] / g['shots']:.1%})"
            f" | {three(g['estimated_over_achieved'])} | {three(g['predicted_over_achieved'])} |"
        )
    lines += [
        "",
        "Cost in processor seconds a picture, against one number of samples for all shots:",
        "",
        "| requested | samples | cost | fixed, same mean error: samples | cost | fixed, kept as"
        " often: samples | cost |",
        "|---|---|---|---|---|---|---|",
    ]
    for g in result["figures"]["groups"]:
        if g["requested"] is not None:
            lines.append(
                f"| {g['requested']:g} | {g['samples']:.0f} | {g['seconds']:.3f}"
                f" | {g['fixed_samples_of_the_same_mean']:.0f}"
                f" | {g['fixed_seconds_of_the_same_mean']:.3f}"
                f" | {g['fixed_samples_that_keep_as_often']:.0f}"
                f" | {g['fixed_seconds_that_keep_as_often']:.3f} |"
            )
    missed = [row for row in result["figures"]["rows"] if row["achieved"] > row["requested"]]
    lines += ["", f"Shots whose error was not kept ({len(missed)}):", ""]
    lines += [
        "| shot | estimator, samples | requested | estimated | achieved | cause |",
        "|---|---|---|---|---|---|",
    ]
    for row in sorted(missed, key=lambda row: row["requested"] / row["achieved"]):
        lines.append(
            f"| {row['shape']}, {row['material']}, {row['light']}, {row['tier']}"
            f" | {row['estimator']}, {row['samples']} | {row['requested']:g}"
            f" | {row['estimated']:.3g}"
            f" | {row['achieved']:.3g} ± {row['achieved_standard_error']:.2g} | {cause(row)} |"
        )
    biased = [row for row in result["figures"]["rows"] if _is_biased(row)]
    lines += ["", f"Shots whose squared bias is above a third of the limit ({len(biased)}):", ""]
    lines += [
        "| shot | estimator, samples | requested | squared bias | beyond doubt |",
        "|---|---|---|---|---|",
    ]
    for row in sorted(biased, key=lambda row: row["requested"] / row["squared_bias"]):
        uncertainty = row.get("squared_bias_standard_error", row["achieved_standard_error"])
        lines.append(
            f"| {row['shape']}, {row['material']}, {row['light']}, {row['tier']}"
            f" | {row['estimator']}, {row['samples']} | {row['requested']:g}"
            f" | {row['squared_bias']:.3g} ± {uncertainty:.2g}"
            f" | {'yes' if _is_biased(row, CONFIDENCE) else 'no'} |"
        )
    return "\n".join(lines) + "\n"
