"""Draw the picture of docs/how-to-choose.md: four panels of the report on work and precision.

python docs/work_precision_picture.py docs/results/work-precision/sphere.png
"""

import json
import sys
from pathlib import Path

from matplotlib.figure import Figure

from learn.experiments.layer import chart_drawing, pareto_front

REPORT = Path(__file__).resolve().parent / "results" / "work-precision" / "report.json"
CAMERAS = {"orthographic": "distant viewer", "perspective": "view per pixel"}


def draw(path: Path) -> None:
    """Write the picture: a row for each camera, a column for the typical and one for every case."""
    settings = json.loads(REPORT.read_text(encoding="utf-8"))["settings"]
    names = list(dict.fromkeys(row["method"] for row in settings))
    figure = Figure(figsize=(12, 10.5), layout="constrained")
    axes = figure.subplots(2, 2)
    for row, (camera, title) in zip(axes, CAMERAS.items(), strict=True):
        for place, (judge, time) in zip(row, pareto_front.PAIRS[:2], strict=True):
            chart_drawing.panel(place, settings, names, (camera, "error", judge, time))
            place.set_title(f"{title}: {judge} error, {time} time", fontsize=14)
            place.set_xlabel("processor seconds, forward + backward", fontsize=12)
            place.set_ylabel("error against the sum", fontsize=12)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=5, fontsize=12)
    figure.savefig(path, dpi=80)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
