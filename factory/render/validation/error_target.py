"""Whether pictures keep the error to which their job limits them, and what that costs.

python -m factory.render.validation.error_target law --shots 60
python -m factory.render.validation.error_target check --shots 300 --out DIR
python -m factory.render.validation.error_target check --shots 100 --meshes FOLDER --out DIR

A check that was stopped is continued by the same command.

shots    drawn from a seed: shape, material, light, view, tier and, in turn, the error requested
law      of the denoiser: its error as a power of the error without it, and its time in samples
check    renders each shot twice to its error. A reference in two halves, of at least four times the
         picture's samples, gives achieved errors as (P − R1)(P − R2) and squared biases as
         (P1 − R1)(P2 − R2), in display values: the references' noise cancels in the mean
cost     in processor seconds, since other programs may run. It is compared with one number of
         samples for all shots: the one that gives the same mean error, and the one that keeps the
         error on as many shots, both by noise in proportion to 1/samples from 64 samples of each
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from factory.lights import load as load_light
from factory.render.estimators import blends, choice
from factory.render.estimators.halves import CONFIDENCE, Estimate, Halves, Shown, mean_over
from factory.render.studio import Studio
from factory.shapes.catalogue import load as load_shape
from manifests.errors import InputError
from manifests.files import write_json, write_text
from manifests.materials import load_catalogue
from manifests.option_types import positive, whole
from manifests.provenance import provenance
from manifests.schema import Camera, Tier
from manifests.store import Lines
from shaders import tone

SHAPES = ("chair", "car", "sofa", "monitor", "vessel", "lamp", "blob", "sphere", "cube", "torus")
LIGHTS = ("city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset")
TIERS: tuple[Tier, ...] = ("direct", "shadow", "full")
ERRORS = (5.0, 20.0, 60.0)
LEAST_REFERENCE = 256  # samples of each half of a reference
MOST_REFERENCE = 2048
FIXED = 64  # samples of the pictures that are made as without an error
TRIED = (4, 8, 16, 32)  # samples of each half at which `law` denoises


@dataclass(frozen=True)
class Scene:
    """A shot by names; requested: the error."""

    shape: str
    material: str
    light: str
    rotation: int
    azimuth: float
    tier: Tier
    requested: float
    seed: int


def drawn(number: int, seed: int, materials: list[str], meshes: Sequence[Path] = ()) -> Scene:
    """Return shot `number` of a seed; other shots do not change it.

    meshes  files whose shapes are shown instead of the program's own
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    family = SHAPES[rng.integers(len(SHAPES))]
    shape = family if family in ("sphere", "cube", "torus") else f"{family}:{rng.integers(100)}"
    return Scene(
        shape=str(meshes[number * 7 % len(meshes)]) if meshes else shape,
        material=materials[rng.integers(len(materials))],
        light=LIGHTS[rng.integers(len(LIGHTS))],
        rotation=int(rng.integers(128)),
        azimuth=float(rng.integers(24) * np.pi / 12),
        tier=TIERS[rng.integers(len(TIERS))],
        requested=ERRORS[number % len(ERRORS)],
        seed=int(rng.integers(2**31)),
    )


def meshes_of(folder: Path | None) -> list[Path]:
    """Return the .obj files of a folder; none without a folder. Raises InputError: it has none."""
    meshes = sorted(folder.rglob("*.obj")) if folder else []
    if folder and not meshes:
        raise InputError("--meshes", "a folder with .obj files", "none", "name another folder")
    return meshes


class Stage:
    """A studio that shows scenes, and a clock."""

    def __init__(self, size: int, threads: int):
        self.studio = Studio("cpu", threads)
        self.studio.set_camera(Camera(size=(size, size)))
        self._catalogue = load_catalogue()
        self.materials = sorted(self._catalogue)

    def show(self, scene: Scene) -> np.ndarray:
        """Set a scene up and return its mask (height, width)."""
        mesh = load_shape(scene.shape)
        self.studio.set_shape(mesh)
        self.studio.set_light(load_light(scene.light).L64, scene.rotation)
        self.studio.set_materials([self._catalogue[scene.material].mixture] * mesh.segments)
        self.studio.set_view(scene.azimuth)
        mask = self.studio.geometry().mask
        self.studio.picture(1, 0, scene.tier)  # Cycles sends mesh and materials with the first
        return mask

    def reference(self, scene: Scene, mask: np.ndarray, samples: int) -> Halves:
        """Return halves of many samples by a seed that no picture has."""
        halves = Halves(Shown(self.studio, (scene.seed + 1) % 2**31, scene.tier, mask))
        halves.grow(samples)
        return halves


