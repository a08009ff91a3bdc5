"""Estimates the exposure of a photograph: the factor that turns its values into radiance under a
light of unit mean luminance.

A file does not say how bright its scene was. The network therefore sees the object in a first
guess, which depends only on the object's brightness in the file (learn.data.framing). Two cues then
allow a better estimate, which is linear in their logarithms:

- how much brighter the re-rendered prediction is than the picture, because a dark material in
  bright light looks different from a bright material in dim light;
- how bright the background is, because a camera exposes for the whole frame, so an object that is
  darker than its surroundings is likely to be dark.

The coefficients were fitted to display values, where white is 1. `python -m learn.experiments
exposure-line` fits them, and `photographed-edits` and `room-photographs` measure the result.
"""

from dataclasses import dataclass, replace

import numpy as np

from learn.data.batch import ExampleBatch
from learn.data.devices import to_numpy
from learn.data.framing import DEPENDENCE, TYPICAL, Framed
from learn.editing import reflectance_store
from learn.editing.photograph import CLEAR, Photograph
from learn.layer import predictions
from learn.networks.prediction import Prediction, require_part
from shaders.tone import LUMINANCE

MOST = 4.0  # stops, the largest correction of the first guess
LEAST_PIXELS = 16  # unclipped pixels that suffice to measure the object's brightness
LEAST_BACKGROUND = 0.05  # share of the picture below which it counts as a cut-out
DARKEST = 1 / 256  # smallest luminance relative to the background's mean that 8 bits can hold
LEAST_LUMINANCE = 1e-6  # below which an object counts as black


@dataclass(frozen=True)
class Cues:
    """What a photograph says about its exposure, in stops: logarithms to base 2.

    object      mean luminance of the object in the file
    again       by how much the prediction, rendered again, is brighter than the picture in its
                first exposure; None: unknown
    background  mean logarithm of the background's luminance; None: hardly any background is visible
    """

    object: float
    again: float | None
    background: float | None


@dataclass(frozen=True)
class Line:
    """An exposure in stops that is linear in the cues: a constant and a slope for each.

    Unknown cues count as 0.
    """

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


FIRST = Line(float(np.log2(TYPICAL)), -DEPENDENCE)  # the first guess, that of learn.data.framing
# fitted to objects in front of their light map and in rooms, which have equal weights
# (docs/results/exposure-line)
WITH_BACKGROUND = Line(-2.3, again=0.47, background=-0.77)
CUT_OUT = Line(-0.83, again=0.55)
# cues of the background are limited to about its 5th and 95th percentile in these photographs
BACKGROUNDS = (-3.5, -1.0)
USUAL = 2.0  # the typical `again` of these photographs, used where it is unknown


def exposure_from_cues(cues: Cues) -> float:
    """Return the exposure that the cues suggest, as a factor."""
    first = FIRST(cues)
    known = cues if cues.again is not None else replace(cues, again=USUAL)
    line = CUT_OUT
    if cues.background is not None:
        line = WITH_BACKGROUND
        known = replace(known, background=float(np.clip(cues.background, *BACKGROUNDS)))
    return float(2 ** np.clip(line(known), first - MOST, first + MOST))


def measure_background(photograph: Photograph) -> float | None:
    """Return the cue `background` of a photograph; None if hardly any background is visible.

    Pixels darker than DARKEST times the mean count as that dark.
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
    """Return the Cues of a photograph that is framed in its first exposure.

    rendered    (H, W, 3) radiance that `render_prediction` returned
    background  the cue that `measure_background` returned
    """
    seen = float((framed.radiance[framed.mask] @ LUMINANCE).mean()) / framed.exposure
    ratio = brightness_ratio(framed, rendered)
    again = None if ratio is None else float(np.log2(ratio))
    return Cues(float(np.log2(max(seen, LEAST_LUMINANCE))), again, background)


def correct_exposure(
    framed: Framed, batch: ExampleBatch, rendered: np.ndarray, background: float | None
) -> tuple[Framed, ExampleBatch, Cues]:
    """Return a framed photograph and its batch in the exposure that its Cues suggest, and the Cues.

    batch                 the picture as the network saw it
    rendered, background  as `measure_cues` takes them
    """
    cues = measure_cues(framed, rendered, background)
    exposure = exposure_from_cues(cues)
    factor = exposure / framed.exposure
    scaled = replace(framed, radiance=framed.radiance * np.float32(factor), exposure=exposure)
    return scaled, replace(batch, image=batch.image * factor), cues


def render_prediction(batch: ExampleBatch, prediction: Prediction) -> np.ndarray:
    """Render the prediction of a batch of one picture; return its radiance (H, W, 3)."""
    n, label, light = map(require_part, (prediction.n, prediction.label, prediction.light))
    normals, labels = to_numpy(n[0].movedim(0, -1)), to_numpy(label[0].float())
    segments, picture = to_numpy(batch.segments[0]), np.zeros_like(normals)
    for number, each in enumerate(labels, 1):
        inside = segments == number if len(labels) > 1 else segments > 0
        if inside.any():
            picture[inside] = reflectance_store.radiance_at_normals(
                each, normals[inside], light, batch.elevation, predictions.SHOWN.tolerance
            )
    return picture


def brightness_ratio(framed: Framed, rendered: np.ndarray) -> float | None:
    """Return the brightness of a re-rendering (H, W, 3) over that of the picture; None: unknown.

    Brightness is the mean luminance of the object where the file clips no channel. The ratio is
    unknown if the picture is white almost everywhere, or if the re-rendering is black.
    """
    kept = framed.mask if framed.clipped is None else framed.mask & (framed.clipped.max(-1) == 0)
    if kept.sum() < LEAST_PIXELS:
        return None
    before, after = (float((each[kept] @ LUMINANCE).mean()) for each in (framed.radiance, rendered))
    return None if min(before, after) < LEAST_LUMINANCE else after / before
