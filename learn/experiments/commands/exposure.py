"""`learn.experiments exposure`: the rule by which a photograph's unknown exposure is guessed,
measured on pictures of known light.
"""

from pathlib import Path


def register(subparsers):
    parser = subparsers.add_parser(
        "exposure",
        help="measure the rule by which a photograph's unknown exposure is guessed",
        description=(
            "Exposes rendered pictures as a camera would, fits the factor back to their radiance"
            " against the object's brightness, and says how far the fitted rule and the one in use"
            " (learn/data/photographs.py) miss. Writes exposure.json."
        ),
    )
    parser.add_argument(
        "--data",
        type=Path,
        required=True,
        metavar="DIR",
        help="a dataset with pictures to fit on, of the training side",
    )
    parser.add_argument(
        "--check",
        type=Path,
        nargs="*",
        default=[],
        metavar="DIR",
        help="further ones, to measure the rules on",
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="where exposure.json goes"
    )
    parser.set_defaults(run=run)


def run(options):
    from learn.data.records import Records
    from learn.experiments import exposure
    from manifests.errors import InputError

    records = [Records(folder) for folder in (options.data, *options.check)]
    for each in records:
        if not len(each):
            raise InputError(
                each.folder,
                "pictures",
                "none",
                "render some: python -m factory render JOB --out DIR",
            )
    result = exposure.fit_and_check(records[0], records[1:], options.out)
    for name, values in result["line"].items():
        print("{} {:.3f} [{:.3f}, {:.3f}]".format(name, *values))
    for folder, rules in result["missed"].items():
        for rule, report in rules.items():
            print(
                f"{folder}, {rule}: "
                + ", ".join(f"{key} {value:.2f}" for key, value in report.items())
            )
