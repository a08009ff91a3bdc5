"""Lights of a map whose texels are split where a lobe is too narrow for them.

The sharpness of a measured lobe differs along its curves: many are narrow at grazing angles alone.
Under a distant viewer a texel has one θ_d for all pixels, half of the angle between it and the
viewer, so that those where no lobe is narrow can stay whole. Views of pixels that differ by up to
an angle have each θ_d within half of it.

H, W rows and columns of a map, P pixels, T lights; m (3, 3, 2, 6) one material.
"""

import functools
from collections.abc import Sequence

import numpy as np
import torch

from learn.engines.lights import Rotation
from learn.methods.light_tables import VIEWER, Lights, lights_and_energy, lights_at, order_in_tiles
from shaders.envmap import centres, directions, row_solid_angles
from shaders.spline import basis

INTERVALS = 64  # of θ_d in [0, π/2], at whose ends sharpness is known: 16 of each of the splines'
ANGLES = np.linspace(0, np.pi / 2, INTERVALS + 1)


def sharpness_along(m: torch.Tensor) -> torch.Tensor:
    """Return sharpness γ · max(κ, 1) of each channel and lobe at ANGLES.

    m        (…, 3, 3, 2, 6)
    Returns  (…, 3, 3, INTERVALS + 1)
    """
    along = basis(torch.as_tensor(ANGLES, dtype=m.dtype, device=m.device))
    kappa, gamma = torch.einsum("...ksjb,ab->j...ksa", m, along)
    return gamma * kappa.clamp(min=1)


def parts_of_texels(
    m: torch.Tensor,
    lobes: torch.Tensor,
    view: torch.Tensor | None,
    size: tuple[int, int],
    camera_from_light: np.ndarray,
    broadest: Sequence[float],
    splits: Sequence[int],
) -> np.ndarray:
    """Return into how many parts of its side each texel is to be split (H, W), 0 if none serve.

    m         a material
    lobes     (3, 3) bool, which channels and lobes count
    view      (P, 3) of each pixel, or None for a distant viewer
    size      H, W
    broadest  the largest sharpness that texels split so serve, of the first of `splits`, rising
    """
    w = directions(*size)[0] @ camera_from_light.T
    return parts_for(sharpest_at(m, lobes, view, w, size), broadest, splits)


def sharpest_at(
    m: torch.Tensor,
    lobes: torch.Tensor,
    view: torch.Tensor | None,
    w: np.ndarray,
    size: tuple[int, int],
) -> np.ndarray:
    """Return how sharp a lobe may be for any pixel in texels about some directions, (…).

    w     (…, 3) centres of texels, camera frame
    size  H, W of their map; other arguments as `parts_of_texels`
    """
    along = sharpness_along(m.detach())
    sharpest = torch.where(lobes[..., None], along, 0.0).amax((0, 1)).cpu().numpy()
    axis, spread = VIEWER, 0.0
    if view is not None:
        views = view.detach().double().cpu().numpy()
        axis = views.sum(0) / np.linalg.norm(views.sum(0))
        spread = float(np.arccos(np.clip((views @ axis).min(), -1, 1)))
    theta_d = np.arccos(np.clip(w @ axis, -1, 1)) / 2
    # a texel's corners are this far from its centre
    corner = np.hypot(np.pi / size[0], 2 * np.pi / size[1]) / 2
    step = ANGLES[1]
    around = int(np.ceil((corner + spread) / 2 / step)) + 1  # and the rounding of θ_d
    padded = np.pad(sharpest, around, mode="edge")
    largest = np.lib.stride_tricks.sliding_window_view(padded, 2 * around + 1).max(-1)
    return np.asarray(largest[np.rint(theta_d / step).astype(int)])


def parts_for(sharp: np.ndarray, broadest: Sequence[float], splits: Sequence[int]) -> np.ndarray:
    """Return the least of `splits` that serves each sharpness (…), 0 if none does.

    broadest  as for `parts_of_texels`
    """
    return np.asarray([*splits[: len(broadest)], 0])[np.searchsorted(broadest, sharp)]


def lights_of(
    light: torch.Tensor, camera_from_light: torch.Tensor, parts: np.ndarray
) -> tuple[Lights, torch.Tensor]:
    """`Lights` and E (T, 3), differentiable in light (H, W, 3), of split texels.

    parts  (H, W) of each texel's side; texels of 0 are left out
    """
    if (parts == 1).all():
        return lights_and_energy(light, camera_from_light)
    rotation = tuple(camera_from_light.double().flatten().tolist())
    lights, texels, solid_angles = _split(
        *parts.shape, rotation, np.ascontiguousarray(parts, np.uint8).tobytes()
    )
    places = torch.from_numpy(texels).to(light.device)
    areas = torch.as_tensor(solid_angles, dtype=light.dtype, device=light.device)
    return lights, light.reshape(-1, 3)[places] * areas[:, None]


@functools.lru_cache(maxsize=8)
def _split(
    height: int, width: int, rotation: Rotation, parts: bytes
) -> tuple[Lights, np.ndarray, np.ndarray]:
    """Return `Lights`, the texel (T,) of which each is a part, and its solid angle (T,) in sr.

    Those of equal parts come one after the other, in 4×4 tiles.
    """
    requested = np.frombuffer(parts, np.uint8).reshape(height, width)
    directions_, texels, areas = [], [], []
    for split in np.unique(requested[requested > 0]).astype(int):
        fine = height * split, width * split
        row, column = np.nonzero(requested == split)
        within = np.indices((split, split)).reshape(2, 1, -1)
        row = (split * row[:, None] + within[0]).ravel()
        column = (split * column[:, None] + within[1]).ravel()
        order = order_in_tiles(row, column)
        row, column = row[order], column[order]
        directions_.append(centres(row, column, *fine))
        texels.append(row // split * width + column // split)
        areas.append(row_solid_angles(*fine)[row])
    turned = np.concatenate(directions_) @ np.array(rotation).reshape(3, 3).T
    return lights_at(turned), np.concatenate(texels), np.concatenate(areas)
