"""Sets of directional lights as the kernels read them: directions in blocks, and their energies.

T lights
w  (T, 3) unit, camera frame, constant
E  (T, 3) radiance × solid angle
"""

import functools
from dataclasses import dataclass

import numpy as np
import torch

from learn.engines.layout import CONE_ENERGY, CONE_H_X, CONE_ROWS, LANES
from learn.engines.lights import Rotation, blocked
from shaders.dsbrdf import half_angles
from shaders.envmap import directions
from shaders.spline import basis

VIEWER = np.array([0.0, 0.0, 1.0])
SLACK = 1e-5  # radians by which cones are widened against rounding


@dataclass(frozen=True, eq=False)
class Lights:
    """Directions of lights in blocks of 16 neighbours; the last light pads the last block.

    w         (T, 3) float64
    geometry  (blocks, 9, 16) float32: w, h, and what rounding took off h
    cones     (wide blocks, CONE_ROWS, 16) float32 for learn.engines.culled_lists: the cones about w
              and about h; the material's rows are 0
    axes      (blocks, 3) float32: the axes of the cones about h
    basis     (blocks, 6, 16) float32: the spline's basis at each light's θ_d
    """

    w: np.ndarray
    geometry: np.ndarray
    cones: np.ndarray
    axes: np.ndarray
    basis: np.ndarray

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return len(self.geometry)

    @functools.cached_property
    def general_geometry(self) -> np.ndarray:
        """The lights' geometry (blocks, 6, 16) for learn.engines.general."""
        w = pad_to_blocks(self.w).T
        return blocked(np.concatenate([w, w - w.astype(np.float32)]))


def pad_to_blocks(w: np.ndarray) -> np.ndarray:
    """Return the directions (T, 3) with the last one repeated up to whole blocks."""
    return np.concatenate([w, np.broadcast_to(w[-1], (-len(w) % LANES, 3))])


def lights_at(w: np.ndarray) -> Lights:
    """Return the `Lights` of directions (T, 3), as a distant viewer at VIEWER sees them.

    Neighbours in order should be neighbours on the sphere.
    """
    filled = pad_to_blocks(w)
    h, theta_d = half_angles(filled, VIEWER)
    rest = h.T - h.T.astype(np.float32)
    cones = np.concatenate([cone(filled.reshape(-1, LANES, 3)), cone(h.reshape(-1, LANES, 3))], -1)
    rows = np.zeros((CONE_ROWS, len(cones) + -len(cones) % LANES))
    rows[:CONE_ENERGY, : len(cones)] = cones.T
    axes = np.ascontiguousarray(cones[:, CONE_H_X : CONE_H_X + 3], np.float32)
    return Lights(
        w,
        blocked(np.concatenate([filled.T, h.T, rest])),
        blocked(rows),
        axes,
        blocked(basis(theta_d).T),
    )


def cone(vectors: np.ndarray) -> np.ndarray:
    """Axis, cosine and sine of the half angle (…, 5) of a cone that holds vectors (…, K, 3).

    It is the whole sphere where one of them is 0.
    """
    axis = vectors.sum(-2)
    length = np.linalg.norm(axis, axis=-1, keepdims=True)
    axis = np.where(length > 1e-6, axis / np.maximum(length, 1e-6), VIEWER)
    cosine = np.clip((vectors * axis[..., None, :]).sum(-1).min(-1), -1.0, 1.0)
    whole = (np.abs(vectors).max(-1) == 0).any(-1)
    angle = np.where(whole, np.pi, np.minimum(np.arccos(cosine) + SLACK, np.pi))
    return np.concatenate([axis, np.cos(angle)[..., None], np.sin(angle)[..., None]], -1)


def order_in_tiles(row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Return the order (T,) of texels in 4×4 tiles, by their rows and columns (T,)."""
    return np.lexsort((column, row, column // 4, row // 4))


@functools.lru_cache(maxsize=8)
def map_lights(height: int, width: int, camera_from_light: Rotation) -> tuple[Lights, np.ndarray]:
    """The `Lights` of a map's texels in 4×4 tiles, and their places (T,) in the flattened map.

    All in numpy: a cached tensor from torch's inference mode could not join a graph later.
    """
    order = order_in_tiles(*np.divmod(np.arange(height * width), width))
    rotation = np.array(camera_from_light).reshape(3, 3)
    return lights_at(directions(height, width)[0].reshape(-1, 3)[order] @ rotation.T), order


def lights_and_energy(
    light: torch.Tensor, camera_from_light: torch.Tensor
) -> tuple[Lights, torch.Tensor]:
    """`Lights` and E (T, 3), differentiable in light (height, width, 3)."""
    height, width = light.shape[:2]
    lights, order = map_lights(height, width, tuple(camera_from_light.double().flatten().tolist()))
    solid_angle = torch.as_tensor(
        directions(height, width)[1], dtype=light.dtype, device=light.device
    )
    E = (light * solid_angle[..., None]).reshape(-1, 3)
    return lights, E[torch.from_numpy(order).to(light.device)]


def energy_blocks(E: np.ndarray, lights: Lights) -> np.ndarray:
    """E (3, T) as blocks (blocks, 3, 16) float32; padding lights are dark."""
    rows = np.zeros((3, LANES * lights.blocks), np.float32)
    rows[:, : E.shape[1]] = E
    return blocked(rows)
