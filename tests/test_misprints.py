"""Where the paper's text must not be followed to the letter: each test shows the printed form
failing and ours holding.

The table "Misprints" of docs/deviations.md has a row for each test here, with its figures.
Printed forms are written out below as the supplement has them; ours come from shaders/ and learn/.
"""

import re

import numpy as np
import pytest

from factory.lights import load
from shaders import dsbrdf, envmap, frames

V = np.array([0.0, 0.0, 1.0])
W_LIGHT, SOLID_ANGLE = envmap.directions(64, 128)
W_OURS = W_LIGHT.reshape(-1, 3) @ frames.camera_from_light().T  # camera frame
WEIGHT_OURS = SOLID_ANGLE.ravel()


def printed_angles(full_turn=False, centres=False):
    """θ, φ (64, 128) as printed: θ = h/H·π, φ = w/W·π; each slip can be mended by itself."""
    rows, columns = np.indices((64, 128)) + (0.5 if centres else 0.0)
    return rows / 64 * np.pi, columns / 128 * np.pi * (2 if full_turn else 1)


def printed_directions(theta, phi):
    w = np.stack([np.cos(phi) * np.sin(theta), np.cos(theta), np.sin(phi) * np.sin(theta)], axis=-1)
    return w.reshape(-1, 3) @ frames.camera_from_light().T


def material(kappa, gamma):
    """m (3, 3, 2, 6) of constant curves, the same in all channels."""
    m = np.zeros(dsbrdf.SHAPE)
    m[:, :, 0], m[:, :, 1] = np.asarray(kappa, float)[:, None], np.asarray(gamma, float)[:, None]
    return m


DIFFUSE = material([0.2, 0, 0], [1e-3, 1, 1])
CHROME = material([0, 0, 2.0], [1, 1, 2000.0])


def sphere(count=14):
    """Normals (P, 3) of a sphere's visible pixels, camera frame."""
    x, y = (a.ravel() for a in frames.pixel_grid(count, count))
    inside = x * x + y * y < 0.95
    return np.stack([x, y, np.sqrt(np.clip(1 - x * x - y * y, 0, 1))], axis=-1)[inside]


def picture(n, m, L, w, weight):
    """Eq. 2 (= 8) as a plain sum: radiance (P, 3) for the distant viewer V."""
    h, theta_d = dsbrdf.half_angles(w, np.broadcast_to(V, w.shape))
    E = L.reshape(-1, 3) * weight[:, None]
    rows = []
    for n_p in n:
        mu = np.maximum(w @ n_p, 0)
        lit = mu > 0
        rows.append(
            (dsbrdf.evaluate(m, h[lit] @ n_p, theta_d[lit]) * E[lit] * mu[lit, None]).sum(0)
        )
    return np.stack(rows)


def image_errors(w, weight, m, L):
    """Relative rms difference (3,) of a sphere's picture from ours under each of three lights, the
    channels of L.

    The exposure is matched, so that only the look-up counts.
    """
    ours, theirs = picture(sphere(), m, L, W_OURS, WEIGHT_OURS), picture(sphere(), m, L, w, weight)
    theirs = theirs * (ours.sum(0) / theirs.sum(0))
    return np.sqrt(((ours - theirs) ** 2).mean(0) / (ours**2).mean(0))


def percent_range(values, digits=0):
    """The least and the largest value as docs/deviations.md writes them: "26–61 %"."""
    low, high = (f"{100 * value:.{digits}f}" for value in (min(values), max(values)))
    return f"{low}–{high} %"


@pytest.fixture(scope="module")
def L():
    """The luminance of three computed lights as three channels: the materials here are grey, so
    that one picture shows all three.
    """
    return np.stack(
        [
            load(f"{family}-1").L64 @ envmap.LUMINANCE
            for family in ("sun-and-sky", "one-texel", "softboxes")
        ],
        -1,
    ).astype(float)


@pytest.fixture(scope="module")
def cost(root):
    """A function of a test's name: what docs/deviations.md says that the printed form costs."""
    return lambda name: next(row[3] for row in table(root) if f"`{name}`" in row[-1])


# Supplement, "Illumination"


def test_phi_over_pi_covers_half_the_sphere_and_over_two_pi_all_of_it(L, cost):
    theta, phi = printed_angles()
    weight = np.sin(theta).ravel() / np.sin(theta).sum()
    printed_mean = weight @ printed_directions(theta, phi) @ frames.camera_from_light()
    # a constant light must have no direction; as printed everything comes from the viewer's side
    np.testing.assert_allclose(printed_mean, [0.006, 0.0, 0.5], atol=0.01)
    np.testing.assert_allclose(WEIGHT_OURS @ W_OURS, 0.0, atol=1e-12)

    # the same slip in pictures, everything else mended
    theta, phi = printed_angles(centres=True)
    w = printed_directions(theta, phi)
    matte, chrome = (percent_range(image_errors(w, WEIGHT_OURS, m, L)) for m in (DIFFUSE, CHROME))
    report = cost("test_phi_over_pi_covers_half_the_sphere_and_over_two_pi_all_of_it")
    assert f"image error {matte} (matte), {chrome} (chrome) over three lights" in report
    whole = printed_directions(*printed_angles(full_turn=True, centres=True))
    assert image_errors(whole, WEIGHT_OURS, CHROME, L).max() < 1e-12


