"""The exposure of a photograph: what it must be multiplied by to be that of a light of unit mean.

A file does not say how bright the scene was. The network sees the object under a first guess, which
follows from how bright it is in the file (learn.data.framing). Two things then say more, and the
exposure is a line through their logarithms:

- how much brighter than the picture the network's prediction is when it is rendered again: a dark
  material in bright light and a bright one in dim light give different pictures;
- how bright the background is, because a camera exposes for the whole frame: what is darker than
  its surroundings is likely to be dark.

The line was fitted to display values, where white is 1: `python -m learn.experiments
exposure-line` fits it, and `photographed-edits` and `room-photographs` measure it.
"""

from dataclasses import dataclass, replace

import numpy as np

from learn.data.batch import ExampleBatch
from learn.data.devices import to_numpy
from learn.data.framing import DEPENDENCE, TYPICAL, Framed
from learn.editing.photograph import CLEAR, Photograph
from learn.layer import predictions
from learn.networks.prediction import Prediction, require_part
from shaders.tone import LUMINANCE

MOST = 4.0  # stops by which a first exposure is corrected at most
LEAST_PIXELS = 16
LEAST_BACKGROUND = 0.05  # of a picture that shows more than its object
DARKEST = 1 / 256  # of the background's mean: 8 bits hold no finer ratio
LEAST_LUMINANCE = 1e-6


@dataclass(frozen=True)
class Cues:
    """What a photograph says about its exposure, in stops: logarithms to base 2.

    object      mean luminance of the object in the file
    again       how much brighter the prediction, rendered again, is than the picture under the
                first exposure; None: cannot be said
    background  mean of the logarithm of what lies behind the object; None where nothing does
    """

    object: float
    again: float | None
    background: float | None


@dataclass(frozen=True)
class Line:
    """An exposure in stops: a constant and the sum of slopes times cues; an unknown cue is 0."""

    constant: float
    object: float = 0.0
    again: float = 0.0
    background: float = 0.0

    def __call__(self, cues: Cues) -> float:
        """Return the exposure in stops."""
        return (
            self.constant
            + self.object * cues.object
            + self.again * (cues.again or 0.0)
            + self.background * (cues.background or 0.0)
        )


FIRST = Line(float(np.log2(TYPICAL)), -DEPENDENCE)  # the guess under which the network sees it
# fitted alike to objects before their light map and in rooms (docs/results/exposure-line)
WITH_BACKGROUND = Line(-2.3, again=0.47, background=-0.77)
CUT_OUT = Line(-0.83, again=0.55)
# about the 5th and the 95th percentile of their backgrounds: black says no more than dark
BACKGROUNDS = (-3.5, -1.0)
USUAL = 2.0  # of `again`, in these photographs, for one that says nothing of it


def exposure_from_cues(cues: Cues) -> float:
    """Return the factor from a photograph's radiance to that under light of unit mean."""
    first = FIRST(cues)
    known = cues if cues.again is not None else replace(cues, again=USUAL)
    line = CUT_OUT
    if cues.background is not None:
        line = WITH_BACKGROUND
        known = replace(known, background=float(np.clip(cues.background, *BACKGROUNDS)))
    return float(2 ** np.clip(line(known), first - MOST, first + MOST))


def measure_background(photograph: Photograph) -> float | None:
    """Return the background of a photograph's Cues; None where it shows hardly any.

    What is far darker than its mean counts as DARKEST of it.
    """
    there = photograph.coverage < CLEAR
    if photograph.alpha is not None:
        there = there & (photograph.alpha > 0.5)
    if photograph.cut_out or there.mean() < LEAST_BACKGROUND:
        return None
    luminance = photograph.balanced[there] @ LUMINANCE
    mean = float(luminance.mean())
    if not mean > 0:
        return None
    return float(np.log2(np.maximum(luminance, DARKEST * mean)).mean())


def measure_cues(framed: Framed, rendered: np.ndarray, background: float | None) -> Cues:
    """Return the Cues of a photograph under its first exposure.

    rendered    (H, W, 3) radiance, as from `render_prediction`
    background  of the Cues
    """
    seen = float((framed.radiance[framed.mask] @ LUMINANCE).mean()) / framed.exposure
    ratio = brightness_ratio(framed, rendered)
    again = None if ratio is None else float(np.log2(ratio))
    return Cues(float(np.log2(max(seen, LEAST_LUMINANCE))), again, background)


def correct_exposure(
    framed: Framed, batch: ExampleBatch, rendered: np.ndarray, background: float | None
) -> tuple[Framed, ExampleBatch, Cues]:
    """Return a framed photograph and its batch under the exposure of its Cues, and these.

    batch       of the one picture, as the network saw it; its image is scaled alike
    rendered, background  as of `measure_cues`
    """
    cues = measure_cues(framed, rendered, background)
    exposure = exposure_from_cues(cues)
    factor = exposure / framed.exposure
    scaled = replace(framed, radiance=framed.radiance * np.float32(factor), exposure=exposure)
    return scaled, replace(batch, image=batch.image * factor), cues


def render_prediction(batch: ExampleBatch, prediction: Prediction) -> np.ndarray:
    """Return the radiance (H, W, 3) of a prediction of a batch of one picture."""
    n, label, light = map(require_part, (prediction.n, prediction.label, prediction.light))
    segments, elevation = batch.segments, batch.elevation
    return to_numpy(predictions.picture(n, label, light, segments, elevation, predictions.SHOWN)[0])


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
