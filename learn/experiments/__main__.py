"""`python -m learn.experiments`: the measurements behind docs/results, one command each."""

import sys
from collections.abc import Mapping

from learn.commands import prepare
from learn.experiments import runner
from manifests.cli import main

GROUPS: Mapping[str, Mapping[str, str]] = {
    "The rendering layer's methods": {
        "work-precision": "time each rendering method against the error that it makes",
        "tolerance-check": 'count how often method="auto" keeps its tolerance in random scenes',
        "quadrature-accuracy": 'compare method="quadrature" with the converged integral',
        "latency": 'time method="auto" on every measured material',
        "view-per-pixel": 'time method="auto" in perspective against a distant viewer',
        "calibrate-auto": 'fit the constants by which method="auto" plans',
    },
    "The rendering layer's engine": {
        "engine-speed": "time the exact sum against plain torch operators",
        "cold-start": "time the first use of the layer in a fresh process",
        "second-derivatives": "time second derivatives of the exact sum against first ones",
    },
    "Training": {
        "self-shadowing": "measure the shadows that training adds to relit pictures",
        "unseen-shapes": "measure normals of weights on many shapes that no training saw",
        "stereo-normals": "measure normals of photographs whose depth was measured by stereo",
        "nearest-shapes": "measure normals by distance to the nearest training shape",
        "step-profile": "time the parts of a training step, and relighting",
        "layer-ablation": "train with and without the layer for the same time (Section 4.3)",
        "objective-ablation": "train with and without rendered pictures, for the same steps",
        "glossy-weights": "compare weights on Cycles' pictures of glossy objects",
        "light-repairs": "train with and without two repairs of predicted lights",
        "normals-ablation": "train normals with further losses and shapes for the same time",
        "training-runs": "chart what training runs reached against the time that they took",
    },
    "Editing": {
        "refinement-ablation": "measure refinement for each weight, and from bad initialisations",
        "edit-cost": "chart the error of edits against seconds and hours of training",
        "edit-methods": "chart all methods of editing against their cost, from several reports",
        "edit-summary": "chart the errors of edits from several reports, at a glance",
        "edit-brightness": "measure how bright edits are beside their truth",
        "photographed-edits": "measure edits of photographs, and how to expose them",
        "room-photographs": "measure edits of photographs of objects that stand in rooms",
        "mask-edges": "measure how much fitting a mask's edge to its photograph improves edits",
        "named-shapes": "measure normals of objects that are said to be a box, cylinder or ball",
        "exposure-line": "fit how photographs are exposed to several sets of them at once",
        "painted-photographs": "measure edits of objects in colours that no catalogue has",
        "outer-iterations": "measure what refinement gains by its last outer iteration",
        "refinement-methods": "refine glossy objects by the sum and by the integral",
        "clipped-highlights": "refine clipped pictures with and without one-sided highlights",
        "mitsuba-comparison": "compare refinement with descent through Mitsuba 3",
        "compare-weights": "compare two weights on the same edits, from lines that were kept",
        "relighting": "relight pictures, and put materials on other objects, against the truth",
        "upsampling": "compare strategies that bring an edit to the photograph's size",
        "principled-fit": "measure how close labels come to materials given by a few numbers",
        "exposure": "measure the rule that estimates a photograph's exposure",
    },
}
COMMANDS = {name: runner.register(name) for group in GROUPS.values() for name in group}


def description() -> str:
    """Return the text of --help: every experiment with one line, by group."""
    lines = [
        "Measure what docs/results reports. `python -m learn.experiments NAME --help` says more."
    ]
    for title, group in GROUPS.items():
        lines += ["", f"{title}:", *(f"  {name:<20} {line}" for name, line in group.items())]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main("learn.experiments", description(), COMMANDS, prepare=prepare))
