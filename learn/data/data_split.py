"""What examples of one side of the split are drawn from, and how glossy its materials are."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from learn.data.geometry import Geometry
from shaders.dsbrdf import SHAPE

if TYPE_CHECKING:
    from learn.data.rendered import RenderedSplit


@dataclass(frozen=True)
class DataSplit:
    """The shapes, materials and lights of one side of the split: train, validation or test.

    geometry        of the whole data set
    views           (V,) indices into geometry
    labels          {name: (108,) float32} of the side's materials
    maps            [(64, 128, 3)] light maps of unit mean luminance, light frame
    side            "train", "validation" or "test"
    rendered_split  this side's pictures by Cycles, or None
    skipped         {name: what is wrong} of materials that were left out, on all sides
    copies          hashes (learn.data.seen) of further copies of these maps, which were left out
    map_names       of the maps; () where they have none
    """

    geometry: Geometry
    views: np.ndarray
    labels: dict[str, np.ndarray]
    maps: list[np.ndarray]
    side: str
    rendered_split: RenderedSplit | None = None
    skipped: dict[str, str] = field(default_factory=dict)
    copies: tuple[str, ...] = ()
    map_names: tuple[str, ...] = ()

    def sizes(self) -> dict[str, int]:
        """Return {"shapes": number, …} of what examples are drawn from."""
        shapes = {self.geometry.views[v].shape for v in self.views}
        result = {
            "shapes": len(shapes),
            "views": len(self.views),
            "materials": len(self.labels),
            "lights": len(self.maps),
        }
        return result | ({"pictures": len(self.rendered_split)} if self.rendered_split else {})


def gloss(label: np.ndarray) -> float:
    """Return the largest γ max(κ, 1) of a label (108,), a measure of its narrowest highlight."""
    kappa, gamma = np.exp(label.reshape(SHAPE)).transpose(2, 0, 1, 3)
    return float((gamma * np.maximum(kappa, 1)).max())
