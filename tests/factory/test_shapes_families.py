"""Every family's shapes are sound, repeatable and distinct."""

from itertools import combinations

import numpy as np
import pytest

from factory.shapes.catalogue import FAMILIES, PAPER_COUNTS, load, specs
from factory.shapes.closed_surface import signed_volume
from factory.shapes.creases import edge_pairs
from factory.shapes.curves import superellipse
from factory.shapes.lofts import ellipsoid, revolve, rod, slab, tube
from factory.shapes.mesh import face_components
from factory.shapes.raster import back_faces, look, silhouette
from factory.shapes.rounded_boxes import cushion, rounded_box
from factory.shapes.shells import shell
from manifests.errors import InputError
from shaders.frames import camera_from_world

FIRST = 10
SEGMENT_OF = {
    "chair": ("seat", "leg"),
    "sofa": ("seat cushion", "foot"),
    "car": ("body", "tyre"),
    "monitor": ("screen", "casing"),
}


@pytest.fixture(scope="module", params=FAMILIES)
def family(request):
    return request.param


@pytest.fixture(scope="module")
def meshes(family):
    return [load(spec) for spec in specs(family, FIRST)]


def test_first_shapes_of_a_family_are_finite_in_the_unit_sphere_with_unit_normals(meshes):
    for mesh in meshes:
        assert np.isfinite(mesh.vertices).all()
        radius = np.linalg.norm(mesh.vertices, axis=1)
        assert abs(radius.max() - 1) < 1e-9  # float64 rounding of a centre and a scale
        assert np.abs(np.linalg.norm(mesh.corner_normals, axis=2) - 1).max() < 1e-6  # float32
        assert 3_000 <= mesh.report.triangles <= 45_000


def test_every_face_has_a_part_and_one_of_two_segments(meshes, family):
    for mesh in meshes:
        assert mesh.category == family and mesh.segments == 2
        assert set(np.unique(mesh.segment)) == {1, 2}
        assert len(mesh.part) == len(mesh.segment) == len(mesh.faces)
        assert set(np.unique(mesh.part)) == set(range(len(mesh.parts)))


def test_segments_are_what_the_parts_say(meshes, family):
    one, two = SEGMENT_OF[family]
    for segment, name in ((1, one), (2, two)):
        result = [
            mesh.segment[mesh.part == mesh.parts.index(name)]
            for mesh in meshes
            if name in mesh.parts
        ]
        assert result, f"no {name} among the first {FIRST}"
        assert all((part == segment).all() for part in result)


def test_every_piece_is_watertight_wound_alike_and_looks_outward(meshes):
    for mesh in meshes:
        _, _, same, counts = edge_pairs(mesh.faces)
        assert (counts == 2).all() and not same.any(), mesh.name
        piece = face_components(mesh.faces)
        corners = mesh.vertices[mesh.faces]
        volume = np.bincount(
            piece, np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
        )
        assert (volume > 0).all(), (
            f"{mesh.name}:"
            f" {[mesh.parts[mesh.part[piece == k][0]] for k in np.flatnonzero(volume <= 0)]}"
        )


def test_no_face_is_seen_from_behind(meshes):
    for mesh in meshes[:4]:
        counts = back_faces(mesh.vertices, mesh.faces).sum(0)
        # a pixel at the rim of two pieces that touch
        assert counts[1] <= 1e-4 * counts.sum(), mesh.name


def test_no_triangle_stands_twice(meshes):
    for mesh in meshes:
        corners = np.sort(
            np.round(mesh.vertices[mesh.faces] * 1e7)
            .astype(np.int64)
            .view([("", np.int64)] * 3)[..., 0],
            axis=1,
        )
        assert len(np.unique(corners, axis=0)) == len(corners), mesh.name


def test_a_seed_gives_the_same_shape_again_and_another_seed_another(meshes, family):
    again = load(f"{family}:3")
    assert again.hash == meshes[3].hash
    assert np.array_equal(again.vertices, meshes[3].vertices) and np.array_equal(
        again.corner_normals, meshes[3].corner_normals
    )
    assert len({mesh.hash for mesh in meshes}) == FIRST


