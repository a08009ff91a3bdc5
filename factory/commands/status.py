"""`status DIR`: how much of a data set is made, what it holds, and what failed."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from manifests.help_format import HelpFormatter
from manifests.wording import number_of

if TYPE_CHECKING:
    from manifests.schema import Camera, Record

EPILOG = """examples:
  python -m factory status out/demo
  python -m factory status out/demo --json"""


def register(subparsers: argparse._SubParsersAction) -> None:
    """Add the parser of `status`."""
    parser = subparsers.add_parser(
        "status",
        help="show how much of a data set is made, and what failed",
        description=(
            "Counts the pictures and views of a data set by split, category, tier and light, and"
            " lists the failures. Reads only the records and opens no picture."
        ),
        epilog=EPILOG,
        formatter_class=HelpFormatter,
    )
    parser.add_argument(
        "folder", metavar="DIR", help="the data set's folder, or the URL of one on an object store"
    )
    parser.add_argument("--json", action="store_true", help="print the counts as JSON")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Print the counts; return 0. Raises InputError for a folder that is no data set."""
    import json

    report = count_data_set(options.folder)
    if options.json:
        print(json.dumps(report, indent=1))
        return 0
    made = report["records"] + report["views"]
    what = "pictures and views" if report["views"] else "pictures"
    if report["planned"] == 1:
        what = "view" if report["views"] else "picture"
    # jobs of one folder can share pictures, which are rendered once
    most = "at most " if len(report["jobs"]) > 1 and made < report["planned"] else ""
    planned = f"{most}{report['planned']}"
    print(f"{options.folder}: {made} of {planned} {what}, {report['failed']} failed")
    for job in report["jobs"]:
        print(
            f"  job {job['name']}: {number_of(job['shots'], job['of'][:-1])}, begun {job['begun']}"
        )
    if report["views"]:
        print(
            f"  views            {report['views']} without pictures: "
            + ", ".join(f"{n} {side}" for side, n in report["view_side"].items())
        )
    for key in ("split", "category", "tier", "light_resolution", "light"):
        if report[key]:
            print(
                f"  {key.replace('_', ' '):<16} "
                + ", ".join(f"{name} {count}" for name, count in report[key].items())
            )
    if any(low < high for low, high in report["cameras"].values()):
        print(
            f"  {'cameras':<16} "
            + ", ".join(
                f"{key.removesuffix('_deg')} {low:g}° to {high:g}°"
                for key, (low, high) in report["cameras"].items()
            )
        )
    for requested, kept in report["errors"].items():
        counts = ", ".join(f"{count} {name}" for name, count in kept["estimators"].items())
        print(
            f"  {'error ≤ ' + requested:<16} {counts}; estimated {kept['mean']:.3g} on average,"
            f" at most {kept['largest']:.3g}; {kept['above']} above;"
            f" samples {kept['samples']:.0f} on average"
        )
    print(
        f"  {'materials':<16} {report['materials']};  shapes {report['shapes']};  rendering time"
        f" {report['hours']:.2f} worker-hours"
    )
    for failure in report["failures"][:10]:
        print(
            f"  failed {failure['id']}: {failure['shape']}, {', '.join(failure['materials'])},"
            f" {failure['light']}: {failure['reason']}"
        )
    return 0


def count_data_set(folder: str) -> dict[str, Any]:
    """Return the counts of a data set, as `status --json` prints them."""
    from collections import Counter

    import msgspec

    from manifests.cached_store import open_store

    store = open_store(folder)
    dataset = store.dataset()
    kinds = ("split", "category", "tier", "light_resolution", "light")
    counts: dict[str, Counter[str]] = {kind: Counter() for kind in kinds}
    shapes: set[str] = set()
    materials: set[str] = set()
    done: set[str] = set()
    seconds = 0.0
    spans: dict[str, tuple[float, float]] = {}
    errors: dict[str, dict[str, Any]] = {}
    for record in store.records():
        if record.id in done:  # a line that stands there twice, which verify finds
            continue
        _widen(spans, record.camera)
        _count_error(errors, record)
        for kind in kinds:
            counts[kind][getattr(record, kind)] += 1
        shapes.add(record.shape)
        materials.update(record.materials)
        done.add(record.id)
        seconds += record.seconds
    views: Counter[str] = Counter()
    for view in store.views():
        if view.id in done:
            continue
        _widen(spans, view.camera)
        views[view.side] += 1
        counts["category"][view.category] += 1
        shapes.add(view.shape)
        done.add(view.id)
        seconds += view.seconds
    failures = {f.id: f for f in store.failures() if f.id not in done}
    # what several jobs share counts for each of them in "planned"
    return {
        "records": len(done) - views.total(),
        "views": views.total(),
        "view_side": dict(sorted(views.items())),
        "planned": sum(order.shots for order in dataset.orders),
        "failed": len(failures),
        "jobs": [
            {
                "name": o.job.name,
                "shots": o.shots,
                "of": "pictures" if o.job.pictures else "views",
                "begun": o.begun,
            }
            for o in dataset.orders
        ],
        **{kind: dict(sorted(count.items())) for kind, count in counts.items()},
        "cameras": {key: list(span) for key, span in spans.items()},
        "errors": errors,
        "shapes": len(shapes),
        "materials": len(materials) if not views else len(dataset.materials),
        "hours": seconds / 3600,
        "failures": [msgspec.to_builtins(f) for f in failures.values()],
    }


def _count_error(errors: dict[str, dict[str, Any]], record: Record) -> None:
    """Add a record to the counts of pictures whose error is limited, by that limit."""
    if (accuracy := record.accuracy) is None:
        return
    empty = {"estimators": {}, "mean": 0.0, "largest": 0.0, "above": 0, "samples": 0.0}
    kept = errors.setdefault(f"{accuracy.requested:g}", empty)
    kept["estimators"][accuracy.estimator] = kept["estimators"].get(accuracy.estimator, 0) + 1
    share = 1 / sum(kept["estimators"].values())
    kept["mean"] += share * (accuracy.estimated - kept["mean"])
    kept["samples"] += share * (record.samples - kept["samples"])
    kept["largest"] = max(kept["largest"], accuracy.estimated)
    kept["above"] += accuracy.estimated > accuracy.requested


def _widen(spans: dict[str, tuple[float, float]], camera: Camera) -> None:
    """Widen the ranges of angles by a camera's; fov_deg is that of cameras in perspective."""
    for key in ("elevation_deg", "roll_deg", "fov_deg"):
        value = getattr(camera, key)
        if value is not None:
            low, high = spans.get(key, (value, value))
            spans[key] = (min(low, value), max(high, value))
