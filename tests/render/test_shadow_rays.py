"""Shadow rays: their tree against all triangles, their share against geometry and Cycles."""

import numpy as np
import pytest

from factory.render import direct_light
from factory.render.estimators.renderer import Share
from factory.render.geometry import Surface
from factory.render.ray_tree import RayTree
from factory.render.shadow_rays import ROWS, ShadowRays
from manifests.materials import load_catalogue
from manifests.schema import Camera
from shaders import envmap
from shaders.direct_light import NARROW, DirectLight
from shaders.mixture import Mixture

RNG = np.random.default_rng(3)


def soup(count):
    """Triangles of many sizes anywhere in a cube."""
    centres = RNG.uniform(-1, 1, (count, 1, 3))
    corners = centres + RNG.normal(size=(count, 3, 3)) * RNG.uniform(0.01, 0.3, (count, 1, 1))
    return corners.reshape(-1, 3).astype(np.float32), np.arange(3 * count).reshape(count, 3)


def meet_any(vertices, faces, origins, towards):
    """Whether rays (R,) meet any triangle, by all pairs of them in float64."""
    a, b, c = (vertices[faces[:, k]].astype(float)[None] for k in range(3))
    o, d = origins[:, None].astype(float), towards[:, None].astype(float)
    normal = np.cross(b - a, c - a)
    along = (normal * d).sum(-1)
    t = (normal * (a - o)).sum(-1) / np.where(along == 0, np.inf, along)
    at = o + t[..., None] * d
    inside = np.ones(t.shape, bool)
    for one, other in ((a, b), (b, c), (c, a)):
        inside &= (np.cross(other - one, at - one) * normal).sum(-1) >= 0
    return ((t > 0) & inside).any(1)


@pytest.mark.parametrize("count", [1, 3, 200, 3000])
def test_rays_meet_what_all_triangles_together_meet(count):
    vertices, faces = soup(count)
    origins = RNG.uniform(-1.5, 1.5, (500, 3)).astype(np.float32)
    towards = RNG.normal(size=(500, 3))
    towards[:30] = np.eye(3)[RNG.integers(3, size=30)]  # along an axis, other components 0
    towards = (towards / np.linalg.norm(towards, axis=1, keepdims=True)).astype(np.float32)
    truth = meet_any(vertices, faces, origins, towards)
    known = RayTree(vertices, faces).are_blocked(origins, towards)
    # a ray through an edge may count to either side
    assert (known != truth).mean() <= 0.004
    assert 0.0 <= truth.mean() < 1.0 and (count == 1 or truth.any())


def test_triangles_in_one_place_make_a_tree_too():
    vertices = np.tile(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32), (500, 1))
    rays = RayTree(vertices, np.arange(1500).reshape(500, 3))
    up = np.array([[0, 0, 1]], np.float32)
    assert rays.are_blocked(np.array([[0.2, 0.2, -1]], np.float32), up).all()
    assert not rays.are_blocked(np.array([[0.9, 0.9, -1]], np.float32), up).any()


@pytest.mark.parametrize("name", ["green-fabric", "steel", "paper_white", "brass"])
def test_listed_lights_add_up_to_direct_light(name):
    light = RNG.gamma(0.3, size=(8, 16, 3)).astype(np.float32).repeat(8, 0).repeat(8, 1)
    direct = DirectLight(load_catalogue()[name].mixture, light, np.eye(3), misdirected=False)
    n = RNG.normal(size=(40, 3)) + np.array([0, 0, 2])
    n = (n / np.linalg.norm(n, axis=1, keepdims=True)).astype(np.float32)
    n = n[n[:, 2] > 0.3]
    listed = direct.each_light(n, ROWS)
    assert listed.shape[2] == len(direct.blocks.listed_patches(ROWS))
    assert (listed >= 0).all()
    places = RNG.random((len(n), 4000, 2))
    drawn = sum(direct.draw_narrow(k, n, n, places)[1].mean(1) for k in range(direct.narrow))
    total = listed.sum(2) + drawn
    np.testing.assert_allclose(total.mean(0), direct.at(n).mean(0), rtol=0.05)


