"""Direct light by the closed form against Cycles, where meshes are coarse and views grazing."""

import numpy as np
import pytest

pytest.importorskip("numba")

from factory.render import camera
from factory.render.validation import reference
from factory.shapes.primitives import sphere
from manifests.materials import load_catalogue
from manifests.schema import Camera
from shaders import direct_light, tone
from shaders.mixture import Mixture

pytestmark = pytest.mark.blender
SIZE = 48
SAMPLES = 512
COARSE, FINE = 1, 5  # subdivisions of an icosahedron


@pytest.fixture(autouse=True)
def soft_light_and_a_lamp(studio):
    studio.set_camera(Camera(size=(SIZE, SIZE), pixel="centre"))
    L = reference.soft_light().astype(np.float32)
    L[20:22, 30:33] = 40
    studio.set_shape(sphere(FINE))
    studio.set_light(L, 17)


def error(studio, mixture, level):
    """The closed form's display error, without Cycles' noise."""
    studio.set_shape(sphere(level))
    studio.set_view(0.3)
    studio.set_materials([mixture])
    surface = studio._surface()
    mask = surface.mask
    pictures = [studio.picture(SAMPLES, seed, "direct")[0] for seed in (1, 2)]
    exposure = tone.auto_exposure((pictures[0] + pictures[1]) / 2, mask)
    first, second = (tone.display(each[mask], exposure) for each in pictures)
    exact = tone.display(studio.direct_light().radiance[mask], exposure)
    # a ray that passes the silhouette meets another surface than the one through the centre
    steady = np.abs(first - second).max(-1) < 60
    return float(((exact - first) * (exact - second)).mean(-1)[steady].mean())


@pytest.mark.parametrize("name", ["natural-209", "pink-fabric2", "brass", "gold-paint"])
def test_measured_materials_on_a_fine_sphere(studio, name):
    assert error(studio, load_catalogue()[name].mixture, FINE) < 1


def test_a_wide_lobe_at_grazing_angles_is_as_bright_as_cycles_shows_it(studio, monkeypatch):
    mixture = Mixture.constant("ashikhmin_shirley", 0.75, [0.6, 0.5, 0.4])
    assert error(studio, mixture, FINE) < 0.3
    monkeypatch.setattr(
        direct_light.DirectLight,
        "misdirected",
        lambda self, n, facets=None: np.zeros_like(n, np.float32),
    )
    studio._direct_light.forget_closed_forms()
    assert error(studio, mixture, FINE) > 5
    studio._direct_light.forget_closed_forms()


@pytest.mark.parametrize("alpha, gain", [(0.5, 1), (0.15, 4)])
def test_narrower_lobes_end_at_the_facets_of_a_coarse_sphere(studio, monkeypatch, alpha, gain):
    mixture = Mixture.constant("ggx", alpha, [0.6, 0.5, 0.4])
    with_facets = error(studio, mixture, COARSE)
    at = direct_light.DirectLight.at
    monkeypatch.setattr(
        direct_light.DirectLight, "at", lambda self, n, samples, *_, **__: at(self, n, samples)
    )
    without = error(studio, mixture, COARSE)
    assert with_facets < 0.6 and with_facets <= without / gain


def test_facets_are_those_of_the_mesh(studio):
    mesh = sphere(COARSE)
    studio.set_shape(mesh)
    studio.set_view(0.0)
    surface = studio._surface()
    corners = mesh.vertices[mesh.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    rotation = camera.camera_from_fixed_world(studio._lens)
    cosines = (surface.facets @ (across @ rotation.T).T).max(1)
    assert cosines.min() > 1 - 1e-5
    np.testing.assert_allclose(np.linalg.norm(surface.facets, axis=1), 1, atol=1e-5)
    assert (surface.facets * surface.normals).sum(1).min() > 0.9
