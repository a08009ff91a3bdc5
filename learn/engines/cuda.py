"""The exact sum and its derivatives on a CUDA device, by the Triton kernels.

Arguments as in learn.engines.cpu, as tensors. Tables are made on the device in float64 and passed
in float32; sums over lights and materials are returned in fixed parts and are added in float64.
For a distant viewer one launch sums many groups, since a training batch has one per picture; with a
view per pixel each group is summed by itself. Memory beyond inputs and outputs: tables and parts of
one slab of lights, at most LARGEST_WORK bytes or those of one group, below 40 MiB.
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
LARGEST_WORK = 512 << 20  # bytes of tables and parts for the groups of one launch
MOST_GROUPS = 65_535 // 3  # the third side of a CUDA grid, with three channels for each group


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

    def energy(self, light: torch.Tensor, light_of: Sequence[int]) -> torch.Tensor:
        """Radiance × solid angle (G, 3, T) float32 of light (maps, height, width, 3).

        light_of  the map of each of G groups; padding is black
        """
        own = light.reshape(len(light), -1, 3)
        if tuple(light_of) != tuple(range(len(light))):
            own = own[_places(light_of, light.device)]
        energy = light.new_zeros(len(light_of), 3, self.lights)
        lit = own[:, self.order].double() * self.solid_angle[:, None]
        energy[:, :, : len(self.order)] = lit.transpose(1, 2).float()
        return energy

    def add_light_gradient(
        self, by_energy: torch.Tensor, light_of: Sequence[int], gradient: torch.Tensor
    ) -> None:
        """Add the derivative by energy (G, 3, T) to the one by light (maps, height, width, 3)."""
        lit = by_energy[..., : len(self.order)].double() * self.solid_angle
        if tuple(light_of) != tuple(range(len(gradient))):
            # a product adds groups of one map in a fixed order, unlike index_add_
            share = lit.new_zeros(len(gradient), len(light_of))
            share[_places(light_of, lit.device), torch.arange(len(light_of))] = 1
            lit = torch.einsum("ig,gct->ict", share, lit)
        gradient.view(len(gradient), -1, 3)[:, self.order] += lit.transpose(1, 2).float()


def _places(light_of: Sequence[int], device: torch.device) -> torch.Tensor:
    """Return indices of maps as a tensor on a device."""
    return torch.as_tensor(list(light_of), dtype=torch.long).to(device, non_blocking=True)


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
    for slab in _slabs(*light.shape[1:3], rotation, n.device):
        for chunk in _chunks(counts, slab.lights) if view is None else ():
            groups, pixels, of_chunk = chunk
            part = n[pixels]
            energy = slab.energy(light, light_of[groups])
            lobes, result = _distant_tables(m[groups], slab)[0], torch.empty_like(part)
            distant.forward[_tiles(of_chunk)](
                part,
                _offsets(of_chunk, n.device),
                slab.distant,
                energy,
                lobes,
                result,
                slab.lights,
                PIXELS=distant.PIXELS,
                LIGHTS=TILE,
            )
            out[pixels] += result
        if view is None:
            continue
        for g, pixels in _pixels_of_groups(counts):
            part, v = n[pixels], view[pixels]
            energy, result = slab.energy(light, light_of[g : g + 1])[0], torch.empty_like(part)
            seen = part, v, _shortfall(v), slab.general, energy, _general_tables(m[g])[0]
            sizes = {"PIXELS": general.PIXELS, "LIGHTS": TILE}
            grid = (triton.cdiv(len(part), general.PIXELS),)
            general.forward[grid](*seen, result, len(part), slab.lights, **sizes)
            out[pixels] += result
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
    for slab in _slabs(*light.shape[1:3], rotation, n.device):
        for groups, pixels, of_chunk in _chunks(counts, slab.lights) if view is None else ():
            energy = slab.energy(light, light_of[groups])
            of_n, of_m, by_energy = _distant_backward(
                n[pixels], of_chunk, m[groups], slab, energy, g_radiance[pixels]
            )
            by_n[pixels] += of_n
            by_m[groups] += of_m
            slab.add_light_gradient(by_energy, light_of[groups], by_light)
        if view is None or by_view is None:
            continue
        for group, pixels in _pixels_of_groups(counts):
            one = light_of[group : group + 1]
            energy = slab.energy(light, one)[0]
            of_n, of_m, by_energy, of_view = _general_backward(
                n[pixels], view[pixels], m[group], slab, energy, g_radiance[pixels]
            )
            by_view[pixels] += of_view
            by_n[pixels] += of_n
            by_m[group] += of_m
            slab.add_light_gradient(by_energy[None], one, by_light)
    return by_n, by_view, by_m, by_light


def _pixels_of_groups(counts):
    """(number, slice of its pixels) of each group."""
    ends = np.cumsum((0, *counts)).tolist()
    return [(g, slice(ends[g], ends[g + 1])) for g in range(len(counts))]


def _chunks(counts, total):
    """(slice of groups, slice of their pixels, their counts) for each launch over `total` lights.

    A launch has as many groups as LARGEST_WORK allows, at least one.
    """
    most = _most(counts, total)
    ends, result = np.cumsum((0, *counts)).tolist(), []
    for first in range(0, len(counts), most):
        last = min(first + most, len(counts))
        pixels = slice(ends[first], ends[last])
        if pixels.stop > pixels.start:
            result.append((slice(first, last), pixels, counts[first:last]))
    return result


def _most(counts, total):
    """The largest number of groups in a launch over `total` lights."""
    # float32 and float64 tables, and sums by the kernel and in float64
    of_one = total * (18 * 12 + 3 * 4 + 21 * (4 * _parts(counts) + 3 * 8))
    return min(max(1, LARGEST_WORK // of_one), MOST_GROUPS)


def _offsets(counts, device):
    """First pixel of each group and the end of the last one, (G + 1,) int32."""
    return torch.as_tensor(np.cumsum((0, *counts)).astype(np.int32)).to(device, non_blocking=True)


def _tiles(counts):
    """The grid of programs of `distant.forward`: tiles of pixels × groups."""
    return triton.cdiv(max(counts), distant.PIXELS), len(counts)


def _parts(counts):
    """Number of parts of a group's pixels in the pass over lights."""
    return min(distant.SPLITS, triton.cdiv(max(counts), distant.PIXELS))


