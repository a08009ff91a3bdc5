"""`learn.experiments quadrature-accuracy`: how near quadrature is to the integral, and how fast."""

from pathlib import Path


def register(subparsers):
    parser = subparsers.add_parser(
        "quadrature-accuracy",
        help='how near method="quadrature" is to the integral, and how fast',
        description=(
            "Renders a sphere over 40 %% of a 256 × 256 picture under a sun in one texel, for lobes"
            " of γ from 0.01 to 1e5, and compares the half-vector quadrature, and the paper's sum"
            " over texels, with the converged integral: quadrature.json."
        ),
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="where quadrature.json goes"
    )
    parser.add_argument(
        "--tolerance",
        type=float,
        default=1e-2,
        metavar="T",
        help="given to the method (default 1e-2)",
    )
    parser.add_argument(
        "--threads",
        type=int,
        default=2,
        metavar="N",
        help="threads; one thread is timed too (default 2)",
    )
    parser.set_defaults(run=run)


def run(options):
    from learn.experiments import quadrature_accuracy
    from manifests.files import write_json
    from manifests.provenance import provenance

    made = provenance()
    rows = quadrature_accuracy.measure(options.tolerance, options.threads)
    for row in rows:
        result = ", ".join(
            f"{method}: " + ", ".join(f"{k} {v:.2g}" for k, v in row[method].items())
            for method in ("quadrature", "exact")
        )
        print(f"γ {row['gamma']:g}: {result}; converged to {row['converged to']:.1g}")
    options.out.mkdir(parents=True, exist_ok=True)
    write_json(
        options.out / "quadrature.json", made | {"tolerance": options.tolerance, "rows": rows}
    )
