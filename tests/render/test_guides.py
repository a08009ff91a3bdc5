"""What guides the denoiser: Cycles' own passes, and the surface's where a mirror shows the sky."""

import numpy as np
import pytest

pytestmark = pytest.mark.blender


def passes(length, diffuse=0.2):
    """Passes of a square whose denoising normals have a length in the mean."""
    covered = np.zeros((8, 8, 4), np.float32)
    covered[2:6, 2:6] = 1
    up = np.array([0, 0, 1], np.float32) * covered[..., :1]
    return {
        "Combined": covered,
        "Denoising Albedo": 0.9 * covered[..., :3],
        "Denoising Normal": length * up,
        "DiffCol": diffuse * covered[..., :3],
        "Normal": up[..., ::-1],
    }


@pytest.mark.parametrize("length, albedo, axis", [(0.9, 0.9, 2), (0.6, 0.9, 2), (0.1, 0.2, 0)])
def test_the_surface_guides_where_followed_normals_are_missing(length, albedo, axis):
    pytest.importorskip("bpy", reason="needs Blender as a module (pip install .[factory])")
    from factory.render import denoiser

    guides = denoiser.guides_of(passes(length))
    assert guides.shape == (8, 8, 6)
    np.testing.assert_allclose(guides[3, 3, :3], albedo)
    assert np.argmax(guides[3, 3, 3:]) == axis


@pytest.mark.parametrize("alpha", [0.5, 0.02])
def test_every_pixel_of_an_object_has_a_normal_and_passes_are_put_back(studio, alpha):
    """A mirror-like sphere mirrors the sky alone, which has no normal."""
    from factory.render.validation import reference
    from factory.shapes.catalogue import load
    from manifests.schema import Camera
    from shaders.mixture import Mixture

    mesh = load("sphere")
    studio.set_shape(mesh)
    studio.set_light(reference.soft_light())
    studio.set_materials([Mixture.constant("ggx", alpha, [0.6, 0.5, 0.4])] * mesh.segments)
    studio.set_camera(Camera(size=(32, 32)))
    studio.set_view(0.0)
    portion = studio.portion(0, 4, 7, "full")
    inside = portion.alpha > 0.99
    lengths = np.linalg.norm(portion.guides[inside][:, 3:], axis=1)
    assert lengths.min() > 0.9 and inside.sum() > 400
    layer = studio._scene.view_layers[0]
    assert not layer.use_pass_normal and not layer.use_pass_diffuse_color
    assert not layer.cycles.denoising_store_passes
