"""The settings that factory.render.validation.speed_accuracy compares, and their pictures.

setting  a family, as "path tracing", and what of it, as "16 samples"
picture  (height, width, 3) float32, linear radiance
time     processor seconds per picture in one thread
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from factory.render.estimators import choice, ratio, shadow_rays
from factory.render.estimators.adaptive_sampling import stop_where_noise_is_below
from factory.render.estimators.halves import half_seed
from factory.render.estimators.renderer import Shown, effort
from factory.render.validation.speed_accuracy_report import (
    BARE_LOOP,
    CLOSED,
    LIMIT,
    PEER_DEFAULTS,
    PEER_NAME,
)
from manifests.errors import InputError
from manifests.files import write_json
from manifests.schema import Tier

if TYPE_CHECKING:
    from factory.render.studio import Studio

FAMILIES = (
    "path tracing",
    "adaptive sampling",
    "adaptive sampling, denoised",
    "denoised",
    "ratio",
    "shadow rays",
    CLOSED,
    LIMIT,
)
SAMPLES = (4, 16, 64, 256, 1024)
MOST = 256  # samples, unless more are requested
RATIO_SAMPLES = (4, 16, 64)
# samples, of which indirect light is denoised, and rays from each point of direct light
SHADOW_RAYS = ((4, 1), (16, 2), (64, 8))
CLOSED_POINTS = (16, 64)  # per pixel; mirror-like materials have 64 at least in small frames
LIMITS = (60.0, 20.0, 10.0, 5.0, 2.0)
# tried until a limit's picture is as good as the other program's
SMALLER_LIMITS = (1.0, 0.5, 0.125)
LONGEST = 60.0  # processor seconds of a setting beyond which its family's next one is left out
THRESHOLDS = (0.1, 0.03, 0.01)
MOST_ADAPTIVE = 1024
FRAMES = 2
PEER_SETTINGS: dict[str, dict[str, Any]] = {
    "defaults": {"samples": 1024, "threshold": 0.01, "denoiser": "INTEL"},
    "16 samples": {"samples": 16, "threshold": 0, "denoiser": "INTEL"},
    "64 samples": {"samples": 64, "threshold": 0, "denoiser": "INTEL"},
    "64 samples, no denoiser": {"samples": 64, "threshold": 0, "denoiser": None},
}
# without "samples" they are Cycles' own, at most 4,096 to a threshold of 0.01, and denoised
BARE_SETTINGS: dict[str, dict[str, Any]] = {
    "defaults": {},
    "16 samples": {"samples": 16, "use_adaptive_sampling": False},
    "64 samples": {"samples": 64, "use_adaptive_sampling": False},
    "64 samples, no denoiser": {
        "samples": 64,
        "use_adaptive_sampling": False,
        "use_denoising": False,
    },
}
PEER = Path(__file__).with_name("blenderproc_peer.py")
BARE = Path(__file__).with_name("bare_loop_peer.py")

Method = Callable[[Shown], np.ndarray]
# family, setting, pictures (pictures, height, width, 3), processor seconds of each
Rendered = tuple[str, str, np.ndarray, float]


def render_to_limit(error: float) -> Method:
    """Return the function that renders a shot to a limit on its error."""
    return lambda at: choice.render_within_error(at, error).radiance


def methods(
    studio: Studio, adaptively: bool = True, most: int = MOST
) -> dict[tuple[str, str], Method]:
    """Return functions that render a shot, by family and setting; `of_tier` selects among them.

    most  samples of path tracing and of the denoiser, of which there are no more
    """
    counts = [n for n in SAMPLES if n <= most]

    def fixed(samples: int) -> Method:
        return lambda at: studio.picture(samples, at.seed, at.tier)[0]

    def adaptive(threshold: float) -> Method:
        def render(at: Shown) -> np.ndarray:
            with stop_where_noise_is_below(studio._scene, threshold):
                return studio.picture(MOST_ADAPTIVE, at.seed, at.tier)[0]

        return render

    def adaptive_smooth(threshold: float) -> Method:
        def render(at: Shown) -> np.ndarray:
            with stop_where_noise_is_below(studio._scene, threshold):
                portion = studio.portion(0, MOST_ADAPTIVE, at.seed, at.tier)
            return studio.denoise(portion, effort(MOST_ADAPTIVE))

        return render

    def smooth(samples: int) -> Method:
        return lambda at: studio.denoise(
            studio.portion(0, samples, at.seed, at.tier), effort(samples)
        )

    def by_ratio(samples: int) -> Method:
        def render(at: Shown) -> np.ndarray:
            exact = studio.direct_light()
            shown = smooth(samples)(at)
            if exact is None:
                return shown
            return ratio.multiply_by_ratio(
                exact.radiance, shown, smooth(samples)(replace(at, tier="direct"))
            )

        return render

    def by_rays(samples: int, rays: int) -> Method:
        def render(at: Shown) -> np.ndarray:
            exact = studio.direct_light()
            if exact is None:
                return smooth(samples)(at)
            part = studio.portion(0, samples, at.seed, at.tier)
            shares = [
                studio.visible_share(shadow_rays.POINTS, rays, half_seed(at.seed, half), half)
                for half in (0, 1)
            ]
            assert shares[0] is not None and shares[1] is not None
            direct = exact.radiance * shares[0].add(shares[1]).factor
            if not part.indirect.any():
                return direct
            how = effort(samples)
            return direct + studio.denoise(part._replace(noisy=part.indirect), how)

        return render

    def closed(points: int) -> Method:
        def render(at: Shown) -> np.ndarray:
            exact = studio.direct_light(points)
            assert exact is not None
            return exact.radiance

        return render

    return (
        {("path tracing", f"{n} samples"): fixed(n) for n in counts}
        | {
            (family, f"threshold {t:g}"): make(t)
            for family, make in (
                ("adaptive sampling", adaptive),
                ("adaptive sampling, denoised", adaptive_smooth),
            )
            for t in (THRESHOLDS if adaptively else ())
        }
        | {("denoised", f"{n} samples"): smooth(n) for n in counts}
        | {("ratio", f"{n} samples"): by_ratio(n) for n in RATIO_SAMPLES}
        | {
            ("shadow rays", f"{n} samples, {rays} rays"): by_rays(n, rays)
            for n, rays in SHADOW_RAYS
        }
        | {(CLOSED, f"{n} points"): closed(n) for n in CLOSED_POINTS}
        | {(LIMIT, f"{e:g}"): render_to_limit(e) for e in LIMITS}
    )


def of_tier(known: dict[tuple[str, str], Method], tier: Tier) -> dict[tuple[str, str], Method]:
    """Return the settings that a tier has: the closed form in `direct`, else ratio and rays."""
    others = ("ratio", "shadow rays") if tier == "direct" else (CLOSED,)
    return {key: method for key, method in known.items() if key[0] not in others}


def save(shown: Shown, path: Path) -> None:
    """Write what is shown as a picture, with the light map inside, into a .blend file."""
    import bpy

    # a closed form that was accepted at once has left the segments emitting their numbers
    shown.renderer.portion(0, 1, shown.seed, shown.tier)
    for image in bpy.data.images:
        if image.type != "RENDER_RESULT":
            image.update()
            image.pack()
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)


def warm(shown: Shown, methods: Iterable[Method]) -> None:
    """Render a picture by each method, so that each finds scene, maps and denoiser in memory."""
    for method in methods:
        method(replace(shown, seed=shown.seed ^ 2))


def time_pictures(method: Method, shown: Shown, count: int = 1) -> tuple[np.ndarray, float]:
    """Return pictures of as many seeds, stacked, and the processor seconds of each.

    Each of them is the first of its view: what an earlier one has seen of it is forgotten.
    """
    pictures, spent = [], 0.0
    for k in range(count):
        shown.renderer.forget_grids()
        start = time.process_time()
        pictures.append(method(replace(shown, seed=shown.seed ^ 4 * k)))
        spent += time.process_time() - start
    return np.stack(pictures), spent / count


def render_settings(
    known: dict[tuple[str, str], Method], shown: Shown, count: int = 1
) -> list[Rendered]:
    """Return pictures of as many seeds for each setting, without what would take too long."""
    pictures: list[Rendered] = []
    for (family, name), method in known.items():
        slow = any(each[0] == family and each[3] > LONGEST for each in pictures)
        if not slow:
            pictures.append((family, name, *time_pictures(method, shown, count)))
    return pictures


def smaller_limits(
    pictures: list[Rendered], shown: Shown, error: Callable[[np.ndarray], float], count: int = 1
) -> Iterator[Rendered]:
    """Yield pictures of ever smaller limits, until one has the error of the other program's best.

    A limit's speed at that error is then measured. It need not be extrapolated.
    error  of a setting's pictures
    count  of the pictures of each setting
    """
    asked = min((error(each[2]) for each in pictures if each[0] == PEER_NAME), default=np.inf)
    limits = [each for each in pictures if each[0] == LIMIT]
    least, longest = min(error(each[2]) for each in limits), max(each[3] for each in limits)
    for limit in SMALLER_LIMITS:
        if least <= asked or longest > LONGEST:
            return
        made, seconds = time_pictures(render_to_limit(limit), shown, count)
        least, longest = min(least, error(made)), seconds
        yield LIMIT, f"{limit:g}", made, seconds


def render_by_peer(shown: Shown, python: str, count: int = FRAMES) -> list[Rendered]:
    """Return BlenderProc's pictures of what is shown, FRAMES of each setting.

    Of its defaults, which take long, there are `count`: what a first picture takes besides its
    samples is little of their time. Raises InputError if it does not run.
    """
    settings = {
        name: {**words, "frames": count if name == PEER_DEFAULTS else FRAMES}
        for name, words in PEER_SETTINGS.items()
    }
    return _render_elsewhere(
        shown, PEER_NAME, settings, FRAMES, lambda order: run_peer(python, order)
    )


def render_by_bare_loop(shown: Shown, count: int) -> list[Rendered]:
    """Return a plain loop's pictures of what is shown, as many of each setting."""
    return _render_elsewhere(shown, BARE_LOOP, BARE_SETTINGS, count, run_bare_loop)


