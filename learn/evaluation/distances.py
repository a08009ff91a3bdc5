"""How far materials and lights of an evaluation are from the nearest that weights were trained on.

materials  brdf_log of learn.metrics.intrinsics against each training label; the least counts
lights     relative root mean square error of irradiance against each training map, under all turns
           of TURN texels and mirrored; the least counts. 0 for a map of training, turned or not
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from learn.data.lights import read_maps
from learn.data.seen import Seen, map_hash
from learn.metrics.intrinsics import brdf_log_error
from learn.metrics.radiometry import irradiance
from shaders import envmap

TURN = 4  # texels: 11°, a fifth of the half-width of irradiance's lobe


def of_materials(labels: Mapping[str, np.ndarray], training: np.ndarray | None) -> dict[str, float]:
    """Return {name: distance} of labels (108,); {} without training labels (M, 108)."""
    if training is None:
        return {}
    return {
        name: min(
            0.0 if np.allclose(label, other, atol=1e-5) else brdf_log_error(label, other)
            for other in training
        )
        for name, label in labels.items()
    }


def of_lights(maps: Mapping[str, np.ndarray], training: Sequence[np.ndarray]) -> dict[str, float]:
    """Return {name: distance} of maps (64, 128, 3); {} without training maps."""
    if not training:
        return {}
    known = torch.cat([_turned(L) for L in training])
    result = {}
    for name, L in maps.items():
        if any(envmap.is_same_source(L, other) for other in training):
            result[name] = 0.0
            continue
        right = irradiance(_tensor(envmap.unit_mean(L)[0])[None])
        error = ((known - right) ** 2).mean((1, 2)).min().sqrt() / (right**2).mean().sqrt()
        result[name] = float(error)
    return result


def training_maps(
    path: Path | None, metadata: Mapping[str, Any], seen: Seen | None
) -> list[np.ndarray]:
    """Return the maps of a file that weights were trained on; [] for None.

    metadata  of the weights: maps that their run held out are left out
    seen      what the weights saw; where they say it, all other maps are left out too
    Raises    InputError
    """
    if path is None:
        return []
    of_data = metadata.get("run", {}).get("data", {})
    held_out = {*of_data.get("validation_lights", ()), *of_data.get("test_lights", ())}
    return [
        L
        for name, L in read_maps(path).items()
        if name not in held_out and (seen is None or map_hash(L) in seen.lights)
    ]


def _turned(L: np.ndarray) -> torch.Tensor:
    """Irradiance (T, 3, directions) of a map under all turns, and mirrored."""
    L = envmap.unit_mean(L)[0]
    both = (L, L[:, ::-1])
    turns = range(0, L.shape[1], TURN)
    return torch.cat(
        [irradiance(torch.stack([_tensor(envmap.roll(x, k)) for k in turns])) for x in both]
    )


def _tensor(L: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(L, np.float32)).movedim(-1, 0)
