"""Polygons cut into triangles: their area, their edges, nothing twice and no hole, whatever their
shape.
"""

import tracemalloc

import numpy as np
import pytest

from factory.shapes import ears, polygons
from factory.shapes.ears import TooLarge
from factory.shapes.fans import fans
from factory.shapes.mesh_import import open_mesh
from factory.shapes.polygons import triangulate
from tests.support.polygon_outlines import comb, obj_of, spiral, star

L_SHAPE = np.array([(0, 0), (4, 0), (4, 4), (2, 4), (2, 2), (0, 2)], float)


def shoelace(xy):
    return 0.5 * float((xy[:, 0] * np.roll(xy[:, 1], -1) - np.roll(xy[:, 0], -1) * xy[:, 1]).sum())


def areas(vertices, faces):
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def tilted(xy, rng):
    """The polygon (C, 2) somewhere in space, and by how much lengths grow."""
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    scale = 10.0 ** rng.integers(-3, 4)
    return scale * (np.c_[xy, np.zeros(len(xy))] @ rotation.T + rng.normal(size=3)), scale


def cut(vertices, first=0):
    """Triangles of one polygon that begins at any of its corners, and how many polygons cross
    themselves.
    """
    faces, _, crossing = triangulate(
        vertices, np.roll(np.arange(len(vertices)), -first), np.array([len(vertices)])
    )
    return faces, crossing


def edges(pairs):
    return {tuple(sorted(pair)) for pair in pairs.tolist()}


def outer_edges(faces):
    """Edges of one triangle, and the most triangles that any edge has."""
    every = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, counts = np.unique(every, axis=0, return_counts=True)
    return edges(unique[counts == 1]), counts.max()


def ring(count):
    return edges(np.stack([np.arange(count), np.roll(np.arange(count), -1)], axis=1))


def polyomino(rng, cells):
    """The outline of random unit squares that hang together by edges, a corner at each unit of
    length: many in a line.
    """
    squares = [(0, 0)]
    while len(squares) < cells:
        x, y = squares[rng.integers(len(squares))]
        dx, dy = ((1, 0), (-1, 0), (0, 1), (0, -1))[rng.integers(4)]
        if (x + dx, y + dy) not in squares:
            squares.append((x + dx, y + dy))
    # A step along each square's side that has no neighbour; where two outlines touch at a corner,
    # keep to the left one
    steps = {}
    for x, y in squares:
        for start, end, beyond in (
            ((x, y), (x + 1, y), (x, y - 1)),
            ((x + 1, y), (x + 1, y + 1), (x + 1, y)),
            ((x + 1, y + 1), (x, y + 1), (x, y + 1)),
            ((x, y + 1), (x, y), (x - 1, y)),
        ):
            if beyond not in squares:
                steps.setdefault(start, []).append(end)
    place = first = min(steps)
    outline, ahead = [], None
    while not outline or place != first:
        ends = steps[place]
        if ahead is not None:
            ends.sort(
                key=lambda end: ahead[0] * (end[1] - place[1]) - ahead[1] * (end[0] - place[0])
            )
        end = ends.pop()
        outline.append(place)
        ahead, place = (end[0] - place[0], end[1] - place[1]), end
    return np.array(outline, float)


def with_a_hole(outside, inside):
    """A polygon around a hole: out along a bridge from the outer corner 0 to the hole's corner 0,
    round it, and back.
    """
    return np.concatenate(
        [outside[:1], inside[:1], inside[:0:-1], inside[:1], outside[:1], outside[1:]]
    )


@pytest.mark.parametrize("first", range(6))
def test_an_l_has_its_own_area_wherever_it_begins(first):
    faces, crossing = cut(np.c_[L_SHAPE, np.zeros(6)], first)
    # the fan of one of them: 16
    assert (
        areas(np.c_[L_SHAPE, np.zeros(6)], faces).sum() == pytest.approx(12, rel=1e-12)
        and crossing == 0
    )


