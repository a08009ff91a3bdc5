"""The settings that factory.render.validation.speed_accuracy compares, and their pictures.

setting  a family, as "path tracing", and what of it, as "16 samples"
picture  (height, width, 3) float32, linear radiance
time     processor seconds per picture in one thread
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

from factory.render.estimators import choice, ratio
from factory.render.estimators.adaptive_sampling import stopping_at
from factory.render.estimators.renderer import Shown, effort
from factory.render.studio import Studio
from factory.render.validation.speed_accuracy_report import LIMIT, PEER_NAME
from manifests.errors import InputError
from manifests.files import write_json

SAMPLES = (4, 16, 64, 256)
RATIO_SAMPLES = (4, 16, 64)
LIMITS = (60.0, 20.0, 5.0, 2.0)
SMALLER_LIMITS = (0.5, 0.125)  # tried until a limit's picture is as good as the other program's
LONGEST = 60.0  # processor seconds of a setting beyond which its family's next one is left out
THRESHOLDS = (0.1, 0.03, 0.01)
MOST_ADAPTIVE = 1024
FRAMES = 2
PEER_SETTINGS = {
    "defaults": {"samples": 1024, "threshold": 0.01, "denoiser": "INTEL"},
    "16 samples": {"samples": 16, "threshold": 0, "denoiser": "INTEL"},
    "64 samples": {"samples": 64, "threshold": 0, "denoiser": "INTEL"},
    "64 samples, no denoiser": {"samples": 64, "threshold": 0, "denoiser": None},
}
PEER = Path(__file__).with_name("blenderproc_peer.py")

Method = Callable[[Shown], np.ndarray]
# family, setting, pictures (pictures, height, width, 3), processor seconds of each
Rendered = tuple[str, str, np.ndarray, float]


def limited(error: float) -> Method:
    """Return the function that renders a shot to a limit on its error."""
    return lambda at: choice.picture(at, error).radiance


def methods(studio: Studio, adaptively: bool = True) -> dict[tuple[str, str], Method]:
    """Return functions that render a shot, by family and setting."""

    def fixed(samples: int) -> Method:
        return lambda at: studio.picture(samples, at.seed, at.tier)[0]

    def adaptive(threshold: float) -> Method:
        def render(at: Shown) -> np.ndarray:
            with stopping_at(studio._scene, threshold):
                return studio.picture(MOST_ADAPTIVE, at.seed, at.tier)[0]

        return render

    def smooth(samples: int) -> Method:
        return lambda at: studio.denoised(
            studio.portion(0, samples, at.seed, at.tier), effort(samples)
        )

    def by_ratio(samples: int) -> Method:
        def render(at: Shown) -> np.ndarray:
            exact = studio.direct_light()
            if exact is not None and at.tier == "direct":
                return exact.radiance
            shown = smooth(samples)(at)
            if exact is None:
                return shown
            return ratio.combined(
                exact.radiance, shown, smooth(samples)(replace(at, tier="direct"))
            )

        return render

    return (
        {("path tracing", f"{n} samples"): fixed(n) for n in SAMPLES}
        | {
            ("adaptive sampling", f"threshold {t:g}"): adaptive(t)
            for t in (THRESHOLDS if adaptively else ())
        }
        | {("denoised", f"{n} samples"): smooth(n) for n in SAMPLES}
        | {("ratio", f"{n} samples"): by_ratio(n) for n in RATIO_SAMPLES}
        | {(LIMIT, f"{e:g}"): limited(e) for e in LIMITS}
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


def warm(shown: Shown, methods: Iterable[Method]) -> None:
    """Render a picture by each method, so that each finds scene, maps and denoiser in memory."""
    for method in methods:
        method(replace(shown, seed=shown.seed ^ 2))


def timed(method: Method, shown: Shown, count: int = 1) -> tuple[np.ndarray, float]:
    """Return pictures of as many seeds, stacked, and the processor seconds of each."""
    start = time.process_time()
    pictures = [method(replace(shown, seed=shown.seed ^ 4 * k)) for k in range(count)]
    return np.stack(pictures), (time.process_time() - start) / count


def rendered(known: dict[tuple[str, str], Method], shown: Shown, count: int = 1) -> list[Rendered]:
    """Return pictures of as many seeds for each setting, without what would take too long."""
    pictures: list[Rendered] = []
    for (family, name), method in known.items():
        slow = any(each[0] == family and each[3] > LONGEST for each in pictures)
        if not slow:
            pictures.append((family, name, *timed(method, shown, count)))
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
        made, seconds = timed(limited(limit), shown, count)
        least, longest = min(least, error(made)), seconds
        yield LIMIT, f"{limit:g}", made, seconds


def rendered_by_peer(shown: Shown, python: str) -> list[Rendered]:
    """Return BlenderProc's pictures of what is shown. Raises InputError if it does not run."""
    settings = {f"s{k}": value for k, value in enumerate(PEER_SETTINGS.values())}
    with tempfile.TemporaryDirectory() as folder:
        blend, order = Path(folder) / "scene.blend", Path(folder) / "scene.json"
        save(shown, blend)
        write_json(
            order, {"scenes": [str(blend)], "settings": settings, "threads": 1, "frames": FRAMES}
        )
        done = run_peer(python, str(order))
        seconds = json.loads(done.stdout.strip().splitlines()[-1])
        return [
            (PEER_NAME, name, np.load(f"{blend}.s{k}.npy"), seconds[f"s{k}"][0])
            for k, name in enumerate(PEER_SETTINGS)
        ]


def run_peer(python: str, argument: str) -> subprocess.CompletedProcess[str]:
    """Run blenderproc_peer. Raises InputError if it fails."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        [python, str(PEER), argument],
        capture_output=True,
        text=True,
        env={**environment, "OMP_NUM_THREADS": "1"},
    )
    if done.returncode:
        raise InputError(
            "--blenderproc",
            "a Python that has the packages blenderproc and bpy",
            done.stderr.strip().splitlines()[-1][:200],
            "docs/error-limit.md lists what it needs",
        )
    return done