@pytest.mark.parametrize("kind", ["beckmann", "ggx", "ashikhmin_shirley"])
@pytest.mark.parametrize("alpha", [0.004, 0.025, 0.05])
def test_listed_and_drawn_light_add_up_at_each_normal(kind, alpha):
    """On a flat face all points show the same of the light, which no other normal makes up for."""
    light = RNG.gamma(0.3, size=(64, 128, 3)).astype(np.float32)
    mixture = Mixture.constant(kind, alpha, [0.5] * 3)
    direct = DirectLight(mixture, light, np.eye(3), misdirected=False)
    n = np.array([[0, 0, 1], [0.3, 0.1, 0.95], [-0.2, 0.5, 0.84]], np.float32)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    exact = direct.at(n, 4096)
    listed = direct.each_light(n, ROWS).sum(2)
    u = (np.arange(4096) + RNG.random((3, 4096))) / 4096
    places = np.stack([u, np.arange(4096) * (np.sqrt(5) - 1) / 2 % 1 + 0 * u], axis=-1)
    assert direct.narrow == (alpha < NARROW)
    drawn = np.zeros_like(listed)
    if alpha < NARROW:
        w, radiance = direct.draw_narrow(0, n, n, places)
        np.testing.assert_allclose(np.linalg.norm(w, axis=-1), 1, atol=1e-5)
        drawn = radiance.mean(1)
    np.testing.assert_allclose(listed + drawn, exact, rtol=0.1)
    if alpha < NARROW:
        assert (listed < (0.5 if kind == "ggx" else 0.01) * exact).all()


def test_places_cover_the_unit_square_in_each_pixel():
    from factory.render import ray_kernels

    pixels = np.repeat([3, 4], [35, 64])
    turns = np.concatenate([np.arange(35), np.arange(64)])
    out = np.empty((99, 2, 2))
    ray_kernels.draw_places(pixels, turns, np.bincount(pixels), 2, 7, out)
    assert out.min() >= 0 and out.max() < 1
    for pixel in (3, 4):
        for across in (0, 1):
            values = np.sort(out[pixels == pixel][..., across].ravel())
            assert np.diff(values).max() < 2.7 / len(values)


def test_patches_hold_the_directions_of_their_lights():
    light = RNG.gamma(0.3, size=(64, 128, 3)).astype(np.float32)
    blocks = DirectLight(Mixture.lambert((1, 1, 1)), light, np.eye(3)).blocks
    near = blocks.detail(1)[2]
    w = np.concatenate([blocks.lights(ROWS)[:3].T, near[:, :3].swapaxes(1, 2).reshape(-1, 3)])
    top, bottom, left, right = blocks.listed_patches(ROWS).T
    turn = np.arctan2(w[:, 2], w[:, 0]) % (2 * np.pi)
    assert ((w[:, 1] <= top + 1e-5) & (w[:, 1] >= bottom - 1e-5)).all()
    assert ((turn >= left - 1e-4) & (turn <= right + 1e-4)).all()
    solid_angle = (top - bottom) * (right - left)
    lamps = len(w) - near.shape[0] * near.shape[2]
    assert solid_angle[lamps:].sum() == pytest.approx(4 * np.pi, rel=1e-5)


def test_a_share_of_two_rounds_is_that_of_all_their_rays():
    one = Share(np.full((1, 1, 3), 3.0), np.full((1, 1, 3), 4.0))
    other = Share(np.full((1, 1, 3), 0.0), np.full((1, 1, 3), 8.0))
    assert one.add(other).factor == pytest.approx(0.25)
    assert Share(np.zeros((1, 1, 3)), np.zeros((1, 1, 3))).factor == pytest.approx(1)


def test_energies_of_listed_lights_are_those_of_the_map():
    light = RNG.gamma(0.3, size=(64, 128, 3)).astype(np.float32)
    blocks = DirectLight(Mixture.lambert((1, 1, 1)), light, np.eye(3)).blocks
    energies = blocks.listed_energies(ROWS)
    assert len(energies) == len(blocks.listed_patches(ROWS))
    total = float((light.mean(-1) * envmap.directions(64, 128)[1]).sum())
    assert energies.sum() == pytest.approx(2 * total, rel=1e-4)  # blocks and lamps, and texels


