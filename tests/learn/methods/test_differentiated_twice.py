"""Every method's second derivatives: right by finite differences of its own first ones, or refused
by name; never None or 0 in their place.

What is right is said below, case by case: where a method refuses although it need not, that shows
too.
"""

import pytest
import torch

from learn import methods
from learn.engines import machine_code
from learn.layer import render
from learn.methods import directional, light_tables, planned, reflectance_map, split_sum
from learn.methods.exact import texels
from tests.support.card_scenes import names_for_a_view_per_pixel

SAMPLED = {"monte_carlo", "monte_carlo_brdf"}
CUT = {
    "median_cut",
    "hybrid",
    "spherical_gaussians",
    "monte_carlo_light",
}  # right while the light is a constant
PLAIN = {
    "exact",
    "spherical_harmonics",
    "quadrature",
}  # the same code in float32 and float64, as far as the layer's caller sees
MATERIALS = {
    "broad": (0.5, 4.0, 12.0),
    "sharp": (0.5, 20.0, 4000.0),
}  # largest γ of each lobe; quadrature's taps begin at 300


@pytest.fixture(autouse=True)
def a_coarse_split_sum(monkeypatch):
    """Its map of 32 × 64 directions takes most of this file's time, and is no finer than this test
    needs it.
    """
    monkeypatch.setattr(split_sum, "ROWS", 8)


@pytest.fixture(autouse=True)
def no_sum_is_small(monkeypatch):
    """Small sums are made whole, by the exact sum, and the scenes here are small: what approximates
    is what this file is about.
    """
    monkeypatch.setattr(directional, "WHOLE", 0)
    monkeypatch.setattr(directional, "FEW_TEXELS", 0)


def scene_of(dtype, perspective, gammas, size=5):
    """render's arguments by name, of 25 pixels: auto plans something from 24 on."""
    rng = torch.Generator().manual_seed(7)

    def draw(*shape):
        return torch.randn(*shape, dtype=torch.float64, generator=rng)

    n, v = draw(1, size, size, 3), 0.2 * draw(1, size, size, 3)
    n[..., 2], v[..., 2] = n[..., 2].abs() + 0.3, v[..., 2] + 1.0
    m = 0.2 + torch.rand(1, 3, 3, 2, 6, dtype=torch.float64, generator=rng)
    m[:, :, :, 1] *= torch.tensor(gammas, dtype=torch.float64)[:, None] / 1.2
    light = torch.rand(1, 4, 8, 3, dtype=torch.float64, generator=rng)
    unit = torch.nn.functional.normalize
    scene = {"n": unit(n, dim=-1), "material": m.reshape(1, 108), "light": light} | (
        {"view": unit(v, dim=-1)} if perspective else {}
    )
    return {name: x.to(dtype) for name, x in scene.items()}


def random_like(x, seed):
    return torch.randn(
        x.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)
    ).to(x.dtype)


def first(scene, method, constant, create_graph=False):
    leaves = {
        name: x.detach().clone().requires_grad_(name not in constant) for name, x in scene.items()
    }
    seen = render(**leaves, method=method)
    expected = {name: x for name, x in leaves.items() if x.requires_grad}
    result = torch.autograd.grad(
        (seen * random_like(seen, 1)).sum(), list(expected.values()), create_graph=create_graph
    )
    return expected, dict(zip(expected, result, strict=True))


def products(scene, method, constant):
    """{(by, then): the derivative along `then`'s direction of the first derivative by `by`,
    weighted}; None taken for 0.
    """
    leaves, slopes = first(scene, method, constant, create_graph=True)
    result = {}
    for by, slope in slopes.items():
        weighted = (slope * random_like(slope, 2)).sum()
        seconds = torch.autograd.grad(
            weighted, list(leaves.values()), retain_graph=True, allow_unused=True
        )
        for (then, leaf), x in zip(leaves.items(), seconds, strict=True):
            result[by, then] = 0.0 if x is None else (x * towards(then, leaf.detach())).sum().item()
    return result


