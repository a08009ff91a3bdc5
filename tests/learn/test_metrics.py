"""Each metric against a kept library or a case that can be done by hand."""

import numpy as np
import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from learn.metrics import intrinsics
from learn.metrics import lpips as perceptual
from learn.metrics import pictures as metrics
from learn.networks.coding import Ranges
from manifests.errors import InputError
from shaders import envmap, tone
from shaders.dsbrdf import SHAPE, evaluate
from shaders.frames import ELEVATION


@pytest.fixture
def pictures(rng):
    """Radiance, true radiance (40, 40, 3) and a mask of a disk, all smooth enough for windows to
    mean something.
    """
    y, x = np.mgrid[:40, :40] / 40
    truth = 0.3 + 0.2 * np.stack([np.sin(9 * x), np.cos(7 * y), np.sin(5 * x * y)], -1)
    return (
        np.clip(truth * 1.2 + 0.02 * rng.standard_normal(truth.shape), 0, None),
        truth,
        np.hypot(x - 0.5, y - 0.5) < 0.4,
    )


def shown(picture, truth, mask):
    return (tone.display(p, tone.auto_exposure(truth, mask)) for p in (picture, truth))


def test_l2_of_flat_pictures_is_the_square_of_the_curves_difference():
    """Truth 1 under its own exposure is display 255; half of it 255 × srgb(½)."""
    truth, mask = np.ones((8, 8, 3)), np.ones((8, 8), bool)
    by_hand = (255 * (1 - (1.055 * 0.5 ** (1 / 2.4) - 0.055))) ** 2
    result = metrics.compare(0.5 * truth, truth, mask)
    assert result["l2"] == pytest.approx(by_hand, rel=1e-9) and result["l2_frame"] == result["l2"]


def test_nothing_differs_from_itself(pictures):
    _, truth, mask = pictures
    result = metrics.compare(truth, truth, mask)
    assert result["l2"] == result["flip"] == 0.0 and result["ssim"] == pytest.approx(1.0, abs=1e-12)
    assert result["psnr"] == pytest.approx(68.1, abs=0.1)


def test_the_frame_counts_what_the_mask_leaves_out(pictures):
    picture, truth, mask = pictures
    picture, truth = (p * mask[..., None] for p in (picture, truth))
    result = metrics.compare(picture, truth, mask)
    assert result["l2_frame"] == pytest.approx(result["l2"] * mask.mean(), rel=1e-9)


def test_ssim_and_psnr_are_scikit_images(pictures):
    picture, truth, inside = pictures
    mask = np.ones(truth.shape[:2], bool)
    a, b = shown(picture, truth, mask)
    result = metrics.compare(picture, truth, mask)
    _, values = structural_similarity(a, b, data_range=255.0, channel_axis=-1, full=True)
    assert result["ssim"] == result["ssim_frame"] == pytest.approx(values.mean(), rel=1e-12)
    _, values = structural_similarity(
        *shown(picture, truth, inside), data_range=255.0, channel_axis=-1, full=True
    )
    assert metrics.compare(picture, truth, inside)["ssim"] == pytest.approx(
        values.mean(-1)[inside].mean(), rel=1e-12
    )
    assert result["psnr"] == pytest.approx(peak_signal_noise_ratio(b, a, data_range=255), rel=1e-12)


def test_flip_is_the_packages_of_display_values(pictures):
    """Its own loader reads pictures as values in [0, 1] under the sRGB curve: what it is given
    here.
    """
    from flip_evaluator import evaluate

    picture, truth, mask = pictures
    a, b = (np.float32(p / 255) for p in shown(picture, truth, mask))
    errors, mean, _ = evaluate(b, a, "LDR", inputsRGB=True, applyMagma=False)
    assert metrics.compare(picture, truth, mask)["flip"] == pytest.approx(
        errors[mask].mean(), rel=1e-6
    )
    assert metrics.flip(*shown(picture, truth, mask)).mean() == pytest.approx(mean, rel=1e-5)


def test_a_picture_below_the_window_has_no_ssim():
    assert (
        metrics.compare(np.ones((5, 5, 3)), np.ones((5, 5, 3)), np.ones((5, 5), bool))["ssim"]
        is None
    )


def test_angles_of_turned_normals_are_the_turn():
    angles = np.radians(np.repeat([10.0, 20.0, 50.0, 60.0], 4)).reshape(4, 4)
    true = torch.zeros(3, 4, 4)
    true[2] = 1
    n = torch.from_numpy(np.stack([np.sin(angles), 0 * angles, np.cos(angles)])).float()
    result = intrinsics.normals(n, true, torch.ones(4, 4, dtype=torch.bool))
    assert result["mean_deg"] == pytest.approx(35, abs=1e-3) and result[
        "median_deg"
    ] == pytest.approx(35, abs=1e-3)
    assert [result[f"below_{limit:g}"] for limit in intrinsics.LIMITS_DEG] == [0.25, 0.5, 0.5]
    # outside does not count
    assert intrinsics.normals(n, true, torch.tensor(angles < 0.2))["mean_deg"] == pytest.approx(
        10, abs=1e-3
    )


