"""Monte Carlo draws what it says that it draws, and estimates the integral and its derivatives
without bias.

P pixels with one normal are P independent estimates: each pixel turns the pattern of samples by a
hash of its own number. All numbers repeat, so that a test passes always or never.
"""

import functools

import numpy as np
import pytest
import torch
from scipy.stats import chi2

from learn.layer import render
from learn.methods import sampling
from shaders import envmap
from shaders.frames import camera_from_light
from tests.support.card_scenes import LIGHTS, MATERIALS, light, material
from tests.support.dense_integral import VIEWER, radiance

DRAWS = 200_000
METHODS = ("monte_carlo", "monte_carlo_light", "monte_carlo_brdf")
N = np.array([0.48, 0.36, 0.8])  # leans by 37°
PIXELS = 4096
COARSE = 0.25  # the tolerance of 16 samples per pixel


def normal(n=N):
    return torch.as_tensor(n, dtype=torch.float64)


def p_value(counts, expected):
    """Of Pearson's χ² between counts and what is expected; cells that expect fewer than 10 are
    taken together.
    """
    few = expected < 10
    counts = np.append(counts[~few], counts[few].sum())
    expected = np.append(expected[~few], expected[few].sum())
    if expected[-1] == 0:
        assert counts[-1] == 0
        counts, expected = counts[:-1], expected[:-1]
    return chi2.sf(((counts - expected) ** 2 / expected).sum(), len(expected) - 1)


def uniform():
    """(DRAWS, 3) numbers of the product's own pattern: the first sample of many pixels."""
    return sampling.pattern(0, DRAWS, 1)[:, 0]


# Every p-value below is one draw from (0, 1) where all is right; a density wrong by 5 % gives less
# than 1e-20.
LEAST_P = 1e-4


def test_the_pattern_is_uniform_over_pixels_in_each_pair_of_its_three_numbers():
    u = uniform()
    for a, b in ((0, 1), (0, 2), (1, 2)):
        counts, _, _ = np.histogram2d(u[:, a], u[:, b], bins=32, range=[[0, 1], [0, 1]])
        assert p_value(counts.ravel(), np.full(1024, DRAWS / 1024)) > LEAST_P


@pytest.mark.parametrize("name", LIGHTS)
def test_light_samples_follow_the_density_they_are_weighed_by_and_the_energy_of_the_map(name):
    """χ² over the map at twice its resolution: the texel by its energy, and the place within it by
    solid angle.
    """
    L = light(name, torch.float64)[0]
    height, width = L.shape[:2]
    table = sampling.Texels(L, torch.as_tensor(camera_from_light()))
    w = table.draw(*uniform().T) @ camera_from_light()
    row, column = envmap.texel(w, 2 * height, 2 * width)
    counts = np.bincount(row * 2 * width + column, minlength=4 * height * width)
    _, fine = envmap.directions(2 * height, 2 * width)
    density = np.repeat(np.repeat(table.density.numpy().reshape(height, width), 2, 0), 2, 1)
    assert p_value(counts, DRAWS * (density * fine).ravel()) > LEAST_P
    _, solid_angle = envmap.directions(height, width)
    energy = (L.numpy() @ envmap.LUMINANCE) * solid_angle
    np.testing.assert_allclose(
        table.density.numpy().reshape(height, width) * solid_angle,
        energy / energy.sum(),
        rtol=1e-12,
    )


