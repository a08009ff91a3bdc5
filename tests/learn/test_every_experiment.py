"""Every experiment at its smallest size: its report, its page, and one relation that must hold."""

import importlib.util
import json
import math
import shlex
import subprocess
import sys

import numpy as np
import pytest
import torch

import learn.__main__
import learn.experiments.__main__
from learn.data import seen
from learn.experiments import runner
from learn.experiments.__main__ import COMMANDS, GROUPS, description
from learn.experiments.editing import edit_brightness
from learn.experiments.layer import (
    auto_calibration,
    chart_measurement,
    engine_timing,
    quadrature_materials,
    second_derivatives,
)
from learn.experiments.photographs import exposure_rule, named_shapes
from learn.experiments.training import unseen_shapes
from learn.metrics import bootstrap
from learn.networks import weights
from learn.networks.coding import Ranges
from learn.networks.compact import Compact
from learn.networks.seen_lists import write_lists
from learn.networks.weights import save_weights
from learn.refinement import descent
from manifests import allocator
from manifests.cli import main
from manifests.store import Store
from tests.support import ladder_rungs, room_scenes, stereo_sphere
from tests.support.full_disk_case import RUN as SETTINGS
from tests.support.synthetic import add_sides, glossy, matte, write_dataset
from tests.support.two_materials import written

SIZE = 32
TRAINING = "--data {room}/data --size 32 --seconds 0.05 --seeds 1 --batches 1 --workers 0"


def steps_of_all_parts(report):
    step = dict(report["step"])
    total = step.pop("total")
    return total == pytest.approx(sum(step.values()))