def compared(one: np.ndarray, other: np.ndarray, reference: Halves) -> Estimate:
    """Return the mean of (one − R1)(other − R2) in display values: an error, or a squared bias."""
    mask = reference.shown.mask
    exposure = tone.auto_exposure(reference.picture, mask)
    a, b, r1, r2 = (
        tone.display(each[mask], exposure) for each in (one, other, *reference.pictures)
    )
    return mean_over(((a - r1) * (b - r2)).mean(-1))


def named(scene: Scene) -> Scene:
    """Return a scene whose shape is the name of its file, where it is a file's."""
    return replace(scene, shape=Path(scene.shape).name)


def law(stage: Stage, options: argparse.Namespace) -> dict[str, Any]:
    """Return the denoiser's law, fitted over shots, and its time in samples by tier."""
    rows: list[dict[str, Any]] = []
    for number in range(options.shots):
        scene = drawn(number, options.seed, stage.materials)
        mask = stage.show(scene)
        reference = stage.reference(scene, mask, LEAST_REFERENCE)
        pilot = Halves(Shown(stage.studio, scene.seed, scene.tier, mask))
        pilot.grow(choice.PILOT)
        for samples in TRIED:
            halves = Halves(Shown(stage.studio, scene.seed + samples, scene.tier, mask))
            start = time.process_time()
            halves.grow(samples)
            middle = time.process_time()
            halves.grow(samples, denoise=True)
            end = time.process_time()
            alone = Halves(halves.shown)
            smooth = alone.grow(samples, denoise=True)
            blend = blends.best(alone, smooth, alone.pictures, 0.0)
            picture = (blend.pair[0] + blend.pair[1]) / 2
            rows.append(
                {
                    "shot": number,
                    "tier": scene.tier,
                    "samples": samples,
                    "noise_by_pilot": pilot.estimate().noise * choice.PILOT / samples,
                    "noise": compared(alone.picture, alone.picture, reference).error,
                    "estimated": blend.estimate.error,
                    "achieved": compared(picture, picture, reference).error,
                    "seconds": middle - start,
                    "denoiser": end - middle - (middle - start),
                }
            )
        print(f"{number}: {scene}", flush=True)
    usable = [row for row in rows if min(row["achieved"], row["noise_by_pilot"]) > 0]
    x = np.log([row["noise_by_pilot"] for row in usable])
    y = np.log([row["achieved"] for row in usable])
    shots = np.array([row["shot"] for row in usable])
    # the power within shots, then the spread of the factor between them
    centre = {n: (x[shots == n].mean(), y[shots == n].mean()) for n in set(shots.tolist())}
    dx, dy = (v - np.array([centre[n][k] for n in shots]) for k, v in enumerate((x, y)))
    power = float(dx @ dy / (dx @ dx))
    factors = np.exp([cy - power * cx for cx, cy in centre.values()])
    cost = {}
    for tier in TIERS:
        of = [row for row in rows if row["tier"] == tier and row["samples"] >= 16]
        per_sample = [row["seconds"] / row["samples"] for row in of]
        cost[tier] = float(np.median([r["denoiser"] for r in of]) / np.median(per_sample))
    ratios = [row["estimated"] / row["achieved"] for row in usable]
    return {
        "power": power,
        "scale_10_50_90": np.percentile(factors, [10, 50, 90]).tolist(),
        "cost_in_samples": cost,
        "estimated_over_achieved_10_50_90": np.percentile(ratios, [10, 50, 90]).tolist(),
        "rows": rows,
    }


