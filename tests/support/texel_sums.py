"""Direct light as a sum of shaders.closures over finely divided texels."""

import numpy as np

from shaders import envmap, frames

ROTATION = frames.camera_from_light()


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
