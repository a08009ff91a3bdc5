"""Compare method="quadrature", and the paper's sum over texels, with the converged integral.

A sphere over 40 % of the picture under a sun in one texel, for lobes from broad to narrow (γ from
0.01 to 1e5). An error is a mean absolute difference over the picture's mean; "converged to" is
the same between the two finest means, and bounds what the comparison can show.

With --material, measured materials as well: the time of a picture with all of its gradients, beside
the sum's, and the error of both, from a distant viewer and in perspective.
"""

from __future__ import annotations

import argparse

from learn.commands import options
from learn.experiments import runner
from manifests.option_types import above_zero

# at 300 half-vector sample directions take over from the sum over texels
GAMMAS = (0.01, 1.0, 30.0, 290.0, 310.0, 1.3e3, 5e3, 3e4, 1e5)
METHODS = ("quadrature", "exact")
MATERIALS_SIZE = 64  # of pictures of measured materials


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the lobes, the tolerance, the size of pictures and the number of threads."""
    parser.add_argument(
        "--tolerance",
        type=above_zero,
        default=1e-2,
        metavar="T",
        help="relative error that is allowed (default 0.01)",
    )
    parser.add_argument(
        "--gamma",
        type=above_zero,
        nargs="+",
        default=list(GAMMAS),
        metavar="G",
        help="exponents of the lobes (default: nine from 0.01 to 1e5)",
    )
    parser.add_argument(
        "--material",
        action="append",
        default=[],
        metavar="NAME",
        help="a material of the catalogue to measure too; repeatable. `all`: all 151, which takes"
        " a quarter of an hour",
    )
    options.add_size(parser, 256)
    options.add_threads(parser, "number of threads; one thread is timed too")


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"tolerance", "threads", "rows": [a row per lobe], "materials": [rows]}."""
    from learn.experiments.layer import converged_integrals, quadrature_materials

    measured = quadrature_materials.choose_materials(arguments.material)
    rows = converged_integrals.compare_lobes(
        arguments.tolerance, arguments.threads, tuple(arguments.gamma), arguments.size
    )
    materials = (
        quadrature_materials.compare_materials(
            arguments.tolerance, measured, MATERIALS_SIZE, arguments.out / "materials.jsonl"
        )
        if measured
        else []
    )
    return {
        "tolerance": arguments.tolerance,
        "threads": arguments.threads,
        "rows": rows,
        "materials": materials,
    }


def tables(report: runner.Report) -> str:
    """Return errors and seconds of both methods for each lobe."""
    counts = sorted({report["threads"], 1}, reverse=True)
    head = ["γ", "converged to"]
    for method in METHODS:
        head += [f"{method}: error", *(f"s, {count} threads" for count in counts)]
    rows = [
        [
            f"{row['gamma']:g}",
            f"{row['converged to']:.1g}",
            *(
                cell
                for method in METHODS
                for cell in (
                    f"{row[method]['error']:.2g}",
                    *(f"{row[method][f'seconds, threads: {count}']:.3f}" for count in counts),
                )
            ),
        ]
        for row in report["rows"]
    ]
    page = (
        "# Quadrature and the sum over texels against the converged integral\n\n"
        f"Sun in one texel; tolerance {report['tolerance']:g}; forward alone.\n\n"
        + runner.table(head, rows)
    )
    if report.get("materials"):
        from learn.experiments.layer import quadrature_materials

        page += (
            f"\nMeasured materials at {MATERIALS_SIZE}², forward and backward with the gradients of"
            " normals, material and light, one thread; under suns 20 to 125° from the viewer"
            " forward alone, at 32²:\n\n"
            + runner.table(
                quadrature_materials.HEAD, quadrature_materials.summary(report["materials"])
            )
        )
    return page