def check(stage: Stage, options: argparse.Namespace) -> dict[str, Any]:
    """Return a row for each shot; with --out, rows of an earlier, stopped check are kept."""
    meshes, rows, lines = meshes_of(options.meshes), [], None
    if options.out:
        path = options.out / "rows.jsonl"
        lines = Lines(path)
        rows = [json.loads(line) for line in lines.read().splitlines()]
        for number, row in enumerate(rows[: options.shots]):
            scene = named(drawn(number, options.seed, stage.materials, meshes))
            if any(row[key] != value for key, value in asdict(scene).items()):
                raise InputError(
                    str(path),
                    f"the shots of seed {options.seed}",
                    f"another shot {number}",
                    "name another folder, or the same seed and meshes as before",
                )
    for number in range(len(rows), options.shots):
        scene = drawn(number, options.seed, stage.materials, meshes)
        mask = stage.show(scene)
        shown = [
            Shown(stage.studio, seed, scene.tier, mask) for seed in (scene.seed, scene.seed ^ 1)
        ]
        start = time.process_time()
        first = choice.picture(shown[0], scene.requested)
        seconds = time.process_time() - start
        second = choice.picture(shown[1], scene.requested)
        start = time.process_time()
        fixed, _ = stage.studio.picture(FIXED, scene.seed, scene.tier)
        fixed_seconds = time.process_time() - start
        samples = int(np.clip(2 * first.samples, LEAST_REFERENCE, MOST_REFERENCE))
        reference = stage.reference(scene, mask, samples)
        achieved = compared(first.radiance, first.radiance, reference)
        rows.append(
            {
                **asdict(named(scene)),
                "pixels": int(mask.sum()),
                "estimator": first.estimator,
                "samples": first.samples,
                "traced": first.traced,
                "seconds": seconds,
                "predicted": first.predicted,
                "estimated": first.estimated.error,
                "standard_error": first.estimated.standard_error,
                "achieved": achieved.error,
                "achieved_standard_error": achieved.standard_error,
                "second_estimator": second.estimator,
                "second_achieved": compared(second.radiance, second.radiance, reference).error,
                "squared_bias": compared(first.radiance, second.radiance, reference).error,
                "reference_noise": reference.estimate().error,
                "fixed": compared(fixed, fixed, reference).error,
                "fixed_seconds": fixed_seconds,
            }
        )
        last = rows[-1]
        if lines:
            lines.append(last)
        print(
            f"{number}: {last['estimator']} {last['samples']}, achieved {last['achieved']:.3g} of"
            f" {scene.requested:g}, {seconds:.2f} s; {last['shape']} {scene.material} {scene.light}"
            f" {scene.tier}",
            flush=True,
        )
    rows = rows[: options.shots]
    return {"groups": [_group(rows, requested) for requested in (*ERRORS, None)], "rows": rows}


def _group(rows: list[dict[str, Any]], requested: float | None) -> dict[str, Any]:
    """Return the figures of the shots that requested an error; None: of all."""
    of = [row for row in rows if requested in (None, row["requested"])]
    column = {
        name: np.array([row[name] for row in of])
        for name in ("requested", "achieved", "estimated", "predicted", "squared_bias", "seconds")
    }
    kept = column["achieved"] <= column["requested"]
    fixed = np.array([row["fixed"] for row in of])
    per_sample = float(np.mean([row["fixed_seconds"] for row in of])) / FIXED
    result = {
        "requested": requested,
        "shots": len(of),
        "estimators": {name: sum(row["estimator"] == name for row in of) for name in choice.ALL},
        "kept": int(kept.sum()),
        "missed_beyond_doubt": sum(
            row["achieved"] - CONFIDENCE * row["achieved_standard_error"] > row["requested"]
            for row in of
        ),
        "bias_above_a_third": int((column["squared_bias"] > column["requested"] / 3).sum()),
        "achieved_over_requested": float((column["achieved"] / column["requested"]).mean()),
        "bias_over_requested": float((column["squared_bias"] / column["requested"]).mean()),
        "estimated_over_achieved": _spread(column["estimated"] / column["achieved"]),
        "predicted_over_achieved": _spread(column["predicted"] / column["achieved"]),
        "samples": float(np.mean([row["samples"] for row in of])),
        "seconds": float(column["seconds"].mean()),
    }
    if requested is not None:
        equal = FIXED * float(fixed.mean() / column["achieved"].mean())
        keeping = FIXED * float(np.quantile(fixed / requested, kept.mean()))
        result |= {
            "fixed_samples_of_the_same_mean": equal,
            "fixed_seconds_of_the_same_mean": equal * per_sample,
            "fixed_samples_that_keep_as_often": keeping,
            "fixed_seconds_that_keep_as_often": keeping * per_sample,
        }
    return result


def _spread(values: np.ndarray) -> list[float]:
    """Return the 5th percentile, the median and the 95th percentile."""
    return [float(v) for v in np.percentile(values, [5, 50, 95])]


