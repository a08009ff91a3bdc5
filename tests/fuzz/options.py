"""Odd values for every option of every command: the options are read from the commands' own
parsers.
"""

import argparse
import functools
import importlib
from pathlib import Path

import numpy as np

from learn.commands.options import weights_file

from . import STATUSES, Case, Room, commands, mutation, seeds

# wherever a number is asked for, none of these is one
NO_NUMBERS = ("x", "1,5", "0x10", "--", "1e", "½", "1 2", "None", "True")
NUMBERS = (
    "0",
    "1",
    "2",
    "3",
    "-1",
    "1.5",
    "nan",
    "inf",
    "-inf",
    "1e999",
    "1e-320",
    "1e5",
    " 3",
    "+3",
    "1_0",
    "0.999999",
    "-0",
)
# which no count of work can be
GIANTS = ("9" * 30, "-" + "9" * 30, str(2**31), str(2**63), str(2**64), "9" * 5000)
TEXTS = (
    "x",
    "a,b",
    "0,6",
    "1/2",
    "2/1",
    "0/0",
    "1/999999999",
    "random:5",
    "random:999",
    "brass",
    "city",
    "../x",
    "/",
    "-1",
    "é\udcff",
)
TEXTS += (
    "a\nb",
    "x" * 5000,
    "%s",
    "{0}",
    "brass+keep",
    "keep",
    "none",
    "grey",
    "1,1,1",
    "nan,1,1",
    "1e-9,1,1",
    "128",
    "4x4",
    "0x128",
    "y",
    "-z",
)

# A quick and valid line for each command; {view} and others as in tests/fuzz/commands.py
BASES = {
    "factory plan": "{seeds}/job.json --no-probe",
    "factory render": "{seeds}/job.json --out {out} --limit 1",
    "factory status": "{seeds}/data",
    "factory verify": "{views}",
    "factory preview": "{seeds}/data --count 1 --size 16 --out {out}",
    "factory export": "{seeds}/data --to tars --out {out}",
    "factory materials list": "",
    "factory materials preview": (
        "own-brass --catalogue {seeds}/catalogue.json --light {seeds}/light.exr --size 16 --out"
        " {room}/out.png"
    ),
    "factory materials report": "{seeds}/catalogue.json --out {out}",
    "factory materials condition": "{seeds}/nothing.npz --only brass",
    "factory materials fit": "{seeds}/nothing.npz --out {room}/out.json",
    "factory materials add": "{seeds}/nothing.npz --out {room}/out.json",
    "factory shapes list": "{seeds}/mesh.obj",
    "factory shapes preview": "{seeds}/mesh.obj --size 16 --out {room}/out.png",
    "factory shapes add": "{seeds}/mesh.obj --category object --licence CC0 --library {out}",
    "factory lights preview": "{seeds}/light.exr --size 16 --out {room}/out.png",
    "factory lights add": "{seeds}/light.exr --library {out}",
    "learn agree": "{seeds}/data --limit 1 --out {out}",
    "learn predict": "{seeds}/second.png --weights {seeds}/weights.safetensors --out {out}",
    "learn mask": "{seeds}/photograph.png --around 20%,20% 80%,80% --out {room}/out.png",
    "learn edit": "{seeds}/second.png --material white-acrylic " + commands.QUICK_EDIT,
    "learn transfer": "{seeds}/second.png {seeds}/photograph.png " + commands.QUICK_EDIT,
    "learn train": "{seeds}/run.json --data {views} --steps 1 --workers 0 --out {out}",
    "learn.experiments exposure": "--data {seeds}/data --out {out}",
    "learn evaluate-network": "{seeds}/weights.safetensors --data {views} --batches 1 --out {out}",
    "learn.experiments step-profile": (
        "{seeds}/run.json --data {views} --steps 1 --images 2 --out {out}"
    ),
    "learn.experiments refinement-ablation": "--data {seeds}/nothing --out {out}",
    "learn evaluate": (
        "--data {seeds}/data --weights {seeds}/weights.safetensors --no-refine --edits 1"
        " --processes 1 --out {out}"
    ),
    "learn evaluate-ladder": (
        "--data {seeds}/data --weights {seeds}/weights.safetensors --out {out}"
    ),
    "learn join-weights": (
        "--normals {seeds}/weights.safetensors --others {seeds}/weights.safetensors"
        " --out {out}/joined.safetensors"
    ),
    "learn.experiments upsampling": "--data {seeds}/nothing --out {out}",
    "learn train-baselines": "--data {seeds}/nothing --out {out}",
    "learn.experiments layer-ablation": "--data {seeds}/nothing --out {out}",
    "learn.experiments normals-ablation": "--data {seeds}/nothing --out {out}",
    "learn.experiments objective-ablation": "--data {seeds}/nothing --out {out}",
    "learn.experiments light-repairs": "--data {seeds}/nothing --out {out}",
    "learn.experiments nearest-shapes": "--data {seeds}/nothing --geometry {seeds} --out {out}",
    "learn.experiments refinement-methods": "--data {seeds}/nothing --out {out}",
    "learn.experiments room-photographs": "--data {seeds}/nothing --out {out}",
    "learn.experiments mask-edges": "--data {seeds}/nothing --out {out}",
    "learn.experiments named-shapes": (
        "--data {seeds}/nothing --shapes {seeds}/run.json --out {out}"
    ),
    "learn.experiments exposure-line": "--fit a={seeds}/nothing --out {out}",
    "learn.experiments stereo-normals": "--pictures {seeds}/nothing --out {out}",
    "learn.experiments edit-summary": "--out {out}",
    "learn.experiments edit-methods": "--out {out}",
    "learn.experiments engine-speed": "--out {out}",
    "learn.experiments work-precision": "--out {out}",
    "learn.experiments tolerance-check": "--out {out}",
    "learn.experiments latency": "--out {out}",
    "learn.experiments view-per-pixel": "--out {out}",
    "learn.experiments cold-start": "--out {out}",
    "learn.experiments quadrature-accuracy": "--out {out}",
}
LONG = (  # minutes, if not refused
    "learn.experiments engine-speed",
    "learn.experiments work-precision",
    "learn.experiments tolerance-check",
    "learn.experiments latency",
    "learn.experiments view-per-pixel",
    "learn.experiments cold-start",
    "learn.experiments quadrature-accuracy",
)
WORK = (  # larger numbers are more work, and right
    *(
        "--steps",
        "--edits",
        "--count",
        "--workers",
        "--threads",
        "--processes",
        "--rounds",
        "--cases",
        "--pictures",
        "--starts",
    ),
    *(
        "--batches",
        "--images",
        "--draws",
        "--seeds",
        "--gallery",
        "--seconds",
        "--pretraining",
        "--matte-first",
        "--samples",
        "--limit",
        "--limit",
    ),
)


