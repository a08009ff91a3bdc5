"""`learn.experiments calibrate-auto`: fit the numbers by which method="auto" plans."""

from pathlib import Path


def register(subparsers):
    parser = subparsers.add_parser(
        "calibrate-auto",
        help='fit the numbers by which method="auto" plans',
        description=(
            "Measures errors of maps and times of sums on this machine and fits the few numbers"
            " from which auto plans. They decide how fast auto is, not how right: what it renders"
            " is checked. Put the file in the place of learn/methods/calibration.json to use it."
        ),
    )
    parser.add_argument("--out", type=Path, required=True, metavar="JSON", help="the file to write")
    parser.set_defaults(run=run)


def run(options):
    import json

    from learn.experiments import auto_calibration
    from manifests.files import write_json

    fitted = auto_calibration.fit()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_json(options.out, fitted)
    print(json.dumps(fitted, indent=1))
