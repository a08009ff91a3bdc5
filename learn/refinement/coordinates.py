"""What L-BFGS moves in Eq. 6: for each property a vector z, 0 at the prediction, in units in which
one step means the same everywhere.

material  label* = label' + Σ z_k σ_k u_k: principal directions u of the training materials' labels,
σ their spread; float64
light     log L* = log L' + Σ z_j Y_j / (1 + l): real spherical harmonics, by degree l less, then
scaled to unit mean luminance; so L* > 0,
          and light's scale stays where it was agreed to be: brightness as a whole belongs to the
          material
normals   p* = p' + Σ of grids, coarse to fine, interpolated; p = n_xy/(1 + n_z) is the disk of the
stereographic projection, where the
          hemisphere facing the viewer is |p| < 1: normals stay on it, of unit length
"""

import functools
import math

import numpy as np
import torch
import torch.nn.functional as F

from learn.networks.coding import unit_mean
from manifests.materials import load_catalogue
from shaders import envmap

LEAST_SPREAD = 1e-3  # of a principal direction that is kept, in units of a label
# of the mean: under it a texel is treated as this bright, so that it can become brighter
LEAST_LIGHT = 1e-3
LARGEST_CHANGE = 6.0  # of log L: four hundred times brighter or darker
RIM = 0.97  # of |p|: 88.3° from the viewer
GRIDS = (4, 8, 16, 32, 64)


class Material:
    """z (S, K) → label (1, S, 108) float64."""

    def __init__(self, label):
        self.start = label.detach().double()
        self.directions = torch.from_numpy(principal_directions()).to(label.device)
        self.shape = (label.shape[1], len(self.directions))
        self.predicted = torch.zeros(self.shape, dtype=torch.float64, device=label.device)

    def __call__(self, z):
        return self.start + (z @ self.directions)[None]


@functools.cache
def principal_directions():
    """σ_k u_k, (K, 108), the largest first, of the training materials' labels under every exchange
    of colour channels.

    The materials are the built-in ones: they belong to the method, as its weights do, for a
    photograph has no data set.
    """
    labels = [m.label.reshape(3, 36) for m in load_catalogue().values() if m.split == "train"]
    orders = [(0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)]
    all_labels = np.stack([label[list(order)].reshape(108) for label in labels for order in orders])
    _, spread, directions = np.linalg.svd(all_labels - all_labels.mean(0), full_matrices=False)
    spread = spread / math.sqrt(len(all_labels))
    return (spread[:, None] * directions)[spread > LEAST_SPREAD]


class Light:
    """z (J, 3) → light (1, 3, Hl, Wl) > 0 of unit mean luminance."""

    def __init__(self, light, degree):
        H, W = light.shape[-2:]
        self.start = light.detach().clamp(min=LEAST_LIGHT).log()
        self.waves = torch.from_numpy(spherical_harmonics(H, W, degree)).to(light.device)
        self.solid_angle = torch.as_tensor(envmap.row_solid_angles(H, W), dtype=light.dtype).to(
            light.device
        )
        self.shape = (len(self.waves), 3)
        self.predicted = torch.zeros(self.shape, dtype=torch.float64, device=light.device)

    def __call__(self, z):
        change = torch.einsum("jc,jhw->chw", z.to(self.waves), self.waves).clamp(
            -LARGEST_CHANGE, LARGEST_CHANGE
        )
        return unit_mean((self.start + change[None]).exp(), self.solid_angle)


@functools.cache
def spherical_harmonics(H, W, degree):
    """(J, H, W) float32 real harmonics Y_lm / (1 + l), of unit mean square over the sphere before
    the division.
    """
    w, _ = envmap.directions(H, W)
    phi, cosine = np.arctan2(w[..., 2], w[..., 0]), w[..., 1]
    sine = np.sqrt(np.clip(1 - cosine**2, 0, 1))
    results = []
    legendre = {}
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


class Normals:
    """z (Z,) → n (1, 3, H, W) unit, facing the viewer."""

    def __init__(self, n, mask, reach):
        self.size = n.shape[-2:]
        self.reach = reach
        self.p = disk(n, mask)
        self.grids = [(g, g) for g in GRIDS if g < min(self.size)] + [tuple(self.size)]
        self.shape = (sum(2 * h * w for h, w in self.grids),)
        self.predicted = torch.zeros(self.shape, dtype=torch.float64, device=n.device)

    def __call__(self, z):
        change, first = 0, 0
        for h, w in self.grids:
            grid = z[first : first + 2 * h * w].reshape(1, 2, h, w).to(self.p)
            change = change + (
                grid
                if (h, w) == tuple(self.size)
                else F.interpolate(grid, self.size, mode="bilinear")
            )
            first += 2 * h * w
        return hemisphere(self.p + self.reach * torch.tanh(change / self.reach))


def disk(n, mask):
    """(1, 2, H, W): normals (1, 3, H, W) in the disk, held off its rim; outside the mask (1, H, W)
    they face the viewer.
    """
    n = torch.where(mask[:, None], n.detach(), n.new_tensor([0.0, 0.0, 1.0])[:, None, None])
    n = F.normalize(n, dim=1)
    return held(n[:, :2] / (1 + n[:, 2:].clamp(min=0)))


def held(p):
    """p (1, 2, H, W) brought to |p| ≤ RIM; the root of a sum, for torch's norm takes ten times as
    long along this axis.
    """
    return p * (RIM / (p * p).sum(1, keepdim=True).clamp(min=1e-24).sqrt()).clamp(max=1)


def hemisphere(p):
    """(1, 3, H, W) unit normals of p in the disk."""
    p = held(p)
    squared = (p * p).sum(1, keepdim=True)
    return torch.cat([2 * p, 1 - squared], 1) / (1 + squared)
