"""Second derivatives of the exact sum through the layer: against finite differences of the first
ones, and float32 against float64.
"""

import pytest
import torch

from learn.engines import machine_code
from learn.layer import render

CAMERAS = pytest.mark.parametrize(
    "perspective", [False, True], ids=["orthographic", "view per pixel"]
)
unit = torch.nn.functional.normalize


def scene_of(draw, seed, perspective, **options):
    """render's arguments by name, float64; without a view for a distant viewer."""
    scene = draw(seed, **options)
    return scene if perspective else {name: x for name, x in scene.items() if name != "view"}


@pytest.fixture
def busy(draw):
    """busy(seed, perspective): arguments, and options with two segments, a mask, background, and a
    pixel that faces away.
    """

    def make(seed, perspective):
        scene = scene_of(
            draw, seed, perspective, images=2, size=(3, 4), light=(6, 12), sharpest=200.0
        )
        scene["material"] = torch.stack(
            [scene["material"], draw(seed + 1, images=2)["material"]], 1
        )
        scene["n"][:, 0, 0] = 0
        scene["n"][:, 2, 3] = torch.tensor([0.8, 0.0, -0.6])
        segments = torch.tensor([[0, 1, 2, 2], [1, 1, 2, 0], [2, 1, 1, 2]]).expand(2, 3, 4)
        mask = torch.ones(2, 3, 4, dtype=torch.bool)
        mask[0, 1, 1] = mask[1, 2, 0] = False
        return scene, {"segments": segments, "mask": mask & (scene["n"] != 0).any(-1)}

    return make


def random_like(x, seed):
    return torch.randn(
        x.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)
    ).to(x.dtype)


def gradients(scene, create_graph=False, **options):
    """({name: leaf}, {name: first derivative of a weighted sum of the picture})."""
    leaves = {name: x.detach().clone().requires_grad_() for name, x in scene.items()}
    seen = render(**leaves, method="exact", **options)
    result = torch.autograd.grad(
        (seen * random_like(seen, 1)).sum(), list(leaves.values()), create_graph=create_graph
    )
    return leaves, dict(zip(leaves, result, strict=True))


def second(scene, **options):
    """{(by, then): what differentiating the first derivative by one argument, summed in a random
    weighting, by another gives}.
    """
    leaves, first = gradients(scene, create_graph=True, **options)
    result = {}
    for by, slope in first.items():
        products = torch.autograd.grad(
            (slope * random_like(slope, 2)).sum(), list(leaves.values()), retain_graph=True
        )
        result |= {(by, then): x for then, x in zip(leaves, products, strict=True)}
    return result


def directions(scene):
    """A direction to step in for each argument: those of n and view keep their length, those of
    material and light their sign.
    """
    result = {name: random_like(x, 3) for name, x in scene.items()}
    for name in {"n", "view"} & result.keys():
        result[name] -= (result[name] * scene[name]).sum(-1, keepdim=True) * scene[name]
    result["material"] *= scene["material"]
    return result


def slopes_by_steps(scene, name, step, **options):
    """{by: change, along the direction of `name`, of the first derivatives as `second` weighs
    them}, by central differences.
    """
    direction, sums = directions(scene)[name], []
    for sign in (1, -1):
        _, first = gradients(scene | {name: scene[name] + sign * step * direction}, **options)
        sums.append({by: (x * random_like(x, 2)).sum() for by, x in first.items()})
    return {by: ((sums[0][by] - sums[1][by]) / (2 * step)).item() for by in sums[0]}


def require_slopes(scene, **options):
    result, towards = second(scene, **options), directions(scene)
    for then in scene:
        # a step of 1e-6: rounding of first derivatives (1e-16 of some hundred) over it, and its
        # square times a fourth derivative
        for by, expected in slopes_by_steps(scene, then, 1e-6, **options).items():
            product = (result[by, then] * towards[then]).sum().item()
            assert product == pytest.approx(expected, rel=1e-6, abs=1e-6), (by, then)


@CAMERAS
def test_every_pair_of_arguments_matches_finite_differences(draw, perspective):
    require_slopes(scene_of(draw, 1, perspective, sharpest=200.0))


@CAMERAS
def test_segments_masks_and_background_match_finite_differences(busy, perspective):
    scene, options = busy(5, perspective)
    require_slopes(scene, **options)


@CAMERAS
def test_chunks_of_texels_and_pixels_match_finite_differences(draw, perspective):
    # 2112 texels × 20 pixels: several chunks each way
    require_slopes(scene_of(draw, 7, perspective, size=(1, 20), light=(33, 64)))


@CAMERAS
def test_gradgradcheck(draw, perspective):
    scene = scene_of(draw, 9, perspective, size=(1, 2), light=(2, 4))
    leaves = [x.requires_grad_() for x in scene.values()]
    # gradcheck's own tolerances, 1e-5 absolute and 1e-3 relative, suit its float64 steps of 1e-6
    assert torch.autograd.gradgradcheck(
        lambda *x: render(**dict(zip(scene, x, strict=True)), method="exact"),
        leaves,
        fast_mode=False,
    )


