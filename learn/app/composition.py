"""A rendered object put into its photograph, as linear values and as what a screen shows."""

from typing import NamedTuple

import numpy as np

from learn.app.choices import Edit
from learn.editing.compositor import Compositor
from learn.editing.photograph import CLEAR, Photograph
from learn.figures import montage
from shaders import tone


def composed(compositor: Compositor, object_: np.ndarray, edit: Edit) -> np.ndarray:
    """Return the photograph (H, W, 3), linear, with an object's radiance (side, side, 3) in it."""
    unchanged = None
    if edit.light.unchanged:
        if edit.detail:
            object_ = object_ * compositor.kept_shading(edit.detail)
        kept = [number for number, p in enumerate(edit.regions, 1) if p.unchanged]
        unchanged = np.isin(compositor.filled_regions, kept)
    return compositor.put_back(object_.astype(np.float32), unchanged, edit.hide_background)


def displayed(
    linear: np.ndarray, exposure: float, photograph: Photograph, hide_background: bool
) -> np.ndarray:
    """Return display values (H, W, 3 or 4) uint8 of an edited photograph, linear (H, W, 3)."""
    return with_opacity(tone.display(linear, exposure), photograph, hide_background)


def with_opacity(shown: np.ndarray, photograph: Photograph, hide_background: bool) -> np.ndarray:
    """Return display values (H, W, 3) as uint8, with a fourth channel where they have opacity."""
    opacity = opacity_of(photograph, hide_background)
    if opacity is not None:
        shown = np.concatenate([shown, 255.0 * opacity[..., None]], -1)
    return shown if shown.dtype == np.uint8 else montage.eight_bit(shown)


def opacity_of(photograph: Photograph, hide_background: bool) -> np.ndarray | None:
    """Return the opacity (H, W) in [0, 1] of an edit, None where it is opaque."""
    return photograph.coverage if hide_background else photograph.opacity


class Covered(NamedTuple):
    """The N pixels of a photograph that its object covers, and all else that their display takes.

    at             flat indices in the object's square
    rows, columns  in the photograph
    share          (N, 1) of the object in a pixel's colour, as Compositor.share has it
    regions        numbers of their regions, 1 the first
    residual       (N, 3) natural logarithms of the residual shading
    photograph     (N, 3) its radiance times the display's exposure
    behind         (N, 3) the same of the background
    display        (h, w, 3) uint8 of the photograph
    """

    at: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    share: np.ndarray
    regions: np.ndarray
    residual: np.ndarray
    photograph: np.ndarray
    behind: np.ndarray
    display: np.ndarray


def covered_pixels(compositor: Compositor, exposure: float) -> Covered:
    """Return the Covered pixels of a compositor's photograph under a display's exposure."""
    photograph, box = compositor.decomposition.photograph, compositor.decomposition.framed.box
    height, width = photograph.mask.shape
    row, column = (
        each + start for each, start in zip(np.indices(2 * (box[2],)), box, strict=False)
    )
    within = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    at = np.flatnonzero(within & (compositor.coverage > 0))
    rows, columns = row.ravel()[at], column.ravel()[at]
    inside = compositor.share().ravel()[at, None]
    factor = np.float32(exposure)
    seen = photograph.radiance[rows, columns] * factor
    behind = seen
    if not photograph.cut_out:
        soft = inside < 1 - CLEAR
        behind = np.where(soft, compositor.background().reshape(-1, 3)[at] * factor, seen)
    return Covered(
        at,
        rows,
        columns,
        inside.astype(np.float32),
        compositor.filled_regions.ravel()[at],
        compositor.residual().reshape(-1, 3)[at],
        seen,
        behind.astype(np.float32),
        montage.eight_bit(tone.display(photograph.radiance, exposure)),
    )