def test_rows_at_texel_corners_lose_the_zenith_and_centres_keep_it(L, cost):
    theta, _ = printed_angles(full_turn=True)
    assert (np.sin(theta[0]) == 0).all() and (SOLID_ANGLE[0] > 0).all()

    zenith_lamp = np.zeros((64, 128, 3))
    zenith_lamp[0] = 1.0
    theta, phi = printed_angles(full_turn=True)
    w, weight = printed_directions(theta, phi), np.sin(theta).ravel()
    assert picture(sphere(), DIFFUSE, zenith_lamp, w, weight).max() == 0.0
    assert picture(sphere(), DIFFUSE, zenith_lamp, W_OURS, WEIGHT_OURS).max() > 0.0

    # a row's texels, weighed by solid angle, balance at the mean of its edges' heights: centres lie
    # there to (π/64)²/8 = 3e-4
    edges = np.cos(np.pi * np.arange(65) / 64)
    balance = (edges[:-1] + edges[1:]) / 2
    assert np.abs(np.cos(theta[:, 0]) - balance).max() > 0.02
    np.testing.assert_allclose(W_LIGHT[:, 0, 1], balance, atol=4e-4)

    # all is half a texel, 1.4°, off: little for a matte sphere, much for a mirror
    matte, chrome = (
        percent_range(image_errors(w, weight, DIFFUSE, L), 1),
        percent_range(image_errors(w, weight, CHROME, L)),
    )
    assert f"{matte} (matte), {chrome} (chrome)" in cost(
        "test_rows_at_texel_corners_lose_the_zenith_and_centres_keep_it"
    )


def test_the_printed_weight_makes_radiance_415_times_too_large_and_solid_angles_sum_to_the_sphere():
    theta, _ = printed_angles(full_turn=True, centres=True)
    assert np.sin(theta).sum() / (4 * np.pi) == pytest.approx(415, rel=1e-3)
    assert WEIGHT_OURS.sum() == pytest.approx(4 * np.pi, rel=1e-14)


# Supplement, "Derivative"


def printed_gradient_in_n(n, m, E, w, chain_factor, upstream=(1, 1, 1)):
    """∂I/∂n (3,) as printed, n not held to unit length; `chain_factor` puts the missing h^c into
    the second term.

    Returns also the same by central differences of the printed sum.
    """
    h, theta_d = dsbrdf.half_angles(w, np.broadcast_to(V, w.shape))
    kappa, gamma = dsbrdf.coefficients(m, theta_d)
    E = E * np.asarray(upstream, float)

    def total(n):
        c, mu = np.maximum(h @ n, 0), np.maximum(w @ n, 0)
        f = np.where(
            (c > 0)[:, None, None],
            np.expm1(kappa * np.maximum(c, 1e-300)[:, None, None] ** gamma),
            0,
        ).sum(-1)
        return (f * E * mu[:, None]).sum()

    step = 1e-6
    differences = np.array(
        [(total(n + step * e) - total(n - step * e)) / (2 * step) for e in np.eye(3)]
    )

    c, mu = h @ n, w @ n
    lit = (c > 0) & (mu > 0)
    c, mu, kappa, gamma = c[lit], mu[lit], kappa[lit], gamma[lit]
    power = c[:, None, None] ** gamma
    first = (np.expm1(kappa * power).sum(-1) * E[lit]).sum(-1) @ w[lit]
    slope = (np.exp(kappa * power) * kappa * gamma * c[:, None, None] ** (gamma - 1)).sum(-1)
    second = ((slope * E[lit]).sum(-1) * mu)[:, None] * (
        h[lit] if chain_factor else np.ones((1, 3))
    )
    return first + second.sum(0), differences


def relative(a, b):
    return np.linalg.norm(a - b) / np.linalg.norm(b)


def test_the_normals_gradient_needs_the_chain_factor_h(cost):
    n = np.array([0.3, -0.2, np.sqrt(1 - 0.13)])
    E = load("softboxes-1").L64.reshape(-1, 3) * WEIGHT_OURS[:, None]
    m = material([0.2, 0.5, 1.0], [0.5, 10.0, 60.0])
    printed, differences = printed_gradient_in_n(n, m, E, W_OURS, chain_factor=False)
    ours, _ = printed_gradient_in_n(n, m, E, W_OURS, chain_factor=True)
    assert f"gradient off by {100 * relative(printed, differences):.0f} %" in cost(
        "test_the_normals_gradient_needs_the_chain_factor_h"
    )
    # central differences with step 1e-6: their rounding, 1e-16 / 1e-6, is ten times what is left
    assert relative(ours, differences) < 1e-9