def test_vectors_that_are_not_quite_unit_are_scaled_twice_differentiably(draw):
    """The layer takes lengths of 1 ± 0.01; the scaling's own second derivative, along the vector
    too.
    """
    scene = scene_of(draw, 11, True)
    scene["n"], scene["view"] = 1.007 * scene["n"], 0.995 * scene["view"]
    leaves = [scene["n"].requires_grad_(), scene["view"].requires_grad_()]
    given = {name: x for name, x in scene.items() if name not in ("n", "view")}
    assert torch.autograd.gradgradcheck(
        lambda n, view: render(n, **given, view=view, method="exact"), leaves
    )


def test_a_texel_along_the_view_has_finite_second_derivatives(draw):
    """w = v: θ_d has a corner there, and a second derivative without bound; what is left of it is
    finite.
    """
    from shaders.envmap import directions as texels

    w = torch.as_tensor(texels(4, 8)[0].reshape(1, 4, 8, 3))
    n = unit(w + 0.3 * w.roll(1, 2), dim=-1)
    for dtype in (torch.float32, torch.float64):
        scene = {
            "n": n,
            "material": draw(13)["material"],
            "light": torch.rand(1, 4, 8, 3, dtype=torch.float64),
            "view": w,
        }
        result = second({name: x.to(dtype) for name, x in scene.items()}, elevation=0.0)
        assert all(x.isfinite().all() for x in result.values())


def relative(a, b):
    return ((a.double() - b.double()).abs().max() / b.double().abs().max().clamp(min=1e-30)).item()


@CAMERAS
@pytest.mark.parametrize("kernels", [True, False], ids=["kernels", "plain torch"])
def test_float32_matches_float64(busy, perspective, kernels, monkeypatch):
    """1e-5: what the engines promise of first derivatives. Their n, scaled to unit length in
    float32, is 6e-8 off; 200 of it show.
    """
    if not kernels:
        monkeypatch.setattr(machine_code, "is_available", lambda: False)
    elif not machine_code.is_available():
        pytest.skip("numba is not installed: no kernels to test")
    scene, options = busy(15, perspective)
    scene = {name: x.float() for name, x in scene.items()}
    result, right = (
        second(scene, **options),
        second({name: x.double() for name, x in scene.items()}, **options),
    )
    assert {pair: x.dtype for pair, x in result.items()} == dict.fromkeys(result, torch.float32)
    wrong = {
        pair: relative(x, right[pair])
        for pair, x in result.items()
        if relative(x, right[pair]) > 1e-5
    }
    assert not wrong


@CAMERAS
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=["float32", "float64"])
def test_the_matrix_of_second_derivatives_is_symmetric(busy, perspective, dtype):
    """uᵀ H_ab v = vᵀ H_ba u, though the two halves come by different lines."""
    scene, options = busy(17, perspective)
    scene = {name: x.to(dtype) for name, x in scene.items()}
    leaves, first = gradients(scene, create_graph=True, **options)
    u, v = ({name: random_like(x, seed) for name, x in scene.items()} for seed in (4, 5))

    def product(a, b, left, right):
        (result,) = torch.autograd.grad((first[a] * left[a]).sum(), leaves[b], retain_graph=True)
        return (result * right[b]).sum().item()

    # of sums whose terms are 10 to 1,000 times as large as they are
    rounding = 1e-4 if dtype == torch.float32 else 1e-10
    for a in scene:
        for b in scene:
            assert product(a, b, u, v) == pytest.approx(
                product(b, a, v, u), rel=rounding, abs=rounding
            ), (a, b)


def test_the_derivative_along_a_direction_by_two_reverse_passes(draw):
    """torch.autograd.functional.jvp differentiates the backward pass by what it was given, where
    nothing else asks for a graph.
    """
    scene = scene_of(draw, 19, False)
    towards = directions(scene)
    for dtype, tolerance in ((torch.float64, 1e-8), (torch.float32, 1e-5)):
        given = {name: x.to(dtype) for name, x in scene.items()}

        def radiance(material, given=given):
            return render(**given | {"material": material}, method="exact")

        _, result = torch.autograd.functional.jvp(
            radiance, given["material"], towards["material"].to(dtype)
        )
        step = 1e-6 * towards["material"]
        after, before = (
            render(**scene | {"material": scene["material"] + s * step}, method="exact")
            for s in (1, -1)
        )
        expected = (after - before) / 2e-6
        assert relative(result, expected) <= tolerance


def test_a_hessian_by_torch_is_symmetric_and_not_empty(draw):
    scene = scene_of(draw, 21, False, size=(2, 2))
    result = torch.autograd.functional.hessian(
        lambda m: render(scene["n"], m, scene["light"], method="exact").sum(), scene["material"]
    )
    result = result.reshape(108, 108)
    assert result.abs().max() > 1e-3
    torch.testing.assert_close(result, result.T, rtol=1e-9, atol=1e-12)


