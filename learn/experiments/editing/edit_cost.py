"""Chart the error of edits against their processor time, and against the hours of training.

Pictures of the ladder's development side are decomposed on the rungs `direct` and `8-bit` and
shown in another material by every method: the weights named, as predicted and with each amount of
refinement, the baselines named, and controls without any training. Seconds are of the processor, on
one thread, from the picture to the edited picture at the network's size; the first edit of every
method is made once without a clock, because kernels are compiled. Hours of training are not
measured here but named: --hours general-compact=3.3. `python -m learn evaluate-ladder --jobs DIR`
names the commands that render the pictures. rows.jsonl keeps a line per edit: the same command
continues, and a larger --scenes adds to it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner
from manifests.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from learn.data.batch import ExampleBatch
    from learn.data.records import Records
    from learn.evaluation.methods import Layered, Method
    from learn.networks.prediction import Prediction
    from learn.refinement import RefinementResult, RefinementSettings

RUNGS = ("direct", "8-bit")  # of learn.evaluation.ladder_design
BASELINES = {  # {name in learn.baselines: name here}
    "Lombardi-like": "Lombardi-like, true normals",
    "Baseline 1": "Baseline 1",
    "Baseline 2": "Baseline 2",
}
TICKS = (0.1, 0.2, 0.5, 1, 2, 5)
LEAST_SECONDS = 0.01  # methods that take less do nothing, and are drawn as a line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, the weights, the baselines, the hours and the number of scenes."""
    options.add_data(parser, "a data set of the ladder's development side")
    parser.add_argument(
        "--weights",
        nargs="+",
        type=options.weights_file,
        default=[options.EDITING_WEIGHTS],
        metavar="FILE|NAME",
        help="weights that are compared, files or names (default: general-compact)",
    )
    parser.add_argument(
        "--baselines",
        type=Path,
        metavar="DIR",
        help="folder of `learn train-baselines`; those that it holds are measured as well",
    )
    parser.add_argument(
        "--hours",
        nargs="*",
        type=hours,
        default=[],
        metavar="NAME=H",
        help="processor hours of training of a method, for the second chart",
    )
    options.add_count(parser, "--scenes", 18, "number of scenes on each rung, of different shapes")
    options.add_seed(parser, "seed by which edits are drawn")


def hours(text: str) -> tuple[str, float]:
    """Return (name, hours) of "NAME=H". Raises argparse.ArgumentTypeError."""
    name, equals, value = text.rpartition("=")
    try:
        result = float(value)
    except ValueError:
        result = -1.0
    if not (name and equals and 0 <= result < 1e6):
        raise argparse.ArgumentTypeError(f"expected NAME=HOURS, found {text!r}")
    return name, result


