"""Mitsuba 3 as a rival of the chart's methods: the same spheres under the same maps.

mitsuba_sphere renders them. Mitsuba integrates, so that its error is that to the
integral; the one to the paper's sum holds the difference between the two as well.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from learn.methods import lobe_shapes
from manifests.errors import InputError
from shaders.frames import camera_from_light

SAMPLES = (16, 64, 256)  # per pixel, each a ray with a sample of the light and one of the BSDF
MOST_SECONDS = 3600.0


class Picture(NamedTuple):
    """Processor seconds of both passes and of the forward one, and radiance (P, 3)."""

    seconds: float
    forward: float
    radiance: np.ndarray


def is_installed() -> bool:
    """Return whether Mitsuba is (`pip install .[witness]`)."""
    return importlib.util.find_spec("mitsuba") is not None


def pictures(
    n: np.ndarray, view: np.ndarray | None, cases: Sequence[tuple[np.ndarray, np.ndarray]]
) -> list[dict[int, Picture]]:
    """Render a unit sphere, seen at points n, in each of the cases.

    n, view  (P, 3), camera frame; no view is the camera's axis
    cases    (label, light (height, width, 3))
    Returns  {samples: picture} for each case
    Raises   InputError where Mitsuba fails, as without a library of LLVM 19 or later
    """
    from_camera = np.asarray(camera_from_light(), np.float64)  # vectors in rows
    view = np.broadcast_to([0.0, 0.0, 1.0], n.shape) if view is None else view
    m = np.exp(np.stack([np.asarray(label).ravel() for label, _ in cases]))
    shaped = m.reshape(-1, 3, 3, 2, 6)
    strength = np.stack([lobe_shapes.strength(each) for each in shaped])
    given = {
        "n": n @ from_camera,
        "view": view @ from_camera,
        "m": m,
        "powers": np.maximum([lobe_shapes.sharpness(each) for each in shaped], 1.0),
        "shares": strength / strength.sum(-1, keepdims=True),
        "light": np.stack([light for _, light in cases]),
        "samples": np.array(SAMPLES),
    }
    result = _run(given)
    return [
        {
            samples: Picture(
                float(result["seconds"][c, s]),
                float(result["forward"][c, s]),
                result["pictures"][c, s],
            )
            for s, samples in enumerate(SAMPLES)
        }
        for c in range(len(cases))
    ]


def _run(given: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return what the program makes of IN.npz."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / "in.npz", Path(folder) / "out.npz"]
        np.savez(paths[0], **given)
        done = subprocess.run(
            [sys.executable, "-m", "learn.experiments.layer.mitsuba_sphere", *paths],
            capture_output=True,
            text=True,
            timeout=MOST_SECONDS,
            check=False,
        )
        if done.returncode:
            last = (done.stderr.strip().splitlines() or ["no message"])[-1][:200]
            remedy = "point DRJIT_LIBLLVM_PATH to libLLVM 19 or later, or leave --mitsuba out"
            raise InputError("mitsuba", "pictures of a sphere", last, remedy)
        with np.load(paths[1], allow_pickle=False) as file:
            return dict(file)