def _part(pixels, parts):
    """Pixels of one of the parts, whole tiles."""
    return distant.PIXELS * triton.cdiv(triton.cdiv(pixels, parts), distant.PIXELS)


def _lobe_first(m):
    """As learn.engines.lights.lobe_first, for tensors (…, 3, 3, 2, 6)."""
    return m.transpose(-4, -3).flip(-2)


def _distant_tables(m, slab):
    """lobes (G, 18, T) float32, and κ (G, 3 lobes, 3 channels, T) float64 of m (G, 3, 3, 2, 6)."""
    curves = _lobe_first(m.double()).reshape(len(m), 18, 6) @ slab.basis.T
    kappa = curves[:, 1::2].reshape(len(m), 3, 3, -1).clone()
    curves[:, 1::2] *= lights.LOG2_E
    return curves.float().contiguous(), kappa


def _distant_backward(
    n: torch.Tensor,
    counts: tuple[int, ...],
    m: torch.Tensor,
    slab: DeviceSlab,
    energy: torch.Tensor,
    g: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Derivatives of G groups by n (P, 3), m (G, 3, 3, 2, 6), energy (G, 3, T)."""
    lobes, kappa = _distant_tables(m, slab)
    by_n, total, offsets = torch.empty_like(n), slab.lights, _offsets(counts, n.device)
    sizes = {"PIXELS": distant.PIXELS, "LIGHTS": TILE}
    distant.backward_pixels[_tiles(counts)](
        n, offsets, slab.distant, energy, lobes, g, by_n, total, **sizes
    )
    parts = _parts(counts)
    sums = n.new_empty(len(m), parts, 3, 7, total)
    distant.backward_lights[(total // TILE, parts, 3 * len(m))](
        n, offsets, slab.distant, lobes, g, sums, total, _part(max(counts), parts), **sizes
    )
    sums = sums.double().sum(1)
    by_lobe = sums[:, :, 1:].reshape(len(m), 3, 3, 2, -1).transpose(1, 2)
    by_lobe = by_lobe * energy.double()[:, None, :, None]
    by_kappa, by_gamma = by_lobe[:, :, :, 0], by_lobe[:, :, :, 1] * kappa * lights.LN2
    by_m = _lobe_first(torch.stack([by_gamma, by_kappa], 3) @ slab.basis)
    return by_n, by_m.float(), sums[:, :, 0]


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
    part = _part(len(n), general.SPLITS)
    general.backward_lights[grid](*seen, g, energy_sums, m_sums, len(n), total, part, **sizes)
    by_m = m_sums[..., :6].double().sum((0, 1))
    by_m[:, :, 0] *= lights.LN2**2
    return by_n, _lobe_first(by_m).float(), energy_sums.double().sum((0, 1)), by_view
