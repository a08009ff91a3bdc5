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
        *((kind, 0.08, 6) for kind in ("ggx", "beckmann", "ashikhmin_shirley")),
        *((kind, 0.04, 8) for kind in ("ggx", "beckmann", "ashikhmin_shirley")),
        *((kind, 0.025, 12) for kind in ("ggx", "beckmann", "ashikhmin_shirley")),
    ],
)
def test_every_closure_is_integrated_at_every_width(light, kind, alpha, parts, tilt):
    mixture = Mixture.constant(kind, alpha, [0.5, 0.3, 0.7], 0.0 if kind == "diffuse" else tilt)
    n = normals(10)
    expected = summed(mixture, light, n, parts)
    # many sample directions, because single normals are compared here
    radiance = DirectLight(mixture, light, ROTATION, misdirected=False).at(n, samples=2048)
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
    first = direct.at(normals(50, 80))
    monkeypatch.setattr(direct, "_sum", lambda *_: pytest.fail("computed again"))
    np.testing.assert_array_equal(direct.at(normals(50, 80)), first)


@pytest.mark.parametrize("kind, alpha", [("diffuse", 1.0), ("ggx", 0.5), ("sheen", 0.6)])
@pytest.mark.parametrize("tilt", [0.0, -0.1])
def test_near_the_horizon_no_map_blurs_where_a_closure_ends(light, kind, alpha, tilt):
    """A lobe whose normal is tilted away by .1 ends at n·v = .1; a matte closure does not."""
    mixture = Mixture.constant(kind, alpha, [0.5, 0.3, 0.7], tilt)
    cosine = np.array([0.02, 0.04, 0.06, 0.09, 0.11, 0.14, 0.18])
    sine = np.sqrt(1 - cosine**2)
    n = np.stack([sine * np.cos(cosine * 40), sine * np.sin(cosine * 40), cosine], axis=1)
    expected = summed(mixture, light, n, 2)
    radiance = DirectLight(mixture, light, ROTATION, misdirected=False).at(n)
    assert kind != "diffuse" or expected.min() > 0
    np.testing.assert_allclose(radiance, expected, rtol=0.03, atol=0.005 * expected.max())


def test_blocks_of_texels_carry_the_energy_of_all(light):
    direct = DirectLight(Mixture.lambert([0.5] * 3), light, ROTATION)
    total = direct.blocks.lights(ROWS)[6:].sum(1)
    for _, rows in direct_light.BLOCKS:
        np.testing.assert_allclose(direct.blocks.lights(rows)[6:].sum(1), total, rtol=1e-4)
        lengths = np.linalg.norm(direct.blocks.lights(rows)[:3], axis=0)
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


def test_a_weight_that_jumps_at_the_front_is_not_blurred_between_nodes(light):
    """Measured materials have stops 0.004 apart there, finer than a map's nodes."""
    mixture = Mixture(
        ("diffuse",),
        np.array([0.0, 1 / 255, 1.0]),
        np.zeros((3, 1)),
        np.zeros((3, 1)),
        np.array([[[0.0] * 3], [[1.0] * 3], [[1.0] * 3]]),
    )
    n = normals(40, 20)
    direct = DirectLight(mixture, light, ROTATION).at(n)
    matte = DirectLight(Mixture.lambert([1.0, 1.0, 1.0]), light, ROTATION).at(n)
    weight = np.minimum(255 * (1 - n[:, 2:]), 1)
    np.testing.assert_allclose(direct, matte * weight, rtol=0.01, atol=0.01)


