"""A million pixels made to break a sum of lobes: nothing that is not finite may come out, in values
or gradients.
"""

import numpy as np
import pytest

from learn.engines import cpu
from learn.methods import HORIZON
from shaders.envmap import directions
from tests.support.awkward_scenes import (
    GROUPS,
    SIZE,
    awkward_lights,
    awkward_materials,
    awkward_normals,
    awkward_views,
)
from tests.support.engine_scenes import ROTATION

# pixels below the layer's horizon are drawn too, and left out
SAMPLES, DRAWN = 1_000_000, 1_400_000


@pytest.mark.parametrize("perspective", [False, True], ids=["orthographic", "view per pixel"])
def test_a_million_adversarial_samples_stay_finite(rng, perspective):
    w = directions(*SIZE)[0].reshape(-1, 3) @ ROTATION.T
    v = (
        awkward_views(rng, w, DRAWN)
        if perspective
        else np.broadcast_to([0.0, 0.0, 1.0], (DRAWN, 3))
    )
    n = awkward_normals(rng, w, v).astype(np.float32)
    v = v.astype(np.float32)
    above = (n * v).sum(1) > HORIZON  # the layer renders no others
    assert above.sum() >= SAMPLES
    group = np.sort(rng.integers(GROUPS, size=DRAWN))[above]
    counts = np.bincount(group, minlength=GROUPS).tolist()
    n, v = n[above].copy(), v[above].copy()
    g = (rng.normal(size=n.shape) * 10.0 ** rng.uniform(-6, 3, (len(n), 1))).astype(np.float32)
    rotation = tuple(ROTATION.flatten().tolist())
    arguments = (
        n,
        v if perspective else None,
        awkward_materials(rng),
        awkward_lights(rng),
        rotation,
        counts,
        list(range(GROUPS)),
    )
    seen = cpu.radiance(*arguments, 1)
    assert np.isfinite(seen).all() and (seen >= 0).all() and seen.max() > 0
    for name, by in zip(("n", "view", "m", "light"), cpu.gradients(g, *arguments, 1), strict=True):
        assert by is None or np.isfinite(by).all(), name
