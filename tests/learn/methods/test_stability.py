"""Every method where sums of lobes break: values and derivatives stay finite, and black stays
black.
"""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from learn import methods
from learn.layer import render
from shaders.envmap import directions
from tests.support.card_scenes import UNIT, material, names_for_a_view_per_pixel, sphere

METHODS = pytest.mark.parametrize("name", methods.NAMES)
SIZE = (8, 16)


def facing(*normals):
    return UNIT(torch.tensor(normals, dtype=torch.float64), dim=-1).reshape(1, 1, -1, 3)


def flat_light(level=1.0):
    return torch.full((1, *SIZE, 3), level, dtype=torch.float64)


def one_texel(row, column, level=1.0):
    L = flat_light(0.0)
    L[0, row, column] = level
    return L


def at_peaks():
    """Normals at the half vectors of texels in front, and 1e-4 beside them: h·n → 1."""
    w = torch.as_tensor(directions(*SIZE)[0].reshape(-1, 3))
    h = UNIT(w[w[:, 2] > 0.1] + torch.tensor([0.0, 0.0, 1.0]), dim=-1)
    return torch.cat([h, UNIT(h + 1e-4, dim=-1)])[::9].reshape(1, 1, -1, 3)


def beside_horizons():
    """Normals at right angles to a texel: n·w → 0."""
    w = torch.as_tensor(directions(*SIZE)[0].reshape(-1, 3))[::11]
    n = torch.linalg.cross(w, torch.tensor([[0.3, -0.7, 0.2]], dtype=torch.float64).expand_as(w))
    n = UNIT(n * torch.where(n[:, 2:] < 0, -1.0, 1.0), dim=-1)
    return n[n[:, 2] > 1e-3].reshape(1, 1, -1, 3)


SOME = facing((0, 0, 1), (0.5, 0.3, 0.8), (-0.9, 0.1, 0.2))
MIXED = ((0.1, 0.3, 1.0), (0.3, 10.0, 300.0))
CASES = {
    "background": (
        torch.cat([SOME, torch.zeros(1, 1, 2, 3, dtype=torch.float64)], 2),
        MIXED,
        flat_light(),
    ),
    "empty mask": (torch.zeros(1, 2, 2, 3, dtype=torch.float64), MIXED, flat_light()),
    "one pixel": (facing((0.1, 0.2, 1.0)), MIXED, flat_light()),
    "grazing view": (
        facing((1, 0, 2e-4), (0, 1, 1e-3), (-1, 1, 1e-2)),
        ((0.1, 0.1, 0.1), (1e-3, 0.3, 1.0)),
        flat_light(),
    ),
    "facing away": (facing((1, 0, 0), (0.5, 0, -0.8), (0, 0, 1)), MIXED, flat_light()),
    "grazing light": (beside_horizons(), ((0.1, 0.1, 0.1), (1e-3, 1.0, 100.0)), flat_light()),
    "peaks": (at_peaks(), ((0.1, 0.5, 1.0), (1.0, 1e3, 1e5)), flat_light()),
    "slow lobe": (SOME, ((0.2, 0.2, 0.2), (1e-3, 1e-3, 1e-3)), flat_light()),
    "no lobe": (SOME, ((0.0, 0.0, 0.0), (1.0, 10.0, 100.0)), flat_light()),
    "high lobes": (SOME, ((30.0, 20.0, 10.0), (3.0, 50.0, 1e3)), flat_light()),
    "dark": (SOME, MIXED, flat_light(0.0)),
    "bright": (SOME, MIXED, flat_light(1e6)),
    "one lit texel": (SOME, MIXED, one_texel(3, 4)),
    "sun in one texel": (SOME, MIXED, one_texel(2, 5, 1e5) + 0.1),
    "zenith": (SOME, MIXED, one_texel(0, 0, 1e3)),
    "nadir": (SOME, MIXED, one_texel(SIZE[0] - 1, 3, 1e3)),
    "seam": (
        facing((1, 0.01, 0.3), (1, -0.01, 0.3)),
        MIXED,
        one_texel(4, 0) + one_texel(4, SIZE[1] - 1),
    ),
    "a map of one texel": (SOME, MIXED, torch.ones(1, 1, 1, 3, dtype=torch.float64)),
}


def finite(name, scene, **options):
    """The picture and derivatives of a scene, each checked to be finite."""
    leaves = {
        key: value.detach().clone().requires_grad_()
        for key, value in scene.items()
        if value is not None
    }
    seen = render(**leaves, method=name, **options)
    assert seen.isfinite().all(), "value"
    seen.sum().backward()
    for key, leaf in leaves.items():
        assert leaf.grad is not None and leaf.grad.isfinite().all(), key
    return seen.detach(), leaves


def scene_of(case, dtype):
    n, lobes, L = CASES[case]
    return {"n": n.to(dtype), "material": material(*lobes).to(dtype), "light": L.to(dtype)}


