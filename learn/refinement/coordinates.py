"""The coordinates of refinement: for each property of Eq. 6 a vector z that L-BFGS moves.

z is 0 at the prediction, and its units are such that one step means about the same everywhere.

material  label* = label' + Σ z_k σ_k u_k: principal directions u of the training materials' labels,
          σ their spread; float64. Whose materials: see `principal_directions`
light     log L* = log L' + Σ z_j Y_j / (1 + l), real spherical harmonics of degree l, then scaled
          to unit mean luminance. So L* > 0, and the overall brightness stays with the material
normals   p* = p' + Σ of grids, coarse to fine, interpolated; p = n_xy/(1 + n_z) lies in the disk of
          the stereographic projection, in which the hemisphere that faces the viewer is |p| < 1:
          normals stay on it, of unit length
"""

import functools
import math

import numpy as np
import torch
import torch.nn.functional as F

from learn.networks.coding import unit_mean
from manifests.materials import load_catalogue
from shaders import envmap
from shaders.dsbrdf import SIZE

LEAST_SPREAD = 1e-3  # of a principal direction that is used, in units of a label
# of the mean: under it a texel is treated as this bright, so that it can become brighter
LEAST_LIGHT = 1e-3
LARGEST_CHANGE = 6.0  # of log L: four hundred times brighter or darker
RIM = 0.97  # of |p|: 88.3° from the viewer
GRIDS = (4, 8, 16, 32, 64)
CHANNEL_ORDERS = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))


class MaterialCoordinates:
    """z (S, K) → label (1, S, 108) float64.

    label       (1, S, 108), at z = 0
    directions  (K, 108) as of `principal_directions`; None: those of the built-in materials
    """

    def __init__(self, label: torch.Tensor, directions: np.ndarray | None = None):
        directions = principal_directions() if directions is None else directions
        self.start = label.detach().double()
        self.directions = torch.from_numpy(directions).to(label.device)
        self.shape = (label.shape[1], len(self.directions))
        self.predicted = torch.zeros(self.shape, dtype=torch.float64, device=label.device)

    def __call__(self, z: torch.Tensor) -> torch.Tensor:
        return self.start + (z @ self.directions)[None]


def principal_directions(labels: np.ndarray | None = None) -> np.ndarray:
    """Return the directions σ_k u_k (K, 108) in which materials vary, the largest first.

    They belong to the method as its weights do, so they are those of the materials that the weights
    were trained on, under every exchange of colour channels. Weights of a run on a data set's own
    materials hold these labels (`training_labels` of a network). All others, and labels that do not
    vary at all, stand for the training split of the built-in materials.

    labels  (M, 108) of training materials; None: the built-in ones
    """
    if labels is not None:
        directions = _directions(np.asarray(labels, np.float64))
        if len(directions):
            return directions
    return _built_in_directions()


@functools.cache
def _built_in_directions() -> np.ndarray:
    training = [m.label for m in load_catalogue().values() if m.split == "train"]
    return _directions(np.stack([label.reshape(SIZE) for label in training]))


