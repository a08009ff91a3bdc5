"""Means over a dataset's rows: the headline, the breakdowns, and the causes.

Means are over conditions (pictures of one scene in one tier) with equal weights; net and noise are
over those with two seeds or more.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from learn.agreement import facets, surface, uncertainty
from learn.agreement.measure import Row

# net display L2 of the direct tier, in units of the materials' own node fit
LIMIT = 1.5  # times the node fit, up to which the layer is said to agree with Cycles
FIGURES = (
    "signed",
    "absolute",
    "l2",
    "noise",
    "net",
    "like_net",
    "ssim",
    "sum_signed",
    "sum_net",
    "node_fit",
)
CAUSES = ("noise", "node_fit", "footprint", "look_up", "net", "net_footprint", "rest", "texel_sum")
DIMENSIONS: dict[str, Callable[[Row], str]] = {
    "tier and light resolution": lambda row: f"{row.tier}, {row.light_resolution}",
    "highlight": lambda row: surface.width_name(row.half_width_deg),
    "material": lambda row: " + ".join(dict.fromkeys(row.materials)),
    "family": lambda row: " + ".join(dict.fromkeys(row.families)),
    "light": lambda row: row.light,
    "category": lambda row: row.category,
    "camera": lambda row: (
        "orthographic" if row.fov_deg is None else f"perspective {row.fov_deg:g}°"
    ),
}


def mean(values: Iterable[float | None]) -> float | None:
    """Return the mean of the values that are known, or None."""
    known = [value for value in values if value is not None and np.isfinite(value)]
    return float(np.mean(known)) if known else None


def figures(rows: Sequence[Row]) -> dict[str, float | None]:
    """Return {figure: mean} of some rows, and their number."""
    return {"pictures": sum(row.seeds for row in rows), "conditions": len(rows)} | {
        f: mean([getattr(row, f) for row in rows]) for f in FIGURES
    }


def direct(rows: Iterable[Row]) -> list[Row]:
    """Return the rows of what the layer models: direct light of the 64×128 map."""
    return [row for row in rows if row.tier == "direct" and row.light_resolution == "64x128"]


def breakdown(rows: Iterable[Row], key: Callable[[Row], str]) -> dict[str, dict[str, float | None]]:
    """Return {value: figures}, the largest l2 first."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return dict(
        sorted(
            ((value, figures(group)) for value, group in groups.items()),
            key=lambda item: -(item[1]["l2"] or 0.0),
        )
    )


def bin_by_grazing_angle(rows: Sequence[Row]) -> list[dict]:
    """Return for each bin of surface.GRAZING_DEG its pixels, mean L2 and mean signed error.

    All pixels have equal weights; the signed error is relative.
    """
    bins = []
    for i, low in enumerate(surface.GRAZING_DEG[:-1]):
        cells = [row.grazing[i] for row in rows]
        pixels = sum(cell["pixels"] for cell in cells)
        weighted = {
            key: sum(cell["pixels"] * cell[key] for cell in cells) / pixels if pixels else None
            for key in ("l2", "signed")
        }
        bins.append(
            {"from_deg": low, "to_deg": surface.GRAZING_DEG[i + 1], "pixels": pixels} | weighted
        )
    return bins


def causes(rows: Sequence[Row]) -> dict:
    """Return the mean L2 of each cause and of the edges, and the light's turn in texels.

    rows  of the direct tier; those whose causes were measured count
    """
    known = [row.causes for row in rows if row.causes]
    out: dict = {name: mean([cause[name] for cause in known]) for name in CAUSES}
    out["edges"] = mean([row.edge_net for row in rows])
    shifts = [cause["look_up_texels"] for cause in known]
    out["look_up_texels"] = (
        {"median": float(np.median(shifts)), "largest": float(np.max(np.abs(shifts)))}
        if shifts
        else None
    )
    return out


def whole(rows: Iterable[Row]) -> dict | None:
    """Return the means of facets.FIGURES over the direct tier's rows, and whether the limit holds.

    Of the pixels of the whole mask the prediction must lie within LIMIT times the node fit of the
    catalogue. predicted_error and noise_may_decide are as in `headline`. None where no row has the
    figures
    """
    known = [row for row in direct(rows) if row.whole]
    if not known:
        return None
    means = {name: mean([(row.whole or {})[name] for row in known]) for name in facets.FIGURES}
    fit = mean([row.node_fit for row in known])
    predicted = means["predicted"]
    holds = None if fit is None or predicted is None else bool(predicted <= LIMIT * fit)
    error = uncertainty.of_mean((row.whole or {}).get("predicted_error") for row in known)
    return {
        "conditions": len(known),
        **means,
        "predicted_error": error,
        "node_fit_catalogue": fit,
        "holds": holds,
        "noise_may_decide": uncertainty.noise_may_decide(
            predicted, error, None if fit is None else LIMIT * fit
        ),
    }


def headline(rows: Iterable[Row]) -> dict:
    """Return the direct tier's net display L2 against LIMIT times the node fit of its materials.

    net        over the whole mask; like_net over the pixels inside, both renderers over the same
               part of the pixel. The limit judges like_net, since a silhouette pixel of Cycles is
               partly background, and the layer has no background
    node_fit   of the catalogue; node_fit_measured on these very pictures (inner pixels). The limit
               uses the catalogue's where there is one
    holds      None if there is no second seed
    like_net_error    standard error of like_net that Cycles' noise alone makes
    noise_may_decide  whether the limit is so close that noise may have decided holds; None where
                      that is not known
    """
    own = direct(rows)
    net, like, fit = (
        mean([getattr(row, key) for row in own]) for key in ("net", "like_net", "node_fit")
    )
    measured = mean([row.causes["node_fit"] for row in own if row.causes])
    against = measured if fit is None else fit
    holds = None if like is None or against is None else bool(like <= LIMIT * against)
    error = uncertainty.of_mean(row.like_net_error for row in own)
    noise = {
        "like_net_error": error,
        "noise_may_decide": uncertainty.noise_may_decide(
            like, error, None if against is None else LIMIT * against
        ),
    }
    shares = {
        "edge_share": mean([row.edge_share for row in own]),
        "sum_net": mean([row.sum_net for row in own]),
    }
    fits = {"node_fit": fit, "node_fit_measured": measured, "limit": LIMIT, "holds": holds}
    return {"conditions": len(own), "net": net, "like_net": like} | noise | shares | fits


def summarise(rows: Sequence[Row]) -> dict:
    """Return the summary of report.json and of the page."""
    own = direct(rows)
    return {
        "all": figures(rows) if rows else {},
        "direct": headline(rows),
        "causes": causes(own),
        "whole": whole(own),
        "grazing": bin_by_grazing_angle(own),
        "breakdowns": (
            {"tier and light resolution": breakdown(rows, DIMENSIONS["tier and light resolution"])}
            | {
                name: breakdown(own, key)
                for name, key in DIMENSIONS.items()
                if name != "tier and light resolution"
            }
        ),
    }