def test_any_two_shapes_differ_in_their_silhouettes(meshes):
    masks = [np.stack([silhouette(mesh, a, 0.2, 48) for a in (0.0, 0.7, 1.6)]) for mesh in meshes]
    overlaps = [(one & two).sum() / (one | two).sum() for one, two in combinations(masks, 2)]
    # One pixel all round a car's outline is 4 % of its 48² picture; the nearest two of 130 cars
    # overlap by 0.968
    assert max(overlaps) < 0.975


def test_backs_stand_behind_seats_and_wheels_below_mirrors():
    def middle(mesh, part, axis):
        return mesh.vertices[mesh.faces[mesh.part == mesh.parts.index(part)]][..., axis].mean()

    for seed in range(FIRST):
        sofa, car = load(f"sofa:{seed}"), load(f"car:{seed}")
        if "back" in sofa.parts:
            assert middle(sofa, "back", 0) < middle(sofa, "seat cushion", 0), sofa.name
        assert middle(car, "tyre", 2) < middle(car, "mirror", 2)
        assert middle(car, "head light", 0) > middle(car, "tail light", 0)


def test_screens_are_seen_from_the_front_and_not_from_behind():
    for seed in range(FIRST):
        mesh = load(f"monitor:{seed}")
        seen = []
        for azimuth in (0.0, np.pi):
            face = look(mesh.vertices, mesh.faces, camera_from_world(azimuth, 0.1), 64)[0]
            seen.append((mesh.segment[face[face >= 0]] == 1).sum())
        assert seen[0] > 150 and seen[1] == 0, mesh.name


def test_the_papers_counts_are_listed():
    assert (
        {family: len(specs(family)) for family in FAMILIES}
        == PAPER_COUNTS
        == {"car": 130, "chair": 50, "sofa": 50, "monitor": 50}
    )


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("chiar:3", "did you mean chair"),
        (
            "chair:x",
            (
                "expected a whole number ≥ 0 of at most 100 digits after the colon, found 'x'"
                " (write chair:3"
            ),
        ),
        ("chair:-1", "found '-1'"),
        ("sphere:9", "a whole number from 0 to 8"),
        ("cube:2", "only sphere (level) and blob (seed) take a number"),
    ],
)
def test_a_wrong_spec_is_named_in_one_line(spec, said):
    with pytest.raises(InputError) as problem:
        load(spec)
    assert said in str(problem.value) and "\n" not in str(problem.value)


def test_surfaces_close_and_look_outward():
    """Each builder's surface: every edge has two faces that run it in opposite ways, and the volume
    is positive.
    """
    t = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    circle = np.stack([np.cos(t), np.sin(t), 0 * t], 1)
    cage = np.stack(
        np.broadcast_arrays(
            *np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 4), indexing="ij"), 0.0
        ),
        -1,
    )
    made = [
        tube([[0, 0, 0], [1, 0, 0], [1, 1, 0.5]], 0.1),
        tube(circle, 0.2, ring=True),
        rod([0, 0, 0], [0, 0.2, 1], 0.1, 0.05, square=6),
        slab(superellipse(32, 4), 0.2, 0.8),
        revolve([[0, 0], [0.5, 0], [0.4, 0.5], [0, 1]]),
        rounded_box([1, 2, 0.5], 0.1),
        cushion([1, 1, 0.3]),
        ellipsoid([1, 1, 0.5], 4),
        shell(cage, 0.05),
        rounded_box([1, 2, 0.5], 0.1).mirrored(),
    ]
    for vertices, faces in made:
        _, _, same, counts = edge_pairs(faces)
        assert (counts == 2).all() and not same.any()
        assert signed_volume(vertices, faces) > 0


def test_a_sphere_of_revolution_has_a_spheres_volume():
    angle = np.linspace(-np.pi / 2, np.pi / 2, 80)
    ball = revolve(np.stack([np.cos(angle), np.sin(angle)], 1), 160)
    # facets of 2.25°: 1 − sin(x)/x and its like
    assert abs(signed_volume(*ball) / (4 / 3 * np.pi) - 1) < 2e-3