def drawn_wrongly(mixture, light, n, count, rng):
    """What Cycles adds at one normal by half vectors that it turns round, drawn one by one."""
    (alpha,), (kind,) = np.exp(mixture.log_alpha[0]), mixture.kinds
    assert kind == "ashikhmin_shirley"
    exponent, v = 2 / alpha**2 - 2, np.array([0, 0, 1.0])
    cos = rng.random(count) ** (1 / (exponent + 1))
    phi = 2 * np.pi * rng.random(count)
    x = np.cross(n, [0.3, 0.8, -0.5])
    x /= np.linalg.norm(x)
    y = np.cross(n, x)
    sin = np.sqrt(1 - cos**2)
    h = cos[:, None] * n + sin[:, None] * (np.cos(phi)[:, None] * x + np.sin(phi)[:, None] * y)
    cd = h @ v
    turned = cd < 0
    # as Cycles has it: h changes its sign, h·v does not
    w = -v + 2 * cd[:, None] * np.where(turned[:, None], -h, h)
    cos_i, cos_o = w @ n, n @ v
    again = (w + v) / np.linalg.norm(w + v, axis=1, keepdims=True)
    p = (exponent + 1) / (8 * np.pi) * np.maximum(again @ n, 0) ** exponent / np.abs(again @ v)
    f = p * cos_i / np.maximum(cos_i, cos_o)
    towards = w / np.linalg.norm(w, axis=1, keepdims=True)
    L = light[envmap.texel(towards @ ROTATION, *light.shape[:2])]
    _, solid_angle = envmap.directions(*light.shape[:2])
    energy = light.mean(-1) * solid_angle
    q = (energy / energy.sum() / solid_angle)[envmap.texel(towards @ ROTATION, *light.shape[:2])]
    used = turned & (cos_i > 0)
    share = np.where(used, f / p * p**2 / (p**2 + q**2), 0)
    return (share[:, None] * L).mean(0) * mixture.weights[0, 0]


@pytest.mark.parametrize("degrees", [70, 78, 85])
def test_light_that_cycles_finds_by_mistake_is_what_its_rule_gives(light, degrees):
    light = np.minimum(light, 5)  # so that few half vectors suffice here
    mixture = Mixture.constant("ashikhmin_shirley", 0.8, [0.5, 0.3, 0.7])
    n = np.array([[np.sin(np.radians(degrees)), 0, np.cos(np.radians(degrees))]])
    found = DirectLight(mixture, light, ROTATION).misdirected(n.astype(np.float32))[0]
    expected = drawn_wrongly(mixture, light, n[0], 400_000, np.random.default_rng(1))
    assert found.min() > 0
    np.testing.assert_allclose(found, expected, rtol=0.05)


def test_no_half_vector_is_turned_round_where_the_surface_faces_the_viewer(light):
    mixture = Mixture.constant("ashikhmin_shirley", 0.3, [0.5] * 3)
    n = np.array([[0.0, 0.0, 1.0], [0.3, 0.0, 0.954]], np.float32)
    assert not DirectLight(mixture, light, ROTATION).misdirected(n).any()


def lost_below(mixture, light, n, facet):
    """What Cycles loses below a facet at one normal, and what light above it gives.

    The closures are a matte one and one of Ashikhmin and Shirley.
    """
    assert mixture.kinds == ("diffuse", "ashikhmin_shirley")
    w, solid_angle = envmap.directions(*light.shape[:2])
    energy = light.mean(-1) * solid_angle
    q = energy / energy.sum() / solid_angle
    w = w @ ROTATION.T
    h = w + np.array([0, 0, 1])
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    cos_i, cos_h, cos_d = np.maximum(w @ n, 1e-9), np.maximum(h @ n, 1e-9), h[..., 2]
    exponent = 2 / np.exp(2 * mixture.log_alpha[0, 1]) - 2
    densities = (
        cos_i / np.pi,
        (exponent + 1) / (8 * np.pi) * cos_h**exponent / cos_d,
    )
    drawn = mixture.weights[0].mean(-1)
    drawn = np.maximum(drawn, drawn.sum() / 8)
    p = sum(part * density for part, density in zip(drawn / drawn.sum(), densities, strict=True))
    f = mixture.evaluate(cos_i, n[2], cos_h, cos_d) * (cos_i * solid_angle)[..., None] * light
    lit, below = w @ n > 1e-4, w @ facet < 0
    share = np.where(lit & below, p**2 / (p**2 + q**2), 0)
    return (f * share[..., None]).sum((0, 1)), (f * lit[..., None]).sum((0, 1))


