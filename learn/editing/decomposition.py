"""Intrinsic decomposition of a photograph: the network's prediction, and its refinement.

The network sees a square around the object, scaled to the size of its training pictures (usually
128²).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch

from learn.data import devices, framing
from learn.data.batch import ExampleBatch
from learn.editing import exposure, light_colour
from learn.editing.photograph import Photograph
from learn.layer.inputs import LENGTH_TOLERANCE
from learn.networks.prediction import Prediction
from learn.refinement import RefinementResult, RefinementSettings, refine
from manifests.errors import InputError
from shaders.frames import ELEVATION

if TYPE_CHECKING:
    from learn.primitives.fitting import PrimitiveFit

LEAST_OVERLAP = 0.95  # of a named shape's outline and the mask: the user is warned of a smaller one


class Parts(NamedTuple):
    """A complete Prediction: n, label and light, in the layout of learn.networks.prediction."""

    n: torch.Tensor
    label: torch.Tensor
    light: torch.Tensor


def require_parts(prediction: Prediction) -> Parts:
    """Return the parts of a prediction. Raises ValueError if one is missing."""
    n, label, light = prediction.n, prediction.label, prediction.light
    if n is None or label is None or light is None:
        raise ValueError("prediction: expected normals, material and light, found fewer parts")
    return Parts(n, label, light)


@dataclass(frozen=True)
class Decomposition:
    """A photograph, and the normals, light and material estimated from it.

    framed   the square that the network saw, in the corrected exposure (learn.editing.exposure)
    batch    the same as a batch of one picture
    start    the network's prediction, from which refinement starts
    refined  the refinement's result; None if no refinement was requested
    shape    the geometric primitive that the user named, as it was fitted; None if none was named
    cues     what the exposure was estimated from; None if the user gave it
    """

    photograph: Photograph
    framed: framing.Framed
    batch: ExampleBatch
    start: Prediction
    refined: RefinementResult | None
    shape: "PrimitiveFit | None" = None
    cues: exposure.Cues | None = None

    @cached_property
    def parts(self) -> Parts:
        """The parts to edit with: refined ones if there are any, with the light's green removed."""
        read = self.start if self.refined is None else self.refined.prediction
        return light_colour.remove_green(require_parts(read))

    @property
    def exposure(self) -> np.ndarray:
        """Factors (3,) by which the photograph's radiance is multiplied for the network."""
        return self.framed.exposure * self.photograph.balance

    @property
    def shape_overlap(self) -> float | None:
        """Intersection over union of the named shape's outline and the mask; None without one."""
        return None if self.shape is None else self.shape.overlap

    @property
    def label(self) -> np.ndarray:
        """Labels (S, 108) float32 of the object's regions."""
        return devices.to_numpy(self.parts.label[0].float())


def decompose(
    photograph: Photograph,
    network: torch.nn.Module,
    size: int,
    settings: RefinementSettings | None = None,
    watch: Callable[[int, int], None] | None = None,
    shape: str | None = None,
) -> Decomposition:
    """Return the Decomposition of a photograph.

    network   predicts normals, light and material
    size      side of the network's pictures, in pixels
    settings  how to refine; None: do not refine
    watch     called during refinement, see learn.refinement.refine
    shape     one of learn.primitives.PRIMITIVES, if the object is known to have this shape: its
              normals are used in place of the predicted ones, and refinement leaves them as they
              are. None: predicted
    """
    framed = framing.frame_object(
        photograph.balanced,
        photograph.mask,
        size,
        photograph.exposure,
        clipped=photograph.clipped,
    )
    regions = framing.frame_regions(photograph.regions, framed)
    batch, start = predict_framed(framed, network, regions, photograph.count)
    cues = None
    if photograph.exposure is None:
        rendered = exposure.render_prediction(batch, start)
        framed, batch, cues = exposure.correct_exposure(
            framed, batch, rendered, exposure.measure_background(photograph)
        )
    batch = replace(batch, elevation=photograph.elevation)
    fitted = None
    if shape is not None:
        fitted, start = _apply_shape(shape, photograph, framed, start)
        if settings is not None:
            free = tuple(name for name in settings.order if name != "normals")
            settings = replace(settings, order=free)
    labels: np.ndarray | None = getattr(network, "training_labels", None)
    refined = None if settings is None else refine(batch, start, settings, labels, watch)
    return Decomposition(photograph, framed, batch, start, refined, fitted, cues)


