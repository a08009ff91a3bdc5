"""General shapes are closed, repeatable, distinct and varied, and whole families are held out."""

import hashlib

import numpy as np
import pytest

from factory.shapes.catalogue import load
from factory.shapes.creases import edge_pairs
from factory.shapes.general import FAMILIES, TEST_ONLY, fields
from factory.shapes.general.isosurface import surface_of
from factory.shapes.raster import silhouette
from manifests import splits

SEEDS = 2


@pytest.fixture(scope="module", params=[*FAMILIES, *TEST_ONLY])
def family(request):
    return request.param


@pytest.fixture(scope="module")
def meshes(family):
    return [load(f"{family}:{seed}") for seed in range(SEEDS)]


def test_a_general_shape_lies_in_the_unit_sphere_and_closes(meshes, family):
    for mesh in meshes:
        assert mesh.category == family
        radius = np.linalg.norm(mesh.vertices, axis=1).max()
        assert abs(radius - 1) < 1e-9  # float64 rounding of a centre and a scale
        counts = edge_pairs(mesh.faces)[3]
        assert (counts % 2 == 0).all() and (counts > 2).mean() <= 0.002
        # fewer show facets at 128²; more take longer to render than a car's 37,000 twice over
        assert 2_000 <= mesh.report.triangles <= 90_000
        assert np.abs(np.linalg.norm(mesh.corner_normals, axis=2) - 1).max() < 1e-6  # float32


def test_seeds_of_a_family_have_hashes_of_their_own(meshes):
    assert len({mesh.hash for mesh in meshes}) == SEEDS


@pytest.mark.parametrize(
    "spec",
    [
        *("dish:1", "metaball:1", "extrusion:1", "cushion:1", "tool:1"),
        *("umbrella:1", "seashell:1", "screw:1", "cycle:1"),
    ],
)
def test_a_seed_gives_the_same_shape_again(spec):
    """One family of each module, since all draw their numbers in one place."""
    first, again = load(spec), load(spec)
    assert first.hash == again.hash
    assert np.array_equal(first.vertices, again.vertices)


def test_seeds_of_a_family_differ_in_their_silhouettes(meshes):
    masks = [np.stack([silhouette(mesh, a, 0.4, 48) for a in (0.0, 0.9)]) for mesh in meshes]
    # the nearest of these pairs, two hollow boxes of `carving`, overlap by 0.83
    assert (masks[0] & masks[1]).sum() / (masks[0] | masks[1]).sum() < 0.97


@pytest.mark.parametrize(
    ("field", "distance"),
    [
        (fields.ellipsoid((0.7, 0.7, 0.7)), lambda p: np.linalg.norm(p, axis=1) - 0.7),
        (fields.torus(0.7, 0.2), fields.torus(0.7, 0.2)),
        (fields.box((0.6, 0.4, 0.5), 0.2), fields.box((0.6, 0.4, 0.5), 0.2)),
    ],
    ids=["ball", "torus", "box"],
)
def test_a_surface_lies_on_its_field_and_looks_outward(field, distance):
    surface = surface_of(field, 1.0, 48)
    assert np.abs(distance(surface.vertices)).max() < 1e-6  # three of Newton's steps
    centres = surface.vertices[surface.faces].mean(1)
    corners = surface.vertices[surface.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert (field(centres + 0.02 * normals) > field(centres)).all()


def test_a_field_without_a_surface_is_refused():
    with pytest.raises(ValueError, match="no surface"):
        surface_of(lambda p: np.ones(p.shape[:-1]))


def test_an_outlines_distance_is_that_to_its_edges():
    square = fields.Outline([np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)])
    places = np.array([[0.0, 0.0], [0.5, 0.0], [1.5, 0.0], [0.0, -1.25], [1.3, 1.4]])
    expected = [-1.0, -0.5, 0.5, 0.25, 0.5]
    # half a cell of the table where the distance has a ridge, at the middle
    assert np.abs(square(*places.T) - expected).max() < 0.006


def test_whole_families_are_held_out_of_training():
    names = [(f"{family}:{k}", family) for family in FAMILIES for k in (0, 10**12)]
    shapes = [(name, family, hashlib.sha256(name.encode()).hexdigest()) for name, family in names]
    roles = splits.shape_roles(shapes, "general")
    sides = {family: {roles[f"{family}:{k}"] for k in (0, 10**12)} for family in FAMILIES}
    assert all(len(side) == 1 for side in sides.values())
    held_out = {family for family, side in sides.items() if side == {"test"}}
    assert held_out == {"dish", "knot", "letter", "tool"}


def test_every_general_family_has_a_rule():
    assert set(FAMILIES) <= set(splits.rules()["general"]["shapes"])
    assert set(TEST_ONLY) == set(splits.rules()["test_only"])
    assert not set(TEST_ONLY) & set(FAMILIES)
    keys = [key for _, key in (FAMILIES | TEST_ONLY).values()]
    assert len(set(keys)) == len(keys)  # or two families would draw the same numbers
