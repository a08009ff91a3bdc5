"""The z-buffer without Blender: what a test of every pixel against every face finds, in time that
slivers do not blow up.
"""

import numpy as np
import pytest

from factory.shapes import raster
from factory.shapes.catalogue import load
from factory.shapes.raster import HALF_EXTENT, back_faces, look
from shaders.frames import camera_from_world
from tests.support.polygon_outlines import fan_of_slivers

SIDES = [(0.0, 0.0), (0.0, np.pi / 2), (np.pi / 4, 0.6), (1.234, 0.2)]


def every_pixel_against_every_face(vertices, faces, camera, size):
    """(nearest depth, set of faces that have it) of each pixel that sees one, by brute force."""
    seen = vertices @ camera.T
    x, y = (
        (seen[:, 0] / HALF_EXTENT + 1) * size / 2 - 0.5,
        (1 - seen[:, 1] / HALF_EXTENT) * size / 2 - 0.5,
    )
    row, column = np.mgrid[:size, :size]
    result = {}
    for number, (a, b, c) in enumerate(faces):
        area = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
        if abs(area) <= 1e-12:
            continue
        weight = [
            ((x[p] - column) * (y[q] - row) - (y[p] - row) * (x[q] - column)) / area
            for p, q in ((b, c), (c, a), (a, b))
        ]
        depth = sum(w * seen[k, 2] for w, k in zip(weight, (a, b, c), strict=True))
        for place in zip(*np.nonzero(np.min(weight, axis=0) >= -1e-9), strict=True):
            result.setdefault(place, []).append((depth[place], number))
    return result


def meshes(rng):
    for name in ("cube", "disc"):
        mesh = load(name)
        yield mesh.vertices, mesh.faces
    for trial in range(9):
        vertices = rng.normal(size=(30, 3))
        vertices /= np.linalg.norm(vertices, axis=1).max()
        if trial % 3 == 1:
            vertices = np.round(vertices * 8) / 8  # edges through pixel centres
        if trial % 3 == 2:
            vertices[:, 1] *= 1e-4  # slivers
        yield vertices, rng.integers(0, 30, (40, 3))


def test_each_pixel_sees_a_nearest_face_and_none_is_missed(rng):
    for vertices, faces in meshes(rng):
        for azimuth, elevation in SIDES:
            camera = camera_from_world(azimuth, elevation)
            face, weight = look(vertices, faces, camera, 24)
            result = every_pixel_against_every_face(vertices, faces, camera, 24)
            assert set(zip(*np.nonzero(face >= 0), strict=True)) == set(result)
            for place, several in result.items():
                nearest = max(depth for depth, _ in several)
                # faces within rounding of the nearest, whose weights of slivers are no better than
                # 1e-16 / 1e-9 of their area
                assert face[place] in {
                    number for depth, number in several if depth > nearest - 1e-6
                }
                assert weight[place].sum() == pytest.approx(1, abs=1e-5)


def test_pictures_do_not_depend_on_how_many_faces_are_looked_at_together(rng, monkeypatch):
    for vertices, faces in meshes(rng):
        camera = camera_from_world(0.3, 0.2)
        together = look(vertices, faces, camera, 48)
        monkeypatch.setattr(raster, "CHUNK", 3000)
        apart = look(vertices, faces, camera, 48)
        monkeypatch.undo()
        same = together[0] == apart[0]  # of faces equally near, another may be seen
        seen = vertices[faces] @ camera[2]
        for one, other in zip(together[0][~same], apart[0][~same], strict=True):
            assert len(set(faces[one]) & set(faces[other])) or np.ptp(seen[[one, other]]) < 1e-6
        assert same.mean() > 0.95


def test_slivers_across_the_frame_cost_their_pixels_and_not_their_boxes(monkeypatch):
    """The boxes around a fan of 4,000 hold 37 million pixels; 50 thousand of them are tested."""
    vertices, faces = fan_of_slivers(4000)
    candidates, tested = raster._candidates, []

    def counted(*arguments):
        result = candidates(*arguments)
        tested.append(len(result[0]))
        return result

    monkeypatch.setattr(raster, "_candidates", counted)
    counts = back_faces(vertices, faces)
    assert 0 < sum(tested) < 200_000
    assert counts.sum() > 14_000  # a disc seen from ten sides of fourteen


def test_faces_that_fill_the_frame_thousands_of_times_are_looked_at_more_coarsely(monkeypatch):
    vertices, faces = fan_of_slivers(500)
    sizes = []
    monkeypatch.setattr(
        raster, "look", lambda v, f, camera, size: sizes.append(size) or look(v, f, camera, size)
    )
    back_faces(vertices, faces)
    assert set(sizes) == {96}
    monkeypatch.setattr(raster, "MOST_LOOKED_AT", 500_000)
    sizes.clear()
    counts = back_faces(vertices, faces)
    assert max(sizes) < 96 and counts[:, 0].sum() > 0