def test_shares_count_angles_below_their_limits_and_no_others():
    angles = np.radians([[11.2, 11.3, 22.4, 22.6, 29.9, 30.1]])
    n = torch.from_numpy(np.stack([np.sin(angles), 0 * angles, np.cos(angles)]))
    true = torch.zeros(3, 1, 6, dtype=torch.float64)
    true[2] = 1
    result = intrinsics.normals(n, true, torch.ones(1, 6, dtype=torch.bool))
    assert [result[f"below_{limit:g}"] for limit in intrinsics.LIMITS_DEG] == pytest.approx(
        [1 / 6, 3 / 6, 5 / 6]
    )


def lambert(albedo):
    m = np.full(SHAPE, 1e-9)
    m[:, 0, 0] = np.log1p(albedo / np.pi)
    return np.log(m).reshape(-1)


def test_the_brdf_error_of_matte_surfaces_is_the_logarithm_of_their_ratio():
    by_hand = abs(np.log((0.6 / np.pi + intrinsics.FLOOR) / (0.2 / np.pi + intrinsics.FLOOR)))
    assert intrinsics.brdf_log_error(lambert(0.6), lambert(0.2)) == pytest.approx(by_hand, rel=1e-5)
    assert intrinsics.brdf_log_error(lambert(0.2), lambert(0.2)) == 0


def test_the_brdf_error_weighs_by_the_lights_cosine(rng):
    """Of two labels that differ under grazing light alone; the same mean by random half and
    difference angles.
    """
    label, true = lambert(0.4).reshape(SHAPE).copy(), lambert(0.4)
    label[:, 0, 0, -1] += np.log(3)  # κ where θ_d is 90°
    u, v, t = rng.random((3, 200_000))
    theta_h, theta_d, phi = np.pi / 2 * u**2, np.pi / 2 * v, np.pi * t
    along, across = (
        np.cos(theta_h) * np.cos(theta_d),
        np.sin(theta_h) * np.sin(theta_d) * np.cos(phi),
    )
    weight = np.where((along > abs(across)), along - across, 0)
    f, right = (
        evaluate(np.exp(x).reshape(SHAPE), np.cos(theta_h), theta_d)[:, 0] + intrinsics.FLOOR
        for x in (label, true)
    )
    error = np.log(f / right) ** 2
    by_chance = np.sqrt((error * weight).sum() / weight.sum())
    # 200,000 draws, steps of 1°
    assert intrinsics.brdf_log_error(label.reshape(-1), true) == pytest.approx(by_chance, rel=0.03)
    assert np.sqrt(error.mean()) > 1.5 * by_chance


def test_material_errors_are_means_over_regions():
    a, b = (
        torch.from_numpy(np.stack([lambert(x) for x in pair])) for pair in ((0.6, 0.3), (0.2, 0.3))
    )
    ranges = Ranges(torch.zeros(108, dtype=torch.float64), torch.ones(108, dtype=torch.float64))
    result = intrinsics.material(a, b, ranges)
    assert result["brdf_log"] == pytest.approx(
        0.5 * intrinsics.brdf_log_error(lambert(0.6), lambert(0.2)), rel=1e-9
    )
    # a code is 0.95 at the end of the range
    assert result["code_l2"] == pytest.approx(0.95**2 * result["log_l2"], rel=1e-9)


def lamp(row, column, height=64, width=128):
    L = np.full((height, width, 3), 1e-3, np.float32)
    L[row, column] = 500.0
    return torch.from_numpy(np.moveaxis(envmap.unit_mean(L)[0], -1, 0).copy())


def test_the_brightest_direction_is_where_the_lamp_is():
    w, _ = envmap.directions(64, 128)
    result = intrinsics.brightest(lamp(20, 37))
    assert (
        np.degrees(np.arccos(result @ w[20, 37])) < 2.5
    )  # the smoothed map's texels are 5.6° wide


def test_a_lamp_between_two_texels_of_the_smoothed_map_is_found_between_them():
    w, _ = envmap.directions(64, 128)
    # 18.5 and 19 of the smoothed columns: the two are halves of different ones
    L = lamp(21, 37) + lamp(21, 38)
    middle = w[21, 37] + w[21, 38]
    result = intrinsics.brightest(L)
    # the wider texels' own: 2.8 off
    assert (
        abs(np.degrees(np.arctan2(result[0], result[2]) - np.arctan2(middle[0], middle[2]))) < 0.3
    )


def test_spheres_are_seen_from_the_cameras_elevation():
    a, b = lamp(10, 37), lamp(40, 90)
    level, above = (
        intrinsics.light(a, b, elevation)["matte_sphere_l2"] for elevation in (0.0, 1.2)
    )
    assert abs(level - above) > 0.05 * level