def towards(name, x):
    direction = random_like(x, 3)
    return (
        direction - (direction * x).sum(-1, keepdim=True) * x
        if name in ("n", "view")
        else direction * x
    )


def differences(scene, method, constant, step=1e-7):
    """The same by central differences; the step is small against what separates a map's cells and a
    pixel from a texel's horizon.
    """
    result = {}
    for then in scene.keys() - constant:
        sums = []
        for sign in (1, -1):
            _, slopes = first(
                scene | {then: scene[then] + sign * step * towards(then, scene[then])},
                method,
                constant,
            )
            sums.append(
                {by: (slope * random_like(slope, 2)).sum().item() for by, slope in slopes.items()}
            )
        result |= {(by, then): (sums[0][by] - sums[1][by]) / (2 * step) for by in sums[0]}
    return result


def require_refusal(scene, method, constant):
    """Each pair alone is refused by the method's name and with the remedy, where the graph is used
    and not where it is kept.
    """
    leaves, slopes = first(scene, method, constant, create_graph=True)
    named = rf'^method: expected "exact" .* found "{method}", .*render with method="exact"\)$'
    for slope in slopes.values():
        assert slope.isfinite().all() and slope.any()
        for leaf in leaves.values():
            with pytest.raises(NotImplementedError, match=named):
                torch.autograd.grad(slope.sum(), leaf, retain_graph=True)
            with pytest.raises(NotImplementedError, match=f'"{method}"'):
                torch.autograd.grad(slope.square().sum(), leaf, retain_graph=True)


def cases():
    for name in methods.NAMES:
        for perspective in (False, True):
            if perspective and name not in names_for_a_view_per_pixel():
                continue
            yield name, perspective, "broad", frozenset()
            if name == "quadrature":
                yield name, perspective, "sharp", frozenset()
            if name in CUT | {"auto"}:
                yield name, perspective, "broad", frozenset({"light"})


def has_second(name, dtype, perspective, lobes, constant):
    """What the methods promise (docs/layer-in-a-model.md)."""
    if name in SAMPLED or (name == "quadrature" and lobes == "sharp"):
        return False
    if name in CUT and not constant:
        return False
    return dtype == torch.float64 or name in PLAIN | {"spherical_gaussians", "monte_carlo_light"}


def label(value):
    if isinstance(value, frozenset):
        return "constant light" if value else "all arguments"
    return {True: "view per pixel", False: "orthographic"}.get(value)


@pytest.mark.parametrize(("name", "perspective", "lobes", "constant"), list(cases()), ids=label)
def test_in_float64_they_are_right_or_refused(name, perspective, lobes, constant):
    scene = scene_of(torch.float64, perspective, MATERIALS[lobes])
    if not has_second(name, torch.float64, perspective, lobes, constant):
        return require_refusal(scene, name, constant)
    result, expected = products(scene, name, constant), differences(scene, name, constant)
    scale = max(abs(x) for x in expected.values())
    for pair, x in expected.items():
        # rounding of first derivatives, 1e-16 of the largest over a step of 1e-7, is 1e-8 of what
        # they change by in a unit step
        assert result[pair] == pytest.approx(x, rel=1e-5, abs=1e-7 * scale), pair


@pytest.mark.parametrize(("name", "perspective", "lobes", "constant"), list(cases()), ids=label)
def test_in_float32_they_are_those_of_float64_or_refused(name, perspective, lobes, constant):
    if not machine_code.is_available():
        pytest.skip("numba is not installed: no kernels to test")
    scene = scene_of(torch.float32, perspective, MATERIALS[lobes])
    if not has_second(name, torch.float32, perspective, lobes, constant):
        return require_refusal(scene, name, constant)
    result = products(scene, name, constant)
    expected = products({key: x.double() for key, x in scene.items()}, name, constant)
    scale = max(abs(x) for x in expected.values())
    for pair, x in expected.items():
        # sums of some thousand terms of two signs, γ up to 4000
        assert result[pair] == pytest.approx(x, rel=1e-3, abs=1e-4 * scale), pair


