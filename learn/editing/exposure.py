"""The exposure of a photograph, corrected by the re-rendering of its prediction.

A file does not say how bright the scene was. The reader's rule (learn.data.framing.exposure_of)
guesses from the object's brightness alone. The network guesses again: a dark material in bright
light and a bright one in dim light give different pictures, so that what it renders again is
brighter or darker than the picture it was given. TRUST is the share of this ratio's logarithm by
which the exposure is moved.

`python -m learn.experiments exposure-correction` measures shares. Its pictures prefer the whole
ratio, while edits of the ladder's pictures become worse with more than half of it (docs/log.md).
"""

from dataclasses import replace

import numpy as np

from learn.data.batch import ExampleBatch
from learn.data.devices import array
from learn.data.framing import Framed
from learn.layer import predictions
from learn.networks.prediction import Prediction, required
from shaders.tone import LUMINANCE

TRUST = 0.75
MOST = 3.0  # stops by which an exposure is corrected at most
LEAST_PIXELS = 16
LEAST_LUMINANCE = 1e-6


def corrected(
    framed: Framed,
    batch: ExampleBatch,
    prediction: Prediction,
    rendered: np.ndarray | None = None,
) -> tuple[Framed, ExampleBatch]:
    """Return a framed photograph and its batch under the corrected exposure.

    batch       of the one picture, as the network saw it; its image is scaled alike
    prediction  of all three parts
    rendered    as from `rendered_again`, if it is known
    """
    if rendered is None:
        rendered = rendered_again(batch, prediction)
    factor = correction(framed, rendered)
    scaled = replace(
        framed,
        radiance=framed.radiance * np.float32(factor),
        exposure=framed.exposure * factor,
    )
    return scaled, replace(batch, image=batch.image * factor)


def rendered_again(batch: ExampleBatch, prediction: Prediction) -> np.ndarray:
    """Return the radiance (H, W, 3) of a prediction of a batch of one picture."""
    n, label, light = map(required, (prediction.n, prediction.label, prediction.light))
    segments, elevation = batch.segments, batch.elevation
    return array(predictions.picture(n, label, light, segments, elevation, predictions.SHOWN)[0])


def correction(framed: Framed, rendered: np.ndarray) -> float:
    """Return the factor by which the exposure is corrected: the ratio of brightness, to TRUST.

    rendered  (H, W, 3) radiance, as from `rendered_again`
    """
    ratio = brightness_ratio(framed, rendered)
    if ratio is None:
        return 1.0
    return float(2 ** np.clip(TRUST * np.log2(ratio), -MOST, MOST))


def brightness_ratio(framed: Framed, rendered: np.ndarray) -> float | None:
    """Return how much brighter a re-rendering (H, W, 3) is than the picture; None: cannot be said.

    Brightness is the mean luminance of the object where the file clips no channel. Nothing can be
    said of a picture that is white almost everywhere, or of a re-rendering that is black.
    """
    kept = framed.mask if framed.clipped is None else framed.mask & (framed.clipped.max(-1) == 0)
    if kept.sum() < LEAST_PIXELS:
        return None
    seen, again = (float((each[kept] @ LUMINANCE).mean()) for each in (framed.radiance, rendered))
    return None if min(seen, again) < LEAST_LUMINANCE else again / seen