SMALLEST = {  # experiment: its words, and what must hold of its report
    "work-precision": (
        "--size 8 --material chrome --light sky --camera orthographic --no-torch --further cube",
        lambda r: next(s for s in r["settings"] if s["method"] == "exact")["error"]["worst"] == 0,
    ),
    "tolerance-check": (
        "--cases 2 --size 8",
        lambda r: all(0 <= share <= 1 for share in r["kept"].values()) and r["cases"] == 2,
    ),
    "quadrature-accuracy": (
        "--gamma 1 30000 --size 16 --threads 1 --material chrome",
        lambda r: (
            r["rows"][1]["quadrature"]["error"] < 0.1 < r["rows"][1]["exact"]["error"]
            and all(m["quadrature"]["error"] < 0.01 < m["exact"]["error"] for m in r["materials"])
            and {m["camera"] for m in r["materials"]} == {"orthographic", "perspective"}
        ),
    ),
    "latency": (
        "--every 100 --tolerance 0.1 --threads 1",
        lambda r: r["tolerances"]["0.1"]["materials"] == len(r["tolerances"]["0.1"]["rows"]) == 1,
    ),
    "view-per-pixel": (
        "--every 100 --cases 1 --size 24",
        lambda r: (
            {row["shape"] for row in r["times"]} == {"sphere", "dented sphere"}
            and all(row["pixels"] > 3500 and row["error"] < 1e-2 for row in r["times"])
            and [row["tolerance"] for row in r["cases"]] == [5e-2, 1e-2, 1e-3]
        ),
    ),
    "calibrate-auto": (
        "--size 24",
        lambda r: all(x > 0 for x in r["calibration"]["map_error"].values()),
    ),
    "engine-speed": (
        "--material chrome --threads 1 --rounds 1 --eager-pixels 4",
        lambda r: all(row["ratio"]["torch, plain"] > 1 for row in r["rows"]),
    ),
    "cold-start": (
        "--case exact --rounds 1 --threads 1",
        lambda r: (
            r["seconds"]["exact"]["kept"]["picture"] < r["seconds"]["exact"]["empty"]["picture"]
        ),
    ),
    "second-derivatives": (
        "--size 12",
        lambda r: len(r["cases"]) == 4 and all(c["second"] > 0 for c in r["cases"].values()),
    ),
    "step-profile": ("{room}/run.json --data {room}/data --steps 1 --images 2", steps_of_all_parts),
    "layer-ablation": (
        TRAINING,
        lambda r: (
            r["material"]["ratios"]["both / control"][0]
            == pytest.approx(r["material"]["both"]["l2"][0] / r["material"]["control"]["l2"][0])
        ),
    ),
    "objective-ablation": (
        "--data {room}/data --run {room}/all-terms.json --start {room}/weights.safetensors"
        " --allow-overlap --size 32 --steps 2 --batches 1 --workers 0"
        ' --variants "all terms" "without both" features',
        lambda r: (
            set(r["initialisations"]) == {"nothing", "weights"}
            and all(
                of["all terms"]["ratios"]["target_l2"] == [1, 1, 1]
                and of["without both"]["ratios"]["target_l2"][0]
                == pytest.approx(
                    of["without both"]["figures"]["target_l2"][0]
                    / of["all terms"]["figures"]["target_l2"][0]
                )
                and ("features" in of) != ("features" in r["left_out"])
                for of in r["initialisations"].values()
            )
        ),
    ),
    "light-repairs": (
        "--data {room}/data --run {room}/lights.json --size 32 --steps 2 --batches 1 --workers 0",
        lambda r: (
            len(r["variants"]) == 4
            and all(x == [1, 1, 1] for x in r["variants"]["as in use"]["ratios"].values())
            and r["variants"]["zeros beyond the edges"]["ratios"]["irradiance"] != [1, 1, 1]
        ),
    ),
    "normals-ablation": (
        TRAINING + " --pretraining 0.05 --variants L2 pixels",
        lambda r: r["rows"]["L2"]["ratio"] == [1, 1, 1] and "pixels" in r["rows"],
    ),
    "refinement-ablation": (
        "--data {room}/pictures --weights {room}/weights.safetensors --pictures 1"
        " --only passes=1 --initialisations 0",
        lambda r: (
            r["settings"]["outer_iterations=1"]["image"][1]
            <= r["settings"]["outer_iterations=1"]["image"][0]
        ),
    ),
    "edit-brightness": (
        "--data {room}/ladder --weights {room}/weights.safetensors --scenes 1",
        lambda r: (
            [row["rung"] for row in r["rows"]] == ["direct", "8-bit"]
            # an edit's own best factor is at least as good as any of the common ones
            and all(
                row[method]["l2_one_factor"] <= min(row[method]["l2"]) + 1e-6
                for row in r["rows"]
                for method in ("predicted", "refined")
            )
        ),
    ),
    "training-runs": (
        "own={room}/trained,{room}/trained other={room}/trained",
        lambda r: (
            [each["validations"][-1]["hours"] for each in r["runs"]["own"]] == [1.0, 2.0]
            and [each["steps"] for each in r["runs"]["other"]] == [2]
            and r["runs"]["other"][0]["validations"][0]["albedo"] == 0.5
        ),
    ),
    "outer-iterations": (
        "--data {room}/ladder --weights {room}/weights.safetensors --scenes 1"
        " --outer-iterations 1 2",
        lambda r: (
            [row["number"] for row in r["rows"]] == 2 * [1, 2]
            and len({row["predicted"]["edit_l2"] for row in r["rows"][:2]}) == 1
            and len({row["refined"]["edit_l2"] for row in r["rows"][:2]}) == 2
        ),
    ),
    "edit-cost": (
        "--data {room}/ladder --weights {room}/weights.safetensors --scenes 1"
        " --hours {room.name}=2",
        lambda r: (
            list(r["hours"].values()) == [2]
            and len({row["method"] for row in r["rows"]}) == len(r["rows"]) / 2 == 7
            # a further outer iteration that lowers no energy is not kept
            and len({row["edit_l2"] for row in r["rows"] if "3 outer" not in row["method"]}) == 12
            and all(row["edit_l2_aligned"] <= row["edit_l2"] for row in r["rows"])
        ),
    ),
    "refinement-methods": (
        "--data {room}/glossy --weights {room}/weights.safetensors --scenes 1"
        " --true-light 1 --pictures 2",
        lambda r: (
            [(row["rung"], row["start"], row["method"]) for row in r["rows"]]
            == [
                (rung, f"{light} light", method)
                for rung, light in (
                    ("direct", "true"),
                    ("direct", "predicted"),
                    ("8-bit", "predicted"),
                )
                for method in ("quadrature", "auto")
            ]
            # an untrained network's light is smooth, so that both methods see the same
            and all(each["predicted"] < 1e-2 < each["true"] for each in r["pictures"])
            and [each["rung"] for each in r["pictures"]] == 2 * ["direct", "8-bit"]
            and len({row["refined"]["edit_l2"] for row in r["rows"]}) == 6
            # the true light stays
            and all(
                (row["refined"]["irradiance"] < 1e-6) == (row["start"] == "true light")
                for row in r["rows"]
            )
            and {row["source"] for row in r["rows"]} == {"glossy"}
        ),
    ),
    "glossy-weights": (
        "--data {room}/glossy --weights a={room}/weights.safetensors"
        " --weights b={room}/weights.safetensors --scenes 1 --size 16",
        lambda r: (
            [(row["rung"], row["weights"]) for row in r["rows"]]
            == [(rung, name) for rung in ("direct", "8-bit") for name in "ab"]
            and {row["source"] for row in r["rows"]} == {"glossy"}
            and r["sizes"] == {"a": 16, "b": 16}
            # the same weights twice differ in nothing
            and all(
                {**a, "weights": ""} == {**b, "weights": ""}
                for a, b in zip(r["rows"][::2], r["rows"][1::2], strict=True)
            )
            and all(row["edit_l2_aligned"] <= row["edit_l2"] for row in r["rows"])
        ),
    ),
    "edit-summary": (
        "--photographs rooms={root}/room-photographs/report.json --ladder"
        " meshes={root}/ladder-test/report.json --evaluation rendered={root}/evaluation/report.json"
        " --methods some={root}/evaluation-kept-jobs/report.json"
        " later={root}/evaluation-equal-time/report.json",
        lambda r: (
            [row["name"] for row in r["pictures"]] == ["rooms", "meshes", "rendered"]
            and all(row["after"][0] < (row["before"] or [4000])[0] for row in r["pictures"])
            and r["methods"]["name"] == "some"
            and [row["name"] for row in r["methods"]["rows"]][0::4]
            == ["not edited", "this program"]
            # the later report replaces the baselines alone
            and [row["source"] == "evaluation-equal-time" for row in r["methods"]["rows"]]
            == [row["name"].startswith("Baseline") for row in r["methods"]["rows"]]
        ),
    ),
    "edit-methods": (
        "--evaluation {root}/evaluation-kept-jobs/report.json"
        " --mitsuba {root}/mitsuba-comparison/report.json"
        ' --edit-cost {root}/edit-cost/report.json --hours "Baseline 2"=2 joint=1',
        lambda r: (
            [len(each["methods"]) for each in r["sets"]] == [14, 13, 13, 5]
            and {m["hours"] for m in r["sets"][0]["methods"]} == {None, 1, 2}
            and all(m["edit"][1] <= m["edit"][0] <= m["edit"][2] for m in r["sets"][3]["methods"])
        ),
    ),
    "compare-weights": (
        "--before {room}/before --after {room}/after",
        lambda r: (
            # edits that only one folder has are left out, and the others are paired by their ids
            [(row["set"], row["count"]) for row in r["rows"]] == [("meshes, 8-bit, predicted", 2)]
            and (r["rows"][0]["before"], r["rows"][0]["after"]) == (150, 75)
            and r["rows"][0]["ratio"] == [0.5, 0.5, 0.5]
        ),
    ),
    "clipped-highlights": (
        "--data {room}/data --weights {room}/weights.safetensors --pictures 1 --outer-iterations 1",
        lambda r: [row["treatment"] for row in r["rows"]] == ["at its value", "one-sided"],
    ),
    "self-shadowing": (
        "--data {room}/tiers --pictures 1",
        # both tiers of this data set show the same picture, and there is no third one
        lambda r: r["rows"][0]["direct"] == 0 and r["rows"][0]["shadow"] is None,
    ),
    "unseen-shapes": (
        "--data {room}/pictures --weights {room}/weights.safetensors --pictures 2",
        lambda r: (
            len(r["rows"]) == 2
            and all(row["family"] == row["shape"].split(":")[0] for row in r["rows"])
            and all(0 < row["facing the viewer"] < 90 for row in r["rows"])
        ),
    ),
    "nearest-shapes": (
        "--data {room}/pictures --geometry {room}/data --weights {room}/weights.safetensors"
        " --pictures 2",
        lambda r: (
            len(r["rows"]) == 2
            and all(0 < row["angle"] < 180 for row in r["rows"])
            # the same sphere is among the training shapes
            and r["distances"]["pictures"]["sphere"] < 0.1
        ),
    ),
    "relighting": (
        "--data {room}/ladder --weights {room}/weights.safetensors --pictures 1",
        lambda r: (
            [row["task"] for row in r["rows"]] == 2 * ["relighting", "transfer"]
            and all(row["l2"]["true"] < row["l2"]["predicted"] for row in r["rows"])
        ),
    ),
    "mitsuba-comparison": (
        "--data {room}/ladder --weights {room}/weights.safetensors --scenes 1 --longer 1",
        lambda r: (
            r["rows"][0]["begun"]["edit"]
            == pytest.approx(r["rows"][0]["predicted"]["edit"], rel=0.01)
            and 0 < r["rows"][0]["mitsuba"]["steps"] <= r["rows"][0]["longer"]["steps"]
        ),
    ),
    "upsampling": (
        "--data {room}/large --weights {room}/weights.safetensors --edits 1",
        lambda r: all(p["normals enlarged"]["l2_ratio"] == [1, 1, 1] for p in r["parts"].values()),
    ),
    "photographed-edits": (
        "--data {room}/ladder --weights {room}/weights.safetensors --photographs 2",
        lambda r: (
            len(r["rows"]) == 2
            and all(len(row["edits"]) == 1 for row in r["rows"])
            and all(len(e["l2"]) == 33 for row in r["rows"] for e in row["edits"])
            # far too bright is worse than as it is
            and all(e["l2"][-1] > e["l2"][16] for row in r["rows"] for e in row["edits"])
        ),
    ),
    "room-photographs": (
        "--data {room}/rooms --weights {room}/weights.safetensors --scenes 1",
        lambda r: (
            [(row["source"], row["edits"][0]["target"]) for row in r["rows"]]
            == [("white-marble", "violet-rubber"), ("violet-rubber", "white-marble")]
            # marble is brighter than rubber before the same wall
            and r["rows"][0]["cues"]["object"] - r["rows"][0]["cues"]["background"]
            > r["rows"][1]["cues"]["object"] - r["rows"][1]["cues"]["background"] + 1
            and all(e["unchanged"] > 100 for row in r["rows"] for e in row["edits"])
        ),
    ),
    "mask-edges": (
        "--data {room}/rooms",
        lambda r: (
            len(r["rows"]) == 1
            and not r["rows"][0]["refused"]
            # the exact coverage as given, and what fitting makes of masks that are far off
            and r["rows"][0]["masks"]["exact coverage"]["as given"]["coverage"] == 0
            and all(
                r["rows"][0]["masks"][f"3 pixels too {how}"]["fitted"][key]
                < 0.5 * r["rows"][0]["masks"][f"3 pixels too {how}"]["as given"][key]
                for how in ("narrow", "wide")
                for key in ("coverage", "band", "object")
            )
        ),
    ),
    "named-shapes": (
        "--data {room}/pictures --shapes {room}/shapes.json --weights {room}/weights.safetensors"
        " --pictures 2",
        lambda r: (
            len(r["rows"]) == r["all"] == 2
            and all(row["named"] == "ball" for row in r["rows"])
            # an untrained network's normals are worse than a ball's
            and all(row["primitive"] < 0.7 * row["predicted"] for row in r["rows"])
            and all(row["overlap"] > 0.5 for row in r["rows"])
        ),
    ),
    "exposure-line": (
        "--fit rooms={root}/room-photographs/report.json"
        " metals={root}/photographed-edits-other-metals/report.json"
        " --judge development={root}/photographed-edits-development/report.json",
        lambda r: (
            [(each["name"], each["judged"]) for each in r["sets"]]
            == [("rooms", False), ("metals", False), ("development", True)]
            # no line is as close to a set as the one that is fitted to it
            and all(
                each[line][each["name"]]["off"] <= each[line][rule]["off"] + 1e-9
                for each in r["sets"][:2]
                for line in ("with background", "cut out")
                for rule in ("all", "rooms", "metals")
            )
            and all(
                low < mean < high
                for mean, low, high in [r["fitted"]["with background"]["intervals"]["background"]]
            )
        ),
    ),
    "painted-photographs": (
        "--data {room}/ladder --weights {room}/weights.safetensors --photographs 1",
        lambda r: (
            len(r["rows"]) == 16
            # paint changes what the object shows, and not what it is compared with
            and len({tuple(row["cues"].values()) for row in r["rows"]}) == 4
            and len({row["edits"][0]["target"] for row in r["rows"]}) == 1
        ),
    ),
    "principled-fit": (
        "--count 3 --every 2",
        # no label is closer to its material than every function of its two angles
        lambda r: (
            [("least" in row) for row in r["rows"]] == [True, False, True]
            and all(0 < row["least"] < row["error"] < 0.2 for row in r["rows"] if "least" in row)
        ),
    ),
    "stereo-normals": (
        "--scenes {room}/sphere/scenes.json --pictures {room}/sphere"
        " --weights {room}/weights.safetensors",
        lambda r: (
            len(r["rows"]) == 1
            and r["rows"][0]["kept"] > 0.8
            # normals of a sphere, 45° from the viewer on the average of its rims and its middle
            and 30 < r["rows"][0]["angles"]["facing the viewer"][0] < 50
            # the network's random normals pull at the ball
            and r["rows"][0]["angles"]["shape given"][0] < 27
            and r["rows"][0]["overlap"] > 0.95
        ),
    ),
    "exposure": (
        "--data {room}/exposed",
        lambda r: set(r["missed"]["exposed"]) == {"fitted", "in use", "one factor for all"},
    ),
}