@pytest.mark.parametrize(("elsewhere", "least", "most"), [(0.0, 0.79, 0.81), (1e4, 0.0, 0.01)])
def test_below_a_facet_light_counts_that_cycles_finds_by_the_light(elsewhere, least, most):
    """Directions below it are drawn by the light twice as densely as by the closures, or hardly."""
    from factory.render import ray_kernels

    # cosines of polar angles and azimuths in a frame whose y is the axis: above, below, elsewhere
    patches = np.array([[0.6, 0.5, 0, 0.1], [-0.5, -0.6, 0, 0.1], [0.1, -0.1, 3, 3.1]], np.float32)
    reflected = np.array([[[1.0, 1.0, 0.0]] * 3], np.float32)
    energies = np.array([1, 1, elsewhere], np.float32)  # all of which are listed twice otherwise
    one, up = np.ones(1, np.int64), np.array([[0, 1, 0]], np.float32)
    normal = np.array([[0.6, 0.8, 0]], np.float32)
    far = np.array([[9, 9, 9], [9, 9.1, 9], [9.1, 9, 9]], np.float32)
    arrived, sent = np.zeros((2, 1, 3))
    ray_kernels.cast(
        reflected,
        patches,
        np.arange(3),
        np.eye(3, dtype=np.float32),
        np.array([0, 1]),
        0 * one,
        0 * up,
        up,
        normal,
        np.zeros(1, np.float32),
        np.float32(0.1),
        np.float32(1e-4),
        0 * one,
        0 * one,
        one,
        4096,
        1,
        *RayTree(far, np.arange(3)[None]).arrays,
        energies,
        normal,
        arrived,
        sent,
    )
    assert arrived == pytest.approx(sent)  # nothing is in the way
    kept = sent[0] / 4096 - 1  # half of the rays go above the facet
    assert (kept >= least).all() and (kept <= most).all()


@pytest.mark.parametrize("lean", [-0.05, 0.0, 0.05])
def test_light_that_grazes_counts_by_each_points_own_normal(lean):
    """A lamp near the horizon, ten times as bright as one above, which a triangle hides."""
    from factory.render import ray_kernels

    patches = np.array([[0.101, 0.099, 0, 0.01], [1.0, 0.999, 0, 0.1]], np.float32)
    reflected = np.array([[[1.0, 1.0]] * 3], np.float32)  # at the group's normal
    one, up = np.ones(1, np.int64), np.array([[0, 1, 0]], np.float32)
    normal = np.array([[np.sin(lean), np.cos(lean), 0]], np.float32)
    beside = np.array([[5, -9, -9], [5, 9, -9], [5, 0, 90]], np.float32)
    arrived, sent = np.zeros((2, 1, 3))
    ray_kernels.cast(
        reflected,
        patches,
        np.arange(2),
        np.eye(3, dtype=np.float32),
        np.array([0, 1]),
        0 * one,
        0 * up,
        up,
        normal,
        np.zeros(1, np.float32),
        np.float32(0.1),
        np.float32(1e-4),
        0 * one,
        0 * one,
        one,
        4096,
        1,
        *RayTree(beside, np.arange(3)[None]).arrays,
        np.ones(2, np.float32),
        up,
        arrived,
        sent,
    )
    lamp = np.array([np.sqrt(1 - 0.1**2), 0.1, 0])
    hidden = 10 * float(normal[0] @ lamp)
    expected = np.cos(lean) / (np.cos(lean) + hidden)
    np.testing.assert_allclose(arrived / sent, expected, atol=0.01)


@pytest.mark.parametrize("across", [1, 4])
def test_of_several_narrow_lobes_all_count_though_a_point_follows_one(across):
    """A pixel with fewer points than lobes has points that follow each of them."""
    kinds, weights = ("ggx",) * 3, np.array([0.1, 0.2, 0.6])
    mixture = Mixture(
        kinds,
        np.array([0.0]),
        np.log([[0.004, 0.015, 0.025]]),
        np.zeros((1, 3)),
        np.repeat(weights[None, :, None], 3, axis=2),
    )
    light = np.ones((64, 128, 3), np.float32)
    direct = DirectLight(mixture, light, np.eye(3))
    assert direct.narrow == 3
    size, count = 8, (8 * across) ** 2
    up = np.tile(np.array([[0, 0, 1]], np.float32), (count, 1))
    flat, segments = np.zeros(count, np.float32), np.ones(count, np.uint8)
    surface = Surface(np.ones((8 * across,) * 2, bool), up, up, flat, segments, flat)
    points = direct_light.Points(across, direct_light.SHIFTS[1], samples=1)
    far = RayTree(np.array([[9, 9, 9], [9, 9.1, 9], [9.1, 9, 9]], np.float32), np.arange(3)[None])
    lens = Camera(size=(size, size))
    share = ShadowRays(far).share([direct], [surface], lens, np.eye(3), points, 4, 1)
    assert share.arrived == pytest.approx(share.sent)
    per_ray = share.sent / (4 * across**2)
    np.testing.assert_allclose(per_ray.mean((0, 1)), direct.at(up[:1], 4096)[0], rtol=0.03)


