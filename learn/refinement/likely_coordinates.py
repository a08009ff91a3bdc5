"""What L-BFGS moves where learn.refinement.likely holds it: vectors z in which every step is as likely as it is short.

z = 0 is where the truth is to be expected, given the prediction; `predicted` is the z of the prediction itself.

material  label* = label' + what is expected to be missing + Σ z_k s_k; float64; and its albedo's distance counts beside z
light     log L* = log L' + the same over harmonics in three colour axes, then scaled to unit mean luminance; L' keeps its finer detail
normals   p* = p' + Σ of grids, each times its spread, p as in learn.refinement.coordinates
"""

import numpy as np
import torch
import torch.nn.functional as F

from learn.networks.coding import unit_mean
from learn.refinement.coordinates import LARGEST_CHANGE, LEAST_LIGHT, disk, hemisphere
from learn.refinement.likely import AXES, GRIDS, albedo_axes, light_coordinates, waves
from shaders import envmap


class Material:
    """z (S, K) → label (1, S, 108) float64."""

    def __init__(self, label, likely):
        directions, mean = likely.label_directions.double(), likely.label_mean.double()
        said = (label[0].double() - mean) @ torch.linalg.pinv(directions)
        missing = said @ likely.label_step.double().T + likely.label_shift.double() - said
        self.start = label.detach().double() + (missing @ directions)[None]
        self.directions = likely.label_spread.double() @ directions
        self.predicted = _solved(likely.label_spread, -missing)
        self.shape = tuple(self.predicted.shape)
        said = albedo_axes(label[0].double())
        self.albedo = said @ likely.albedo_step.double().T + likely.albedo_shift.double()
        self.narrow = torch.linalg.pinv(likely.albedo_spread.double())

    def __call__(self, z):
        return self.start + (z @ self.directions)[None]

    def unlikely(self, z, label):
        """(S, K' + 3): z, and how far the label's albedo is from where it is expected, in units of its spread."""
        return torch.cat([z, (albedo_axes(label[0]) - self.albedo) @ self.narrow], -1)


class Light:
    """z (J' + 2 J'',) → light (1, 3, Hl, Wl) > 0 of unit mean luminance."""

    def __init__(self, light, likely):
        H, W = light.shape[-2:]
        self.log = light.detach().clamp(min=LEAST_LIGHT).log()
        self.waves = torch.from_numpy(waves(H, W))
        self.axes = torch.from_numpy(AXES).float()
        self.solid_angle = torch.as_tensor(envmap.row_solid_angles(H, W), dtype=light.dtype)
        said = torch.from_numpy(light_coordinates(light.movedim(1, -1).numpy())[0])
        self.bright, self.tint = likely.bright_spread.double(), likely.tint_spread.double()
        self.missing = said[0, 1:] @ likely.bright_step.double().T + likely.bright_shift.double() - said[0, 1:]
        self.missing_tint = said[1:] @ likely.tint_step.double().T - said[1:]
        parts = _solved(self.bright, -self.missing[None]), _solved(self.tint, -self.missing_tint)
        self.predicted = torch.cat([part.flatten() for part in parts])
        self.shape = tuple(self.predicted.shape)

    def __call__(self, z):
        bright = self.missing + z[: len(self.bright)] @ self.bright
        tint = self.missing_tint + z[len(self.bright) :].reshape(2, -1) @ self.tint
        change = torch.cat([torch.cat([bright.new_zeros(1), bright])[None], tint]).to(self.axes)
        change = torch.einsum("aj,ac,jhw->chw", change, self.axes, self.waves).clamp(-LARGEST_CHANGE, LARGEST_CHANGE)
        return unit_mean((self.log + change[None]).exp(), self.solid_angle)


class Normals:
    """z (Z,) → n (1, 3, H, W) unit, facing the viewer."""

    def __init__(self, n, mask, reach, likely):
        self.size, self.reach = n.shape[-2:], reach
        self.p = disk(n, mask)
        self.grids = [(g, float(s)) for g, s in zip(GRIDS, likely.normals_spread, strict=True) if g < min(self.size)]
        self.shape = (sum(2 * g * g for g, _ in self.grids),)
        self.predicted = torch.zeros(self.shape, dtype=torch.float64)

    def __call__(self, z):
        change, first = 0, 0
        for g, spread in self.grids:
            grid = z[first : first + 2 * g * g].reshape(1, 2, g, g).to(self.p)
            change = change + spread * F.interpolate(grid, self.size, mode="bilinear")
            first += 2 * g * g
        return hemisphere(self.p + self.reach * torch.tanh(change / self.reach))


def _solved(spread, wanted):
    """z (S, K') whose Σ z_k s_k comes nearest to `wanted` (S, K)."""
    return torch.from_numpy(wanted.double().numpy() @ np.linalg.pinv(spread.double().numpy()))