@pytest.mark.parametrize("name", MATERIALS)
def test_brdf_samples_follow_the_density_they_are_weighed_by(name, monkeypatch):
    """χ² of the directions of light over 24 × 48 cells of the sphere about the mirror direction,
    finer towards it, where h·n > 0.
    """
    lobes = sampling.Lobes(material(*MATERIALS[name], torch.float64).reshape(3, 3, 2, 6))
    n = normal().expand(DRAWS, 3)
    v = torch.as_tensor(VIEWER).expand(1, 3)
    w = sampling.draw_by_lobes(n, v, lobes, 1, 0)[:, 0].numpy()
    mirror = 2 * (N @ VIEWER) * N - VIEWER
    side = np.cross(mirror, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    frame = np.stack([side, np.cross(mirror, side), mirror])
    rings, turns, parts = 24, 48, 24

    def cells(directions):
        """Flat cell of directions (…, 3): ring by the square root of the angle to the mirror, turn
        about it.
        """
        x, y, z = np.moveaxis(directions @ frame.T, -1, 0)
        ring = np.sqrt(np.arctan2(np.hypot(x, y), z) / np.pi) * rings
        turn = np.arctan2(y, x) / (2 * np.pi) % 1 * turns
        return np.minimum(ring, rings - 1).astype(int) * turns + np.minimum(turn, turns - 1).astype(
            int
        )

    def cosines(directions):
        h = directions + VIEWER
        h /= np.linalg.norm(h, axis=-1, keepdims=True)
        return h @ N, h @ VIEWER

    edges = np.pi * (np.arange(rings * parts + 1) / (rings * parts)) ** 2
    angle, phi = np.meshgrid(
        (edges[1:] + edges[:-1]) / 2,
        (np.arange(turns * 8) + 0.5) / (turns * 8) * 2 * np.pi,
        indexing="ij",
    )
    area = np.broadcast_to(
        (np.cos(edges[:-1]) - np.cos(edges[1:]))[:, None] * 2 * np.pi / (turns * 8), angle.shape
    )
    points = (
        np.stack([np.sin(angle) * np.cos(phi), np.sin(angle) * np.sin(phi), np.cos(angle)], -1)
        @ frame
    )
    cos_h, cos_d = cosines(points)
    density = np.where(
        cos_h > 0, lobes.density(torch.as_tensor(cos_h)).numpy() / (4 * np.maximum(cos_d, 1e-6)), 0
    )
    expected = DRAWS * np.bincount(cells(points).ravel(), (density * area).ravel(), rings * turns)
    counts = np.bincount(cells(w[cosines(w)[0] > 0]), minlength=rings * turns)
    # cells that the edge h·n = 0 cuts through are known to a few per cent only
    whole = np.bincount(cells(points).ravel(), (cos_h < 0.05).ravel(), rings * turns) == 0
    assert p_value(counts[whole], expected[whole]) > LEAST_P
    assert expected[whole].sum() > 0.7 * DRAWS


@functools.cache
def truth(m, L, step=None):
    """(3,) the dense integral of a named scene; or its derivative by normal, material or light
    along `direction`.
    """
    arguments = {
        "n": N,
        "m": material(*MATERIALS[m], torch.float64).numpy().reshape(3, 3, 2, 6),
        "L": light(L, torch.float64)[0].numpy(),
    }
    if step is None:
        return radiance(**arguments)
    along, size = direction(step, arguments[step]), 1e-4
    ahead, behind = (
        radiance(**arguments | {step: turned(step, arguments[step], s * along)})
        for s in (size, -size)
    )
    return (ahead - behind) / (2 * size)


def direction(step, value):
    """A direction in which an argument is changed: n about an axis, m and L in proportion to their
    values, unequally.
    """
    if step == "n":
        return np.cross(N, [0.0, 0.6, 0.8])
    if step == "m":
        return value * (0.5 + np.sin(1 + np.arange(value.size)).reshape(value.shape))
    return (
        value * (1 + np.cos(np.linspace(0, 2 * np.pi, value.shape[1])))[:, None] * [0.2, 1.0, 0.6]
    )


def turned(step, value, change):
    value = value + change
    return value / np.linalg.norm(value) if step == "n" else value


def picture_of(method, m, L, **changed):
    """(picture (P, 3) of PIXELS equal pixels, its inputs)."""
    given = {
        "n": normal().float().expand(1, 1, PIXELS, 3),
        "material": material(*MATERIALS[m]),
        "light": light(L),
    }
    given = {key: value.clone().requires_grad_(bool(changed)) for key, value in given.items()}
    return render(**given, method=method, tolerance=COARSE)[0, 0], given


# BRDF samples hit a sun in one texel once in thousands: its mean is not normally distributed at any
# number of pixels that a test can have.
CASES = [
    (method, m, L)
    for method in METHODS
    for m in MATERIALS
    for L in LIGHTS
    if not (method == "monte_carlo_brdf" and L == "sun")
]


@pytest.mark.parametrize(("method", "m", "L"), CASES)
def test_the_mean_of_many_pixels_is_the_integral(method, m, L):
    picture = picture_of(method, m, L)[0].double().numpy()
    sigma = picture.std(0, ddof=1) / np.sqrt(PIXELS)
    # 2.3 % at most, most below .5 %: a bias of a tenth is seen everywhere
    assert (sigma < 0.025 * truth(m, L)).all()
    _is_unbiased(picture.mean(0), sigma, truth(m, L), truth(m, L))


@pytest.mark.parametrize("method", METHODS)
def test_derivatives_are_those_of_the_integral_on_average(method, m="satin", L="sky", parts=8):
    """By normal, material and light along one direction each; the noise is that of eight parts of
    the pixels.
    """
    picture, given = picture_of(method, m, L, gradients=True)
    weights = torch.tensor([1.0, 0.7, 0.4])
    means = (picture.reshape(parts, -1, 3).mean(1) * weights).sum(1)
    result = [torch.autograd.grad(mean, tuple(given.values()), retain_graph=True) for mean in means]
    for key, name, slopes in zip(("n", "m", "L"), given, zip(*result, strict=True), strict=True):
        value = N if key == "n" else given[name].detach()[0].double().numpy()
        along = torch.as_tensor(direction(key, value))
        slopes = np.array([(slope.double() * along).sum() for slope in slopes])
        expected = truth(m, L, key) @ weights.double().numpy()
        sigma = slopes.std(ddof=1) / np.sqrt(parts)
        assert sigma < 0.2 * abs(expected), key
        _is_unbiased(slopes.mean(), sigma, expected, truth(m, L) @ weights.double().numpy())


def _is_unbiased(mean, sigma, expected, level):
    """z-test: 5 σ, where σ comes from 8 parts at least; 2e-3 of the radiance is the oracle's own
    error.
    """
    assert (np.abs(mean - expected) <= 5 * sigma + 2e-3 * np.abs(level)).all(), (
        mean,
        sigma,
        expected,
    )