def few_iterations(value_and_gradient, x, iterations, most_trials=None, run=descent.run_lbfgs):
    return run(value_and_gradient, x, min(iterations, 3), most_trials)


SMALLER = (  # what no option of an experiment lowers: module, constant, value
    (auto_calibration, "SHARPNESS", (0.5, 32.0)),
    (engine_timing, "SIZE", 96),
    (quadrature_materials, "ROUNDS", 1),
    (quadrature_materials, "SUNS", (20, 125)),
    (quadrature_materials, "SUNS_SIZE", 8),
    (chart_measurement, "SAMPLE", 24),
    (chart_measurement, "FINE_PARTS", 2),
    (descent, "run_lbfgs", few_iterations),
    (second_derivatives, "ROUNDS", {"float32": 1, "float64": 1}),
)


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """Data sets of all splits, pictures in two materials, larger ones, a run, untrained weights."""
    room = tmp_path_factory.mktemp("room")
    (room / "run.json").write_text(json.dumps(SETTINGS | {"network": "compact"}))
    terms = {"image": 3, "target": 3, "pixels": 8, "layer_light": [8, 16]}
    settings = SETTINGS | {"network": "compact", "losses": SETTINGS["losses"] | terms}
    (room / "all-terms.json").write_text(json.dumps(settings))
    of_light = {"network": "compact-wrapped", "losses": {"light_log": 1}}
    (room / "lights.json").write_text(json.dumps(SETTINGS | of_light))
    both = [matte("dark", 0.2), matte("light", 0.8)]
    rng = np.random.default_rng(3)
    for name, size in (("data", SIZE), ("pictures", SIZE), ("large", 2 * SIZE)):
        store = write_dataset(
            room / name, both, rng, size, 1, 0.0, rotations=(0,), category="sphere"
        )
        if name == "data":
            add_sides(store)
    written(room / "exposed")
    (room / "trained").mkdir()
    (room / "trained" / "run.json").write_text(json.dumps(SETTINGS))
    validation = {"angle_deg": 30.0, "albedo_1": 0.25, "albedo_2": 0.75, "constant_albedo_1": 1.0}
    steps = [
        {"step": 0, "cpu_seconds": 1800.0, "validation": validation},
        {"step": 1, "cpu_seconds": 3600.0, "validation": validation},
    ]
    (room / "trained" / "log.jsonl").write_text("".join(json.dumps(s) + "\n" for s in steps))
    shared = {"group": "meshes", "rung": "8-bit", "light": "sky", "target": "dark", "refined": None}
    for name, errors in (
        ("before", {"a": 100, "b": 200, "c": 5}),
        ("after", {"b": 100, "a": 50, "d": 7}),
    ):
        (room / name).mkdir()
        rows = [
            shared | {"id": key, "shape": f"ball:{key}", "predicted": {"edit_l2": error}}
            for key, error in errors.items()
        ]
        (room / name / "lines.jsonl").write_text("".join(json.dumps(r) + "\n" for r in rows))
    write_dataset(room / "tiers", both, rng, SIZE, 1, 0.0, (0,), tiers=("direct", "full"))
    ladder_rungs.written(room / "ladder", SIZE)
    ladder_rungs.written(room / "glossy", SIZE, glossy(split="test"))
    stereo_sphere.written(room / "sphere", size=4 * SIZE)
    room_scenes.written(room / "rooms")
    (room / "shapes.json").write_text('{"shapes": {"sphere:0": "ball", "sphere": "ball"}}')
    torch.manual_seed(0)
    network = Compact(Ranges.of(torch.tensor([each.label for each in both])))
    save_weights(
        room / "weights.safetensors", network, network.state_dict(), json.dumps(SETTINGS), SIZE
    )
    return room


