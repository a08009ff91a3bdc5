"""`learn.experiments tolerance-check`: whether method="auto" keeps the tolerances it is given."""

from pathlib import Path


def register(subparsers):
    parser = subparsers.add_parser(
        "tolerance-check",
        help='whether method="auto" keeps its tolerance',
        description=(
            "Draws random materials, lights and cameras, renders each exactly and by auto at"
            " tolerances from 5e-2 to 1e-4, and writes how often the tolerance was kept and every"
            " case where it was not: promise.json."
        ),
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="where promise.json goes"
    )
    parser.add_argument(
        "--cases", type=int, default=500, metavar="N", help="random cases (default 500)"
    )
    parser.add_argument(
        "--size", type=int, default=128, metavar="N", help="picture's side in pixels (default 128)"
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="of the random cases (default 0)"
    )
    parser.set_defaults(run=run)


def run(options):
    from learn.experiments import tolerance_check
    from manifests import materials as catalogue
    from manifests.files import write_json
    from manifests.provenance import provenance

    labels = [
        material.label for material in catalogue.load_catalogue(catalogue.BUILT_IN[0]).values()
    ]
    rows = tolerance_check.measure(labels, options.cases, options.size, options.seed)
    kept = {
        f"{t:g}": sum(r["kept"] for r in rows if r["tolerance"] == t) / options.cases
        for t in tolerance_check.TOLERANCES
    }
    result = provenance() | {
        "cases": options.cases,
        "kept": kept,
        "misses": [r for r in rows if not r["kept"]],
    }
    options.out.mkdir(parents=True, exist_ok=True)
    write_json(options.out / "promise.json", result)
    print(f"kept: {', '.join(f'{share:.1%} at {t}' for t, share in kept.items())}")