def test_pictures_of_which_one_is_approximated_refuse():
    """auto takes each picture its own way: what sums them up is refused as a whole."""
    scene = {
        name: torch.cat([x, x])
        for name, x in scene_of(torch.float32, False, MATERIALS["broad"]).items()
    }
    leaves = {name: x.requires_grad_() for name, x in scene.items()}
    (slope,) = torch.autograd.grad(render(**leaves).sum(), leaves["light"], create_graph=True)
    with pytest.raises(NotImplementedError, match='found "auto"'):
        torch.autograd.grad(slope.square().sum(), leaves["n"])


def test_what_goes_before_and_after_the_layer_may_be_differentiated_twice():
    """A refusal stands between the layer's first derivatives and its arguments, not in the way of a
    loss that does not cross it.
    """
    scene = scene_of(torch.float32, False, MATERIALS["broad"])
    gain = torch.tensor(1.5, requires_grad=True)
    light = scene.pop("light")
    seen = gain * render(**scene, light=light, method="culled")
    (slope,) = torch.autograd.grad(seen.square().sum(), gain, create_graph=True)
    (twice,) = torch.autograd.grad(slope, gain)
    torch.testing.assert_close(twice, 2 * (seen / gain).square().sum().detach(), rtol=1e-5, atol=0)


@pytest.mark.parametrize("perspective", [False, True], ids=["orthographic", "view per pixel"])
def test_the_kernels_steps_refuse_by_themselves(perspective):
    """Whoever uses them without a method's name in front: a sum near its lights, a look-up, a
    plan.
    """
    if not machine_code.is_available():
        pytest.skip("numba is not installed: no kernels to test")
    scene = scene_of(torch.float32, perspective, MATERIALS["broad"])
    n, m, light = (
        scene["n"].reshape(-1, 3).requires_grad_(),
        scene["material"].reshape(3, 3, 2, 6),
        scene["light"][0],
    )
    view = scene["view"].reshape(-1, 3) if perspective else None
    lights, E = light_tables.lights_and_energy(light, torch.eye(3, dtype=torch.float64))
    seen = [directional.radiance(n, view, m, E, lights)]
    if not perspective:
        seen.append(reflectance_map.radiance_by_nodes(n, 16, lambda nodes: nodes))
        scene = planned.Scene(
            n.detach().numpy(),
            m.double().numpy(),
            light.numpy(),
            tuple(torch.eye(3).flatten().tolist()),
        )
        strategies = [planned.Strategy((0, 1, 2), 0, 0, 0.0)]
        seen.append(planned.radiance(n, m, light, lambda *_: planned.Sums(scene, strategies, {})))
    for radiance in seen:
        (slope,) = torch.autograd.grad(radiance.sum(), n, create_graph=True)
        assert slope.isfinite().all()
        with pytest.raises(
            NotImplementedError, match='expected "exact" where derivatives are differentiated again'
        ):
            torch.autograd.grad(slope.sum(), n)


def test_the_reference_on_other_lights_than_a_map_is_twice_differentiable():
    """learn.methods.exact.ExactSum, which median_cut and reflectance_map call in float64 for lights
    of their own.
    """
    from learn.methods.exact import ExactSum

    scene = scene_of(torch.float64, False, MATERIALS["broad"], size=1)
    w, E = texels(scene["light"][0, :2, :2], torch.eye(3, dtype=torch.float64))
    m, E = scene["material"].reshape(3, 3, 2, 6).requires_grad_(), E.requires_grad_()
    n = scene["n"].reshape(-1, 3)
    assert torch.autograd.gradgradcheck(lambda m, E: ExactSum.apply(n, None, m, E, w), (m, E))
