"""A dataset's rows added up: the headline, the breakdowns, the causes.

Means are over conditions (pictures of one scene in one tier), each counting alike. net and noise:
over those with two seeds or more.
"""

import numpy as np

from learn.agreement import surface

# net display L2 of the direct tier, in units of the materials' own node fit: the agreement that was
# asked for
LIMIT = 1.5
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
DIMENSIONS = {
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


def mean(values):
    """Mean of the values that are known, or None."""
    known = [value for value in values if value is not None and np.isfinite(value)]
    return float(np.mean(known)) if known else None


def figures(rows):
    """{figure: mean} of some rows, and how many."""
    return {"pictures": sum(row.seeds for row in rows), "conditions": len(rows)} | {
        f: mean([getattr(row, f) for row in rows]) for f in FIGURES
    }


def direct(rows):
    """Rows of what the layer claims to model: no shadow, no interreflection, the 64×128 map."""
    return [row for row in rows if row.tier == "direct" and row.light_resolution == "64x128"]


def breakdown(rows, key):
    """{value: figures}, the worst l2 first."""
    groups = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return dict(
        sorted(
            ((value, figures(group)) for value, group in groups.items()),
            key=lambda item: -item[1]["l2"],
        )
    )


def grazing(rows):
    """A list over the bins of surface.GRAZING_DEG: pixels, mean L2, mean relative signed error,
    pixels counting alike.
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


def causes(rows):
    """Mean L2 of each cause over the direct rows taken apart, and of the edges; the light's turn in
    texels.
    """
    known = [row.causes for row in rows if row.causes]
    out = {name: mean([cause[name] for cause in known]) for name in CAUSES}
    out["edges"] = mean([row.edge_net for row in rows])
    shifts = [cause["look_up_texels"] for cause in known]
    out["look_up_texels"] = (
        {"median": float(np.median(shifts)), "largest": float(np.max(np.abs(shifts)))}
        if shifts
        else None
    )
    return out


def headline(rows):
    """The direct tier's net display L2 against LIMIT times the node fit of its materials.

    net        over the whole mask; like_net over the pixels inside, both renderers over the same
    part of the pixel: what the limit judges,
               since a silhouette pixel of Cycles is partly background and the layer knows no
               background
    node_fit   of the catalogue; node_fit_measured on these very pictures (inner pixels). The limit
    takes the catalogue's where there is one
    holds      None if there is no second seed
    """
    own = direct(rows)
    net, like, fit = (
        mean([getattr(row, key) for row in own]) for key in ("net", "like_net", "node_fit")
    )
    measured = mean([row.causes["node_fit"] for row in own if row.causes])
    against = measured if fit is None else fit
    holds = None if like is None or against is None else bool(like <= LIMIT * against)
    shares = {
        "edge_share": mean([row.edge_share for row in own]),
        "sum_net": mean([row.sum_net for row in own]),
    }
    fits = {"node_fit": fit, "node_fit_measured": measured, "limit": LIMIT, "holds": holds}
    return {"conditions": len(own), "net": net, "like_net": like} | shares | fits


def summarise(rows):
    """All of it, for report.json and the page."""
    own = direct(rows)
    return {
        "all": figures(rows) if rows else {},
        "direct": headline(rows),
        "causes": causes(own),
        "grazing": grazing(own),
        "breakdowns": (
            {"tier and light resolution": breakdown(rows, DIMENSIONS["tier and light resolution"])}
            | {
                name: breakdown(own, key)
                for name, key in DIMENSIONS.items()
                if name != "tier and light resolution"
            }
        ),
    }