def shape_warning(shape: str | None, overlap: float | None, remedy: str) -> str:
    """Return a sentence, without its full stop, if a named shape does not suit the mask; else "".

    shape    the name; None: none was named
    overlap  intersection over union of its outline and the mask
    remedy   how to decompose without it
    """
    if shape is None or overlap is None or overlap >= LEAST_OVERLAP:
        return ""
    return (
        f"The outline of a {shape} overlaps the mask by only {overlap:.0%}: if edits look wrong,"
        f" correct the mask, or {remedy}"
    )


def _apply_shape(
    name: str, photograph: Photograph, framed: framing.Framed, start: Prediction
) -> "tuple[PrimitiveFit, Prediction]":
    """Return the fit of a primitive to the object, and the prediction with its normals."""
    # scipy's geometry takes time to import, and most edits name no shape
    from learn.primitives.fitting import fit_primitive

    size = len(framed.mask)
    coverage = framing.resize_square(
        framing.cut_square(photograph.coverage.astype(np.float32), framed.box), size
    )
    n = require_parts(start).n
    predicted = devices.to_numpy(n[0].movedim(0, -1)).astype(float)
    fitted = fit_primitive(
        name, np.where(framed.mask, np.maximum(coverage, 0.5), coverage), predicted
    )
    inside = torch.from_numpy(framed.mask).to(n.device)
    normals = torch.from_numpy(fitted.normals).movedim(-1, 0)[None].to(n)
    return fitted, start._replace(n=torch.where(inside, normals, n))


def predict_framed(
    framed: framing.Framed,
    network: torch.nn.Module,
    regions: np.ndarray | None = None,
    count: int = 1,
) -> tuple[ExampleBatch, Prediction]:
    """Return a framed picture as a batch of one, and the network's prediction of it.

    Both are on the network's device.

    regions  (size, size) numbers 1 … S, 0 outside the object; None: one region
    count    S, which `regions` may not show: a small region can have no pixel left at this size
    Raises   InputError if the network predicts numbers that are not finite
    """
    image = torch.from_numpy(framed.radiance).movedim(-1, 0)[None].contiguous()
    mask = torch.from_numpy(framed.mask)
    segments = mask[None].long() if regions is None else torch.from_numpy(regions)[None]
    unknown_light, unknown_label = torch.ones(1, 3, 64, 128), torch.zeros(1, count, 108)
    batch = ExampleBatch(
        image,
        mask[None, None].float(),
        torch.zeros_like(image),
        segments,
        unknown_label,
        unknown_light,
        unknown_label,
        ("picture",),
        float(ELEVATION),
        clipped=None
        if framed.clipped is None
        else torch.from_numpy(framed.clipped).movedim(-1, 0)[None].contiguous(),
    )
    batch = batch.to(devices.device_of(network))
    with torch.no_grad():
        predicted = network(
            batch.image, batch.mask, batch.segments if count > 1 else None, regions=count
        )
    # normals have length 0 where the numbers overflowed before they were scaled to unit length
    lengths = predicted.n.movedim(1, -1)[mask[None].to(predicted.n.device)].norm(dim=-1)
    finite = all(part.isfinite().all() for part in (predicted.n, predicted.label, predicted.light))
    if not (finite and ((lengths - 1).abs() <= LENGTH_TOLERANCE).all()):
        rule = "weights that predict finite normals, light and material"
        raise InputError(
            "--weights", rule, "NaN or infinity", "train them again, or leave --weights out"
        )
    return batch, predicted