@METHODS
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=["float32", "float64"])
def test_awkward_scenes_stay_finite(name, dtype):
    for case in CASES:
        given = scene_of(case, dtype)
        seen, leaves = finite(name, given)
        outside = (given["n"] == 0).all(-1) | (given["n"][..., 2] <= methods.HORIZON)
        assert (seen[outside] == 0).all() and (leaves["n"].grad[outside] == 0).all(), case
        if case in ("no lobe", "dark"):
            assert (seen.abs() <= 1e-5).all(), case  # spherical Gaussians hold κ above 1e-6


@pytest.mark.parametrize("name", names_for_a_view_per_pixel())
def test_a_texel_along_or_opposite_to_the_view_is_harmless(name):
    w = torch.as_tensor(directions(*SIZE)[0].reshape(1, 1, -1, 3))[:, :, ::13]
    for sign in (1.0, -1.0):
        view = sign * w
        n = UNIT(view + 0.3 * view.roll(1, -1), dim=-1)
        for dtype in (torch.float32, torch.float64):
            given = {"n": n, "material": material(*MIXED), "light": flat_light(), "view": view}
            finite(name, {key: value.to(dtype) for key, value in given.items()}, elevation=0.0)


@METHODS
def test_half_precision_and_strided_inputs(name):
    given = {"n": sphere(6), "material": material(*MIXED), "light": flat_light().float()}
    plain, _ = finite(name, given)
    strided = {
        key: value.transpose(0, -1).contiguous().transpose(0, -1) for key, value in given.items()
    }
    # sums may run in another order
    torch.testing.assert_close(finite(name, strided)[0], plain, rtol=1e-6, atol=1e-7)
    half, _ = finite(name, {key: value.to(torch.bfloat16) for key, value in given.items()})
    assert half.dtype == torch.bfloat16


@METHODS
def test_radiance_is_proportional_to_light(name):
    given = {
        "n": sphere(8),
        "material": material(*MIXED),
        "light": flat_light().float() + one_texel(2, 5, 20.0).float(),
    }
    once = render(**given, method=name)
    eightfold = render(**given | {"light": 8 * given["light"]}, method=name)
    # 8 is exact in float32; sums of two signs are not
    torch.testing.assert_close(eightfold, 8 * once, rtol=1e-4, atol=1e-5)


@METHODS
def test_a_batch_is_its_pictures_one_by_one(name):
    n = torch.cat([sphere(8), sphere(8).flip(2)])
    m = torch.cat([material(*MIXED), material((0.2, 0.2, 0.1), (0.5, 4.0, 30.0))])
    L = torch.cat([flat_light().float(), one_texel(3, 9, 30.0).float() + 0.2])
    together = render(n, m, L, method=name)
    for i in range(2):
        alone = render(n[i : i + 1], m[i : i + 1], L[i : i + 1], method=name)
        # random samples are numbered within a picture, so even they agree
        torch.testing.assert_close(together[i : i + 1], alone, rtol=1e-5, atol=1e-6)


@settings(max_examples=40, deadline=None)
@given(
    name=st.sampled_from(methods.NAMES),
    seed=st.integers(0, 2**31 - 1),
    kappa=st.floats(-8, 1.47).map(lambda e: 10.0**e),
    gamma=st.floats(-3, 5).map(lambda e: 10.0**e),
    level=st.sampled_from([0.0, 1e-6, 1.0, 1e6]),
    tolerance=st.sampled_from([5e-2, 1e-2, 1e-4]),
    dtype=st.sampled_from([torch.float32, torch.float64]),
)
def test_any_material_under_any_light_is_finite(name, seed, kappa, gamma, level, tolerance, dtype):
    rng = torch.Generator().manual_seed(seed)
    n = torch.randn(1, 1, 30, 3, generator=rng, dtype=torch.float64)
    n[..., 2] = (
        n[..., 2].abs() * 10 ** (-4 * torch.rand(1, 1, 30, generator=rng, dtype=torch.float64))
        + 2e-4
    )
    spread = 10 ** torch.randn(3, 3, 2, 6, generator=rng, dtype=torch.float64).clamp(-1, 1)
    m = spread * torch.tensor([kappa, gamma], dtype=torch.float64)[:, None]
    m[:, :, 0].clamp_(max=30.0)
    L = torch.rand(1, *SIZE, 3, generator=rng, dtype=torch.float64) ** 8
    given = {"n": UNIT(n, dim=-1), "material": m.reshape(1, 108), "light": level * L}
    finite(name, {key: value.to(dtype) for key, value in given.items()}, tolerance=tolerance)


def test_gamma_beyond_every_map_is_finite():
    finite(
        "reflectance_map",
        {
            "n": sphere(8),
            "material": material((1.0, 1.0, 1.0), (1e5, 1e5, 1e5)),
            "light": flat_light().float(),
        },
    )