def wall_and_floor():
    """A floor in the plane z = 0 and a wall upon it that faces +y, as a mesh of the factory."""
    from factory.shapes.mesh import finish

    floor = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    wall = [[-1, 0.2, 0], [1, 0.2, 0], [1, 0.2, 0.9], [-1, 0.2, 0.9]]
    corners = np.array([*floor, *wall], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    return finish("wall", "test", corners, faces, crease_deg=10.0)


@pytest.mark.blender
@pytest.mark.parametrize("material", ["matte", "steel"])
def test_direct_light_times_the_share_is_what_cycles_shows(studio, material):
    light = np.full((64, 128, 3), 0.2, np.float32)
    light[20:24, 40:44] = 30.0
    mixture = (
        Mixture.lambert((0.6, 0.5, 0.4))
        if material == "matte"
        else load_catalogue()["steel"].mixture
    )
    studio.set_camera(Camera(size=(48, 48), elevation_deg=35.0))
    studio.set_shape(wall_and_floor())
    studio.set_light(light, 0)
    studio.set_materials([mixture])
    studio.set_view(0.4)
    mask = studio.geometry().mask
    direct = studio.direct_light(64)
    shares = [studio.visible_share(64, 8, seed, half) for seed, half in ((1, 0), (2, 1))]
    shadowed = direct.radiance * shares[0].add(shares[1]).factor
    cycles = studio.picture(512, 7, "shadow")[0]
    blocked = direct.radiance[mask].mean() - cycles[mask].mean()
    assert blocked > 0.1 * cycles[mask].mean()  # there are shadows
    assert abs(shadowed[mask].mean() - cycles[mask].mean()) < 0.05 * blocked
    off = np.abs(shadowed - cycles)[mask].mean()
    assert off < 0.15 * np.abs(direct.radiance - cycles)[mask].mean()


@pytest.mark.blender
@pytest.mark.parametrize("kind", ["beckmann", "ggx", "ashikhmin_shirley"])
def test_what_a_mirror_shows_is_blocked_where_cycles_blocks_it(studio, kind):
    """A wall hides dim texels of the light from some points and bright ones from others.

    With lobes that are spread to α = 0.02, and normals rounded, the last ratio is 0.047 and more.
    """
    light = np.random.default_rng(5).gamma(0.3, size=(64, 128, 3)).astype(np.float32)
    studio.set_camera(Camera(size=(48, 48), elevation_deg=35.0))
    studio.set_shape(wall_and_floor())
    studio.set_light(light, 0)
    studio.set_materials([Mixture.constant(kind, 0.004, [0.8] * 3)])
    studio.set_view(0.4)
    mask = studio.geometry().mask
    direct = studio.direct_light(256)
    shares = [studio.visible_share(256, 4, seed, half) for seed, half in ((1, 0), (2, 1))]
    shadowed = direct.radiance * shares[0].add(shares[1]).factor
    cycles = studio.picture(2048, 7, "shadow")[0]
    blocked = np.abs(direct.radiance - cycles)[mask].mean()
    assert blocked > 0.1 * cycles[mask].mean()
    assert np.abs(shadowed - cycles)[mask].mean() < 0.025 * blocked


def tube():
    """An upright tube of ten sides whose normals are those of a round one."""
    from factory.shapes.mesh import finish

    turn = 2 * np.pi * np.arange(10) / 10
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    low, high = (np.c_[ring, np.full(10, z)] for z in (-1.0, 1.0))
    k, after = np.arange(10), (np.arange(10) + 1) % 10
    faces = np.concatenate([np.c_[k, after, after + 10], np.c_[k, after + 10, k + 10]])
    caps = [[0, i + 1, i] for i in range(1, 9)] + [[10, 10 + i, 11 + i] for i in range(1, 9)]
    faces = np.concatenate([faces, caps])
    return finish("tube", "test", np.concatenate([low, high]), faces, crease_deg=60.0)


@pytest.mark.blender
@pytest.mark.parametrize("material", ["matte", "black-oxidized-steel"])
def test_coarse_smooth_meshes_do_not_shade_themselves_at_their_edges(studio, material):
    """Nor do they in Cycles, which lifts what shadow rays leave to the smooth surface."""
    light = np.full((64, 128, 3), 0.05, np.float32)
    light[28:36, 112:120] = 5.0  # from the side, so that it grazes facets
    mixture = (
        Mixture.lambert((0.6, 0.5, 0.4))
        if material == "matte"
        else load_catalogue()[material].mixture
    )
    studio.set_camera(Camera(size=(40, 40), elevation_deg=10.0))
    studio.set_shape(tube())
    studio.set_light(light, 0)
    studio.set_materials([mixture])
    studio.set_view(0.2)
    mask = studio.geometry().mask
    direct, shadow = (studio.picture(128, 7, tier)[0] for tier in ("direct", "shadow"))
    assert shadow[mask].mean() == pytest.approx(direct[mask].mean(), rel=1e-3)
    factor = studio.visible_share(64, 4, 1, 0).factor
    arrived = (direct * factor)[mask].mean() / direct[mask].mean()
    assert arrived == pytest.approx(1, abs=1e-3)


def test_points_of_further_turns_fill_the_gaps_between_the_others():
    points = direct_light.Points(16, direct_light.SHIFTS[4], samples=1)
    turns = [np.array(direct_light.turn_points(points, turn).shifts) for turn in range(16)]
    np.testing.assert_allclose(turns[0], direct_light.SHIFTS[4])
    every = np.concatenate(turns)
    assert ((every >= -0.5) & (every < 0.5)).all()
    cells = np.floor((every + 0.5) * 4).astype(int)
    assert len({tuple(cell) for cell in cells}) == 16  # of each quarter of a step, either way


@pytest.mark.blender
@pytest.mark.parametrize("turn", [0, 3])
def test_either_half_has_points_of_its_own_in_every_turn(studio, turn, monkeypatch):
    from factory.render.shadow_rays import ShadowRays
    from factory.shapes.catalogue import load

    studio.set_camera(Camera(size=(8, 8)))
    studio.set_shape(load("cube"))
    studio.set_light(np.ones((64, 128, 3), np.float32), 0)
    studio.set_materials([Mixture.lambert((0.6, 0.5, 0.4))])
    studio.set_view(0.4)
    places = []
    real = ShadowRays.share

    def share(self, direct, grids, lens, rotation, points, *others):
        places.append(set(points.shifts))
        return real(self, direct, grids, lens, rotation, points, *others)

    monkeypatch.setattr(ShadowRays, "share", share)
    for half in (0, 1):
        studio.visible_share(64, 1, 1, half, None, turn)
    assert len(places[0]) == len(places[1]) == 2 and not places[0] & places[1]
    plain = set(direct_light.SHIFTS[4])
    assert (places[0] | places[1] == plain) == (turn == 0)


@pytest.mark.blender
def test_the_point_of_a_pixel_stays_in_its_centre_in_every_turn(studio):
    """A cube, seen at pixels' centres: no ray meets the surface that it leaves."""
    from factory.shapes.catalogue import load

    studio.set_camera(Camera(size=(24, 24), pixel="centre"))
    studio.set_shape(load("cube"))
    studio.set_light(np.ones((64, 128, 3), np.float32), 0)
    studio.set_materials([Mixture.lambert((0.6, 0.5, 0.4))])
    studio.set_view(0.4)
    mask = studio.geometry().mask
    for turn in (0, 1, 7):
        assert studio.visible_share(64, 16, 1, 0, None, turn).factor[mask].mean() >= 0.999


@pytest.mark.blender
@pytest.mark.parametrize(("shape", "least"), [("cube", 0.999), ("sphere", 0.97)])
def test_no_ray_meets_the_surface_that_it_leaves(studio, shape, least):
    """Both are convex; a sphere's facets lean a little from its normals."""
    from factory.shapes.catalogue import load

    light = RNG.gamma(0.3, size=(64, 128, 3)).astype(np.float32)
    studio.set_camera(Camera(size=(48, 48)))
    studio.set_shape(load(shape))
    studio.set_light(light, 0)
    studio.set_materials([Mixture.lambert((0.6, 0.5, 0.4))])
    studio.set_view(0.4)
    mask = studio.geometry().mask
    factor = studio.visible_share(16, 16, 1, 0).factor[mask]
    assert factor.mean() >= least


@pytest.mark.blender
def test_indirect_light_is_what_further_bounces_add(studio):
    light = np.full((64, 128, 3), 0.5, np.float32)
    studio.set_camera(Camera(size=(40, 40), elevation_deg=35.0))
    studio.set_shape(wall_and_floor())
    studio.set_light(light, 0)
    studio.set_materials([Mixture.lambert((0.8, 0.7, 0.6))])
    studio.set_view(0.4)
    full, shadow = (studio.portion(0, 8, 5, tier) for tier in ("full", "shadow"))
    assert full.indirect.max() > 0.02 and not shadow.indirect.any()
    np.testing.assert_allclose(full.indirect, full.noisy - shadow.noisy, atol=2e-6)
