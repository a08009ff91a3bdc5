"""The paper's sum without texels below the horizon or outside the lobes' cones, block by block.

For each tile of like normals, a bound on what each 4×4 block of texels can add through each lobe is
computed from cones about the block's directions and half vectors; blocks are left out from the
smallest bound on until `share × tolerance` of the picture's mean radiance would be missing from
some pixel. The mean is estimated from 32 pixels first. What comes out is nowhere brighter than the
whole sum, so that its own mean bounds the true one from below: where that says that more than the
tolerance may be missing, the sum is made again with less left out. So the error is bounded, not
estimated. Derivatives leave out the same blocks, except those by a lobe that is dim beside another.
"""

import torch

from learn.methods import Batch, Card, directional, light_tables, radiance_by_group

CARD = Card(
    name="culled",
    approximates="the paper's sum, without texels whose lobes are negligible at the pixel",
    error=5e-3,
    cost="pixels × texels near a lobe: falls with the square of the lobes' width",
    memory=(
        "lists of blocks: 16 bytes × pixels / 64 × blocks of 16 texels, for 65,536 pixels at a time"
    ),
    gradient=2e-2,
)

SHARE = 0.5  # of the tolerance that may be left out


def radiance(batch: Batch, tolerance: float) -> torch.Tensor:
    """Return outgoing radiance (P, 3) of a batch."""

    def one_group(
        n: torch.Tensor, view: torch.Tensor | None, m: torch.Tensor, light: torch.Tensor
    ) -> torch.Tensor:
        lights, E = light_tables.lights_and_energy(light, batch.camera_from_light)
        left_out = SHARE * tolerance * directional.mean_radiance(n, view, m, E, lights)
        seen = directional.radiance(n, view, m, E, lights, left_out, method=CARD.name)
        least = seen.detach().mean().item()
        if left_out > tolerance * least:
            return directional.radiance(
                n, view, m, E, lights, SHARE * tolerance * least, method=CARD.name
            )
        return seen

    return radiance_by_group(batch, one_group)