def cause(row: dict[str, Any]) -> str:
    """Return why a shot's error was not kept."""
    if row["estimated"] + CONFIDENCE * row["standard_error"] > row["requested"]:
        return "the most samples did not suffice"
    if row["achieved"] - CONFIDENCE * row["achieved_standard_error"] <= row["requested"]:
        return "within the uncertainty of the reference"
    if row["squared_bias"] > row["achieved"] / 2:
        return "bias that the estimate missed"
    return "noise that the halves' difference missed"


def report(result: dict[str, Any]) -> str:
    """Return the page of a `check`."""
    lines = [
        "# Errors to which jobs limit pictures",
        "",
        f"    {result['command']}",
        "",
        f"Commit {result['commit']}, {result['date']}, {result['machine']};"
        f" pictures of {result['size']}×{result['size']}.",
        "",
        "| requested | shots | path traced, denoised, ratio, closed form | kept"
        " | beyond doubt not | achieved ÷ requested, mean"
        " | squared bias ÷ requested, mean | bias above a third"
        " | estimated ÷ achieved, 5 %, median, 95 % | predicted ÷ achieved |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]

    def three(values: list[float]) -> str:
        return ", ".join(f"{v:.2f}" for v in values)

    for g in result["figures"]["groups"]:
        lines.append(
            f"| {'all' if g['requested'] is None else format(g['requested'], 'g')} | {g['shots']}"
            f" | {', '.join(str(n) for n in g['estimators'].values())}"
            f" | {g['kept']} ({g['kept'] / g['shots']:.1%})"
            f" | {g['missed_beyond_doubt']} | {g['achieved_over_requested']:.2f}"
            f" | {g['bias_over_requested']:.3f} | {g['bias_above_a_third']}"
            f" | {three(g['estimated_over_achieved'])} | {three(g['predicted_over_achieved'])} |"
        )
    lines += [
        "",
        "Cost in processor seconds a picture, against one number of samples for all shots:",
        "",
        "| requested | samples | cost | fixed, same mean error: samples | cost | fixed, kept as"
        " often: samples | cost |",
        "|---|---|---|---|---|---|---|",
    ]
    for g in result["figures"]["groups"]:
        if g["requested"] is not None:
            lines.append(
                f"| {g['requested']:g} | {g['samples']:.0f} | {g['seconds']:.3f}"
                f" | {g['fixed_samples_of_the_same_mean']:.0f}"
                f" | {g['fixed_seconds_of_the_same_mean']:.3f}"
                f" | {g['fixed_samples_that_keep_as_often']:.0f}"
                f" | {g['fixed_seconds_that_keep_as_often']:.3f} |"
            )
    missed = [row for row in result["figures"]["rows"] if row["achieved"] > row["requested"]]
    lines += ["", f"Shots whose error was not kept ({len(missed)}):", ""]
    lines += [
        "| shot | estimator, samples | requested | estimated | achieved | cause |",
        "|---|---|---|---|---|---|",
    ]
    for row in sorted(missed, key=lambda row: row["requested"] / row["achieved"]):
        lines.append(
            f"| {row['shape']}, {row['material']}, {row['light']}, {row['tier']}"
            f" | {row['estimator']}, {row['samples']} | {row['requested']:g}"
            f" | {row['estimated']:.3g}"
            f" | {row['achieved']:.3g} ± {row['achieved_standard_error']:.2g} | {cause(row)} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure what the arguments name; print the figures, or write them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("measure", choices=("law", "check"))
    parser.add_argument("--shots", type=positive, default=60, metavar="N")
    parser.add_argument("--seed", type=whole, default=0, metavar="N", help="from which shots come")
    parser.add_argument("--size", type=positive, default=64, metavar="PIXELS")
    parser.add_argument("--threads", type=positive, default=2, metavar="N")
    parser.add_argument("--meshes", type=Path, metavar="FOLDER", help="of .obj files, as shapes")
    parser.add_argument("--out", type=Path, metavar="DIR", help="of report.json and report.md")
    options = parser.parse_args()
    stage = Stage(options.size, options.threads)
    figures = (law if options.measure == "law" else check)(stage, options)
    result = {"size": options.size, **provenance(), "figures": figures}
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        write_json(options.out / "report.json", result)
        if options.measure == "check":
            write_text(options.out / "report.md", report(result))
    shown = figures["groups"] if options.measure == "check" else [figures | {"rows": None}]
    for each in shown:
        print(each)


if __name__ == "__main__":
    main()