def test_hundreds_of_polygons_keep_their_area_and_their_edges(rng):
    """Stars, outlines of squares with corners in a line and touching corners; half a second for
    all.
    """
    for trial in range(200):
        xy = (
            polyomino(rng, int(rng.integers(2, 30)))
            if trial % 2
            else star(int(rng.integers(4, 40)), 0.05, rng)
        )
        vertices, scale = tilted(xy, rng)
        faces, crossing = cut(vertices, int(rng.integers(len(xy))))
        assert len(faces) == len(xy) - 2 and crossing == 0
        # 40 sums of rounding at 1e-16
        assert areas(vertices, faces).sum() == pytest.approx(scale**2 * shoelace(xy), rel=1e-9)
        assert outer_edges(faces) == (ring(len(xy)), 2 if len(faces) > 1 else 1)


@pytest.mark.parametrize("count", [3, 4, 7, 40])
def test_a_hole_behind_a_bridge_stays_a_hole(count, rng):
    turn = 2 * np.pi * np.arange(count) / count
    ball = np.c_[np.cos(turn), np.sin(turn)]
    xy = with_a_hole(ball * 2, ball)
    vertices, scale = tilted(xy, rng)
    faces, crossing = cut(vertices, 1)
    assert crossing == 0
    assert areas(vertices, faces).sum() == pytest.approx(
        0.75 * scale**2 * shoelace(ball * 2), rel=1e-9
    )


def test_polygons_of_a_mesh_are_cut_together_each_as_it_would_be_alone(rng):
    several = [star(int(rng.integers(3, 30)), 0.1, rng) for _ in range(60)] + [
        L_SHAPE,
        comb(5),
        spiral(40),
    ]
    points = [tilted(xy, rng)[0] for xy in several]
    lengths = np.array([len(p) for p in points])
    faces, owner, _ = triangulate(np.concatenate(points), np.arange(lengths.sum()), lengths)
    start = np.cumsum(lengths) - lengths
    for k, alone in enumerate(points):
        np.testing.assert_array_equal(faces[owner == k] - start[k], cut(alone)[0])
    assert (np.diff(owner) >= 0).all()


def test_convex_polygons_and_quads_stay_the_fans_that_they_were(rng):
    """Plane or not, with corners in a line or doubled: the hash of every such mesh stays."""
    for count in (3, 4, 5, 12, 100):
        angle = np.sort(rng.uniform(0, 2 * np.pi, count))
        points = np.c_[np.cos(angle), np.sin(angle), 0.1 * rng.normal(size=count) * (count < 5)]
        points = (
            np.insert(points, 1, [points[1], (points[0] + points[1]) / 2], axis=0)
            if count > 4
            else points
        )
        faces, _ = cut(points)
        np.testing.assert_array_equal(
            faces, fans(np.arange(len(points)), np.array([len(points)]))[0]
        )


