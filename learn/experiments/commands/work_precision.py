"""`learn.experiments work-precision`: how much time each rendering method takes for how much
error.
"""

from pathlib import Path


def register(subparsers):
    parser = subparsers.add_parser(
        "work-precision",
        help="time against error of every rendering method",
        description=(
            "Renders a sphere in materials from matte to mirror under several lights, from far and"
            " from near, by every method at several settings, and draws time against error:"
            " chart.png, chart.csv and chart.html."
        ),
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="where the chart goes"
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="three materials, two lights, a small picture: two minutes",
    )
    parser.add_argument(
        "--size",
        type=int,
        default=256,
        metavar="N",
        help="picture's side in pixels; 40 %% of it is sphere (default 256)",
    )
    parser.add_argument(
        "--lights",
        type=Path,
        metavar="DIR",
        help="a folder of .exr maps, or a dataset, to light with (default: computed lights)",
    )
    parser.add_argument(
        "--light",
        action="append",
        metavar="NAME",
        help="only this map of the folder; repeatable (default: all)",
    )
    parser.add_argument(
        "--processes",
        type=int,
        default=1,
        metavar="N",
        help="cases measured side by side, on one thread each (default 1)",
    )
    parser.set_defaults(run=run)


def run(options):
    from learn.experiments import chart_cases, chart_drawing, chart_measurement
    from manifests import materials as catalogue
    from manifests.provenance import provenance

    names, lights, size = (
        chart_cases.MATERIALS,
        chart_cases.lights(options.lights, options.light),
        options.size,
    )
    if options.quick:
        names, lights, size = names[::3], dict(list(lights.items())[:2]), min(size, 64)
    made = provenance()
    labels = {name: catalogue.find(name).label for name in names}
    rows = chart_measurement.measure(
        labels, lights, ("orthographic", "perspective"), size, options.processes
    )
    chart_drawing.write(rows, made, options.out)
    print(options.out / "chart.html")
