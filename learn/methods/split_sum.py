"""The split-sum approximation of game engines: blurred light times reflectance under white light.

The light is blurred by the lobe as if seen straight on.

    I(n, v) ≈ P(r) A(n·v) / A(1),   r = 2 (n·v) n − v
    P(d)    radiance for n = v = d: a map of ROWS × 2 ROWS directions, looked up bilinearly
    A(x)    radiance under a light of 1 everywhere at n·v = x: a table of ANGLES values, looked up
    linearly

Source: Karis, Real Shading in Unreal Engine 4, 2013, with the DSBRDF in place of GGX.
"""

import math

import torch

from learn.methods import (
    COMPILED,
    Batch,
    Card,
    directional,
    forbid_second_derivatives,
    light_tables,
    radiance_by_group,
)
from learn.methods.light_tables import Lights
from shaders.envmap import directions

CARD = Card(
    name="split_sum",
    approximates=(
        "the integral of f·L by a product: light blurred about the mirror direction, times"
        " reflectance under white light"
    ),
    error=0.5,
    cost="2048 directions × texels, then a look-up per pixel",
    memory="below 1 MiB beyond the pixels",
)
ROWS, ANGLES, LEAST_COSINE = 32, 48, 1e-3
# least texels of white light: a smaller map's may all lie where a lobe does not look
WHITE = (16, 32)
# reflectance below which a channel fades to black: the derivative of its inverse would overflow
DARKEST = 1e-9


def radiance(batch: Batch, tolerance: float) -> torch.Tensor:
    """Return outgoing radiance (P, 3) of a batch."""
    if directional.has_kernels(batch.n):
        batch = forbid_second_derivatives(batch, CARD.name, COMPILED)

    def one_group(
        n: torch.Tensor, view: torch.Tensor | None, m: torch.Tensor, light: torch.Tensor
    ) -> torch.Tensor:
        lights, E = light_tables.lights_and_energy(light, batch.camera_from_light)
        view = n.new_tensor([[0.0, 0.0, 1.0]]) if view is None else view
        cosine = (n * view).sum(-1)
        mirror = 2 * cosine[:, None] * n - view
        height, width = (
            max(size, least) for size, least in zip(light.shape[:2], WHITE, strict=True)
        )
        albedo = radiance_at_angles(
            m,
            *light_tables.lights_and_energy(
                light.new_ones(height, width, 3), batch.camera_from_light
            ),
        )
        d = (
            torch.as_tensor(directions(ROWS, 2 * ROWS)[0], dtype=n.dtype, device=n.device).reshape(
                -1, 3
            )
            @ batch.camera_from_light.to(n).T
        )
        blurred = directional.radiance(d, d, m, E, lights).reshape(ROWS, 2 * ROWS, 3)
        return (
            look_up_map(blurred, mirror @ batch.camera_from_light.to(n))
            * look_up_angle(albedo, cosine)
            / albedo[-1].clamp(min=DARKEST)
        )

    return radiance_by_group(batch, one_group)


def radiance_at_angles(m: torch.Tensor, lights: Lights, white: torch.Tensor) -> torch.Tensor:
    """A (ANGLES, 3) at n·v from LEAST_COSINE to 1 in equal steps, by turning the normal."""
    x = torch.linspace(LEAST_COSINE, 1.0, ANGLES, dtype=m.dtype, device=m.device)
    n = torch.stack([(1 - x * x).clamp(min=0).sqrt(), torch.zeros_like(x), x], -1)
    return directional.radiance(n, None, m, white, lights)


def look_up_angle(table: torch.Tensor, cosine: torch.Tensor) -> torch.Tensor:
    """Return values (P, 3) of a table (ANGLES, 3) at cosines (P,), linearly interpolated."""
    place = ((cosine - LEAST_COSINE) / (1 - LEAST_COSINE) * (ANGLES - 1)).clamp(0, ANGLES - 1)
    i = place.detach().floor().long().clamp(max=ANGLES - 2)
    t = (place - i)[:, None]
    return table[i] * (1 - t) + table[i + 1] * t


def look_up_map(table: torch.Tensor, d: torch.Tensor) -> torch.Tensor:
    """Return values (P, 3) of a table (height, width, 3) over directions d (P, 3), light frame.

    Interpolation is bilinear and wraps around the vertical.
    """
    height, width = table.shape[:2]
    # straight up and down the azimuth has no slope
    across = (d[:, 0] ** 2 + d[:, 2] ** 2).clamp(min=1e-12).sqrt()
    row = (torch.atan2(across, d[:, 1]) * (height / math.pi) - 0.5).clamp(0, height - 1)
    upright = across > 2e-6
    azimuth = torch.atan2(torch.where(upright, d[:, 2], 0.0), torch.where(upright, d[:, 0], 1.0))
    column = azimuth * (width / (2 * math.pi)) - 0.5
    i, j = row.detach().floor().long().clamp(max=height - 2), column.detach().floor().long()
    s, t = (row - i)[:, None], (column - j)[:, None]
    left, right = j % width, (j + 1) % width
    upper = table[i, left] * (1 - t) + table[i, right] * t
    lower = table[i + 1, left] * (1 - t) + table[i + 1, right] * t
    return upper * (1 - s) + lower * s
