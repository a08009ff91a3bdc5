"""`learn.experiments engine-speed`: how fast and how right the layer's engines are on this
machine.
"""

from pathlib import Path

MATERIALS = ("beige-fabric", "blue-acrylic", "chrome")


def register(subparsers):
    parser = subparsers.add_parser(
        "engine-speed",
        help="time the rendering layer's engine against plain torch",
        description=(
            "Times the exact sum (a sphere that covers 40 %% of a 256 × 256 picture, a 64 × 128"
            " light map), forward and backward, orthographic and with a view vector per pixel,"
            " against the same sum in plain torch operators. Engine and torch take turns, and"
            " figures are medians, so that a busy machine slows both. Writes bench.md and"
            " bench.json with command, commit and machine."
        ),
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="where the tables go"
    )
    parser.add_argument(
        "--material",
        action="append",
        metavar="NAME",
        help=f"a material of the catalogue; repeatable (default: {', '.join(MATERIALS)})",
    )
    parser.add_argument(
        "--threads",
        type=int,
        nargs="+",
        default=[1, 2],
        metavar="N",
        help="thread counts (default: 1 2)",
    )
    parser.add_argument(
        "--rounds", type=int, default=5, metavar="N", help="how often each is timed (default 5)"
    )
    parser.add_argument(
        "--eager-pixels",
        type=int,
        default=96,
        metavar="N",
        help=(
            "pixels that plain torch renders; its time is scaled up to the whole picture, which"
            " would take minutes (default 96)"
        ),
    )
    parser.set_defaults(run=run)


def run(options):
    from learn.experiments import engine_speed, speed_report

    settings = engine_speed.Settings(
        tuple(options.material or MATERIALS),
        tuple(options.threads),
        options.rounds,
        options.eager_pixels,
    )
    rows = engine_speed.measure(settings)
    print(speed_report.write(rows, settings, options.out))
