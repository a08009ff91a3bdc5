"""Rotations of light maps, and of normals into the frame of each pixel's ray."""

import numpy as np
import pytest

from shaders.envmap import directions, mean_radiance, roll, rotated
from shaders.frames import camera_from_light, turned_to_viewer, view_vectors

TURNS = [camera_from_light(e, r) for e, r in ((0.4, 0.0), (-0.7, 0.3), (1.2, -2.0))]


def smooth_map(rng: np.random.Generator, width: int = 128) -> np.ndarray:
    """A map of degree two, so that interpolation between texels is nearly exact."""
    w, _ = directions(width // 2, width)
    a, b = rng.normal(size=(3, 3)), rng.normal(size=(3, 3, 3))
    return 10.0 + w @ a + np.einsum("hwi,ijc,hwj->hwc", w, b, w)


def test_no_rotation_leaves_a_smooth_map(rng: np.random.Generator) -> None:
    L = smooth_map(rng)
    np.testing.assert_allclose(rotated(L, np.eye(3)), L, rtol=2e-3)


def test_a_rotation_about_the_vertical_is_a_roll(rng: np.random.Generator) -> None:
    """Azimuth runs from +x through +z: a positive roll turns +x towards +z."""
    L, angle = smooth_map(rng), 2 * np.pi * 9 / 128
    s, c = np.sin(angle), np.cos(angle)
    turn = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    np.testing.assert_allclose(rotated(L, turn), roll(L, 9), rtol=2e-3)


@pytest.mark.parametrize("turn", TURNS)
def test_a_rotated_map_is_the_map_at_rotated_directions(
    turn: np.ndarray, rng: np.random.Generator
) -> None:
    w, _ = directions(64, 128)
    a = rng.normal(size=(3, 3))
    result, expected = rotated(10.0 + w @ a, turn), 10.0 + (w @ turn) @ a
    np.testing.assert_allclose(result, expected, rtol=2e-3)
    np.testing.assert_allclose(mean_radiance(result), mean_radiance(expected), rtol=1e-4)


@pytest.mark.parametrize("turn", TURNS)
def test_a_lamp_moves_to_where_the_rotation_takes_it_and_keeps_its_energy(turn: np.ndarray) -> None:
    w, solid_angle = directions(64, 128)
    centre = np.array([0.6, 0.48, 0.64])
    lamp = np.exp(60 * (w @ centre - 1))[..., None] * np.ones(3)
    result = rotated(lamp, turn)
    energy = (result[..., 0] * solid_angle).sum()
    assert energy == pytest.approx((lamp[..., 0] * solid_angle).sum(), rel=5e-3)
    mean = np.einsum("hw,hw,hwi->i", result[..., 0], solid_angle, w)
    angle = np.degrees(np.arccos(mean @ (turn @ centre) / np.linalg.norm(mean)))
    assert angle < 0.2


def test_a_ray_is_turned_to_the_viewer_and_back(rng: np.random.Generator) -> None:
    v = view_vectors(8, 12, fov=np.radians(60.0))
    np.testing.assert_allclose(
        turned_to_viewer(v, v), np.broadcast_to([0.0, 0.0, 1.0], v.shape), atol=1e-12
    )
    n = rng.normal(size=v.shape)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    turned = turned_to_viewer(n, v)
    np.testing.assert_allclose(turned[..., 2], (n * v).sum(-1), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(turned, axis=-1), 1.0, atol=1e-12)
    np.testing.assert_allclose(turned_to_viewer(turned, v, back=True), n, atol=1e-12)


def test_the_smallest_rotation_leaves_its_axis(rng: np.random.Generator) -> None:
    v = view_vectors(4, 4, fov=np.radians(50.0))
    axis = np.stack([v[..., 1], -v[..., 0], np.zeros((4, 4))], -1)
    np.testing.assert_allclose(turned_to_viewer(axis, v), axis, atol=1e-12)
    straight = view_vectors(4, 4)
    n = rng.normal(size=v.shape)
    np.testing.assert_array_equal(turned_to_viewer(n, straight), n)
