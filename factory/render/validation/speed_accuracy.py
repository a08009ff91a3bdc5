"""Error against processor time per picture: fixed samples, adaptive sampling, the denoiser, a
limit on the error, and BlenderProc, on the same scenes in the same run.

python -m factory.render.validation.speed_accuracy --scenes 24 --out DIR
python -m factory.render.validation.speed_accuracy --scenes 24 --out DIR --blenderproc PYTHON

scenes     drawn from a seed as in error_target; tiers in turn, or the one that --tier names
error      display L2 over the mask against a reference in two independent halves, whose noise
           cancels in the mean; a negative error is one below the reference's noise
time       processor seconds per picture in one thread, without loading shape, light and materials.
           The second of two pictures counts, so that each method finds the scene in memory
PYTHON     an interpreter with the packages blenderproc and bpy. BlenderProc renders the same
           objects, materials, light, pixel filter and bounces, saved as .blend files, with its own
           defaults for everything else, and with fewer samples in place of its 1,024
speed      of a limit on the error against another method: the other's time divided by that of the
           limit at the other's error, interpolated between limits (logarithms of both); and the
           same of the family that is fastest there, for which one would have to know the errors
"""

from __future__ import annotations

import argparse
import io
import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from factory.render.estimators import choice, ratio
from factory.render.estimators.adaptive_sampling import stopping_at
from factory.render.estimators.halves import Shown
from factory.render.studio import Studio
from factory.render.validation.error_target import TIERS, Scene, Stage, compared, drawn
from manifests.errors import InputError
from manifests.files import write_bytes, write_json, write_text
from manifests.option_types import positive, whole
from manifests.provenance import provenance

SAMPLES = (4, 16, 64, 256)
RATIO_SAMPLES = (4, 16, 64)
LIMITS = (5.0, 20.0, 60.0, 200.0)
THRESHOLDS = (0.1, 0.03, 0.01)
MOST_ADAPTIVE = 1024
FRAMES = 2
LEAST_ERROR = 0.05  # that references of some hundred samples can tell from none
OURS = ("path tracing", "denoised", "ratio", "limit on the error")
BIASED = ("denoised", "ratio")
PEER_SETTINGS = {
    "defaults": {"samples": 1024, "threshold": 0.01, "denoiser": "INTEL"},
    "16 samples": {"samples": 16, "threshold": 0, "denoiser": "INTEL"},
    "64 samples": {"samples": 64, "threshold": 0, "denoiser": "INTEL"},
    "64 samples, no denoiser": {"samples": 64, "threshold": 0, "denoiser": None},
}
PEER = Path(__file__).with_name("blenderproc_peer.py")

Method = Callable[[Shown], np.ndarray]


def methods(studio: Studio) -> dict[tuple[str, str], Method]:
    """Return functions that render a shot, by family and setting."""

    def fixed(samples: int) -> Method:
        return lambda at: studio.picture(samples, at.seed, at.tier)[0]

    def adaptive(threshold: float) -> Method:
        def render(at: Shown) -> np.ndarray:
            with stopping_at(studio._scene, threshold):
                return studio.picture(MOST_ADAPTIVE, at.seed, at.tier)[0]

        return render

    def smooth(samples: int) -> Method:
        def render(at: Shown) -> np.ndarray:
            denoised = studio.portion(0, samples, at.seed, at.tier, denoise=True).denoised
            assert denoised is not None
            return denoised

        return render

    def by_ratio(samples: int) -> Method:
        def render(at: Shown) -> np.ndarray:
            exact = studio.direct_light()
            if exact is not None and at.tier == "direct":
                return exact.radiance
            shown = studio.portion(0, samples, at.seed, at.tier, denoise=True)
            if exact is None:
                assert shown.denoised is not None
                return shown.denoised
            unblocked = studio.portion(0, samples, at.seed, "direct", denoise=True)
            return ratio.combined(exact.radiance, shown, unblocked)

        return render

    def limited(error: float) -> Method:
        return lambda at: choice.picture(at, error).radiance

    return (
        {("path tracing", f"{n} samples"): fixed(n) for n in SAMPLES}
        | {("adaptive sampling", f"threshold {t:g}"): adaptive(t) for t in THRESHOLDS}
        | {("denoised", f"{n} samples"): smooth(n) for n in SAMPLES[:3]}
        | {("ratio", f"{n} samples"): by_ratio(n) for n in RATIO_SAMPLES}
        | {("limit on the error", f"{e:g}"): limited(e) for e in LIMITS}
    )


def save(shown: Shown, path: Path) -> None:
    """Write what is shown as a picture, with the light map inside, into a .blend file."""
    # a closed form that was accepted at once has left the segments emitting their numbers
    shown.renderer.portion(0, 1, shown.seed, shown.tier)
    for image in bpy.data.images:
        if image.type != "RENDER_RESULT":
            image.update()
            image.pack()
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)


def timed(method: Method, shown: Shown) -> tuple[np.ndarray, float]:
    """Return the second of two pictures by different seeds, and its processor seconds."""
    method(replace(shown, seed=shown.seed ^ 2))
    start = time.process_time()
    picture = method(shown)
    return picture, time.process_time() - start


