"""Error against processor time per picture: fixed samples, adaptive sampling, the denoiser, a
limit on the error, BlenderProc and a plain loop in Blender, on the same scenes in the same run.

python -m factory.render.validation.speed_accuracy --scenes 24 --out DIR
python -m factory.render.validation.speed_accuracy --scenes 24 --out DIR --blenderproc PYTHON
python -m factory.render.validation.speed_accuracy --scenes 24 --out DIR --bare-loop
python -m factory.render.validation.speed_accuracy --scenes 24 --out DIR --rounds 2
python -m factory.render.validation.speed_accuracy --scenes 8 --out DIR --families "shadow rays"

A measurement that was stopped is continued by the same command, scene by scene. --rounds measures
all times again, once the scenes are there, for machines on which they vary.

scenes     drawn from a seed (validation.scenes); tiers in turn, or the one that --tier names.
           --meshes shows files in place of the program's shapes
guides     of the denoiser are not filtered in fixed samples: one picture does not show their noise
error      display L2 over the mask against a reference in two independent halves, whose noise
           cancels in the mean; a negative error is one below the reference's noise. The standard
           error that this noise gives each error is in report.json, and --longer-scenes measures
           some scenes' errors by a longer reference, too
bias       squared, and part of the error; measured by --bias, which renders everything twice with
           seeds of its own. The error is then the mean of both pictures'
time       processor seconds per picture in one thread, without loading shape, light and materials.
           Each family renders a picture before, so that all find the scene in memory. The least
           of all rounds counts, which are as far from each other as the scenes take. Where a
           setting took more than LONGEST, the more exact ones of its family are left out. Limits
           of SMALLER_LIMITS are measured on scenes where the others stay above BlenderProc's error
PYTHON     an interpreter with the packages blenderproc and bpy. BlenderProc renders the same
           objects, materials, light, pixel filter and bounces, saved as .blend files, with its own
           defaults for everything else, and with fewer samples in place of its 1,024
bare loop  a few lines of Blender's Python module that render the same scene to EXR files
           (bare_loop_peer), by Cycles' defaults, and with fewer samples in place of its 4,096.
           Cycles' defaults drop dim light and clamp bright reflected light, so it has a bias
speed      of a limit on the error against another method: the other's time divided by that of the
           limit at the other's error, interpolated between limits (logarithms of both); and the
           same of the family that is fastest there, for which one would have to know the errors
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from factory.render.estimators import rules
from factory.render.estimators.halves import Halves
from factory.render.estimators.renderer import Shown
from factory.render.validation import command_line
from factory.render.validation.scenes import (
    TIERS,
    Scene,
    Stage,
    compare,
    draw_scene,
    meshes_of,
    name_of_file,
)
from factory.render.validation.speed_accuracy_report import LIMIT, chart, report, summary
from factory.render.validation.speed_accuracy_settings import (
    FAMILIES,
    MOST,
    SMALLER_LIMITS,
    Method,
    Rendered,
    methods,
    of_tier,
    render_by_bare_loop,
    render_by_peer,
    render_settings,
    render_to_limit,
    run_peer,
    smaller_limits,
    warm,
)
from manifests.errors import InputError
from manifests.files import write_json
from manifests.option_types import positive, whole
from manifests.provenance import provenance
from shaders import tone


def scenes(options: argparse.Namespace, materials: list[str]) -> list[Scene]:
    """Return the scenes that the options draw."""
    tiers = TIERS if options.tier is None else (options.tier,)
    meshes = meshes_of(options.meshes)
    return [
        replace(
            draw_scene(number, options.seed, materials, meshes), tier=tiers[number % len(tiers)]
        )
        for number in range(options.scenes)
    ]


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return a row for each scene and setting; scenes that DIR has already are not repeated."""
    stage = Stage(options.size, 1, options.references)
    known = {
        (family, name): method
        for (family, name), method in methods(
            stage.studio, not options.no_adaptive, options.most_samples
        ).items()
        if family in (*options.families, LIMIT) or not options.families
    }
    rows: dict[int, list[dict[str, Any]]] = {}
    for turn in range(1, options.rounds + 1):
        for number, scene in enumerate(scenes(options, stage.materials)):
            path = options.out / "scenes" / f"{number}.json"
            words = asdict(name_of_file(scene))
            key = json.loads(json.dumps({**words, **_condition(options)}))
            rows[number], done = _read_stored(path, key)
            if done >= turn:
                continue
            longer = options.longer_reference if number < options.longer_scenes else 0
            if done:
                again = time_again(stage, known, scene, options, rows[number])
                rows[number] = _least(rows[number], again)
            else:
                measured = measure_scene(stage, known, scene, options, longer)
                rows[number] = [{**words, "scene": number, **row} for row in measured]
            path.parent.mkdir(parents=True, exist_ok=True)
            write_json(path, {"scene": key, "rounds": turn, "rows": rows[number]})
            print(
                f"round {turn}, {number + 1} of {options.scenes}: {name_of_file(scene)}", flush=True
            )
    return [row for of in rows.values() for row in of]