def amounts() -> dict[str, RefinementSettings]:
    """Return {caption: settings} from the least refinement to the most."""
    from dataclasses import replace

    from learn.refinement import RefinementSettings

    default = RefinementSettings()
    coarse = replace(default.levels[0], joint_iterations=10)
    return {
        "coarse": replace(default, outer_iterations=1, levels=(coarse,)),
        "1 outer": replace(default, outer_iterations=1),
        "2 outer": replace(default, outer_iterations=2),
        "3 outer": replace(default, outer_iterations=3),
    }


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows", "hours", "seen"}; rows as of `row_of`, and scene, rung, method.

    Raises InputError for a data set without the ladder's scenes, and for names in --hours that are
    no method's.
    """
    from learn.experiments.editing import drawn_edits

    contenders, size = methods_of(arguments.weights, arguments.baselines)
    known = {name.partition(", ")[0] for name in contenders}
    for name, _ in arguments.hours:
        if name not in known:
            raise InputError("--hours", f"one of {sorted(known)}", name, "name a method as there")
    edits = drawn_edits.opened(arguments)
    todo = [
        ({"scene": scene.id, "rung": rung, "method": name}, (scene, rung, name))
        for scene in edits.scenes
        for rung in RUNGS
        for name in contenders
    ]
    timed: set[str] = set()

    def row(case: tuple[Any, str, str]) -> dict[str, Any]:
        scene, rung, name = case
        if name not in timed:
            row_of(edits.records, contenders[name](), scene, rung, size)
            timed.add(name)
        return row_of(edits.records, contenders[name](), scene, rung, size)

    rows = runner.resume(arguments.out / "rows.jsonl", todo, row, "edit")
    return {"rows": rows, "hours": dict(arguments.hours), "seen": edits.seen}


def methods_of(
    weights: Sequence[Path], baselines: Path | None = None
) -> tuple[dict[str, Callable[[], Method]], int]:
    """Return {name: a function that makes the method} and the size of their pictures.

    A method is made for each edit, because it remembers the parts of its last picture.
    Raises InputError for weights of different sizes.
    """
    import functools

    from learn.baselines import FILES
    from learn.evaluation import baseline_methods, methods
    from learn.networks import weights as checkpoint

    result: dict[str, Callable[[], Method]] = {
        methods.Unchanged.name: methods.Unchanged,
        "constant light, facing": _constant_facing,
    }
    sizes = {}
    for path in weights:
        network, metadata = checkpoint.load_full_network(path)
        # a run's folder names its weights, which are all called weights.safetensors
        name = path.parent.name if path.stem == "weights" else path.stem
        sizes[name] = metadata["size"]
        predicted = functools.partial(methods.Layered, name, methods.make_predictor(network))
        result[f"{name}, predicted"] = predicted
        known = getattr(network, "training_labels", None)
        for caption, settings in amounts().items():
            result[f"{name}, {caption}"] = functools.partial(_refine, predicted, settings, known)
    if len(set(sizes.values())) > 1:
        raise InputError("--weights", "networks of one size", str(sizes), "measure them apart")
    if baselines is not None:
        for name, shown in BASELINES.items():
            path = baselines / FILES[name]
            if path.exists():
                result[shown] = functools.partial(baseline_methods.load, name, path)
    return result, next(iter(sizes.values()))


def _constant_facing() -> Layered:
    from learn.evaluation import methods

    return methods.constant_light(methods.facing_viewer())


def _refine(start: Callable[[], Layered], settings: RefinementSettings, labels: Any) -> Layered:
    from learn.evaluation.methods import Refined
    from learn.refinement import refine

    def work(batch: ExampleBatch, predicted: Prediction | None) -> RefinementResult:
        assert predicted is not None
        return refine(batch, predicted, settings, labels)

    return Refined(start(), work)


def row_of(records: Records, method: Method, scene: Any, rung: str, size: int) -> dict[str, Any]:
    """Return a scene's names, the method's processor seconds and the errors of its edit."""
    import time

    import torch

    from learn.evaluation.ladder_design import RUNGS as ALL
    from learn.evaluation.ladder_pictures import load_scene
    from learn.metrics.pictures import display_l2, l2_after_alignments

    picture = load_scene(records, scene, next(each for each in ALL if each.name == rung), size)
    label = torch.from_numpy(picture.label)
    began = time.process_time()
    edited = method.edit(picture.batch, label)
    seconds = time.process_time() - began
    target = scene.truth[rung].materials[0]
    return {
        "shape": scene.shape,
        "group": scene.group,
        "light": scene.light,
        "target": target,
        "seconds": seconds,
        "edit_l2": display_l2(edited, picture.target, picture.mask),
        "edit_l2_aligned": l2_after_alignments(edited, picture.target, picture.mask)[
            "l2_one_factor"
        ],
    }


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, dict[str, Any]]]:
    """Return {rung: {method: figures}} of rows as of `measure`.

    figures  {"edit_l2": [mean, low, high], "aligned": the same, "median", "worst",
             "seconds": mean, "slowest"}; intervals draw shapes, targets and lights
    """
    import numpy as np

    from learn.metrics import bootstrap

    result: dict[str, dict[str, dict[str, Any]]] = {}
    for rung in dict.fromkeys(row["rung"] for row in rows):
        result[rung] = {}
        for name in dict.fromkeys(row["method"] for row in rows):
            of = [row for row in rows if row["rung"] == rung and row["method"] == name]
            weights = bootstrap.draws_of_rows(of, ("shape", "target", "light"))
            edits, aligned, seconds = (
                np.array([row[key] for row in of])
                for key in ("edit_l2", "edit_l2_aligned", "seconds")
            )
            result[rung][name] = {
                "edit_l2": bootstrap.interval(edits, weights),
                "aligned": bootstrap.interval(aligned, weights),
                "median": float(np.median(edits)),
                "worst": float(edits.max()),
                "seconds": float(seconds.mean()),
                "slowest": float(seconds.max()),
            }
    return result


def tables(report: runner.Report) -> str:
    """Return error and seconds of every method on each rung, and the hours that are known."""
    rows = report["rows"]
    scenes = {row["scene"] for row in rows}
    result = ["# Error of an edit against its cost\n"]
    result += [f"**{sentence}**\n" for sentence in report["seen"]]
    result.append(
        f"{len(scenes)} scenes of {len({row['shape'] for row in rows})} shapes, in and out of the"
        " families that were trained on. Display L2 over the mask; *one factor free*: after the"
        " factor on the edit's radiance that makes it least. Brackets are 95 % intervals that draw"
        " shapes, target materials and lights. Seconds are of the processor, on one thread.\n\n"
        "![Error against seconds and hours](chart.png)\n"
    )
    head = ["method", "edit L2", "median", "worst", "one factor free", "seconds", "slowest"]
    for rung, by_method in summary(rows).items():
        lines = [
            [
                name,
                runner.interval(of["edit_l2"], 0),
                f"{of['median']:.0f}",
                f"{of['worst']:.0f}",
                runner.interval(of["aligned"], 0),
                f"{of['seconds']:.2f}",
                f"{of['slowest']:.2f}",
            ]
            for name, of in by_method.items()
        ]
        result += [f"## Rung {rung}\n", runner.table(head, lines)]
    if report["hours"]:
        lines = [[name, f"{value:.2g}"] for name, value in report["hours"].items()]
        result += [
            "## Training\n",
            "Processor hours as named on the command line.\n",
            runner.table(["method", "hours"], lines),
        ]
    return "\n".join(result)


def figure(report: runner.Report) -> Figure:
    """Return a row of charts for each rung: error against seconds, and against hours."""
    from matplotlib.figure import Figure

    by_rung = summary(report["rows"])
    drawn = Figure(figsize=(11, 4.2 * len(by_rung)), layout="constrained")
    axes = drawn.subplots(len(by_rung), 2, squeeze=False, sharey="row")
    for (rung, by_method), (left, right) in zip(by_rung.items(), axes, strict=True):
        families = list(dict.fromkeys(name.partition(", ")[0] for name in by_method))
        for k, family in enumerate(families):
            of = {
                name.partition(", ")[2]: figures
                for name, figures in by_method.items()
                if name.partition(", ")[0] == family
            }
            if all(figures["seconds"] < LEAST_SECONDS for figures in of.values()):
                error = next(iter(of.values()))["edit_l2"][0]
                left.axhline(error, color=f"C{k}", linestyle=":", label=family)
                continue
            _points(left, of, family, f"C{k}", "seconds")
            if family in report["hours"]:
                trained = report["hours"][family]
                known = {
                    caption: figures | {"hours": trained}
                    for caption, figures in of.items()
                    if caption in ("", "predicted", "1 outer", "true normals")
                }
                _points(right, known, family, f"C{k}", "hours")
        left.set_xscale("log")
        left.set_yscale("log")
        left.set_title(f"rung {rung}")
        left.set_xlabel("processor seconds of an edit")
        left.set_ylabel("edit, display L2 (mean, 95 %)")
        right.set_xlabel("processor hours of training")
        left.set_xticks(TICKS, [f"{seconds:g}" for seconds in TICKS], minor=False)
        left.set_xticks([], minor=True)
        right.legend(*left.get_legend_handles_labels(), fontsize=7, loc="upper right")
        right.set_xlim(left=-0.2)
        for axis in (left, right):
            axis.grid(alpha=0.3)
    return drawn


def _points(
    axis: Any, of: Mapping[str, Mapping[str, Any]], family: str, color: str, key: str
) -> None:
    """Draw one method's points, joined in the order of the amounts of refinement."""
    x = [figures[key] for figures in of.values()]
    mean, low, high = zip(*(figures["edit_l2"] for figures in of.values()), strict=True)
    errors = [
        [m - a for m, a in zip(mean, low, strict=True)],
        [b - m for m, b in zip(mean, high, strict=True)],
    ]
    axis.plot(x, mean, "o-", color=color, linewidth=1.5, markersize=5, label=family)
    axis.errorbar(x, mean, yerr=errors, fmt="none", ecolor=color, alpha=0.3, capsize=2)
    for caption, across, up in zip(of, x, mean, strict=True):
        axis.annotate(caption, (across, up), xytext=(4, 4), textcoords="offset points", fontsize=7)