def torch_scene(pixels=2):
    """A small scene for the layer: n (1, 1, P, 3), material (1, 108), light (1, 8, 16, 3),
    float64.
    """
    torch = pytest.importorskip("torch")
    rng = np.random.default_rng(7)
    n = rng.normal(size=(pixels, 3))
    n[:, 2] = np.abs(n[:, 2]) + 0.5
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    m = rng.uniform(0.2, 1.5, dsbrdf.SHAPE)
    m[..., 1, :] *= 8
    arrays = (n[None, None], m.reshape(1, 108), rng.uniform(0.1, 3.0, (1, 8, 16, 3)))
    return [torch.tensor(a, dtype=torch.float64, requires_grad=True) for a in arrays]


def test_the_layers_gradient_in_n_is_its_finite_difference():
    torch = pytest.importorskip("torch")
    from learn.layer import render

    n, m, light = torch_scene()
    render(n, m, light, method="exact").sum().backward()
    tangent = torch.linalg.cross(
        n.detach(), torch.tensor([0.3, 0.8, 0.5], dtype=torch.float64).expand_as(n)
    )
    step = 1e-6
    with torch.no_grad():
        unit = torch.nn.functional.normalize
        ahead, behind = (
            render(unit(n + s * tangent, dim=-1), m, light, method="exact").sum()
            for s in (step, -step)
        )
    assert float((n.grad * tangent).sum()) == pytest.approx(
        float(ahead - behind) / (2 * step), rel=1e-6
    )


def test_a_gradient_summed_over_colours_is_right_only_for_a_loss_that_weighs_them_equally(cost):
    n = np.array([0.3, -0.2, np.sqrt(1 - 0.13)])
    E = load("softboxes-1").L64.reshape(-1, 3) * WEIGHT_OURS[:, None] * [1.0, 0.4, 0.1]
    m = material([0.2, 0.5, 1.0], [0.5, 10.0, 60.0])
    summed, _ = printed_gradient_in_n(n, m, E, W_OURS, chain_factor=True)
    blue, differences = printed_gradient_in_n(
        n, m, E, W_OURS, chain_factor=True, upstream=(0, 0, 1)
    )
    report = cost(
        "test_a_gradient_summed_over_colours_is_right_only_for_a_loss_that_weighs_them_equally"
    )
    assert (
        f"off by a factor of {np.linalg.norm(summed) / np.linalg.norm(differences):.0f} for a blue"
        " loss" in report
    )
    assert relative(blue, differences) < 1e-4

    from learn.layer import render  # and the layer takes the upstream gradient

    n, m, light = torch_scene()
    scaled = light.detach().clone() * light.new_tensor([0.0, 0.0, 1.0])
    render(n, m, light, method="exact")[..., 2].sum().backward()
    n_blue = n.detach().clone().requires_grad_()
    render(n_blue, m.detach(), scaled, method="exact").sum().backward()
    np.testing.assert_allclose(n.grad, n_blue.grad, rtol=1e-12)


def test_the_logarithm_in_the_materials_gradient_is_not_finite_at_the_lobes_edge():
    c, gamma = np.array([0.0, 1e-3, 0.5]), 0.7
    with np.errstate(divide="ignore", invalid="ignore"):
        printed = c**gamma * np.log(c)
    assert np.isnan(printed[0])
    # the limit is 0, reached from above
    assert abs(1e-300**gamma * np.log(1e-300)) < 1e-200

    torch = pytest.importorskip("torch")
    from learn.layer import render

    _, m, _ = torch_scene()
    light = torch.ones(1, 64, 128, 3, dtype=torch.float64)
    grazing = torch.tensor([[[[0.0, 0.9999995, 1e-3]]]], dtype=torch.float64)
    render(grazing, m, light, method="exact").sum().backward()
    assert torch.isfinite(m.grad).all() and m.grad.abs().max() > 0