def test_a_notch_less_deep_than_vertices_are_welded_is_none(rng):
    square = np.array([(0, 0, 0), (0.5, 1e-7, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    fan = fans(np.arange(5), np.array([5]))[0]
    np.testing.assert_array_equal(triangulate(square, np.arange(5), np.array([5]), 1e-6)[0], fan)
    square[1, 1] = 1e-5
    assert areas(
        square, triangulate(square, np.arange(5), np.array([5]), 1e-6)[0]
    ).sum() == pytest.approx(1 - 0.5e-5, rel=1e-12)


def test_corners_in_a_line_are_cut_without_flat_triangles_where_the_fan_is_wrong():
    corners = [
        (0, 0),
        (1, 0),
        (2, 0),
        (3, 0),
        (4, 0),
        (4, 2),
        (4, 4),
        (2, 4),
        (2, 3),
        (2, 2),
        (1, 2),
        (0, 2),
        (0, 1),
    ]
    vertices = np.c_[np.array(corners, float), np.zeros(len(corners))]
    for first in range(len(corners)):
        faces, _ = cut(vertices, first)
        fan = fans(np.roll(np.arange(len(corners)), -first), np.array([len(corners)]))[0]
        # the corner sees every other: the fan stays, flat triangles and all
        if areas(vertices, fan).sum() == 12:
            np.testing.assert_array_equal(faces, fan)
        else:
            assert (
                areas(vertices, faces).sum() == pytest.approx(12)
                and areas(vertices, faces).min() > 0.1
            )


def test_a_polygon_that_is_not_plane_is_cut_as_its_shadow_is(rng):
    vertices = np.c_[L_SHAPE, 0.2 * rng.normal(size=6)]
    for first in range(6):
        faces, crossing = cut(vertices, first)
        assert crossing == 0
        # seen along its own normal, some degrees off
        assert areas(np.c_[L_SHAPE, np.zeros(6)], faces).sum() == pytest.approx(12, rel=0.1)


@pytest.mark.parametrize(
    "corners",
    [
        [(0, 0), (1, 1), (1, 0), (0, 1)],  # two triangles that cancel
        [(0, 0), (2, 2), (2, 0), (0, 1)],
        [(np.cos(k), np.sin(k)) for k in 0.8 * np.pi * np.arange(5)],  # a pentagram
        [(0, 0)] * 5,
        [(0, 0), (1, 0), (2, 0), (1, 0), (0, 0)],
        [(0, 0), (4, 0), (4, 0), (4, 4), (2, 4), (2, 2), (2, 2), (0, 2), (0, 0)],
    ],
)
def test_crossing_doubled_and_collapsed_polygons_are_cut_without_a_hole(corners):
    vertices = np.c_[np.array(corners, float), np.zeros(len(corners))]
    for first in range(len(corners)):
        faces, crossing = cut(vertices, first)
        assert len(faces) == len(corners) - 2 and outer_edges(faces)[0] == ring(len(corners))
        whole = abs(shoelace(vertices[:, :2]))
        assert crossing == (areas(vertices, faces).sum() > whole + 1e-9)


def test_random_points_are_cut_and_counted_as_crossing(rng):
    faces, crossing = cut(np.c_[rng.random((500, 2)), np.zeros(500)])
    assert len(faces) == 498 and crossing == 1


@pytest.mark.parametrize("shape", ["star", "comb", "spiral", "random"])
def test_four_thousand_corners_take_few_comparisons(shape, rng, monkeypatch):
    # 0.3 to 2.8 million pairs are compared; all pairs of corners and edges are 16 million
    monkeypatch.setattr(ears, "MOST_TESTS", 5_000_000)
    make = {
        "star": lambda: star(4000, 0.3, rng),
        "comb": lambda: comb(1000),
        "spiral": lambda: spiral(4000),
    }
    xy = make[shape]() if shape in make else rng.random((4000, 2))
    faces, crossing = cut(np.c_[xy, np.zeros(len(xy))])
    assert crossing == (shape == "random")
    if shape != "random":
        assert areas(np.c_[xy, np.zeros(len(xy))], faces).sum() == pytest.approx(
            shoelace(xy), rel=1e-9
        )


def test_memory_stays_small(rng):
    vertices = np.c_[star(4000, 0.3, rng), np.zeros(4000)]
    tracemalloc.start()
    cut(vertices)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100e6  # 500 bytes a corner, and the pairs that are tested at a time


def test_polygons_beyond_the_bounds_are_refused_before_time_is_spent(monkeypatch, tmp_path):
    monkeypatch.setattr(polygons, "MOST_CORNERS", 100)
    with pytest.raises(TooLarge, match="one of 102 corners"):
        cut(np.c_[comb(25), np.zeros(102)])
    monkeypatch.setattr(polygons, "MOST_CORNERS", 1000)
    monkeypatch.setattr(ears, "MOST_TESTS", 10)
    with pytest.raises(TooLarge):
        cut(np.c_[comb(25), np.zeros(102)])
    path = tmp_path / "comb.obj"
    path.write_text(
        "".join(f"v {x} {y} 0\n" for x, y in comb(25))
        + "f "
        + " ".join(map(str, range(1, 103)))
        + "\n"
    )
    with pytest.raises(
        ValueError,
        match=(
            r"expected polygons that are soon cut into triangles, found one of 102 corners"
            r" \(triangulate"
        ),
    ):
        open_mesh(path)


@pytest.mark.parametrize("kind", ["convex", "star"])
def test_a_mesh_file_with_a_polygon_of_four_thousand_corners_is_read_without_much_work(
    tmp_path, kind, rng, monkeypatch
):
    """Its slivers filled the frame with boxes thousands of times when back faces were counted."""
    monkeypatch.setattr(ears, "MOST_TESTS", 5_000_000)
    xy = star(4000, 1.0 if kind == "convex" else 0.5, rng)
    path = tmp_path / "ngon.obj"
    path.write_text(obj_of(xy))
    mesh = open_mesh(path)
    assert mesh.report.triangles == 3998 and mesh.report.open_edges == 4000
