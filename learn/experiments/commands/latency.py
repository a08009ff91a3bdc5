"""`learn.experiments latency`: how long method="auto" takes on every material."""

from pathlib import Path


def register(subparsers):
    parser = subparsers.add_parser(
        "latency",
        help='how long method="auto" takes on every material',
        description=(
            "Times auto, forward and backward, on a sphere over 40 %% of a 256 × 256 picture, for"
            " each of MERL's materials, alone and in a batch that shares light and material:"
            " pace.json."
        ),
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="where pace.json goes"
    )
    parser.add_argument(
        "--tolerance",
        type=float,
        nargs="+",
        default=[1e-2, 1e-3],
        metavar="T",
        help="relative errors (default 1e-2 1e-3)",
    )
    parser.add_argument(
        "--every", type=int, default=1, metavar="N", help="only each N-th material (default 1)"
    )
    parser.add_argument("--threads", type=int, default=2, metavar="N", help="threads (default 2)")
    parser.add_argument(
        "--light",
        default="lamps",
        metavar="NAME",
        help="sky, lamps, sun in a texel or one texel (default lamps)",
    )
    parser.set_defaults(run=run)


def run(options):
    import numpy as np

    from learn.experiments import auto_latency, chart_cases
    from manifests import materials as catalogue
    from manifests.errors import InputError, closest
    from manifests.files import write_json
    from manifests.provenance import provenance

    lights = chart_cases.computed_lights()
    if options.light not in lights:
        raise InputError(
            "--light", "a computed light", f"'{options.light}'", closest(options.light, lights)
        )
    labels = {
        name: material.label
        for name, material in catalogue.load_catalogue(catalogue.BUILT_IN[0]).items()
    }
    labels = dict(list(labels.items())[:: options.every])
    result = provenance() | {"threads": options.threads, "light": options.light, "tolerances": {}}
    for tolerance in options.tolerance:
        rows = auto_latency.measure(labels, lights[options.light], tolerance, options.threads)
        within = {
            f"{kind} within {ms} ms": sum(r[kind] <= ms / 1e3 for r in rows)
            for kind in ("wall", "cpu", "shared")
            for ms in (10, 30, 60, 150)
        }
        medians = {
            kind: float(np.median([r[kind] for r in rows])) for kind in ("wall", "cpu", "shared")
        }
        result["tolerances"][f"{tolerance:g}"] = {
            "materials": len(rows),
            **within,
            "median seconds": medians,
            "rows": rows,
        }
        print(f"{tolerance:g}: {within}; medians {medians}")
    options.out.mkdir(parents=True, exist_ok=True)
    write_json(options.out / "pace.json", result)