def test_lamps_a_quarter_turn_apart_are_90_degrees_apart():
    """On the horizon 32 of 128 columns are 90°."""
    assert intrinsics.light(lamp(32, 5), lamp(32, 37), ELEVATION)["direction_deg"] == pytest.approx(
        90, abs=0.5
    )


def test_one_light_has_no_error_and_darkness_has_all_of_it():
    L = lamp(20, 37)
    assert set(intrinsics.light(L, L, ELEVATION).values()) == {0.0}
    dark = intrinsics.light(0.0 * L, L, ELEVATION)
    assert dark["irradiance"] == pytest.approx(1.0, abs=1e-6) and dark["spheres_l2"] > 1000


def test_spheres_reflect_what_they_say():
    """Under light of 1 everywhere a surface that faces the viewer has the radiance of its
    albedo.
    """
    from learn.layer import render

    for name, (_, albedo) in intrinsics.SPHERES.items():
        m = torch.from_numpy(intrinsics.sphere_material(name)).double().exp()[None]
        n = torch.tensor([[[[0.0, 0.0, 1.0]]]], dtype=torch.float64)
        radiance = render(
            n,
            m,
            torch.ones(1, 64, 128, 3, dtype=torch.float64),
            method="exact",
            elevation=ELEVATION,
        )
        # texels of 2.8° before lobes 8° wide
        assert radiance.mean().item() == pytest.approx(albedo, rel=0.02)


def alex(rng):
    """Weights of AlexNet's and LPIPS' shapes, drawn."""
    shapes = {
        0: (64, 3, 11, 11),
        3: (192, 64, 5, 5),
        6: (384, 192, 3, 3),
        8: (256, 384, 3, 3),
        10: (256, 256, 3, 3),
    }
    result = {}
    for i, (k, shape) in enumerate(shapes.items()):
        result[f"features.{k}.weight"] = torch.from_numpy(
            rng.standard_normal(shape) / np.sqrt(np.prod(shape[1:]))
        ).float()
        result[f"features.{k}.bias"] = torch.from_numpy(0.1 * rng.standard_normal(shape[0])).float()
        result[f"lin{i}.weight"] = torch.from_numpy(
            rng.random((1, shape[0], 1, 1)) / shape[0]
        ).float()
    return result


def test_lpips_is_nothing_for_one_picture_and_grows_with_noise(rng):
    tensors, picture = alex(rng), 255 * rng.random((64, 64, 3))
    noise = rng.standard_normal(picture.shape)
    result = [perceptual.distance(tensors, picture + s * noise, picture) for s in (0, 5, 20)]
    assert result[0] == 0 < result[1] < result[2]


def test_pictures_are_scaled_for_lpips_as_its_package_scales_them():
    """The package's ScalingLayer: of values in [-1, 1], less (-.030, -.088, -.188), over (.458,
    .448, .450).
    """
    black, white = (
        perceptual.prepare(np.full((1, 1, 3), value))[0, :, 0, 0].tolist() for value in (0.0, 255.0)
    )
    np.testing.assert_allclose(black, [-0.97 / 0.458, -0.912 / 0.448, -0.812 / 0.450], rtol=1e-5)
    np.testing.assert_allclose(white, [1.03 / 0.458, 1.088 / 0.448, 1.188 / 0.450], rtol=1e-5)


# the package names its network to torchvision as its earlier versions had it
@pytest.mark.filterwarnings("ignore:.* deprecated since 0.13:UserWarning")
def test_lpips_is_the_packages(rng):
    """With one set of drawn weights; the trained ones are the user's."""
    lpips = pytest.importorskip("lpips", reason="needs the package lpips, which brings torchvision")
    theirs = lpips.LPIPS(net="alex", pretrained=False, pnet_rand=True, verbose=False).eval()
    tensors, state = alex(rng), theirs.state_dict()
    for part, (k, *_) in enumerate(perceptual.LAYERS):
        for what in ("weight", "bias"):
            state[f"net.slice{part + 1}.{k}.{what}"] = tensors[f"features.{k}.{what}"]
        state[f"lin{part}.model.1.weight"] = tensors[f"lin{part}.weight"]
    theirs.load_state_dict(state)
    a, b = 255 * rng.random((2, 64, 64, 3))
    scaled = [torch.from_numpy(x / 127.5 - 1).float().movedim(-1, 0)[None] for x in (a, b)]
    assert perceptual.distance(tensors, a, b) == pytest.approx(theirs(*scaled).item(), rel=1e-4)


def test_weights_without_a_layer_are_refused(tmp_path, rng):
    from learn.networks.weights import save

    tensors = alex(rng)
    del tensors["lin3.weight"]
    save(tmp_path / "lpips.safetensors", tensors, {})
    with pytest.raises(InputError, match=r"no lin3\.weight"):
        perceptual.load(tmp_path / "lpips.safetensors")
