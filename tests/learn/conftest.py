"""Random scenes for the layer, and the paper's sum written as plainly as possible: an oracle that
shares no code path with the methods.
"""

import numpy as np
import pytest
import torch

from shaders.dsbrdf import evaluate, half_angles
from shaders.envmap import directions
from shaders.frames import ELEVATION, camera_from_light


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def draw():
    """draw(seed, images=1, size=(3, 3), light=(4, 8), dtype) → dict of n, material, light, view: a
    random scene without background.
    """

    def scene(seed, images=1, size=(3, 3), light=(4, 8), dtype=torch.float64, sharpest=20.0):
        rng = torch.Generator().manual_seed(seed)
        n = torch.randn(images, *size, 3, dtype=torch.float64, generator=rng)
        n[..., 2] = n[..., 2].abs() + 0.3
        v = 0.2 * torch.randn(images, *size, 3, dtype=torch.float64, generator=rng) + torch.tensor(
            [0.0, 0.0, 1.0]
        )
        m = torch.rand(images, 3, 3, 2, 6, dtype=torch.float64, generator=rng)
        m[..., 1, :] = 0.2 + m[..., 1, :] * torch.tensor([1.0, sharpest / 4, sharpest])[:, None]
        L = torch.rand(images, *light, 3, dtype=torch.float64, generator=rng)
        unit = torch.nn.functional.normalize
        scene = {
            "n": unit(n, dim=-1),
            "material": m.reshape(images, 108),
            "light": L,
            "view": unit(v, dim=-1),
        }
        return {key: value.to(dtype) for key, value in scene.items()}

    return scene


@pytest.fixture
def naive_sum():
    """naive_sum(n, material, light, view=None, elevation) → (H, W, 3) of one image, float64 numpy,
    a loop over pixels.
    """

    def one_pixel(n, v, m, w, E):
        h, theta_d = half_angles(w, np.broadcast_to(v, w.shape))
        f = evaluate(m, h @ n, theta_d)
        return (f * E * np.maximum(w @ n, 0)[:, None]).sum(0)

    def sum_all(n, material, light, view=None, elevation=ELEVATION):
        n, m, L = (np.asarray(x.detach(), dtype=np.float64) for x in (n, material, light))
        w, solid_angle = directions(*L.shape[:2])
        w, E = (
            w.reshape(-1, 3) @ camera_from_light(elevation).T,
            (L * solid_angle[..., None]).reshape(-1, 3),
        )
        v = (
            np.broadcast_to([0.0, 0.0, 1.0], n.shape)
            if view is None
            else np.asarray(view.detach(), dtype=np.float64)
        )
        pixels = zip(n.reshape(-1, 3), v.reshape(-1, 3), strict=True)
        return np.stack([one_pixel(a, b, m, w, E) for a, b in pixels]).reshape(n.shape)

    return sum_all