def scenes(options: argparse.Namespace, materials: list[str]) -> list[Scene]:
    """Return the scenes that the options draw."""
    tiers = TIERS if options.tier is None else (options.tier,)
    return [
        replace(drawn(number, options.seed, materials), tier=tiers[number % len(tiers)])
        for number in range(options.scenes)
    ]


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return a row for each scene and setting."""
    stage = Stage(options.size, 1)
    known = methods(stage.studio)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for number, scene in enumerate(scenes(options, stage.materials)):
            mask = stage.show(scene)
            shown = Shown(stage.studio, scene.seed, scene.tier, mask)
            pictures = [
                (family, name, *timed(method, shown)) for (family, name), method in known.items()
            ]
            if options.blenderproc:
                blend = Path(folder) / "scene.blend"
                save(shown, blend)
                pictures += rendered_by_peer(blend, options.blenderproc)
            reference = stage.reference(scene, mask, options.reference)
            for family, name, picture, seconds in pictures:
                achieved = compared(picture, picture, reference)
                rows.append(
                    {
                        **asdict(scene),
                        "scene": number,
                        "family": family,
                        "setting": name,
                        "seconds": seconds,
                        "error": achieved.error,
                        "reference_noise": reference.estimate().error,
                    }
                )
            print(f"{number + 1} of {options.scenes}: {scene}", flush=True)
    return rows


def rendered_by_peer(blend: Path, python: str) -> list[tuple[str, str, np.ndarray, float]]:
    """Return BlenderProc's pictures of a saved scene. Raises InputError if it does not run."""
    order = blend.with_suffix(".json")
    settings = {f"s{k}": value for k, value in enumerate(PEER_SETTINGS.values())}
    write_json(
        order, {"scenes": [str(blend)], "settings": settings, "threads": 1, "frames": FRAMES}
    )
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        [python, str(PEER), str(order)],
        capture_output=True,
        text=True,
        env={**environment, "OMP_NUM_THREADS": "1"},
    )
    if done.returncode:
        raise InputError(
            "--blenderproc",
            "a Python that has the packages blenderproc and bpy",
            done.stderr.strip().splitlines()[-1][:200],
            "make one: pip install blenderproc bpy opencv-python-headless",
        )
    seconds = json.loads(done.stdout.strip().splitlines()[-1])
    return [
        ("BlenderProc", name, np.load(f"{blend}.s{k}.npy"), seconds[f"s{k}"][0])
        for k, name in enumerate(PEER_SETTINGS)
    ]


def at_error(rows: list[dict[str, Any]], error: float, family: str = "limit on the error") -> float:
    """Return the seconds that a family of settings takes for a scene at an error.

    Interpolated between the settings' achieved errors and times. Beyond them noise in proportion to
    1/samples is assumed, which holds for unbiased families only: infinity for the others.
    """
    pairs = sorted(
        (max(row["error"], 1e-3), row["seconds"]) for row in rows if row["family"] == family
    )
    if not pairs:
        return float("inf")
    x, y = (np.log([pair[k] for pair in pairs]) for k in (0, 1))
    y = np.minimum.accumulate(y)  # a larger error never needs more time
    target = np.log(max(error, 1e-3))
    if target < x[0]:
        return float(np.exp(y[0] + x[0] - target)) if family not in BIASED else float("inf")
    return float(np.exp(np.interp(target, x, y)))


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a row for each family and setting: errors, seconds, and the speed at its error."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    by_scene: dict[int, list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["family"], row["setting"]), []).append(row)
        by_scene.setdefault(row["scene"], []).append(row)
    result = []
    for (family, setting), of in groups.items():
        errors = np.array([row["error"] for row in of])
        ratios = np.array(
            [row["seconds"] / at_error(by_scene[row["scene"]], row["error"]) for row in of]
        )
        best = np.array(
            [
                row["seconds"]
                / min(at_error(by_scene[row["scene"]], row["error"], each) for each in OURS)
                for row in of
            ]
        )
        result.append(
            {
                "family": family,
                "setting": setting,
                "error_mean": float(errors.mean()),
                "error_worst": float(errors.max()),
                "seconds": float(np.mean([row["seconds"] for row in of])),
                "speed_mean": float(np.exp(np.log(ratios).mean())),
                "speed_worst": float(ratios.min()),
                "best_mean": float(np.exp(np.log(best).mean())),
                "best_worst": float(best.min()),
            }
        )
    return result


