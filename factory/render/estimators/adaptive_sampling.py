"""Path tracing that stops at each pixel when its noise seems low: measured, and not chosen.

what      Cycles stops a pixel when two estimates of it, one of half the samples, differ by less
          than a threshold times the square root of its value, which is nearly a display value
bias      a pixel that looks quiet by chance stops too early
cost      the samples, and a look at all pixels from time to time
fails     always, by the error that jobs limit. Cycles gives each pixel as many samples as make all
          pixels equally noisy: n ∝ σ², for a pixel whose display value has the variance σ² at one
          sample. The mean error of N samples per pixel is then mean(σ²) / N, exactly as with N
          samples for every pixel. The best division is n ∝ σ, with mean(σ)² / N, which
          factory.render.validation.adaptive_sampling measures as well: it saves something where a
          few pixels have nearly all noise, as on mirror-like materials, and there the closed form
          and the denoiser are faster. Hence it is no estimator that a job may name
"""

import contextlib
from collections.abc import Iterator
from typing import Any

from factory.render.settings import Setting, apply, assign


@contextlib.contextmanager
def stopping_at(scene: Any, threshold: float) -> Iterator[None]:
    """Let Cycles stop sampling pixels whose noise is below a threshold, as its default does.

    scene  Blender's, with the camera
    """
    apply(
        scene,
        (
            Setting("cycles.use_adaptive_sampling", True, "compared"),
            Setting("cycles.adaptive_threshold", threshold, "compared"),
        ),
    )
    try:
        yield
    finally:
        assign(scene, "cycles.use_adaptive_sampling", False)