def test_background_pixels_poison_the_printed_layer_and_not_ours():
    torch = pytest.importorskip("torch")
    from learn.layer import render

    n = torch.zeros(3, dtype=torch.float64, requires_grad=True)  # a background pixel
    h, gamma = torch.tensor([0.0, 0.6, 0.8], dtype=torch.float64), 0.5
    value = torch.expm1(0.3 * (h @ n).clamp(min=0) ** gamma)
    # masking afterwards does not help
    torch.where(torch.tensor(False), value, torch.zeros_like(value)).backward()
    assert torch.isnan(n.grad).all()

    n, m, light = torch_scene(pixels=4)
    with torch.no_grad():
        n[0, 0, 1] = 0.0
        m.reshape(dsbrdf.SHAPE)[:, :, 1] = 0.5
    picture = render(n, m, light, method="exact")
    picture.sum().backward()
    assert (picture[0, 0, 1] == 0).all() and (n.grad[0, 0, 1] == 0).all()
    assert all(torch.isfinite(x.grad).all() for x in (n, m, light))


def test_a_normals_length_carries_no_light():
    """As printed a longer n is brighter, so an optimiser cheats by scaling it; ours has no slope
    along n.
    """
    n = np.array([0.3, -0.2, np.sqrt(1 - 0.13)])
    E = load("softboxes-1").L64.reshape(-1, 3) * WEIGHT_OURS[:, None]
    printed, _ = printed_gradient_in_n(
        n, material([0.2, 0, 0], [1, 1, 1]), E, W_OURS, chain_factor=True
    )
    assert printed @ n > 0.5 * np.linalg.norm(printed)

    from learn.layer import render

    n, m, light = torch_scene()
    render(n, m, light, method="exact").sum().backward()
    along = (n.grad * n.detach()).sum(-1).abs().max() / n.grad.norm(dim=-1).max()
    assert float(along) < 1e-12


# The material model


def test_nishinos_sign_with_this_papers_kappa_reflects_negative_light():
    power = np.array([0.1, 0.5, 1.0])
    assert (1 - np.exp(0.7 * power) < 0).all()  # Nishino 2009's form, made for κ < 0
    assert (dsbrdf.evaluate(material([0.7, 0, 0], [1, 1, 1]), power, np.zeros(3)) > 0).all()


# The sum itself


def sum_against_integral(gamma):
    """Largest relative error over normals of the 64×128 sum of one lobe under constant light,
    against its integral.

    The integral is taken around the mirror direction, in rings 0.1 of the lobe's width apart, out
    to where c^γ < e^−24.
    """
    rng = np.random.default_rng(3)
    m = material([1e-3, 0, 0], [gamma, 1, 1])
    n = rng.normal(size=(48, 3)) * [0.25, 0.25, 0] + V
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    edges = np.linspace(0, min(np.pi / 2, 14 / np.sqrt(gamma)), 141)
    ring, turn = np.meshgrid(
        (edges[:-1] + edges[1:]) / 2, 2 * np.pi * np.arange(96) / 96, indexing="ij"
    )
    weight = np.repeat((np.cos(edges[:-1]) - np.cos(edges[1:])) * 2 * np.pi / 96, 96)
    about_mirror = np.stack(
        [np.sin(ring) * np.cos(turn), np.sin(ring) * np.sin(turn), np.cos(ring)], axis=-1
    ).reshape(-1, 3)
    errors = []
    for n_p in n:
        mirror = 2 * (n_p @ V) * n_p - V
        side = np.cross(mirror, [0.0, 1.0, 0.0])
        side /= np.linalg.norm(side)
        w = about_mirror @ np.stack([side, np.cross(mirror, side), mirror])
        truth = picture(n_p[None], m, np.ones(w.shape), w, weight)[0, 0]
        errors.append(
            picture(n_p[None], m, np.ones((64, 128, 3)), W_OURS, WEIGHT_OURS)[0, 0] / truth - 1
        )
    return np.abs(errors).max()


def test_the_papers_sum_is_right_for_lobes_wider_than_a_texel_and_wrong_for_narrower_ones(cost):
    wide, narrow, narrower = (100 * sum_against_integral(gamma) for gamma in (264, 5000, 30000))
    report = cost(
        "test_the_papers_sum_is_right_for_lobes_wider_than_a_texel_and_wrong_for_narrower_ones"
    )
    assert report.endswith(
        f"{wide:.1f} % at γ = 264, {narrow:.1f} % at 5,000, {narrower:.0f} % at 30,000"
    )


# The table of docs/deviations.md


def table(root):
    """Rows of the page's table of misprints, as lists of cells."""
    text = (root / "docs" / "deviations.md").read_text(encoding="utf-8")
    section = text.split("## Misprints", 1)[1].split("\n## ", 1)[0]
    return [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in section.splitlines()
        if line.startswith("|")
    ][2:]


def test_each_row_of_the_pages_table_names_its_test_and_each_test_has_its_row(root):
    named = set(re.findall(r"`(test_\w+)`", "\n".join(row[-1] for row in table(root))))
    here = {
        name for name, value in globals().items() if name.startswith("test_") and callable(value)
    }
    here -= {"test_each_row_of_the_pages_table_names_its_test_and_each_test_has_its_row"}
    assert named == here