def numbers(value):
    """All numbers of a report."""
    if isinstance(value, dict | list):
        for each in value.values() if isinstance(value, dict) else value:
            yield from numbers(each)
    elif isinstance(value, int | float):
        yield value


def run(name, words, out):
    threads = torch.get_num_threads()
    try:
        return main(
            "learn.experiments", "", COMMANDS, [name, *shlex.split(words), "--out", str(out)]
        )
    finally:
        torch.set_num_threads(threads)


def test_every_experiment_has_a_smallest_size_and_a_line_in_the_help():
    assert sorted(SMALLEST) == sorted(COMMANDS)
    assert all(f"  {name} " in description() for group in GROUPS.values() for name in group)


def test_help_needs_no_torch():
    program = (
        "import sys; from learn.experiments import __main__ as program, runner;"
        " print(len([runner.find(name) for name in program.COMMANDS]), 'torch' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert run.stdout.split() == [str(len(COMMANDS)), "False"], run.stderr


@pytest.mark.parametrize("name", SMALLEST)
def test_an_experiment_leaves_a_report_that_can_be_drawn_again(
    name, room, root, tmp_path, capsys, monkeypatch
):
    for module, constant, value in SMALLER:
        monkeypatch.setattr(module, constant, value)
    if name == "mitsuba-comparison" and importlib.util.find_spec("mitsuba") is None:
        pytest.skip("mitsuba is not installed: pip install .[witness]")
    words, holds = SMALLEST[name]
    out = tmp_path / "out"
    places = {"room": room, "root": root / "docs" / "results"}
    assert run(name, words.format(**places), out) == 0, capsys.readouterr().err
    report = json.loads((out / "report.json").read_text())
    assert set(report["made_by"]) == {"command", "commit", "date", "machine", "versions"}
    assert all(math.isfinite(x) for x in numbers(report))
    assert holds(report)
    page = (out / "report.md").read_text()
    assert page.startswith("# ") and "\n| " in page and report["made_by"]["commit"] in page
    (out / "report.md").unlink()
    # the chart is made again, but not its pixels, of which there is no other way than the first
    drawn = []
    monkeypatch.setattr(runner.files, "write_figure", lambda path, *_, **__: drawn.append(path))
    with pytest.raises(SystemExit) as end:
        main("learn.experiments", "", COMMANDS, [name, "--report", str(out / "report.json")])
    assert end.value.code == 0 and (out / "report.md").read_text() == page
    charts = [path for path in out.iterdir() if path.name == runner.CHART]
    assert [path for path in drawn if path.name == runner.CHART] == charts


def test_edits_in_rooms_are_compared_with_the_same_ones_edited_otherwise(room, tmp_path, capsys):
    words = f"--data {room}/rooms --weights {room}/weights.safetensors"
    assert run("room-photographs", f"{words} --no-refine", tmp_path / "a") == 0
    beside = f"--beside {tmp_path}/a/report.json"
    assert run("room-photographs", f"{words} --no-refine {beside}", tmp_path / "b") == 0
    ratios = json.loads((tmp_path / "b" / "report.json").read_text())["beside"]
    assert (ratios.pop("name"), ratios.pop("edits")) == ("a", 2)
    assert len(ratios) == 3 and all(of == pytest.approx([1, 1, 1]) for of in ratios.values())
    assert "## Beside `a`" in (tmp_path / "b" / "report.md").read_text()
    room_scenes.written(tmp_path / "others", scenes=2)
    words = f"--data {tmp_path}/others --weights {room}/weights.safetensors"
    assert run("room-photographs", f"{words} --no-refine {beside}", tmp_path / "c") == 1
    assert "expected the same photographs" in capsys.readouterr().err


def test_edits_in_rooms_can_be_told_the_shapes_of_their_objects(room, tmp_path, capsys):
    words = f"--data {room}/rooms --weights {room}/weights.safetensors --no-refine"
    named = f"{words} --shapes {room}/shapes.json"
    l2 = []
    for folder, each in (("a", words), ("b", named), ("c", f"{named} --use-shapes")):
        assert run("room-photographs", each, tmp_path / folder) == 0
        report = json.loads((tmp_path / folder / "report.json").read_text())
        l2.append([row["edits"][0]["l2"] for row in report["rows"]])
    assert l2[0] == l2[1] != l2[2]
    assert run("room-photographs", named, tmp_path / "c") == 1
    assert "use_shapes" in capsys.readouterr().err
    assert run("room-photographs", f"{words} --use-shapes", tmp_path / "d") == 1
    assert "--shapes FILE" in capsys.readouterr().err
    others, wrong = tmp_path / "others.json", tmp_path / "wrong.json"
    others.write_text('{"shapes": {"carton": "box"}}')
    wrong.write_text('{"shapes": {"sphere": "teapot"}}')
    for file, found in ((others, "found sphere"), (wrong, "found sphere: teapot")):
        assert run("room-photographs", f"{words} --shapes {file}", tmp_path / "e") == 1
        assert found in capsys.readouterr().err


def test_named_shapes_that_the_weights_saw_are_refused(room, tmp_path, capsys):
    """Meshes without a name are not measured, so that they may have been seen."""
    shapes = [shape.hash for shape in Store(room / "pictures").dataset().shapes.values()]
    theirs = tmp_path / "theirs.safetensors"
    lists = seen.make_seen({"shapes": shapes, "materials": [], "lights": []})
    write_lists(room / "weights.safetensors", lists, theirs)
    words = f"--data {room}/pictures --weights {theirs} --pictures 1 --shapes"
    assert run("named-shapes", f"{words} {room}/shapes.json", tmp_path / "out") == 1
    error = capsys.readouterr().err
    assert "theirs.safetensors never saw, found 1 of 1 shapes (sphere)" in error
    assert "--allow-overlap" in error and not list((tmp_path / "out").glob("[!.]*"))
    allowed = f"{words} {room}/shapes.json --allow-overlap"
    assert run("named-shapes", allowed, tmp_path / "out") == 0
    line = (tmp_path / "out" / "report.md").read_text().splitlines()[2]
    assert line == "**Overlap: theirs.safetensors saw in training 1 of 1 shapes (sphere).**"
    pictures = unseen_shapes.photographs_of(room / "pictures", theirs, [SIZE])[SIZE]
    assert named_shapes.list_tested(pictures.data_split, {"carton": "box"})["shapes"] == {}


def test_a_summary_needs_reports_and_their_words(tmp_path, capsys):
    assert run("edit-summary", "", tmp_path / "a") == 1
    assert "--photographs WORDS=FILE" in capsys.readouterr().err
    (tmp_path / "other.json").write_text('{"rows": [{}]}')
    assert run("edit-summary", f"--photographs a={tmp_path}/other.json", tmp_path / "b") == 1
    assert "expected a report of that command, found another one" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        run("edit-summary", "--ladder report.json", tmp_path / "c")
    assert "expected WORDS=FILE" in capsys.readouterr().err


def test_a_camera_that_balances_white_has_its_own_folder_of_results(room, tmp_path, capsys):
    room_scenes.written(tmp_path / "warm", lamp=(1.4, 1.0, 0.7))
    words = f"--data {tmp_path}/warm --weights {room}/weights.safetensors --no-refine"
    assert run("room-photographs", f"{words} --white-balance", tmp_path / "a") == 0
    first = json.loads((tmp_path / "a" / "report.json").read_text())
    page = (tmp_path / "a" / "report.md").read_text()
    assert "## What brightness and colour cost" in page
    assert run("room-photographs", words, tmp_path / "a") == 1
    assert "white_balance" in capsys.readouterr().err
    assert run("room-photographs", words, tmp_path / "b") == 0
    second = json.loads((tmp_path / "b" / "report.json").read_text())
    l2 = [[row["edits"][0]["l2"] for row in each["rows"]] for each in (first, second)]
    assert l2[0] != l2[1]


def test_a_name_that_is_not_known_is_a_line_with_the_known_ones(tmp_path, capsys):
    assert run("latency", "--light lampz", tmp_path / "a") == 1
    assert "did you mean lamps" in capsys.readouterr().err
    assert run("work-precision", "--light lampz", tmp_path / "b") == 1
    assert "did you mean lamps" in capsys.readouterr().err


def test_the_comparison_without_mitsuba_is_a_line_with_the_remedy(
    room, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    words = f"--data {room}/ladder --weights {room}/weights.safetensors"
    assert run("mitsuba-comparison", words, tmp_path / "out") == 1
    assert "pip install .[witness]" in capsys.readouterr().err


def test_weights_of_another_size_see_the_same_scenes_in_pictures_of_their_own_size(room, tmp_path):
    """Weights of 32 and 64 pixels, geometry of 64; by themselves, each has the same angles."""
    network, _ = weights.load_network(room / "weights.safetensors")
    larger = tmp_path / "larger.safetensors"
    save_weights(larger, network, network.state_dict(), json.dumps(SETTINGS), 2 * SIZE)
    smaller = room / "weights.safetensors"
    pages = {}
    for name, files in {"both": [smaller, larger], "one": [larger]}.items():
        words = " ".join(f"--weights {file}" for file in files)
        words += f" --data {room}/large --pictures 2"
        assert run("unseen-shapes", words, tmp_path / name) == 0
        pages[name] = json.loads((tmp_path / name / "report.json").read_text())["rows"]
    stem = smaller.parent.name
    for both, one in zip(pages["both"], pages["one"], strict=True):
        assert (both["shape"], both["material"]) == (one["shape"], one["material"])
        assert both["larger"] == one["larger"]
        assert both[stem] != both["larger"]


def test_a_common_factor_is_that_of_the_other_shapes():
    """Each shape is best with a factor that the other one's is not; a single one keeps its own."""
    l2 = np.full((3, len(edit_brightness.FACTORS)), 9.0)
    l2[:2, 0], l2[2, 1] = 1.0, 2.0
    assert edit_brightness.by_other_shapes(l2, ["a", "a", "b"]).tolist() == [9.0, 9.0, 9.0]
    l2[:2, 1] = 5.0
    assert edit_brightness.by_other_shapes(l2, ["a", "a", "b"]).tolist() == [5.0, 5.0, 9.0]
    assert edit_brightness.by_other_shapes(l2, ["a", "a", "a"]).tolist() == [9.0, 9.0, 9.0]


def test_a_line_through_exposures_leaves_out_draws_of_one_picture():
    """Otherwise the interval of few pictures is not a number."""
    Y, X = np.array([0.2, 0.5]), np.array([3.0, 1.0])
    line = exposure_rule.fitted(Y, X, bootstrap.groups_of(["a", "b"]))
    assert np.isfinite(list(line.values())).all()
    mean, low, high = line["dependence"]
    assert low == pytest.approx(mean) == pytest.approx(high)


def test_reports_of_another_command_and_hours_of_no_method_are_a_line(root, tmp_path, capsys):
    results = root / "docs" / "results"
    words = f"--evaluation {results}/edit-cost/report.json"
    assert run("edit-methods", words, tmp_path / "a") == 1
    assert "a report for --evaluation" in capsys.readouterr().err
    words = f"--edit-cost {results}/edit-cost/report.json --hours nothing=2"
    assert run("edit-methods", words, tmp_path / "b") == 1
    assert "the beginning of a method" in capsys.readouterr().err
    assert run("edit-methods", "", tmp_path / "c") == 1
    assert "expected a report, found none" in capsys.readouterr().err


def test_a_folder_that_is_a_file_is_refused_before_anything_is_measured(tmp_path, capsys):
    (tmp_path / "out").write_text("")
    assert run("tolerance-check", "", tmp_path / "out") == 1
    assert "expected a folder" in capsys.readouterr().err


REPORTS = {
    "edit-brightness-other-metals": "edit-brightness",
    "objective-ablation-features": "objective-ablation",
    "objective-ablation-glossy": "objective-ablation",
    "objective-ablation-glossy-300-first": "objective-ablation",
    "objective-ablation-glossy-300-second": "objective-ablation",
    "glossy-weights-300-first": "glossy-weights",
    "glossy-weights-300-second": "glossy-weights",
    "step-profile-integral": "step-profile",
    "step-profile-sum": "step-profile",
    "objective-ablation-long": "objective-ablation",
    "normals-ablation-128": "normals-ablation",
    "normals-ablation-256": "normals-ablation",
    "relighting-general-compact": "relighting",
    "ladder-two-encoders": "compare-weights",
    "ladder-test-two-encoders": "compare-weights",
    "ladder-second-test-two-encoders": "compare-weights",
    "evaluation-regions-fine-tuned": "compare-weights",
    "room-photographs-labels-ignored": "room-photographs",
    "room-photographs-others": "room-photographs",
    "room-photographs-others-balanced": "room-photographs",
    "room-photographs-residual-shading": "room-photographs",
    "room-photographs-shapes-given": "room-photographs",
    "room-photographs-shapes-guessed": "room-photographs",
    "room-photographs-two-encoders": "room-photographs",
    "room-photographs-unrefined": "room-photographs",
    "room-photographs-varied": "room-photographs",
    "room-photographs-varied-labels-ignored": "room-photographs",
    "room-photographs-varied-balanced": "room-photographs",
    "room-photographs-varied-others": "room-photographs",
    "room-photographs-varied-others-balanced": "room-photographs",
    "room-photographs-varied-others-unrefined": "room-photographs",
    "room-photographs-varied-unrefined": "room-photographs",
    "exposure-line-varied": "exposure-line",
    "mask-edges-varied": "mask-edges",
    "named-shapes-flat": "named-shapes",
}
NOT_PUBLISHED = {
    "compare-weights",  # its reports are named by what they compare
    "step-profile",  # and its reports by how a step renders
    "calibrate-auto",  # its result is learn/methods/calibration.json
}


@pytest.mark.parametrize("name", sorted(COMMANDS.keys() - NOT_PUBLISHED | REPORTS.keys()))
def test_a_published_page_is_what_its_report_says(name, root):
    folder = root / "docs" / "results" / name
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    page = runner.page_of(runner.find(REPORTS.get(name, name)), report)
    assert (folder / "report.md").read_text(encoding="utf-8") == page


@pytest.mark.parametrize("program", [learn.__main__, learn.experiments.__main__])
def test_memory_is_kept_when_a_command_runs_and_not_for_help(
    program, monkeypatch, capsys, tmp_path
):
    made = []
    monkeypatch.setattr(allocator, "keep_freed", lambda: made.append(1))
    name = program.__name__.removesuffix(".__main__")
    with pytest.raises(SystemExit):
        main(name, "", program.COMMANDS, ["--help"], prepare=program.prepare)
    assert main(name, "", program.COMMANDS, ["nothing"], prepare=program.prepare) == 2
    assert not made
    words = ["evaluate-network", "none", "--data", "none", "--out", "none"]
    if program is learn.experiments.__main__:
        words = ["exposure", "--data", "none", "--out", str(tmp_path / "out")]
    assert main(name, "", program.COMMANDS, words, prepare=program.prepare) == 1
    assert made == [1]
    capsys.readouterr()


def test_a_chart_of_runs_names_what_is_wrong_with_a_folder_or_a_log(room, tmp_path, capsys):
    assert run("training-runs", f"a={room}/data", tmp_path / "a") == 1
    assert "expected the file run.json, found none" in capsys.readouterr().err
    folder = tmp_path / "unvalidated"
    folder.mkdir()
    (folder / "run.json").write_text(json.dumps(SETTINGS))
    (folder / "log.jsonl").write_text('{"step": 0, "cpu_seconds": 1.0}\n')
    assert run("training-runs", f"a={folder}", tmp_path / "b") == 1
    assert "--sheet-every" in capsys.readouterr().err
    (folder / "log.jsonl").write_text('{"step": 0, "cpu_sec')
    assert run("training-runs", f"a={folder}", tmp_path / "c") == 1
    assert "log.jsonl:1: expected an object in JSON" in capsys.readouterr().err
    assert run("training-runs", f"a={room}/trained a={room}/trained", tmp_path / "d") == 1
    assert "expected a name of its own" in capsys.readouterr().err
