"""`status DIR`: how far a dataset is, what it holds, what failed."""


def register(subparsers):
    """Add the parser of `status`."""
    parser = subparsers.add_parser(
        "status",
        help="show how much of a data set is made, and what failed",
        description=(
            "Counts the pictures and views of a data set, and lists what failed. Opens no picture."
        ),
    )
    parser.add_argument("folder", metavar="DIR", help="the dataset's folder")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(run=run)


def run(options):
    """Print the counts; 0 always, a folder that is no dataset is an InputError."""
    import json

    report = counted(options.folder)
    if options.json:
        print(json.dumps(report, indent=1))
        return 0
    made, what = (
        report["records"] + report["views"],
        ("pictures and views" if report["views"] else "pictures"),
    )
    print(f"{options.folder}: {made} of {report['planned']} {what}, {report['failed']} failed")
    for job in report["jobs"]:
        print(f"  job {job['name']}: {job['shots']} {job['of']}, begun {job['begun']}")
    if report["views"]:
        print(
            f"  views            {report['views']} of geometry alone: "
            + ", ".join(f"{n} {side}" for side, n in report["view_side"].items())
        )
    for key in ("split", "category", "tier", "light_resolution", "light"):
        if report[key]:
            print(
                f"  {key.replace('_', ' '):<16} "
                + ", ".join(f"{name} {count}" for name, count in report[key].items())
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


def counted(folder):
    """The counts, as a dictionary."""
    from collections import Counter

    import msgspec

    from manifests.store import Store

    store = Store(folder)
    dataset = store.dataset()
    kinds = ("split", "category", "tier", "light_resolution", "light")
    counts = {kind: Counter() for kind in kinds}
    shapes, materials, done, seconds = set(), set(), set(), 0.0
    for record in store.records():
        for kind in kinds:
            counts[kind][getattr(record, kind)] += 1
        shapes.add(record.shape)
        materials.update(record.materials)
        done.add(record.id)
        seconds += record.seconds
    views = Counter()
    for view in store.views():
        views[view.side] += 1
        counts["category"][view.category] += 1
        shapes.add(view.shape)
        done.add(view.id)
        seconds += view.seconds
    failures = {f.id: f for f in store.failures() if f.id not in done}
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
        "shapes": len(shapes),
        "materials": len(materials) if not views else len(dataset.materials),
        "hours": seconds / 3600,
        "failures": [msgspec.to_builtins(f) for f in failures.values()],
    }