def _render_elsewhere(
    shown: Shown,
    family: str,
    settings: dict[str, dict[str, Any]],
    count: int,
    run: Callable[[str], subprocess.CompletedProcess[str]],
) -> list[Rendered]:
    """Return pictures of what is shown by a program in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        blend, order = Path(folder) / "scene.blend", Path(folder) / "scene.json"
        save(shown, blend)
        words = {f"s{k}": value for k, value in enumerate(settings.values())}
        write_json(
            order, {"scenes": [str(blend)], "settings": words, "threads": 1, "frames": count}
        )
        seconds = json.loads(run(str(order)).stdout.strip().splitlines()[-1])
        return [
            (family, name, np.load(f"{blend}.s{k}.npy"), seconds[f"s{k}"][0])
            for k, name in enumerate(settings)
        ]


def run_peer(python: str, argument: str) -> subprocess.CompletedProcess[str]:
    """Run blenderproc_peer. Raises InputError if it fails."""
    done = _run(python, PEER, argument)
    if done.returncode:
        raise InputError(
            "--blenderproc",
            "a Python that has the packages blenderproc and bpy",
            done.stderr.strip().splitlines()[-1][:200],
            "docs/speed-accuracy.md lists what it needs",
        )
    return done


def run_bare_loop(order: str) -> subprocess.CompletedProcess[str]:
    """Run bare_loop_peer in this interpreter. Raises RuntimeError if it fails."""
    done = _run(sys.executable, BARE, order)
    if done.returncode:
        raise RuntimeError(f"{BARE.name}: {done.stderr.strip().splitlines()[-1][:200]}")
    return done


def _run(python: str, script: Path, argument: str) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    return subprocess.run(
        [python, str(script), argument],
        capture_output=True,
        text=True,
        env={**environment, "OMP_NUM_THREADS": "1"},
    )