@CAMERAS
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=["float32", "float64"])
def test_training_with_a_gradient_penalty_lowers_it(draw, perspective, dtype):
    """The penalty's own derivative is right: by a small step against it, it falls as predicted."""
    scene = {
        name: x.to(dtype)
        for name, x in scene_of(draw, 23, perspective, size=(4, 4), light=(8, 16)).items()
    }

    def penalty(log_material):
        n = scene["n"].clone().requires_grad_()
        seen = render(**scene | {"n": n, "material": log_material.exp()}, method="exact")
        (slope,) = torch.autograd.grad(seen.sum(), n, create_graph=True)
        return slope.square().mean()

    label = scene["material"].log().requires_grad_()
    before = penalty(label)
    before.backward()
    step = 1e-3 / label.grad.norm()
    after = penalty((label - step * label.grad).detach())
    predicted = step * label.grad.square().sum()
    assert label.grad.isfinite().all() and predicted > 0
    # a step of 1e-3: 1e-3 of curvature
    torch.testing.assert_close(before.detach() - after.detach(), predicted, rtol=2e-2, atol=0)


def test_a_loss_of_picture_and_slope_together(draw):
    """The first pass's g depends on the inputs too, as in any loss but a sum."""
    scene = scene_of(draw, 25, True)
    n, m = scene["n"].requires_grad_(), scene["material"].requires_grad_()

    def slope(n, m):
        seen = render(**scene | {"n": n, "material": m}, method="exact")
        return torch.autograd.grad(seen.square().sum(), m, create_graph=True)[0]

    assert torch.autograd.gradcheck(slope, (n, m), fast_mode=True)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precisions_are_differentiated_twice_in_float32(draw, dtype):
    scene = {name: x.to(dtype) for name, x in scene_of(draw, 27, False).items()}
    leaves, first = gradients(scene, create_graph=True)
    (result,) = torch.autograd.grad(first["n"].float().square().sum(), leaves["material"])
    assert result.dtype == dtype and result.isfinite().all() and result.abs().max() > 0


def test_an_empty_mask_has_second_derivatives_of_zero(draw):
    scene = scene_of(draw, 29, True)
    leaves, first = gradients(scene, create_graph=True, mask=torch.zeros(1, 3, 3, dtype=torch.bool))
    result = torch.autograd.grad(
        sum(x.square().sum() for x in first.values()), list(leaves.values()), allow_unused=True
    )
    assert all(x is None or not x.any() for x in result)


@CAMERAS
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=["float32", "float64"])
def test_a_third_derivative_is_refused(draw, perspective, dtype):
    scene = {name: x.to(dtype) for name, x in scene_of(draw, 31, perspective).items()}
    leaves, first = gradients(scene, create_graph=True)
    (twice,) = torch.autograd.grad(first["n"].square().sum(), leaves["n"], create_graph=True)
    with pytest.raises(
        NotImplementedError, match="expected at most a derivative of a derivative, found a third"
    ):
        torch.autograd.grad(twice.sum(), leaves["material"])


@CAMERAS
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=["float32", "float64"])
def test_a_kept_graph_leaves_picture_and_first_derivatives_as_they_are(busy, perspective, dtype):
    scene, options = busy(33, perspective)
    scene = {name: x.to(dtype) for name, x in scene.items()}
    _, plain = gradients(scene, **options)
    _, kept = gradients(scene, create_graph=True, **options)
    for name, x in plain.items():
        # by n and view the scaling to unit length is torch's instead of the kernel's
        torch.testing.assert_close(
            kept[name].detach(),
            x,
            rtol=1e-5 if dtype == torch.float32 else 1e-13,
            atol=1e-6 * x.abs().max().item(),
        )
        assert name in ("n", "view") or torch.equal(kept[name], x)


# of torch's own parts for forward mode
@pytest.mark.filterwarnings("ignore:`torch.jit.script`:DeprecationWarning")
@pytest.mark.parametrize("name", ["n", "material", "light"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=["float32", "float64"])
def test_forward_mode_is_refused(draw, name, dtype):
    """In float32 the tangents of material and light were dropped without a word."""
    scene = {key: x.to(dtype) for key, x in scene_of(draw, 35, False).items()}
    with (
        torch.autograd.forward_ad.dual_level(),
        pytest.raises(NotImplementedError, match=r"expected reverse mode .*, found forward mode"),
    ):
        render(
            **scene
            | {
                name: torch.autograd.forward_ad.make_dual(scene[name], torch.ones_like(scene[name]))
            },
            method="exact",
        )


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=["float32", "float64"])
def test_a_batch_of_gradients_is_refused_in_the_layers_words(draw, dtype):
    scene = {key: x.to(dtype) for key, x in scene_of(draw, 37, False).items()}

    def mean(material):
        return render(**scene | {"material": material}, method="exact").mean()

    for derivative in (torch.autograd.functional.jacobian, torch.autograd.functional.hessian):
        with pytest.raises(
            NotImplementedError, match="expected one gradient at a time, found a batch"
        ):
            derivative(mean, scene["material"], vectorize=True)
