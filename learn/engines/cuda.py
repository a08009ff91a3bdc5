"""The exact sum and its derivatives on a CUDA device: the Triton kernels, group by group. Arguments as in learn.engines.cpu, as tensors.

Tables are made on the device in float64 and handed over in float32; sums over lights come back per part of the pixels and are added in
float64. Only the distant viewer has kernels here: a view per pixel goes to the reference (learn.methods.exact).
"""

import functools

import numpy as np
import torch
import triton

from learn.engines import lights
from learn.engines import triton_distant as kernels


@functools.lru_cache(maxsize=8)
def _device_slabs(height, width, rotation, device):
    """Of each slab: order (t,), solid angle (t,), geometry (9, T) float32 and spline basis (T, 6) float64, T filled up to whole tiles."""
    found = []
    for slab in lights.slabs(height, width, rotation):
        geometry = lights.unblocked(slab.distant)
        fill = -geometry.shape[1] % kernels.LIGHTS
        geometry = np.concatenate([geometry, np.repeat(geometry[:, -1:], fill, 1)], 1)
        basis = np.concatenate([slab.basis, np.repeat(slab.basis[-1:], fill, 0)])
        arrays = slab.order, slab.solid_angle, np.ascontiguousarray(geometry), basis
        found.append(tuple(torch.as_tensor(a, device=device) for a in arrays))
    return found


def _energy(light, order, solid_angle, total):
    """(3, total) float32; lights that fill up the last tile are black."""
    energy = light.new_zeros(3, total)
    energy[:, : len(order)] = (light.reshape(-1, 3)[order].double() * solid_angle[:, None]).T.float()
    return energy


def _lobe_first(m):
    """As learn.engines.lights.lobe_first, for tensors."""
    return m.transpose(0, 1).flip(2)


def _tables(m, basis):
    """lobes (18, T) float32, and κ (3 lobes, 3 channels, T) float64."""
    curves = _lobe_first(m.double()).reshape(18, 6) @ basis.T
    kappa = curves[1::2].reshape(3, 3, -1).clone()
    curves[1::2] *= lights.LOG2_E
    return curves.float().contiguous(), kappa


def radiance(n, m, light, rotation, counts, light_of):
    """Radiance (P, 3)."""
    out = torch.zeros_like(n)
    for order, solid_angle, geometry, basis in _device_slabs(*light.shape[1:3], rotation, n.device):
        total = geometry.shape[1]
        for g, (part, into) in enumerate(zip(n.split(counts), out.split(counts), strict=True)):
            energy = _energy(light[light_of[g]], order, solid_angle, total)
            result = torch.empty_like(part)
            grid = (triton.cdiv(len(part), kernels.PIXELS),)
            arrays = part, geometry, energy, _tables(m[g], basis)[0], result
            kernels.forward[grid](*arrays, len(part), total, PIXELS=kernels.PIXELS, LIGHTS=kernels.LIGHTS)
            into += result
    return out


def gradients(g_radiance, n, m, light, rotation, counts, light_of):
    """Derivatives by n (right in its tangential part), m and light, in their shapes."""
    by_n, by_m, by_light = torch.zeros_like(n), torch.zeros_like(m), torch.zeros_like(light)
    for slab in _device_slabs(*light.shape[1:3], rotation, n.device):
        order, solid_angle, geometry, basis = slab
        parts = zip(n.split(counts), g_radiance.split(counts), by_n.split(counts), strict=True)
        for group, (part, g, into) in enumerate(parts):
            energy = _energy(light[light_of[group]], order, solid_angle, geometry.shape[1])
            lobes, kappa = _tables(m[group], basis)
            into += _by_n(part, geometry, energy, lobes, g)
            sums = _light_sums(part, geometry, lobes, g)
            by_energy = sums[:, 0, : len(order)].T * solid_angle[:, None]
            by_light[light_of[group]].view(-1, 3)[order] += by_energy.float()
            by_m[group] += _by_m(sums[:, 1:], energy, kappa, basis)
    return by_n, by_m, by_light


def _by_n(n, geometry, energy, lobes, g):
    result = torch.empty_like(n)
    grid = (triton.cdiv(len(n), kernels.PIXELS),)
    arrays = n, geometry, energy, lobes, g, result
    kernels.backward_pixels[grid](*arrays, len(n), geometry.shape[1], PIXELS=kernels.PIXELS, LIGHTS=kernels.LIGHTS)
    return result


def _light_sums(n, geometry, lobes, g):
    """(3 channels, 7, T) float64: the sums of triton_distant.backward_lights over all pixels."""
    total, splits = geometry.shape[1], kernels.SPLITS
    split = kernels.PIXELS * triton.cdiv(triton.cdiv(len(n), splits), kernels.PIXELS)
    sums = n.new_empty(splits, 3, 7, total)
    grid = (total // kernels.LIGHTS, splits, 3)
    arrays = n, geometry, lobes, g, sums
    kernels.backward_lights[grid](*arrays, len(n), total, split, PIXELS=kernels.PIXELS, LIGHTS=kernels.LIGHTS)
    return sums.double().sum(0)


def _by_m(lobe_sums, energy, kappa, basis):
    """(3, 3, 2, 6) from sums (3 channels, 3 lobes × (κ, γ), T)."""
    sums = lobe_sums.reshape(3, 3, 2, -1).transpose(0, 1) * energy.double()[:, None]
    by_kappa, by_gamma = sums[:, :, 0], sums[:, :, 1] * kappa * lights.LN2
    return _lobe_first(torch.stack([by_gamma, by_kappa], 2) @ basis).float()
