"""Compare two commits: speed in turns, and equality of what they compute.

    python tests/endurance/compare_commits.py OLD NEW [--quick] [--repeats N] [--out FILE.md]

Both commits are checked out into temporary worktrees. Each task runs in a process of its own, OLD
and NEW in turns, so that a busy machine slows both: the layer's methods forward and backward,
planning, a small rendering by Blender, and a few training steps. The first table has the median
over pairs of the ratio NEW ÷ OLD of each time, with a 95 % bootstrap interval (with less than six
pairs, the range). The second says what is equal: pictures and gradients of the layer bit for bit,
labels, record ids of the jobs that OLD ships, a rendered picture, weights, and a prediction.

Only public interfaces are used: `learn.layer.render`, the commands, and the files that they write.
Planning alone has no command that prints ids; modules are looked up by their names in both commits.
--quick takes about two minutes on two idle cores.
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import importlib
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
QUICK_METHODS = ("exact", "auto", "culled", "quadrature")
QUICK_JOBS = ("smallest", "agreement", "demo", "00", "01")
METHODS = (*QUICK_METHODS, "reflectance_map", "median_cut", "hybrid", "split_sum")
GEOMETRY = {  # for training: a job of geometry alone
    "name": "compare-geometry",
    "pictures": False,
    "shapes": ["chair:0-3", "chair:13"],  # the last one is for validation
    "materials": ["chrome", "nylon"],
    "lights": ["city", "forest"],
    "views": [0, 6],
    "camera": {"size": [32, 32], "pixel": "centre"},
}
PICTURES = {
    "name": "compare-pictures",
    "shapes": ["sphere", "chair:0"],
    "materials": ["nylon"],
    "lights": ["city"],
    "views": [0, 6],
    "tiers": ["direct"],
    "samples": 8,
    "camera": {"size": [48, 48], "pixel": "centre"},
}
# version 1 stands for the built-in materials in both commits
RUN = {"version": 1, "name": "compare", "size": 32, "schedule": {"batch": 4, "warm_up": 1}}


def digest(parts: Iterable[bytes]) -> str:
    """Return the first 16 digits of a SHA-256 hash over all parts."""
    total = hashlib.sha256()
    for part in parts:
        total.update(part)
    return total.hexdigest()[:16]


# Tasks: each runs in a process in which one of the commits is imported, and returns
# {"seconds": {name: seconds}, "equal": {name: anything that must be the same}}.


def render_layer(size: str, rounds: str, *methods: str) -> dict[str, Any]:
    """Time the layer forward and backward, and hash its pictures and gradients."""
    import torch

    from learn.layer import render

    torch.set_num_threads(1)
    n, material, light, view = _scene(int(size))
    result: dict[str, Any] = {"seconds": {}, "equal": {}}
    for method in methods:
        for camera in ("orthographic", "view per pixel"):
            name = f"{method}, {camera}"
            given = {"view": view} if camera != "orthographic" else {}
            try:
                picture, gradients, seconds = _timed(
                    functools.partial(render, method=method, **given),
                    (n, material, light),
                    int(rounds),
                )
            except ValueError:  # methods that know one camera alone
                result["equal"][name] = "refused"
                continue
            result["seconds"][f"layer: {name}"] = seconds
            result["equal"][f"picture: {name}"] = digest([picture.numpy().tobytes()])
            result["equal"][f"gradients: {name}"] = digest(g.numpy().tobytes() for g in gradients)
    return result


def _scene(size: int) -> tuple[Any, Any, Any, Any]:
    """n, material, light, view of a sphere with lobes from matte to sharp."""
    import torch

    place = torch.arange(size) - (size - 1) / 2
    y, x = torch.meshgrid(place, place, indexing="ij")
    radius = 0.36 * size
    z = (1 - (x * x + y * y) / radius**2).clamp(min=0).sqrt()
    n = torch.where(z[..., None] > 0, torch.stack([x / radius, -y / radius, z], -1), 0)[None]
    lobes = torch.tensor([[0.3, 0.5], [0.2, 30.0], [1.0, 1000.0]])[:, :, None]
    light = 0.2 + torch.rand(1, 64, 128, 3, generator=torch.Generator().manual_seed(0))
    light[0, 18, 40] = 500.0
    view = torch.stack([0.1 * x / size, -0.1 * y / size, torch.ones_like(x)], -1)[None]
    view = torch.nn.functional.normalize(view, dim=-1)
    return n, lobes.expand(3, 3, 2, 6).reshape(1, 108), light, view


def _timed(render: Callable, tensors: tuple, rounds: int) -> tuple[Any, tuple, float]:
    """The picture, its gradients, and the least processor seconds after one round of warm-up."""
    import torch

    least = float("inf")
    for k in range(rounds + 1):
        leaves = [tensor.clone().requires_grad_() for tensor in tensors]
        start = time.process_time()
        picture = render(*leaves)
        gradients = torch.autograd.grad(picture.square().sum(), leaves, allow_unused=True)
        if k:
            least = min(least, time.process_time() - start)
    there = tuple(g for g in gradients if g is not None)
    return picture.detach(), there, least


def labels() -> dict[str, Any]:
    """Hash the labels of the built-in materials."""
    from manifests import materials

    equal = {}
    for path in materials.BUILT_IN:
        known = materials.load_catalogue(path)
        parts = (name.encode() + known[name].label.tobytes() for name in sorted(known))
        equal[f"labels: {path.name}, {len(known)} materials"] = digest(parts)
    return {"seconds": {}, "equal": equal}


def plan(most: str, *paths: str) -> dict[str, Any]:
    """Time planning, and hash the first record ids of each job."""
    jobs = _first("factory.planning.jobs", "factory.jobs")
    assets = _first("factory.planning.assets", "factory.assets")
    run = _first("factory.execution.run", "factory.run")
    result: dict[str, Any] = {"seconds": {}, "equal": {}}
    for path in paths:
        name = f"ids: {Path(path).name}"
        try:
            job, folder = jobs.load(path)
            make_plan = getattr(run, "make_plan", None) or run.planned  # its earlier name
            planned = make_plan(job, assets.resolve(job, folder, None, []))
        except ValueError as error:  # a user's mistake: meshes or lights that are not here
            print(f"{name}: {error}", file=sys.stderr)
            result["equal"][name] = "not planned: its files are not here"
            continue
        start, ids = time.process_time(), []
        for shot in planned:
            ids.append(shot.id)
            if len(ids) == int(most):
                break
        if len(ids) >= 100:
            result["seconds"][f"planning {len(ids)} shots of {Path(path).name}"] = (
                time.process_time() - start
            )
        result["equal"][f"{name}, the first {len(ids)}"] = digest(each.encode() for each in ids)
    return result


def _first(*names: str) -> Any:
    """The first of these modules that there is."""
    for name in names:
        try:
            return importlib.import_module(name)
        except ModuleNotFoundError as error:
            if error.name and not name.startswith(error.name):
                raise
    raise ModuleNotFoundError(" or ".join(names))


def render_pictures(job: str, out: str) -> dict[str, Any]:
    """Time `factory render` of a small job by the clock, and hash its pictures."""
    from manifests import exr

    seconds = _command("factory", "render", job, "--out", out)
    records = sorted(_records(Path(out)), key=lambda record: record["id"])
    pixels = []
    for record in records:
        path = next(Path(out).rglob(f"*{record['id']}*.exr"), None)
        if path is not None:
            pixels += [channel.tobytes() for _, channel in sorted(exr.read(path).items())]
    return {
        "seconds": {f"factory render, {len(records)} pictures": seconds},
        "equal": {
            "rendered record ids": digest(record["id"].encode() for record in records),
            "rendered pictures (Blender may differ in the last bits)": digest(pixels),
        },
    }


def _records(folder: Path) -> Iterator[dict[str, Any]]:
    for path in sorted(folder.rglob("*.jsonl")):
        for line in path.read_text().splitlines():
            record = json.loads(line)
            if "id" in record:
                yield record


def train(data: str, settings: str, steps: str, photo: str, out: str) -> dict[str, Any]:
    """Time a few training steps by `learn train`, hash the weights, and predict with them."""
    words = ["--data", data, "--steps", steps, "--workers", "0", "--sheet-every", steps]
    seconds = {
        f"learn train, {steps} steps": _command("learn", "train", settings, *words, "--out", out)
    }
    weights = Path(out) / "weights.safetensors"
    parts = str(Path(out) / "prediction")
    seconds["learn predict"] = _command(
        "learn", "predict", photo, "--weights", str(weights), "--out", parts
    )
    files = sorted(Path(parts).glob("*.exr")) + sorted(Path(parts).glob("*.json"))
    return {
        "seconds": seconds,
        "equal": {
            "weights": digest(_tensors(weights)),
            f"prediction, {', '.join(path.name for path in files)}": digest(
                path.read_bytes() for path in files
            ),
        },
    }


def _tensors(path: Path) -> Iterator[bytes]:
    """Names, types, shapes and bytes of a safetensors file, without its metadata."""
    data = path.read_bytes()
    start = 8 + int.from_bytes(data[:8], "little")
    header = json.loads(data[8:start])
    for name in sorted(header.keys() - {"__metadata__"}):
        entry = header[name]
        first, last = entry["data_offsets"]
        yield f"{name} {entry['dtype']} {entry['shape']}".encode()
        yield data[start + first : start + last]


def _command(*words: str) -> float:
    """Run a command of this commit and return its seconds by the clock."""
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", *words], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{' '.join(words)}: {done.stderr.strip()[-600:]}")
    return time.perf_counter() - start


TASKS = {f.__name__: f for f in (render_layer, labels, plan, render_pictures, train)}


# The comparison.


@contextmanager
def checked_out(commits: dict[str, str], room: Path) -> Iterator[dict[str, Path]]:
    """Check commits out as worktrees of a folder; they are removed at the end."""
    git = ["git", "-C", str(ROOT), "worktree"]
    trees = {side: room / side for side in commits}
    try:
        for side, commit in commits.items():
            add = [*git, "add", "--detach", "--force", str(trees[side]), commit]
            subprocess.run(add, check=True, capture_output=True)
        yield trees
    finally:
        for tree in trees.values():
            subprocess.run([*git, "remove", "--force", str(tree)], capture_output=True, check=False)


def in_commit(tree: Path, task: str, *arguments: object) -> dict[str, Any]:
    """Return what a task says in a fresh process that imports one commit."""
    environment = os.environ | {
        "PYTHONPATH": str(tree),
        "BRDFACTORY_CACHE": str(tree.parent / f"kernels-{tree.name}"),
        "NUMBA_CACHE_DIR": str(tree.parent / f"numba-{tree.name}"),
    }
    command = [sys.executable, __file__, "--task", task, *map(str, arguments)]
    done = subprocess.run(
        command, env=environment, cwd=tree.parent, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"{task} at {tree.name} failed:\n{done.stderr.strip()[-1500:]}")
    return json.loads(done.stdout.splitlines()[-1])


def interval(ratios: list[float]) -> tuple[float, float]:
    """Return 95 % bootstrap limits of the median, or the range of less than six ratios."""
    if len(ratios) < 6:
        return min(ratios), max(ratios)
    import numpy as np

    drawn = np.random.default_rng(0).choice(ratios, (2000, len(ratios)))
    low, high = np.percentile(np.median(drawn, axis=1), [2.5, 97.5])
    return float(low), float(high)


def compared(
    trees: dict[str, Path], todo: list[tuple], repeats: int
) -> tuple[dict[str, list[tuple[float, float]]], dict[str, tuple[Any, Any]]]:
    """Return {name: [(OLD's seconds, NEW's seconds)]} and {name: (OLD's value, NEW's value)}.

    todo  (task, number of pairs or None for `repeats`, function of side and pair → arguments)
    """
    times: dict[str, list[tuple[float, float]]] = {}
    values: dict[str, tuple[Any, Any]] = {}
    for task, pairs, arguments in todo:
        for pair in range(pairs or repeats):
            results = {}
            # the order changes from pair to pair, as what runs first may warm the disk
            for side in ("old", "new") if pair % 2 == 0 else ("new", "old"):
                print(f"{task}, pair {pair + 1}, {side}", file=sys.stderr)
                results[side] = in_commit(trees[side], task, *arguments(side, pair))
            old, new = results["old"], results["new"]
            for name in old["seconds"].keys() & new["seconds"].keys():
                times.setdefault(name, []).append((old["seconds"][name], new["seconds"][name]))
            for name in old["equal"] | new["equal"]:
                values.setdefault(name, (old["equal"].get(name), new["equal"].get(name)))
    return times, values


def page(commits: dict[str, str], times: dict, values: dict) -> str:
    """Return both tables in Markdown."""
    lines = [f"# {commits['new']} against {commits['old']}", ""]
    lines += [
        "| time | OLD, s | NEW, s | NEW ÷ OLD | interval | pairs |",
        "|---|---|---|---|---|---|",
    ]
    for name, pairs in sorted(times.items()):
        ratios = [new / old for old, new in pairs]
        old, new = (statistics.median(side) for side in zip(*pairs, strict=True))
        low, high = interval(ratios)
        lines.append(
            f"| {name} | {old:.4f} | {new:.4f} | {statistics.median(ratios):.3f} |"
            f" {f'{low:.3f} – {high:.3f}' if len(pairs) > 1 else '–'} | {len(pairs)} |"
        )
    lines += ["", "| what | equal | OLD | NEW |", "|---|---|---|---|"]
    for name, (old, new) in sorted(values.items()):
        lines.append(f"| {name} | {'yes' if old == new else '**no**'} | {old} | {new} |")
    return "\n".join(lines) + "\n"


def draw_photo(path: Path) -> None:
    """Write a picture of a shaded sphere, transparent outside it."""
    import numpy as np
    from PIL import Image

    y, x = np.mgrid[-1.2:1.2:128j, -1.2:1.2:128j]
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, 1))
    shade = 0.1 + 0.6 * np.clip(0.5 * x - 0.5 * y + 0.7 * z, 0, 1) + 0.3 * z**40
    colours = shade[..., None] * [1.0, 0.7, 0.5]
    pixels = np.dstack([colours, x * x + y * y < 1])
    Image.fromarray((255 * pixels.clip(0, 1)).astype(np.uint8)).save(path)


def short(commit: str) -> str:
    """Return the short hash of a commit. Raises CalledProcessError for an unknown one."""
    command = ["git", "-C", str(ROOT), "rev-parse", "--short", f"{commit}^{{commit}}"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def main() -> None:
    """Compare the two commits of the command line and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("old", help="a commit, such as c795182")
    parser.add_argument("new", help="another one, such as HEAD")
    parser.add_argument("--quick", action="store_true", help="small scenes, few pairs")
    parser.add_argument("--repeats", type=int, metavar="N", help="pairs (default 9; quick: 2)")
    parser.add_argument("--only", nargs="+", choices=TASKS, help="these tasks (default: all)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="a file for the tables as well")
    arguments = parser.parse_args()
    quick = arguments.quick
    # a run that is ended removes its worktrees too
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("compare_commits: ended"))
    commits = {"old": short(arguments.old), "new": short(arguments.new)}
    with (
        tempfile.TemporaryDirectory(prefix="compare-") as name,
        checked_out(commits, Path(name)) as trees,
    ):
        room = Path(name)
        for file, content in (("geometry", GEOMETRY), ("pictures", PICTURES), ("run", RUN)):
            (room / f"{file}.json").write_text(json.dumps(content))
        jobs = sorted((trees["old"] / "manifests" / "jobs").glob("*.json"))
        jobs += sorted((trees["old"] / "docs").glob("**/jobs/**/*.json"))
        if quick:  # few shapes: each is made and hashed
            jobs = [path for path in jobs if path.stem in QUICK_JOBS]
        layer = (48, 3, *QUICK_METHODS) if quick else (128, 5, *METHODS)
        for side in trees:  # kernels are compiled before anything is timed
            in_commit(trees[side], "render_layer", 12, 1, *layer[2:])
        todo: list[tuple] = [
            ("labels", 1, lambda side, pair: ()),
            ("plan", 1 if quick else None, lambda side, pair: (500 if quick else 5000, *jobs)),
            ("render_layer", None, lambda side, pair: layer),
        ]
        if {"render_pictures", "train"} & set(arguments.only or TASKS):
            in_commit(trees["old"], "render_pictures", room / "geometry.json", room / "geometry")
            few = 1 if quick else 3
            steps = 4 if quick else 30
            picture = room / "photo.png"
            draw_photo(picture)
            todo += [
                (
                    "render_pictures",
                    few,
                    lambda side, pair: (room / "pictures.json", room / f"pictures-{side}-{pair}"),
                ),
                (
                    "train",
                    few,
                    lambda side, pair: (
                        *(room / "geometry", room / "run.json", steps, picture),
                        room / f"run-{side}-{pair}",
                    ),
                ),
            ]
        todo = [task for task in todo if task[0] in (arguments.only or TASKS)]
        tables = page(commits, *compared(trees, todo, arguments.repeats or (2 if quick else 9)))
    print(tables)
    if arguments.out:
        arguments.out.write_text(tables)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--task"]:
        # the commit's own packages come from PYTHONPATH: neither from this folder, nor from where
        # an editable installation would find a module that this commit lacks
        sys.path.pop(0)
        sys.meta_path[:] = [f for f in sys.meta_path if "Editable" not in repr(f)]
        print(json.dumps(TASKS[sys.argv[2]](*sys.argv[3:])))
    else:
        main()
