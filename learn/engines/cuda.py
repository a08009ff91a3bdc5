"""The exact sum and its derivatives on a CUDA device: the Triton kernels, group by group.

Arguments as in learn.engines.cpu, as tensors. Tables are made on the device in float64 and passed
in float32; sums over lights and materials are returned in fixed parts and are added in float64.
Memory beyond inputs and outputs: tables and parts of one slab of lights, below 20 MiB.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import triton

from learn.engines import lights
from learn.engines import triton_distant as distant
from learn.engines import triton_general as general
from learn.engines.lights import Rotation

TILE = distant.LIGHTS


@dataclass(frozen=True)
class DeviceSlab:
    """A learn.engines.lights.Slab on a device, as rows (R, T).

    T lights, padded to a multiple of TILE
    """

    order: torch.Tensor
    solid_angle: torch.Tensor
    distant: torch.Tensor
    general: torch.Tensor
    basis: torch.Tensor

    @property
    def lights(self) -> int:
        """T."""
        return self.distant.shape[1]

    def energy(self, light: torch.Tensor) -> torch.Tensor:
        """Radiance × solid angle (3, T) float32 of light (height, width, 3); padding is black."""
        energy = light.new_zeros(3, self.lights)
        energy[:, : len(self.order)] = (
            light.reshape(-1, 3)[self.order].double() * self.solid_angle[:, None]
        ).T.float()
        return energy

    def add_light_gradient(self, by_energy: torch.Tensor, gradient: torch.Tensor) -> None:
        """Add the derivative by energy (3, T) to the one by light (height, width, 3)."""
        by_light = by_energy[:, : len(self.order)].T * self.solid_angle[:, None]
        gradient.view(-1, 3)[self.order] += by_light.float()


@functools.lru_cache(maxsize=8)
def _slabs(height, width, rotation, device):
    def filled(rows):
        return np.ascontiguousarray(
            np.concatenate([rows, np.repeat(rows[:, -1:], -rows.shape[1] % TILE, 1)], 1)
        )

    results = []
    for slab in lights.slabs(height, width, rotation):
        geometry = filled(lights.unblocked(slab.distant)), filled(lights.unblocked(slab.general))
        arrays = slab.order, slab.solid_angle, *geometry, filled(slab.basis.T).T.copy()
        results.append(DeviceSlab(*(torch.as_tensor(a, device=device) for a in arrays)))
    return results


def radiance(
    n: torch.Tensor,
    view: torch.Tensor | None,
    m: torch.Tensor,
    light: torch.Tensor,
    rotation: Rotation,
    counts: tuple[int, ...],
    light_of: tuple[int, ...],
) -> torch.Tensor:
    """Radiance (P, 3)."""
    out = torch.zeros_like(n)
    views: Sequence[torch.Tensor | None] = (
        [None] * len(counts) if view is None else view.split(counts)
    )
    for slab in _slabs(*light.shape[1:3], rotation, n.device):
        for g, (part, into) in enumerate(zip(n.split(counts), out.split(counts), strict=True)):
            energy, result = slab.energy(light[light_of[g]]), torch.empty_like(part)
            grid = (triton.cdiv(len(part), distant.PIXELS),)
            v = views[g]
            if v is None:
                lobes = _distant_tables(m[g], slab)[0]
                sizes = {"PIXELS": distant.PIXELS, "LIGHTS": TILE}
                distant.forward[grid](
                    part, slab.distant, energy, lobes, result, len(part), slab.lights, **sizes
                )
            else:
                seen = part, v, _shortfall(v), slab.general, energy, _general_tables(m[g])[0]
                sizes = {"PIXELS": general.PIXELS, "LIGHTS": TILE}
                general.forward[grid](*seen, result, len(part), slab.lights, **sizes)
            into += result
    return out


def gradients(
    g_radiance: torch.Tensor,
    n: torch.Tensor,
    view: torch.Tensor | None,
    m: torch.Tensor,
    light: torch.Tensor,
    rotation: Rotation,
    counts: tuple[int, ...],
    light_of: tuple[int, ...],
) -> tuple[torch.Tensor, torch.Tensor | None, torch.Tensor, torch.Tensor]:
    """Derivatives by n, view (None without one), m and light, in their shapes.

    Those by n and view are right in their tangential parts.
    """
    by_n, by_m, by_light = torch.zeros_like(n), torch.zeros_like(m), torch.zeros_like(light)
    by_view = None if view is None else torch.zeros_like(view)
    ends = np.cumsum((0, *counts)).tolist()
    for slab in _slabs(*light.shape[1:3], rotation, n.device):
        for group, image in enumerate(light_of):
            pixels = slice(ends[group], ends[group + 1])
            energy = slab.energy(light[image])
            arguments = m[group], slab, energy, g_radiance[pixels]
            if view is None or by_view is None:
                group_by_n, group_by_m, by_energy = _distant_backward(n[pixels], *arguments)
            else:
                group_by_n, group_by_m, by_energy, group_by_view = _general_backward(
                    n[pixels], view[pixels], *arguments
                )
                by_view[pixels] += group_by_view
            by_n[pixels] += group_by_n
            by_m[group] += group_by_m
            slab.add_light_gradient(by_energy, by_light[image])
    return by_n, by_view, by_m, by_light


def _part(pixels):
    """Pixels of one of the SPLITS parts, whole tiles."""
    return distant.PIXELS * triton.cdiv(triton.cdiv(pixels, distant.SPLITS), distant.PIXELS)


def _lobe_first(m):
    """As learn.engines.lights.lobe_first, for tensors."""
    return m.transpose(0, 1).flip(2)


def _distant_tables(m, slab):
    """lobes (18, T) float32, and κ (3 lobes, 3 channels, T) float64."""
    curves = _lobe_first(m.double()).reshape(18, 6) @ slab.basis.T
    kappa = curves[1::2].reshape(3, 3, -1).clone()
    curves[1::2] *= lights.LOG2_E
    return curves.float().contiguous(), kappa


def _distant_backward(
    n: torch.Tensor, m: torch.Tensor, slab: DeviceSlab, energy: torch.Tensor, g: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Derivatives of one group by n (p, 3), m (3, 3, 2, 6), energy (3, T)."""
    lobes, kappa = _distant_tables(m, slab)
    by_n, total = torch.empty_like(n), slab.lights
    sizes = {"PIXELS": distant.PIXELS, "LIGHTS": TILE}
    over_pixels = (triton.cdiv(len(n), distant.PIXELS),)
    distant.backward_pixels[over_pixels](
        n, slab.distant, energy, lobes, g, by_n, len(n), total, **sizes
    )
    sums = n.new_empty(distant.SPLITS, 3, 7, total)
    over_lights = (total // TILE, distant.SPLITS, 3)
    distant.backward_lights[over_lights](
        n, slab.distant, lobes, g, sums, len(n), total, _part(len(n)), **sizes
    )
    sums = sums.double().sum(0)
    by_lobe = sums[:, 1:].reshape(3, 3, 2, -1).transpose(0, 1) * energy.double()[:, None]
    by_kappa, by_gamma = by_lobe[:, :, 0], by_lobe[:, :, 1] * kappa * lights.LN2
    by_m = _lobe_first(torch.stack([by_gamma, by_kappa], 2) @ slab.basis)
    return by_n, by_m.float(), sums[:, 0]


def _shortfall(view):
    """1/‖v‖ − 1 of vectors that were scaled to unit length in float32, (p,)."""
    return (0.5 * (1.0 - view.double().square().sum(-1))).float()


def _general_tables(m):
    """values (108,) and steps (90,) float32, on the material's device."""
    values, steps, _ = lights.general_tables(m.double().cpu().numpy())
    return torch.as_tensor(values, device=m.device), torch.as_tensor(steps, device=m.device)


def _general_backward(
    n: torch.Tensor,
    view: torch.Tensor,
    m: torch.Tensor,
    slab: DeviceSlab,
    energy: torch.Tensor,
    g: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Derivatives of one group by n (p, 3), m (3, 3, 2, 6), energy (3, T), view (p, 3)."""
    (values, steps), total = _general_tables(m), slab.lights
    sizes = {"PIXELS": general.PIXELS, "LIGHTS": TILE}
    seen = n, view, _shortfall(view), slab.general, energy, values
    by_n, by_view = torch.empty_like(n), torch.empty_like(n)
    general.backward_pixels[(triton.cdiv(len(n), general.PIXELS),)](
        *seen, steps, g, by_n, by_view, len(n), total, **sizes
    )
    energy_sums = n.new_empty(general.SPLITS, 3, 3, total)
    m_sums = n.new_empty(total // TILE, general.SPLITS, 3, 3, 2, 8)
    grid = (total // TILE, general.SPLITS, 9)
    general.backward_lights[grid](
        *seen, g, energy_sums, m_sums, len(n), total, _part(len(n)), **sizes
    )
    by_m = m_sums[..., :6].double().sum((0, 1))
    by_m[:, :, 0] *= lights.LN2**2
    return by_n, _lobe_first(by_m).float(), energy_sums.double().sum((0, 1)), by_view