@pytest.mark.parametrize("weight", [0.02, 0.6])
def test_below_a_facet_cycles_loses_what_it_finds_by_the_closures(light, weight):
    n = np.array([0.9, 0.0, np.sqrt(1 - 0.81)])
    facet = np.array([0.3, 0.2, np.sqrt(1 - 0.13)])
    mixture = Mixture(
        ("diffuse", "ashikhmin_shirley"),
        np.array([0.0]),
        np.log([[1.0, 0.3]]),
        np.zeros((1, 2)),
        np.array([[[0.5, 0.4, 0.3], [weight] * 3]]),
    )
    lost, whole = lost_below(mixture, light, n, facet)
    direct = DirectLight(mixture, light, ROTATION, misdirected=False)
    straight, leaning = (
        direct.at(n[None].astype(np.float32), 12, facets)[0].astype(float)
        for facets in (None, facet[None].astype(np.float32))
    )
    assert (lost > 0.02 * whole).all()
    np.testing.assert_allclose(straight - leaning, lost, rtol=0.05)


def test_where_the_normal_faces_away_only_matte_closures_reflect(light):
    n = np.array([[0.995, 0.0, -0.0999]], np.float32)
    facet = np.array([[0.98, 0.0, 0.199]], np.float32)
    lobe = Mixture.constant("ggx", 0.5, [0.5] * 3)
    assert not DirectLight(lobe, light, ROTATION).at(n, 12, facet).any()
    leaning = Mixture.constant("ggx", 0.5, [0.5] * 3, tilt=0.3)  # its own normal faces the viewer
    assert DirectLight(leaning, light, ROTATION).at(n, 12, facet).all()
    w, solid_angle = envmap.directions(*light.shape[:2])
    energy = light.mean(-1) * solid_angle
    q = energy / energy.sum() / solid_angle
    cosines = np.maximum(w @ (n[0] @ ROTATION), 0)
    p = cosines / np.pi
    found = np.where(w @ (facet[0] @ ROTATION) < 0, q**2 / (p**2 + q**2), 1)
    expected = 0.5 / np.pi * np.einsum("yx,yx,yx,yxc->c", found, cosines, solid_angle, light)
    matte = DirectLight(Mixture.lambert([0.5] * 3), light, ROTATION).at(n, 12, facet)
    np.testing.assert_allclose(matte[0], expected, rtol=0.01)


def at_facets(count):
    """Normals that turn slowly from one to the next, and the facet that all of them lean from."""
    degrees = np.radians(np.linspace(40, 46, count))
    n = np.stack([np.sin(degrees), np.zeros(count), np.cos(degrees)], axis=-1)
    facet = np.array([np.sin(np.radians(25)), 0.2, np.cos(np.radians(25))])
    return n.astype(np.float32), np.tile(facet / np.linalg.norm(facet), (count, 1)).astype("f4")


def test_no_light_below_a_facet_is_passed_over_with_its_block(light):
    sparse = np.where(np.random.default_rng(1).random(light.shape[:2]) < 0.2, 1, 0)[..., None]
    direct = DirectLight(Mixture.constant("ggx", 0.3, [0.5] * 3), light * sparse, ROTATION)
    n, facets = at_facets(24)
    lost = direct._leaning(n, facets, away=False)
    lights, density, *_ = direct.blocks.texels(1)
    firsts, centre = np.array([0, len(density)]), np.array([[0, 0, 1]], np.float32)
    # a single block
    direct.blocks._texels[1] = (lights, density, firsts, centre, np.ones(1, np.float32))
    np.testing.assert_allclose(lost, direct._leaning(n, facets, away=False), rtol=1e-4)
    assert (lost > 0).all() and len(density) < 0.25 * light[..., 0].size


def test_neighbours_share_what_facets_take_away(light, monkeypatch):
    direct = DirectLight(Mixture.constant("beckmann", 0.3, [0.5] * 3), light, ROTATION)
    n, facets = at_facets(24)
    each = direct.at(n, 12, facets)
    asked = []
    original = DirectLight._leaning
    monkeypatch.setattr(
        DirectLight,
        "_leaning",
        lambda self, *a, **k: asked.append(len(a[0])) or original(self, *a, **k),
    )
    shared = direct.at(n, 12, facets, cells=np.arange(24) // 4)
    assert asked == [6]
    lost = direct.at(n, 12) - each
    assert 0 < np.abs(shared - each).max() < 0.2 * lost.max()
