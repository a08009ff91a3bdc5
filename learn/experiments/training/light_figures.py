"""How wrong predicted light maps are, at their edges and in colour too."""

import torch

from learn.layer.light_maps import solid_angles

FAINT = 0.02  # of a light's mean: ratios of what is darker count little


def light_figures(light: torch.Tensor, true: torch.Tensor) -> dict[str, torch.Tensor]:
    """Return {figure: (B,)} of predicted and true maps (B, 3, Hl, Wl).

    light_log   mean over solid angle and channels of the squared difference of log(1 + L)
    edge_error  the same over the outermost texels alone, all of them alike
    frame       by how many stops the outermost texels are brighter than those four texels further
                within, beyond the same of the true map; below 0 where a map has a dark frame
    seam        mean over rows of the step in stops between the first and the last column, which
                meet, beyond the same of the true map
    green       by how many stops the mean colour is greener than that of the true map
    """
    squared = (torch.log1p(light) - torch.log1p(true)) ** 2
    outermost, within = ring(light, 0), ring(light, 4)
    brightness, steps, colours = [], [], []
    for each in (light, true):
        logarithm = (FAINT + each.mean(1)).log2()
        brightness.append(logarithm[:, outermost].mean(1) - logarithm[:, within].mean(1))
        steps.append((logarithm[..., 0] - logarithm[..., -1]).abs().mean(1))
        mean = (each * solid_angles(each)).sum((2, 3)).clamp(min=1e-6).log2()
        colours.append(mean[:, 1] - (mean[:, 0] + mean[:, 2]) / 2)
    return {
        "light_log": (squared * solid_angles(light)).sum((2, 3)).mean(1),
        "edge_error": squared.mean(1)[:, outermost].mean(1),
        "frame": brightness[0] - brightness[1],
        "seam": steps[0] - steps[1],
        "green": colours[0] - colours[1],
    }


def ring(light: torch.Tensor, within: int) -> torch.Tensor:
    """Return (Hl, Wl) bool: the texels of a map (…, Hl, Wl) at this distance from its edges."""
    H, W = light.shape[-2:]
    row, column = torch.arange(H)[:, None], torch.arange(W)[None]
    distance = torch.minimum(torch.minimum(row, H - 1 - row), torch.minimum(column, W - 1 - column))
    return distance == within
