"""The fit errors of a catalogue as a table, plots and JSON, compared with their limits."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from manifests.errors import InputError
from manifests.files import transaction, write_figure, write_json, write_text
from manifests.materials import Entry, read_catalogue
from manifests.provenance import provenance
from shaders.samples import HELD_OUT_DEG

LIMITS = (  # name, key of the figure, limit, what the prototype reached
    ("label against nodes, L1, median", "agreement_median", 0.015, "0.017"),
    ("label against nodes, L1, 95th percentile", "agreement_p95", 0.035, "0.040"),
    ("label against nodes, worst view of a material, 95th percentile", "worst_p95", 0.06, "0.071"),
    ("label against nodes on a sphere, display L2, median", "display_median", 0.4, "0.37"),
    ("label against nodes on a sphere, display L2, 95th percentile", "display_p95", 2.0, "2.57"),
    ("label against nodes on a sphere, display L2, largest", "display_max", 10.0, "18.3"),
    ("nodes against measurement, L1, median", "drift_median", 0.070, "0.071"),
    ("nodes against measurement, L1, 95th percentile", "drift_p95", 0.17, "0.177"),
)


def figures(entries: Sequence[Entry]) -> dict[str, float]:
    """Return the figures of LIMITS, and those of label against measurement and of closures."""
    agreement = np.array([e.errors.nodes_vs_label.l1 for e in entries])
    drift = np.array([e.errors.nodes_vs_source.l1 for e in entries])
    label = np.array([e.errors.label_vs_source.l1 for e in entries])
    shown = np.array([e.errors.nodes_vs_label.display_l2 for e in entries])
    result = {
        "agreement_median": np.median(agreement.mean(1)),
        "agreement_p95": np.percentile(agreement.mean(1), 95),
        "worst_p95": np.percentile(agreement.max(1), 95),
        "drift_median": np.median(drift.mean(1)),
        "drift_p95": np.percentile(drift.mean(1), 95),
        "label_drift_median": np.median(label.mean(1)),
        "label_drift_p95": np.percentile(label.mean(1), 95),
        "closures_mean": np.mean([len(e.mixture.kinds) for e in entries]),
    }
    if shown.size:
        result |= {
            "display_median": np.median(shown),
            "display_p95": np.percentile(shown, 95),
            "display_max": shown.max(),
        }
    return {key: float(f"{value:.4g}") for key, value in result.items()}


def by_view(entries: Sequence[Entry]) -> np.ndarray:
    """Return the median L1 (6,) of label against nodes at each held-out view angle."""
    return np.median([e.errors.nodes_vs_label.l1 for e in entries], axis=0)


def write(path: str | Path, out: Path, source: Path | None = None, abc: Path | None = None) -> str:
    """Write report.md, report.json and errors.png into `out`; return the table of limits as text.

    source, abc  measurements and ABC parameters to compare with each other, or None
    """
    from factory.materials import abc as microfacets
    from factory.materials import sources

    catalogue = read_catalogue(path)
    entries = catalogue.materials
    if not entries:
        raise InputError(
            path, "a material to report on", "none", "add one: python -m factory materials add"
        )
    result, made = figures(entries), provenance()
    witnesses = {}
    if source and abc:
        witnesses = {
            name: l1.mean()
            for name, l1 in microfacets.relative_distances(
                sources.load(source), microfacets.load(abc)
            ).items()
        }
    out.mkdir(parents=True, exist_ok=True)
    table = limits_table(result)
    data = {
        **made,
        "catalogue": Path(path).name,
        "materials": len(entries),
        "light_maps": catalogue.light_maps,
        "figures": result,
    }
    data |= {
        "nodes_vs_label_by_view": dict(
            zip(map(str, HELD_OUT_DEG), map(float, by_view(entries)), strict=True)
        )
    }
    data |= {
        "measurement_vs_abc": {name: float(f"{value:.4g}") for name, value in witnesses.items()}
    }
    with transaction():
        write_text(out / "report.md", _page(catalogue, table, result, made, witnesses))
        write_json(out / "report.json", data)
        plot(entries, out / "errors.png")
    return f"{table}\n{out}: report.md, report.json, errors.png"


def limits_table(reached: Mapping[str, float]) -> str:
    """Return a Markdown table of each limit, the figure reached, and whether it is kept."""
    rows = ["| what | prototype | reached | limit | kept |", "|---|---|---|---|---|"]
    for text, key, limit, before in LIMITS:
        if key in reached:
            rows.append(
                f"| {text} | {before} | {reached[key]:g} | ≤ {limit:g} |"
                f" {'yes' if reached[key] <= limit else '**no**'} |"
            )
    return "\n".join(rows)


def _page(catalogue, table, reached, made, witnesses):
    entries = catalogue.materials
    views = ", ".join(
        f"{d:g}°: {v:.3f}" for d, v in zip(HELD_OUT_DEG, by_view(entries), strict=True)
    )
    maps = ", ".join(catalogue.light_maps) or "none"
    lines = [
        f"# {catalogue.title}: fit errors",
        "",
        *(f"{key}: `{value}`  " for key, value in made.items()),
        f"display errors on a sphere under: {maps}",
        "",
        table,
        "",
        (
            f"Label against nodes, median by view angle: {views}. Label against measurement: median"
            f" {reached['label_drift_median']:g}, 95th percentile {reached['label_drift_p95']:g}."
            f" Closures per material: {reached['closures_mean']:g}."
        ),
        "",
        "![errors](errors.png)",
        "",
    ]
    if witnesses:
        values = np.array(list(witnesses.values()))
        far = sorted(witnesses, key=witnesses.get)[-5:][::-1]
        lines += [
            (
                "Measurement (neural fits) against ABC microfacet fits, L1 at the same views:"
                f" median {np.median(values):.3f}, 95th percentile {np.percentile(values, 95):.3f};"
                f" farthest {', '.join(f'{n} {witnesses[n]:.2f}' for n in far)}."
            ),
            "",
        ]
    lines += [
        (
            "| material | family | split | nearest for training | closures | L–N | worst | N–M |"
            " L–M | display L2 |"
        ),
        "|" + "---|" * 10,
    ]
    for e in entries:
        near = f"{e.nearest_train.name} {e.nearest_train.distance:.2f}" if e.nearest_train else ""
        shown = " ".join(f"{v:.2f}" for v in e.errors.nodes_vs_label.display_l2)
        a, d, w = e.errors.nodes_vs_label, e.errors.nodes_vs_source, e.errors.label_vs_source
        lines.append(
            f"| {e.name} | {e.family} | {e.split} | {near} | {len(e.mixture.kinds)} | {a.mean:.4f}"
            f" | {a.worst:.4f} | {d.mean:.3f} | {w.mean:.3f} | {shown} |"
        )
    lines += [
        "",
        (
            "L–N: label against nodes, relative L1, mean of the six view angles; worst: of the six;"
            " N–M, L–M: against the measurement."
        ),
    ]
    return "\n".join(lines) + "\n"


def plot(entries: Sequence[Entry], path: Path) -> None:
    """Draw sorted errors with their limits, and agreement over drift by family."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4.6), constrained_layout=True)
    share = (np.arange(len(entries)) + 0.5) / len(entries) * 100
    curves = (
        ("label against nodes", [e.errors.nodes_vs_label.mean for e in entries], "C0"),
        ("… at the worst view", [e.errors.nodes_vs_label.worst for e in entries], "C9"),
        ("nodes against measurement", [e.errors.nodes_vs_source.mean for e in entries], "C1"),
        ("label against measurement", [e.errors.label_vs_source.mean for e in entries], "C3"),
    )
    for name, values, colour in curves:
        left.plot(share, np.sort(values), label=name, color=colour)
    for x, limit, colour in (
        (50, 0.015, "C0"),
        (95, 0.035, "C0"),
        (95, 0.06, "C9"),
        (50, 0.07, "C1"),
        (95, 0.17, "C1"),
    ):
        left.plot([x], [limit], "v", color=colour)
    left.set(
        yscale="log",
        xlabel="percent of the materials (triangles: limits)",
        ylabel="relative L1 of f · cos",
    )
    left.legend(frameon=False)
    for family in sorted({e.family for e in entries}):
        own = [e for e in entries if e.family == family]
        right.plot(
            [e.errors.nodes_vs_source.mean for e in own],
            [e.errors.nodes_vs_label.mean for e in own],
            "o",
            label=family,
            ms=4,
        )
    right.set(
        xscale="log", yscale="log", xlabel="nodes against measurement", ylabel="label against nodes"
    )
    right.legend(frameon=False, fontsize=7, ncols=2)
    write_figure(path, figure, dpi=90)
    plt.close(figure)
