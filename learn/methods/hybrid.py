"""Broad lobes from a few lights, sharp lobes from the texels near them: f is a sum over lobes, so
each goes the way that suits it.

Broad lobes (sharpness ≤ BROAD, learn/methods/lobe_shapes.py) see the light cut into regions of
equal energy (learn/methods/median_cut.py); sharp ones see every texel that can matter to them
(learn/methods/culled.py).
"""

import numpy as np

from learn.methods import Batch, Card, by_group, directional, lobe_shapes, median_cut

CARD = Card(
    name="hybrid",
    approximates="the light by few directional lights for broad lobes; all texels near sharp lobes",
    error=1e-2,
    cost="pixels × (lights + texels near a sharp lobe)",
    memory="as median_cut and culled",
    gradient=0.2,
)
BROAD = 60.0


def radiance(batch: Batch, tolerance):
    return with_lights(
        median_cut.held(batch, CARD.name), median_cut.count(tolerance), 0.25 * tolerance
    )


def with_lights(batch, count, left_out):
    """Radiance with `count` lights for broad lobes; left_out: what culling may cost, relative."""

    def one_group(n, view, m, light):
        broad = lobe_shapes.sharpness(m) <= BROAD
        out = 0
        if broad.any():
            lights, E = median_cut.cut(light, batch.camera_from_light, count)
            out = directional.radiance(n, view, m, E, lights, lobes=numbers(broad))
        if not broad.all():
            lights, E = directional.of_map(light, batch.camera_from_light)
            # relative to all lobes, not to the sharp ones
            allowed = left_out * directional.scale(n, view, m, E, lights)
            out = out + directional.radiance(n, view, m, E, lights, allowed, numbers(~broad))
        return out

    return by_group(batch, one_group)


def numbers(lobes):
    """The numbers, in a tuple, of lobes marked in an array (3,)."""
    return tuple(np.flatnonzero(lobes).tolist())