def report(result: dict[str, Any]) -> str:
    """Return the page of a measurement."""
    figures = result["figures"]
    noise = max(row["reference_noise"] for row in result["rows"])
    lines = [
        "# Error against time per picture",
        "",
        f"    {result['command']}",
        "",
        f"Commit {result['commit']}, {result['date']}, {result['machine']}.",
        f"{result['scenes']} scenes of {result['size']}×{result['size']}, {result['tier']};"
        f" references of {2 * result['reference']} samples, whose own display error is at most"
        f" {noise:.2g}.",
        "Times are processor seconds in one thread; the speed is the time divided by the one that a"
        " limit on the error takes at the same error, per scene; and by the one of our family of"
        " settings that is fastest there, as one chooses who knows the errors.",
        "",
        "![chart](chart.png)",
        "",
        "| method | setting | error: mean | worst | seconds | speed of a limit: mean | worst"
        " | of our best: mean | worst |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for each in figures:
        speed = f"{each['speed_mean']:.1f} | {each['speed_worst']:.1f}"
        if each["family"] == "limit on the error":
            speed = "– | –"
        best = "– | –"
        if each["family"] not in OURS:
            best = f"{each['best_mean']:.1f} | {each['best_worst']:.1f}"
        lines.append(
            f"| {each['family']} | {each['setting']} | {each['error_mean']:.3g}"
            f" | {each['error_worst']:.3g} | {each['seconds']:.3f} | {speed} | {best} |"
        )
    if result["tier"] == "direct":
        lines += against_path_tracing(result["rows"])
    return "\n".join(lines) + "\n"


def against_path_tracing(rows: list[dict[str, Any]]) -> list[str]:
    """Return lines on how much longer path tracing takes to reach the closed form's error.

    In the tier `direct` the ratio is the closed form alone. Path tracing's error is taken to fall
    in proportion to its time beyond its most samples, and errors below LEAST_ERROR count as that.
    """
    lines = [
        "",
        "Direct light by the closed form, and the time of path tracing for the same error:",
        "",
        "| scene | error | seconds | path tracing, times as long |",
        "|---|---|---|---|",
    ]
    speeds = []
    for scene in sorted({row["scene"] for row in rows}):
        of = [row for row in rows if row["scene"] == scene]
        closed = min((r for r in of if r["family"] == "ratio"), key=lambda row: row["seconds"])
        traced = max(
            (r for r in of if r["family"] == "path tracing"), key=lambda row: row["seconds"]
        )
        factor = max(traced["error"], LEAST_ERROR) / max(closed["error"], LEAST_ERROR)
        speeds.append(factor * traced["seconds"] / closed["seconds"])
        lines.append(
            f"| {closed['shape']}, {closed['material']} | {closed['error']:.2f}"
            f" | {closed['seconds']:.2f} | {speeds[-1]:.0f} |"
        )
    mean = float(np.exp(np.log(speeds).mean()))
    return [*lines, f"| geometric mean, worst | | | {mean:.0f}, {min(speeds):.0f} |"]


def chart(figures: list[dict[str, Any]], path: Path) -> None:
    """Draw mean and worst errors over pictures per second."""
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(11, 4.6), layout="constrained")
    families = list(dict.fromkeys(each["family"] for each in figures))
    for axes, key, title in zip(
        drawing.subplots(1, 2, sharey=True),
        ("error_mean", "error_worst"),
        ("mean over scenes", "worst scene"),
        strict=True,
    ):
        for family in families:
            of = sorted(
                (each for each in figures if each["family"] == family),
                key=lambda each: each["seconds"],
            )
            x = [1 / each["seconds"] for each in of]
            y = [max(each[key], 1e-2) for each in of]
            mine = family == "limit on the error"
            joined = "" if family == "BlenderProc" else "-"
            axes.plot(x, y, "o" + joined, label=family, lw=2.5 if mine else 1.2, ms=5)
            if family == "BlenderProc":
                for each, a, b in zip(of, x, y, strict=True):
                    axes.annotate(
                        each["setting"],
                        (a, b),
                        xytext=(5, 4),
                        textcoords="offset points",
                        fontsize=7,
                    )
        axes.set(xscale="log", yscale="log", title=title, xlabel="pictures per second and core")
        axes.grid(alpha=0.3, which="both")
    drawing.axes[0].set_ylabel("display L2 over the object")
    drawing.axes[0].legend(fontsize=8)
    buffer = io.BytesIO()
    drawing.savefig(buffer, dpi=110)
    write_bytes(path, buffer.getvalue())


def main() -> None:
    """Measure, and write report.json, report.md and chart.png."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--scenes", type=positive, default=24, metavar="N")
    parser.add_argument("--seed", type=whole, default=7, metavar="N", help="from which scenes come")
    parser.add_argument("--size", type=positive, default=128, metavar="PIXELS")
    parser.add_argument("--tier", choices=TIERS, help="of all scenes (default: each in turn)")
    parser.add_argument(
        "--reference", type=positive, default=512, metavar="N", help="samples of each half"
    )
    parser.add_argument("--blenderproc", metavar="PYTHON", help="compare with BlenderProc, too")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    options = parser.parse_args()
    rows = measure(options)
    result = {
        **provenance(),
        **{key: getattr(options, key) for key in ("scenes", "size", "reference")},
        "tier": options.tier or "tiers in turn",
        "figures": summary(rows),
        "rows": rows,
    }
    options.out.mkdir(parents=True, exist_ok=True)
    write_json(options.out / "report.json", result)
    write_text(options.out / "report.md", report(result))
    chart(result["figures"], options.out / "chart.png")
    print(f"See {options.out / 'report.md'}")


if __name__ == "__main__":
    main()
