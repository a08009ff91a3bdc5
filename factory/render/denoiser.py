"""Open Image Denoise, as Cycles has it, on pictures that have been rendered already.

Cycles denoises what a render has just finished. A picture that grows by portions is denoised as a
whole by Cycles' operator for rendered animations instead, which reads and writes EXR files; these
lie in Blender's own temporary folder and are removed at once. At 256² a call takes .1 to
.3 s of one thread, 10 ms of which are the files'.

The denoiser is a network, and what it makes of a flipped picture is not quite the flipped result.
The mean over flips has less error than each.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import OpenEXR

from factory.render.estimators.renderer import Effort
from factory.render.settings import DENOISED, Setting, apply, assign
from manifests.quiet import silenced

LAYER = "Layer"
# channels of the file that the operator looks for; it demands motion, which it uses only between
# frames
CHANNELS = {
    "Combined": "RGBA",
    "Denoising Albedo": "RGB",
    "Denoising Normal": "XYZ",
    "Vector": "XYZW",
}
FLIPS = ((1, 1), (-1, -1), (1, -1), (-1, 1))  # steps along rows and columns
# passes of albedo and normal: those that Cycles' own denoiser takes, which follow mirrors, and
# those of the surface itself
FOLLOWED, OWN = ("Denoising Albedo", "Denoising Normal"), ("DiffCol", "Normal")
LEAST_LENGTH = 0.5  # of followed normals, averaged over the object; below, they count as missing


def guides_of(passes: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return albedo and normal (height, width, 6) of a rendered portion, as `denoise` takes them.

    Where a surface is mirror-like, Cycles' passes show what it mirrors. If that is the sky, there
    is no normal, and the albedo is that of few paths; the surface's own diffuse colour and normal
    then leave less error (docs/log.md).

    passes  {pass: (height, width, channels)} with FOLLOWED, OWN and Combined
    """
    lengths = np.linalg.norm(passes[FOLLOWED[1]], axis=-1)
    missing = lengths.sum() < LEAST_LENGTH * passes["Combined"][..., 3].sum()
    return np.concatenate([passes[name] for name in (OWN if missing else FOLLOWED)], axis=-1)


def denoise(
    scene: Any, radiance: np.ndarray, alpha: np.ndarray, guides: np.ndarray, effort: Effort
) -> np.ndarray:
    """Return the denoised radiance (height, width, 3), which is nowhere negative.

    radiance  (height, width, 3) of the rendered window
    alpha     (height, width)
    guides    (height, width, 6) albedo and normal, as of `guides_of`
    Raises    RuntimeError if Cycles has not finished
    """
    height, width = alpha.shape
    motion = np.zeros((height, width, len(CHANNELS["Vector"])), np.float32)
    values = np.concatenate([radiance, alpha[..., None], guides, motion], axis=-1, dtype=np.float32)
    prefilter = "FAST" if effort.prefilter else "NONE"
    own = (
        Setting("cycles.denoising_quality", effort.quality, "by samples"),
        Setting("cycles.denoising_prefilter", prefilter, "by the noise of the guides"),
    )
    apply(scene, (*DENOISED, *own))
    total = np.zeros((height, width, 3), np.float32)
    for rows, columns in FLIPS[: effort.flips]:
        total += _run(scene, values[::rows, ::columns])[::rows, ::columns]
    return total / np.float32(effort.flips)


def _run(scene: Any, values: np.ndarray) -> np.ndarray:
    """Return what the operator makes (height, width, 3) of values (height, width, channels)."""
    names = [f"{LAYER}.{name}.{c}" for name, letters in CHANNELS.items() for c in letters]
    planes = np.ascontiguousarray(np.moveaxis(values, -1, 0))
    header = {
        "type": OpenEXR.scanlineimage,
        "compression": OpenEXR.NO_COMPRESSION,
        f"cycles.{LAYER}.samples": "1",  # the values are means
    }
    noisy, smooth = (Path(bpy.app.tempdir) / f"{name}.exr" for name in ("noisy", "smooth"))
    try:
        OpenEXR.File(header, dict(zip(names, planes, strict=True))).write(str(noisy))
        assign(scene, "cycles.use_denoising", True)
        layer = scene.view_layers[0]
        with silenced(1, 2), bpy.context.temp_override(scene=scene, view_layer=layer):
            outcome = bpy.ops.cycles.denoise_animation(
                input_filepath=str(noisy), output_filepath=str(smooth)
            )
        if outcome != {"FINISHED"}:
            raise RuntimeError(
                f"Cycles: expected a denoised picture, found {outcome} (render the shot in a new"
                " process)"
            )
        picture = OpenEXR.File(str(smooth)).channels()[f"{LAYER}.Combined"].pixels
    finally:
        assign(scene, "cycles.use_denoising", False)
        for file in (noisy, smooth):
            file.unlink(missing_ok=True)
    return np.maximum(picture[..., :3], np.float32(0))