def _read_stored(path: Path, key: dict[str, Any]) -> tuple[list[dict[str, Any]], int]:
    """Return a scene's rows and the rounds that they have, ([], 0) if it was not measured.

    Raises InputError if it was measured under other conditions.
    """
    if not path.exists():
        return [], 0
    earlier = json.loads(path.read_text())
    if earlier["scene"] != key:
        raise InputError(
            str(path),
            "a scene of the same options and rules",
            "another",
            "name another folder, or the same options as before",
        )
    return earlier["rows"], earlier["rounds"]


def _least(rows: list[dict[str, Any]], again: list[Rendered]) -> list[dict[str, Any]]:
    """Return rows with the shorter of two times of each setting."""
    seconds = {(family, setting): spent for family, setting, _, spent in again}
    return [
        {
            **row,
            "seconds": min(row["seconds"], seconds.get((row["family"], row["setting"]), np.inf)),
        }
        for row in rows
    ]


def _condition(options: argparse.Namespace) -> dict[str, Any]:
    """Return what scenes that are reported together have in common."""
    return {
        **{name: getattr(options, name) for name in ("size", "reference", "longer_reference")},
        "most_samples": options.most_samples,
        "peer": bool(options.blenderproc),
        "bare_loop": options.bare_loop,
        "adaptive": not options.no_adaptive,
        "families": sorted(options.families),
        "bias": options.bias,
        "rules": rules.VERSION,
    }


def measure_scene(
    stage: Stage,
    known: dict[tuple[str, str], Method],
    scene: Scene,
    options: argparse.Namespace,
    longer: int = 0,
) -> list[dict[str, Any]]:
    """Return family, setting, seconds, error and the reference's noise for each setting.

    With --bias the squared bias, too.

    longer  samples of each half of a reference by which errors are measured again, 0: of none
    """
    shown, pictures = _all_rendered(stage, known, scene, options)
    mask, count = shown.mask, _count(options)
    start = time.process_time()
    reference = stage.reference(scene, mask, options.reference)
    spent = time.process_time() - start

    def error(of: np.ndarray) -> float:
        return float(np.mean([compare(each, each, reference).error for each in of]))

    pictures += smaller_limits(pictures, shown, error, count)
    rows = []
    for family, name, of, seconds in pictures:
        bias = compare(of[0], of[1], reference).error if options.bias else None
        rows.append(
            {
                "family": family,
                "setting": name,
                "seconds": seconds,
                "error": error(of),
                "standard_error": doubt(of, reference),
                **({} if bias is None else {"squared_bias": bias}),
                "reference_noise": reference.estimate().error,
                "reference_seconds": spent,
            }
        )
    if longer:
        reference.grow(longer - options.reference)
        for row, (_, _, of, _) in zip(rows, pictures, strict=True):
            row["longer"] = {
                "error": error(of),
                "standard_error": doubt(of, reference),
                "reference_noise": reference.estimate().error,
            }
    return rows


def doubt(pictures: np.ndarray, reference: Halves) -> float:
    """Return the standard error that a reference's noise gives the mean error of pictures.

    What of the standard error of `compared` comes from the pictures' own noise is no doubt about
    their error, and does not count.
    """
    mask = reference.shown.mask
    exposure = tone.auto_exposure(reference.picture, mask)
    first, second = (tone.display(each[mask], exposure) for each in reference.pictures)
    # of (a − R1)(a − R2) the references' noise n has the parts −(a − t)(n1 + n2) and n1 · n2, where
    # t is the truth. (n1 − n2) / 2 is as large as (n1 + n2) / 2, and a − (R1 + R2) / 2 differs from
    # a − t by as much as the second part counts
    noise, mean = (first - second) / 2, (first + second) / 2
    off = np.mean([tone.display(each[mask], exposure) - mean for each in pictures], axis=0)
    parts = (2 * off * noise).mean(-1, dtype=np.float64)
    return float(np.sqrt((parts**2).sum()) / len(parts))