def _directions(labels: np.ndarray) -> np.ndarray:
    """Return σ_k u_k (K, 108) of labels (M, 108) under every exchange of colour channels."""
    orders = [list(order) for order in CHANNEL_ORDERS]
    by_channel = labels.reshape(-1, 3, SIZE // 3)
    all_labels = np.stack([label[order].reshape(SIZE) for label in by_channel for order in orders])
    _, spread, directions = np.linalg.svd(all_labels - all_labels.mean(0), full_matrices=False)
    spread = spread / math.sqrt(len(all_labels))
    return (spread[:, None] * directions)[spread > LEAST_SPREAD]


class LightCoordinates:
    """z (J, 3) → light (1, 3, Hl, Wl) > 0 of unit mean luminance.

    light   (1, 3, Hl, Wl), at z = 0; degree: the highest of the spherical harmonics
    """

    def __init__(self, light: torch.Tensor, degree: int):
        H, W = light.shape[-2:]
        self.start = light.detach().clamp(min=LEAST_LIGHT).log()
        self.waves = torch.from_numpy(spherical_harmonics(H, W, degree)).to(light.device)
        self.solid_angle = torch.as_tensor(envmap.row_solid_angles(H, W), dtype=light.dtype).to(
            light.device
        )
        self.shape = (len(self.waves), 3)
        self.predicted = torch.zeros(self.shape, dtype=torch.float64, device=light.device)

    def __call__(self, z: torch.Tensor) -> torch.Tensor:
        change = torch.einsum("jc,jhw->chw", z.to(self.waves), self.waves).clamp(
            -LARGEST_CHANGE, LARGEST_CHANGE
        )
        return unit_mean((self.start + change[None]).exp(), self.solid_angle)


@functools.cache
def spherical_harmonics(H: int, W: int, degree: int) -> np.ndarray:
    """Return the real harmonics Y_lm / (1 + l) up to a degree, (J, H, W) float32.

    Before the division each has a mean square of 1 over the sphere.
    """
    w, _ = envmap.directions(H, W)
    phi, cosine = np.arctan2(w[..., 2], w[..., 0]), w[..., 1]
    sine = np.sqrt(np.clip(1 - cosine**2, 0, 1))
    results = []
    legendre: dict[tuple[int, int], np.ndarray] = {}
    for m in range(degree + 1):
        legendre[m, m] = (
            np.ones_like(sine)
            if m == 0
            else legendre[m - 1, m - 1] * sine * math.sqrt((2 * m + 1) / (2 * m))
        )
        for l in range(m + 1, degree + 1):  # noqa: E741 -- the degree's letter
            before = legendre.get((l - 2, m), 0 * sine)
            scale = math.sqrt((4 * l * l - 1) / (l * l - m * m))
            back = math.sqrt(((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1))
            legendre[l, m] = scale * (cosine * legendre[l - 1, m] - back * before)
        for l in range(m, degree + 1):  # noqa: E741
            waves = (
                [legendre[l, m]]
                if m == 0
                else [math.sqrt(2) * legendre[l, m] * f(m * phi) for f in (np.cos, np.sin)]
            )
            results += [wave / (1 + l) for wave in waves]
    return np.stack(results).astype(np.float32)


class NormalCoordinates:
    """z (Z,) → n (1, 3, H, W) of unit length, facing the viewer.

    n             (1, 3, H, W), at z = 0; mask (1, H, W) bool
    trust_region  the most that p may move along either axis
    """

    def __init__(self, n: torch.Tensor, mask: torch.Tensor, trust_region: float):
        height, width = n.shape[-2:]
        self.size = (height, width)
        self.trust_region = trust_region
        self.p = disk_from_normals(n, mask)
        self.grids = [(g, g) for g in GRIDS if g < min(self.size)] + [self.size]
        self.sizes = [2 * h * w for h, w in self.grids]
        self.shape = (sum(self.sizes),)
        self.predicted = torch.zeros(self.shape, dtype=torch.float64, device=n.device)

    def __call__(self, z: torch.Tensor) -> torch.Tensor:
        change = torch.zeros((), dtype=self.p.dtype, device=self.p.device)
        # split at once: the derivative of each slice alone would be as long as z
        for part, size in zip(z.to(self.p).split(self.sizes), self.grids, strict=True):
            grid = part.reshape(1, 2, *size)
            change = change + (
                grid if size == self.size else F.interpolate(grid, self.size, mode="bilinear")
            )
        return normals_from_disk(
            self.p + self.trust_region * torch.tanh(change / self.trust_region)
        )


def disk_from_normals(n: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Return normals (1, 3, H, W) as p (1, 2, H, W) in the disk, kept off its rim.

    Outside the mask (1, H, W) normals are taken to face the viewer.
    """
    n = torch.where(mask[:, None], n.detach(), n.new_tensor([0.0, 0.0, 1.0])[:, None, None])
    n = F.normalize(n, dim=1)
    return clamp_to_rim(n[:, :2] / (1 + n[:, 2:].clamp(min=0)))


def clamp_to_rim(p: torch.Tensor) -> torch.Tensor:
    """Return p (1, 2, H, W) shortened to |p| ≤ RIM where it is longer."""
    # the root of a sum, for torch's norm takes ten times as long along this axis
    return p * (RIM / (p * p).sum(1, keepdim=True).clamp(min=1e-24).sqrt()).clamp(max=1)


def normals_from_disk(p: torch.Tensor) -> torch.Tensor:
    """Return the unit normals (1, 3, H, W) of p (1, 2, H, W) in the disk."""
    p = clamp_to_rim(p)
    squared = (p * p).sum(1, keepdim=True)
    return torch.cat([2 * p, 1 - squared], 1) / (1 + squared)
