"""`learn.experiments cold-start`: how long the layer's first use takes."""

from pathlib import Path


def register(subparsers):
    parser = subparsers.add_parser(
        "cold-start",
        help="how long the layer's first use takes",
        description=(
            "Times what importing the layer adds to a program that has torch, its first picture and"
            " its first derivatives, in fresh processes: with no kernels kept from before, when"
            " they must be compiled, and with them. Other work on the machine adds to all of it."
        ),
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="where first-use.json goes"
    )
    parser.add_argument(
        "--rounds",
        type=int,
        default=3,
        metavar="N",
        help="fresh starts of each kind, whose medians are told (default 3)",
    )
    parser.add_argument(
        "--threads", type=int, default=2, metavar="N", help="torch's threads (default 2)"
    )
    parser.set_defaults(run=run)


def run(options):
    from learn.experiments import cold_start
    from manifests.files import write_json
    from manifests.provenance import provenance

    made = provenance()
    result = cold_start.measure(options.rounds, options.threads)
    for case, both in result.items():
        for kernels, times in both.items():
            print(
                f"{case}, kernels' folder {kernels}: "
                + ", ".join(f"{what} {seconds:.2f} s" for what, seconds in times.items())
            )
    options.out.mkdir(parents=True, exist_ok=True)
    content = made | {"threads": options.threads, "rounds": options.rounds, "seconds": result}
    write_json(options.out / "first-use.json", content)
