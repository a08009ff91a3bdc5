"""Broad lobes under a few lights, sharp lobes under all texels near them: f is a sum over lobes.

Broad lobes (sharpness ≤ BROAD, learn/methods/lobe_shapes.py) see the light cut into regions of
equal energy (learn/methods/median_cut.py); sharp ones see every texel that can matter to them
(learn/methods/culled.py).
"""

import functools

import numpy as np
import torch

from learn.methods import (
    Batch,
    Card,
    directional,
    light_tables,
    lobe_shapes,
    median_cut,
    radiance_by_group,
)

CARD = Card(
    name="hybrid",
    approximates="the light by few directional lights for broad lobes; all texels near sharp lobes",
    error=1e-2,
    cost="pixels × (lights + texels near a sharp lobe)",
    memory="as median_cut and culled",
    gradient=0.2,
)
BROAD = 60.0


def radiance(batch: Batch, tolerance: float) -> torch.Tensor:
    """Return outgoing radiance (P, 3) of a batch."""
    return radiance_by_lights(
        median_cut.prepare_batch(batch, CARD.name),
        median_cut.light_count(tolerance),
        0.25 * tolerance,
    )


def radiance_by_lights(batch: Batch, count: int, left_out: float) -> torch.Tensor:
    """Return radiance with `count` lights for broad lobes; left_out: relative error by culling."""

    def one_group(
        n: torch.Tensor, view: torch.Tensor | None, m: torch.Tensor, light: torch.Tensor
    ) -> torch.Tensor:
        broad = lobe_shapes.sharpness(m) <= BROAD
        parts = []
        if broad.any():
            lights, E = median_cut.cut_light(light, batch.camera_from_light, count)
            parts.append(directional.radiance(n, view, m, E, lights, lobes=marked_lobes(broad)))
        if not broad.all():
            lights, E = light_tables.lights_and_energy(light, batch.camera_from_light)
            # relative to all lobes, not to the sharp ones
            allowed = left_out * directional.mean_radiance(n, view, m, E, lights)
            sharp = directional.radiance(n, view, m, E, lights, allowed, marked_lobes(~broad))
            parts.append(sharp)
        return functools.reduce(torch.add, parts)

    return radiance_by_group(batch, one_group)


def marked_lobes(lobes: np.ndarray) -> tuple[int, ...]:
    """Return the numbers, in a tuple, of lobes marked in an array (3,)."""
    return tuple(np.flatnonzero(lobes).tolist())