def time_again(
    stage: Stage,
    known: dict[tuple[str, str], Method],
    scene: Scene,
    options: argparse.Namespace,
    rows: list[dict[str, Any]],
) -> list[Rendered]:
    """Render every setting of a scene's rows once more."""
    names = [(row["family"], row["setting"]) for row in rows]
    smaller = {(LIMIT, f"{limit:g}"): render_to_limit(limit) for limit in SMALLER_LIMITS}
    again = {key: method for key, method in {**known, **smaller}.items() if key in names}
    return _all_rendered(stage, again, scene, options)[1]


def _all_rendered(
    stage: Stage,
    known: dict[tuple[str, str], Method],
    scene: Scene,
    options: argparse.Namespace,
) -> tuple[Shown, list[Rendered]]:
    """Return what a scene shows, and the pictures of all settings, other programs' included."""
    shown = Shown(stage.studio, scene.seed, scene.tier, stage.show(scene))
    known = of_tier(known, scene.tier)
    # the largest limit stands for all of them, and the fewest samples
    warm(shown, {family: known[family, name] for family, name in reversed(known)}.values())
    pictures = render_settings(known, shown, _count(options))
    if options.blenderproc:
        pictures += render_by_peer(shown, options.blenderproc, _count(options))
    if options.bare_loop:
        pictures += render_by_bare_loop(shown, _count(options))
    return shown, pictures


def _count(options: argparse.Namespace) -> int:
    """Return the pictures of each setting."""
    return 2 if options.bias else 1


def main() -> None:
    """Measure, and write report.json, report.md and chart.png."""
    parser = command_line.parser(
        __doc__, "scenes", 24, seed=7, size=128, reference=512, meshes=True, references=True
    )
    parser.add_argument("--tier", choices=TIERS, help="of all scenes (default: each in turn)")
    parser.add_argument("--blenderproc", metavar="PYTHON", help="compare with BlenderProc, too")
    parser.add_argument(
        "--bare-loop", action="store_true", help="compare with a plain loop in Blender, too"
    )
    parser.add_argument(
        "--no-adaptive", action="store_true", help="leave Cycles' adaptive sampling out"
    )
    parser.add_argument(
        "--families",
        nargs="+",
        default=[],
        choices=FAMILIES,
        metavar="NAME",
        help=f"of our settings, besides limits, those named: {', '.join(FAMILIES)} (default: all)",
    )
    parser.add_argument(
        "--most-samples",
        type=positive,
        default=MOST,
        metavar="N",
        help="of path tracing and the denoiser, up to 1024 (default: %(default)s)",
    )
    parser.add_argument(
        "--longer-reference",
        type=positive,
        default=2048,
        metavar="N",
        help="samples of each half of the longer reference of some scenes (default: 2048)",
    )
    parser.add_argument(
        "--longer-scenes",
        type=whole,
        default=0,
        metavar="N",
        help="measure errors of the first N scenes with the longer reference, too (default: 0)",
    )
    parser.add_argument(
        "--bias", action="store_true", help="render each setting twice, and report its bias"
    )
    parser.add_argument(
        "--rounds",
        type=positive,
        default=1,
        metavar="N",
        help="measure all times so often (default: 1); the least counts",
    )
    options = command_line.parse(parser)
    if options.blenderproc:
        run_peer(options.blenderproc, "--check")
    rows = measure(options)
    result = {
        **provenance(),
        **{key: getattr(options, key) for key in ("scenes", "size", "reference")},
        "tier": options.tier or "tiers in turn",
        "rounds": options.rounds,
        "figures": summary(rows),
        "rows": rows,
    }
    command_line.write_report(options.out, result, report(result))
    chart(rows, options.out / "chart.png")
    print(f"See {options.out / 'report.md'}")


if __name__ == "__main__":
    main()
