"""Direct light without noise against sums of shaders.closures over finely divided light."""

import numpy as np
import pytest

pytest.importorskip("numba")

from shaders import direct_light, direct_light_kernels, envmap, normal_groups
from shaders.direct_light import DirectLight
from shaders.mixture import Mixture
from tests.support.texel_sums import ROTATION, normals, summed

ROWS = 64


@pytest.fixture(scope="module")
def light():
    """A dim map with a lamp of 3 × 4 texels in front, 200 times as bright, and a coloured side."""
    rng = np.random.default_rng(3)
    L = rng.uniform(0.2, 1.0, (ROWS, 2 * ROWS, 3)).astype(np.float32)
    L[:, 10:40, 0] *= 3
    L[20:23, 38:42] = 200
    return L


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


def test_normals_asked_for_before_change_no_bit(light):
    """A continued run begins with empty maps: what it shows is what an undisturbed run does."""
    kinds = ("diffuse", "ggx", "sheen")
    mixture = Mixture(
        kinds,
        np.array([0.0, 1.0]),
        np.log(np.full((2, 3), [1.0, 0.3, 0.6])),
        np.zeros((2, 3)),
        np.random.default_rng(2).uniform(0.1, 0.5, (2, 3, 3)),
    )
    n = normals(300, 80)
    fresh, asked = (DirectLight(mixture, light, ROTATION) for _ in range(2))
    asked.at(n[::3])
    first = fresh.at(n)
    np.testing.assert_array_equal(asked.at(n), first)
    np.testing.assert_array_equal(fresh.at(n), first)


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
    shared = direct.at(n, 12, facets, patches=np.arange(24) // 4)
    assert asked == [6]
    lost = direct.at(n, 12) - each
    assert 0 < np.abs(shared - each).max() < 0.2 * lost.max()


def test_a_patch_loses_what_its_mean_normal_does(light):
    direct = DirectLight(Mixture.constant("beckmann", 0.3, [0.5] * 3), light, ROTATION)
    n, facets = at_facets(24)
    patches = np.arange(24) // 8
    lost = direct.at(n, 12) - direct.at(n, 12, facets, patches=patches)
    each = direct.at(n, 12) - direct.at(n, 12, facets)
    for patch in range(3):
        inside = patches == patch
        np.testing.assert_allclose(lost[inside].mean(0), each[inside].mean(0), rtol=0.03)
        first = np.abs(each[inside][0] - each[inside].mean(0)).max()
        assert np.abs(lost[inside].mean(0) - each[inside].mean(0)).max() < first / 2


def test_points_of_a_flat_face_share_their_directions(light):
    mixture = Mixture.constant("beckmann", 0.02, [0.5] * 3)
    direct = DirectLight(mixture, light, ROTATION)
    flat = normals(40, 60)[20].astype(np.float32)
    n = np.repeat(flat[None], 300, axis=0)
    n[100:] = normals(200, 60)
    exact = summed(mixture, light, n[:1].astype(float), 24)
    beside = n + np.float32([0.01, 0, 0])  # half a degree from the normals: no face is flat
    beside /= np.linalg.norm(beside, axis=1, keepdims=True)
    alone = direct.at(n, 4, facets=beside)[:100]
    together = direct.at(n, 4, facets=n)
    assert np.ptp(together[:100], axis=0).max() == 0 and np.ptp(alone, axis=0).max() > 0
    np.testing.assert_allclose(together[:1], exact, rtol=0.03)
    few, many = (np.abs(each[:100] - exact).mean() for each in (alone, together))
    assert many < few / 2


def test_normals_of_several_points_are_those_of_flat_faces():
    n = np.repeat(normals(6, 60).astype(np.float32), [1, 2, 3, 4, 9, 1], axis=0)
    facets = n.copy()
    facets[-1] = n[0]  # no flat face
    alone, shared = normal_groups.by_repetition(n, facets)
    assert alone.points.tolist() == [0, 19] == alone.first.tolist()
    assert shared.points.tolist() == list(range(1, 19)) and len(shared.first) == 4
    assert (n[shared.first][shared.each] == n[shared.points]).all()


def lean_in_numpy(direct, n, facets, away, parts):
    """What add_leaning adds, in float64 and without its lanes, blocks and polynomials."""
    mixture = direct.mixture
    lights, q, *_ = direct.blocks.texels(parts)
    lights, q = lights.astype(float), q.astype(float)
    w, h, energy = lights[:3], lights[3:6], lights[6:]
    out = np.zeros((len(n), 3))
    for i in range(len(n)):
        a, o = n[i].astype(float), abs(float(n[i, 2]))
        parameters = [[np.interp(1 - o, np.linspace(0, 1, len(t)), c) for c in t.T.astype(float)]
                      for t in direct._tables]  # fmt: skip
        chances = np.array([np.mean(each[2:]) for each in parameters])
        chances = np.maximum(chances, 0.125 * chances.sum())
        chances /= chances.sum()
        f, p = np.zeros((3, w.shape[1])), np.zeros(w.shape[1])
        for kind, (log_alpha, _, *weights), chance in zip(
            mixture.kinds, parameters, chances, strict=True
        ):
            value, density = lobe_in_numpy(kind, np.exp(log_alpha), a, w, h)
            f += value * np.array(weights)[:, None]
            p += density * chance
        below = facets[i] @ w < 0
        share = p**2 / (p**2 + q**2)
        share = np.where(below, 1 - share, 1) if away else np.where(below, share, 0)
        out[i] = (f * share * energy * (a @ w > 1e-4)).sum(1)
    return out


def lobe_in_numpy(kind, alpha, n, w, h):
    """f · cos_i (T,) of an untilted closure, and the density by which Cycles draws it."""
    ci, o, ch, cd = n @ w, n[2], n @ h, np.maximum(h[2], 1e-6)
    if kind == "diffuse":
        return np.maximum(ci, 0) / np.pi, np.maximum(ci, 0) / np.pi
    lit = (ci > 1e-4) & (ch > 1e-4) & (o > 1e-4)
    ci, ch, o = np.maximum(ci, 1e-4), np.clip(ch, 1e-4, 1), max(o, 1e-4)
    s2 = 1 - ch**2
    if kind == "sheen":
        s2 = np.maximum(s2, 1e-9)
        d = np.exp(-(ch**2) / (s2 * alpha**2)) / (np.pi * alpha**2 * s2**2)
        hidden = np.minimum(2 * ch / cd * np.minimum(ci, o), 1)
        return np.where(lit, d * hidden / (4 * o), 0), np.where(lit, 0.5 / np.pi, 0)
    if kind == "ashikhmin_shirley":
        exponent = 2 / alpha**2 - 2
        p = (exponent + 1) / (8 * np.pi) * ch**exponent / cd
        return np.where(lit, p * ci / np.maximum(ci, o), 0), np.where(lit, p, 0)
    if kind == "ggx":
        d = alpha**2 / (np.pi * (s2 + alpha**2 * ch**2) ** 2)
        hidden = [(np.sqrt(1 + alpha**2 * (1 / c**2 - 1)) - 1) / 2 for c in (ci, o)]
    else:
        d = np.exp(-s2 / (ch**2 * alpha**2)) / (np.pi * alpha**2 * ch**4)
        hidden = []
        for c in (ci, o):
            x = c / (np.sqrt(np.maximum(1 - c**2, 1e-12)) * alpha)
            rational = (1 - 1.259 * x + 0.396 * x**2) / (3.535 * x + 2.181 * x**2)
            hidden.append(np.where(x < 1.6, rational, 0))
    common = d / (4 * o)
    both, one = common / (1 + hidden[0] + hidden[1]), common / (1 + hidden[1])
    return np.where(lit, both, 0), np.where(lit, one, 0)


@pytest.mark.parametrize("away", [False, True])
@pytest.mark.parametrize(
    "kind, alpha",
    [
        ("diffuse", 1.0),
        ("sheen", 0.6),
        *(
            (kind, alpha)
            for kind in ("ggx", "beckmann", "ashikhmin_shirley")
            for alpha in (0.5, 0.1)
        ),
    ],
)
def test_light_at_facets_is_what_numpy_gives(light, kind, alpha, away):
    """Beside another closure, and for light of which some texels are black."""
    sparse = np.where(np.random.default_rng(1).random(light.shape[:2]) < 0.3, 1, 0)[..., None]
    mixture = Mixture(
        ("diffuse", kind),
        np.array([0.0]),
        np.log([[1.0, alpha]]),
        np.zeros((1, 2)),
        np.array([[[0.1, 0.2, 0.3], [0.5, 0.4, 0.2]]]),
    )
    direct = DirectLight(mixture, light * sparse, ROTATION)
    n, facets = at_facets(9)
    if away:
        n = np.concatenate([n[:, :2], -0.1 * n[:, 2:]], axis=1)
        n /= np.linalg.norm(n, axis=1, keepdims=True)
    width = alpha if kind in direct_light.LOBES else 1.0
    parts = 1 if away else next(parts for wide, parts in direct_light.LEANING if width >= wide)
    expected = lean_in_numpy(direct, n, facets, away, parts)
    found = direct._leaning(n, facets, away)
    assert expected.min() > 0
    np.testing.assert_allclose(found, expected, rtol=2e-3)


def sample_in_numpy(kind, alpha, n, facet, extent, light, count):
    """Means over sample directions of one lobe, drawn at random by its own distribution of h."""
    rng = np.random.default_rng(7)
    u, phi = rng.random(count), 2 * np.pi * rng.random(count)
    end = max(extent / alpha, 3.0) ** 2 if kind == "ggx" else 25.0
    t = u / (1 - u) if kind == "ggx" else -np.log(1 - u)
    cos = 1 / np.sqrt(1 + alpha**2 * t)
    sin = np.sqrt(1 - cos**2)
    x = np.cross(n, [0.3, 0.8, -0.5])
    x /= np.linalg.norm(x)
    y = np.cross(n, x)
    across = np.cos(phi)[:, None] * x + np.sin(phi)[:, None] * y
    h = cos[:, None] * n + sin[:, None] * across
    w = 2 * h[:, 2:] * h - np.array([0, 0, 1.0])
    d = 1 / (1 + t) ** 2 if kind == "ggx" else np.exp(-t)
    p = d / (np.pi * alpha**2 * cos**3) / (4 * h[:, 2])
    f, _ = lobe_in_numpy(kind, alpha, n, w.T, h.T)
    if kind == "ggx":
        x = np.clip(2 * np.sqrt(t / end) - 1, 0, 1)
        f = f * (1 - x * x * (3 - 2 * x))
    f = np.where((h[:, 2] > 1e-4) & (w @ facet >= 0), f, 0)
    L = light[envmap.texel(w @ ROTATION, *light.shape[:2])]
    return (L * (f / p)[:, None]).mean(0)


@pytest.mark.parametrize("kind", ["ggx", "beckmann"])
@pytest.mark.parametrize("degrees", [10, 50, 80])
def test_samples_of_narrow_lobes_are_what_numpy_gives(light, kind, degrees):
    """At 70 equal normals, more than are evaluated side by side, with light below their facets."""
    alpha = 0.02
    direct = DirectLight(Mixture.constant(kind, alpha, [1.0] * 3), light, ROTATION)
    normal = np.array([np.sin(np.radians(degrees)), 0, np.cos(np.radians(degrees))])
    towards = 2 * normal[2] * normal - np.array([0, 0, 1.0])
    facet = np.cross(towards, [0.0, 1.0, 0.0])  # half of the lobe is below it
    facet /= np.linalg.norm(facet)
    n, facets = (np.tile(each, (70, 1)).astype(np.float32) for each in (normal, facet))
    found = np.zeros_like(n)
    direct._sample(0, n, facets, *normal_groups.by_repetition(n, facets), 512, found)
    extent = np.tan(direct_light.EXTENT / 2)
    expected = sample_in_numpy(kind, alpha, normal, facet, extent, light, 400_000)
    assert expected.min() > 0
    np.testing.assert_allclose(found.mean(0), expected, rtol=0.01)
    np.testing.assert_allclose(found[-1], expected, rtol=0.1)


def test_a_map_is_interpolated_by_catmull_rom_splines():
    """Of more normals than are placed side by side, where all but one of the nodes are known."""
    size = 64
    nodes = np.random.default_rng(5).random((size, size, 4)).astype(np.float32)
    n = normals(200, 70).astype(np.float32)
    table = np.array([[0, 0, 1, 2, 3], [0, 0, 4, 5, 6]], np.float32)
    known = np.ones((size, size), np.uint8)
    n64 = n.astype(float)
    theta = np.arccos(np.clip(n64[:, 2], -1, 1)) * 2 / np.pi
    along = theta / np.maximum(np.hypot(n64[:, 0], n64[:, 1]), 1e-12)
    place = (along[:, None] * n64[:, :2] + 1) / 2 * (size - 3) + 1
    start = np.floor(place).astype(int)
    f = place - start
    spline = [2 * f**2 - f - f**3, 2 - 5 * f**2 + 3 * f**3, f + 4 * f**2 - 3 * f**3, f**3 - f**2]
    known[start[80, 1] + 2, start[80, 0] - 1] = 0
    expected, complete = np.zeros((200, 3)), np.ones(200, bool)
    for a in range(4):
        for c in range(4):
            at = start[:, 1] + a - 1, start[:, 0] + c - 1
            expected += (spline[a][:, 1] * spline[c][:, 0] / 4)[:, None] * nodes[at][:, :3]
            complete &= known[at] == 1
    weights = (1 - n64[:, 2:]) * (table[1, 2:] - table[0, 2:]) + table[0, 2:]
    expected = np.maximum(expected, 0) * weights
    above = n[:, 2] >= np.float32(0.5)
    out, lacking = np.zeros((200, 3), np.float32), np.empty(200, np.int32)
    count = direct_light_kernels.interpolate(n, np.float32(0.5), known, nodes, table, lacking, out)
    np.testing.assert_array_equal(lacking[:count], np.nonzero(above & ~complete)[0])
    assert 0 < count < 20 and (known == 2).sum() == 1
    inside = above & complete
    np.testing.assert_allclose(out[inside], expected[inside], rtol=1e-3, atol=2e-3)
    assert not out[~inside].any()