def prepare(folder: Path) -> None:
    """The shared seeds."""
    seeds.shared(folder)


def case(index: int, rng: np.random.Generator, room: Room) -> Case:
    """First each command as it is, or its help where it takes long; then commands in turn, one or
    two options odd.
    """
    name = list(BASES)[index % len(BASES)]
    words, statuses = chosen(name, rng)
    if index < len(BASES):
        words, statuses = ["--help"] * (name in LONG), (1,) if "nothing" in BASES[name] else (0,)
    return Case(
        label=f"{name} {' '.join(words)}"[:150],
        command=[*name.split(), *commands.line(BASES[name], room), *words],
        writes=(*commands.WRITES, "cwd", "views", "x"),
        statuses=statuses,
        before=before(name),
    )


def chosen(name: str, rng: np.random.Generator) -> tuple[list[str], tuple[int, ...]]:
    """One or two options of a command with odd values, and the exit statuses that are right."""
    words, must_fail = [], False
    options = [a for a in parser_of(name)._actions if a.option_strings and a.dest != "help"]
    if name in LONG:
        options = [a for a in options if a.type not in (None, Path)]
    for _ in range(int(rng.choice([1, 1, 2]))):
        action = mutation.pick(rng, options)
        option = action.option_strings[-1] if rng.random() < 0.9 else action.option_strings[-1][:-1]
        values, refused = odd_values(action, rng, name in LONG)
        words += [option, *values]
        must_fail |= refused
    return words, (1, 2) if must_fail or name in LONG else STATUSES


def before(name: str):
    """What stands in for Blender and for slow drawing."""
    if name == "factory render":
        return seeds.fake_studio
    return commands.draw_small if name.startswith(commands.SLOW) else None


@functools.cache
def parser_of(name: str) -> argparse.ArgumentParser:
    """The parser of a command, "factory lights add"."""
    program, command, *action = name.split()
    subparsers = argparse.ArgumentParser().add_subparsers()
    if program == "learn.experiments":
        importlib.import_module(f"{program}.__main__").COMMANDS[command](subparsers)
    else:
        module = importlib.import_module(f"{program}.commands.{command.replace('-', '_')}")
        module.register(subparsers)
    parser = subparsers.choices[command]
    for each in action:
        parser = next(
            a for a in parser._actions if isinstance(a, argparse._SubParsersAction)
        ).choices[each]
    return parser


def odd_values(
    action: argparse.Action, rng: np.random.Generator, only_wrong: bool
) -> tuple[list[str], bool]:
    """Values for an option, and whether they must be refused."""
    if action.nargs == 0:
        return [], False
    if action.choices is not None:
        wrong = only_wrong or rng.random() < 0.5
        return [
            (
                mutation.pick(rng, ("x", "Full", " full"))
                if wrong
                else str(mutation.pick(rng, list(action.choices)))
            )
        ], wrong
    count = int(rng.integers(0, 4)) if action.nargs in ("+", "*") else 1
    if action.type in (None, Path, str, weights_file):
        return [mutation.pick(rng, TEXTS) for _ in range(count)], False
    if only_wrong or rng.random() < 0.3:
        return [mutation.pick(rng, NO_NUMBERS)], True
    numbers = NUMBERS if action.option_strings[-1] in WORK else (*NUMBERS, *GIANTS)
    return [mutation.pick(rng, numbers) for _ in range(count)], False
