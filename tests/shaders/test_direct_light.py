"""Direct light without noise against sums of shaders.closures over finely divided light."""

import numpy as np
import pytest

pytest.importorskip("numba")

from shaders import direct_light, direct_light_kernels, envmap, frames
from shaders.direct_light import DirectLight
from shaders.mixture import Mixture

ROTATION = frames.camera_from_light()
ROWS = 64


@pytest.fixture(scope="module")
def light():
    """A dim map with a lamp of 3 × 4 texels in front, 200 times as bright, and a coloured side."""
    rng = np.random.default_rng(3)
    L = rng.uniform(0.2, 1.0, (ROWS, 2 * ROWS, 3)).astype(np.float32)
    L[:, 10:40, 0] *= 3
    L[20:23, 38:42] = 200
    return L


def normals(count, steepest_deg=85):
    """Normals that are spread over the visible side, the first one towards the viewer."""
    k = np.arange(count)
    theta = np.radians(steepest_deg) * np.sqrt(k / max(count - 1, 1))
    phi = 2.4 * k
    return np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1
    )


def summed(mixture, light, n, parts):
    """Radiance (P, 3) at normals by a sum over texels that are divided into parts × parts."""
    height, width = light.shape[0] * parts, light.shape[1] * parts
    w, solid_angle = envmap.directions(height, width)
    w = w.reshape(-1, 3) @ ROTATION.T
    energy = light.repeat(parts, 0).repeat(parts, 1).reshape(-1, 3) * solid_angle.reshape(-1, 1)
    h = w + np.array([0, 0, 1])
    h /= np.maximum(np.linalg.norm(h, axis=1, keepdims=True), 1e-9)
    out = np.zeros((len(n), 3))
    for i, each in enumerate(n):
        cos_i = w @ each
        lit = cos_i > 1e-4
        f = mixture.evaluate(cos_i[lit], each[2], (h @ each)[lit], h[lit, 2])
        out[i] = (f * cos_i[lit, None] * energy[lit]).sum(0)
    return out


@pytest.mark.parametrize("tilt", [0.0, 0.25])
@pytest.mark.parametrize(
    "kind, alpha, parts",
    [
        ("diffuse", 1.0, 2),
        ("sheen", 0.6, 2),
        *((kind, 0.5, 2) for kind in ("ggx", "beckmann", "ashikhmin_shirley")),
        *((kind, 0.15, 4) for kind in ("ggx", "beckmann", "ashikhmin_shirley")),
        *((kind, 0.04, 8) for kind in ("ggx", "beckmann", "ashikhmin_shirley")),
    ],
)
def test_every_closure_is_integrated_at_every_width(light, kind, alpha, parts, tilt):
    mixture = Mixture.constant(kind, alpha, [0.5, 0.3, 0.7], 0.0 if kind == "diffuse" else tilt)
    n = normals(10)
    expected = summed(mixture, light, n, parts)
    # many sample directions, because single normals are compared here
    radiance = DirectLight(mixture, light, ROTATION).at(n, samples=2048)
    off = np.abs(radiance - expected) / expected.mean()
    assert off.mean() < 0.01 and off.max() < 0.06


def test_few_samples_suffice_where_many_normals_are_averaged(light):
    mixture = Mixture.constant("ggx", 0.02, [1.0, 1.0, 1.0])
    n = np.repeat(normals(6, 60), 256, axis=0)
    direct = DirectLight(mixture, light, ROTATION)
    few = direct.at(n, samples=4).reshape(6, 256, 3).mean(1)
    many = direct.at(normals(6, 60), samples=4096)
    np.testing.assert_allclose(few, many, rtol=0.03)


def test_parameters_follow_the_viewing_angle(light):
    """A weight that rises from 0 to 1 towards grazing angles."""
    mixture = Mixture(
        ("diffuse",),
        np.array([0.0, 1.0]),
        np.zeros((2, 1)),
        np.zeros((2, 1)),
        np.array([[[0.0] * 3], [[1.0] * 3]]),
    )
    n = normals(8)
    direct = DirectLight(mixture, light, ROTATION).at(n)
    matte = DirectLight(Mixture.lambert([1.0, 1.0, 1.0]), light, ROTATION).at(n)
    np.testing.assert_allclose(direct, matte * (1 - n[:, 2:]), rtol=0.02, atol=0.02)


def test_maps_are_kept_between_calls(light, monkeypatch):
    direct = DirectLight(Mixture.lambert([0.5] * 3), light, ROTATION)
    first = direct.at(normals(50))
    monkeypatch.setattr(direct, "_fill", lambda nodes: pytest.fail("computed again"))
    np.testing.assert_array_equal(direct.at(normals(50)), first)


def test_blocks_of_texels_carry_the_energy_of_all(light):
    direct = DirectLight(Mixture.lambert([0.5] * 3), light, ROTATION)
    total = direct.lights(ROWS)[2].sum(1)
    for _, rows in direct_light.BLOCKS:
        np.testing.assert_allclose(direct.lights(rows)[2].sum(1), total, rtol=1e-4)
        lengths = np.linalg.norm(direct.lights(rows)[0], axis=0)
        np.testing.assert_allclose(lengths, 1, rtol=1e-5)


def test_narrow_lobes_are_those_below_the_limit(light):
    mixture = Mixture(
        ("ggx", "beckmann", "diffuse", "sheen"),
        np.array([0.0]),
        np.log([[0.02, 0.4, 0.01, 0.05]]),
        np.zeros((1, 4)),
        np.full((1, 4, 3), 0.2),
    )
    direct = DirectLight(mixture, light, ROTATION)
    assert direct.narrow == 1 and direct.narrowest == pytest.approx(0.02)
    assert DirectLight(Mixture.lambert([0.5] * 3), light, ROTATION).narrowest == 1


def test_kernels_compile_without_a_cache_where_no_folder_can_be_written(monkeypatch):
    requested = []

    def refusing(**options):
        requested.append(options.get("cache", False))
        if options.get("cache"):
            raise RuntimeError("cannot cache function: no locator available")
        return lambda function: function

    monkeypatch.setattr(direct_light_kernels, "njit", refusing)
    assert direct_light_kernels._compiled(len) is len and requested == [True, False]
