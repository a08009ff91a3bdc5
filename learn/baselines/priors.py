"""Priors: Gaussians over materials and lights, fitted to the training split alone.

material  label = mean + z U, z (K,) standard normal, rows of U the principal directions of the
          training labels, scaled by their spread, under every exchange of colour channels; the
          smallest are left out once 1 − VARIANCE of the variance remains
light     log L = Σ_j (μ_j + σ_j z_j) Y_j over spherical harmonics up to DEGREE, in three colour
          axes, then unit mean luminance. μ_j is the training maps' mean for harmonics that do not
          depend on the light's rotation (m = 0), else 0; σ_j is one number per degree and axis. So
          the prior states no more than that light is smooth, bright above and nearly grey
noise     standard deviation of compressed radiance about the layer's; not fitted but set: see NOISE

J harmonics, K directions, M materials, N maps
"""

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from learn.data.seen import KEY, Seen, encode_seen
from learn.networks import tensor_file, weights
from learn.networks.coding import unit_mean
from learn.refinement.coordinates import spherical_harmonics
from manifests.errors import InputError
from shaders import envmap

FORMAT = "brdfactory priors 1"
VARIANCE = 0.99
DEGREE = 10
MOST_MEDOIDS = 8
NOISE = 0.03  # of log(1 + 8 I)/log 9: the layer's error in a sum over 32×64 lights
DARKEST = 1e-2  # of the mean: darker texels count as this dark, for the logarithm is unbounded
# brightness, red against green, yellow against blue
AXES = np.array([[1, 1, 1], [1, -1, 0], [1, 1, -2]]) / np.sqrt([[3], [2], [6]])


@dataclass(frozen=True)
class Priors:
    """The parameters of both Gaussians.

    mean (108,), directions (K, 108), medoids (T, K): z of typical training materials
    light_mean, light_spread (J, 3)
    """

    mean: torch.Tensor
    directions: torch.Tensor
    medoids: torch.Tensor
    light_mean: torch.Tensor
    light_spread: torch.Tensor

    def to(self, device: torch.device | str) -> "Priors":
        """Return the same priors with their tensors on a device."""
        return Priors(**{name: tensor.to(device) for name, tensor in vars(self).items()})

    def label(self, z: torch.Tensor) -> torch.Tensor:
        """Return the label (…, 108) of z (…, K)."""
        return self.mean + z @ self.directions

    def light(self, z: torch.Tensor, height: int, width: int) -> torch.Tensor:
        """Return radiance (1, 3, height, width) of unit mean luminance, of z (J, 3)."""
        waves = torch.from_numpy(spherical_harmonics(height, width, DEGREE)).to(z)
        axes = torch.as_tensor(AXES).to(z)
        log = torch.einsum(
            "ja,ac,jhw->chw", self.light_mean.to(z) + self.light_spread.to(z) * z, axes, waves
        )
        solid_angle = torch.as_tensor(envmap.row_solid_angles(height, width)).to(z)
        return unit_mean(log.clamp(-10, 10).exp()[None], solid_angle)


def fit(labels: Sequence[np.ndarray], maps: Sequence[np.ndarray]) -> Priors:
    """Return the Priors of training labels [(108,)] and maps [(64, 128, 3)]."""
    mean, directions = _fit_labels(np.stack(labels).astype(np.float64))
    z = (np.stack(labels) - mean) @ np.linalg.pinv(directions)
    mu, spread = _fit_lights(maps)
    numbers = (mean, directions, _choose_medoids(z, MOST_MEDOIDS), mu, spread)
    return Priors(*(torch.from_numpy(np.ascontiguousarray(x)).double() for x in numbers))


def _fit_labels(labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return mean (108,) and directions σ_k u_k (K, 108) of labels (M, 108), the largest first."""
    orders = itertools.permutations(range(3))
    all_labels = np.concatenate(
        [labels.reshape(-1, 3, 36)[:, list(order)].reshape(-1, 108) for order in orders]
    )
    mean = all_labels.mean(0)
    _, spread, directions = np.linalg.svd(all_labels - mean, full_matrices=False)
    total = (spread**2).sum()  # 0 for a data set of one grey material: nothing spreads
    count = int(np.searchsorted(np.cumsum(spread**2) / total, VARIANCE)) + 1 if total > 0 else 1
    return mean, (spread[:count, None] / np.sqrt(len(all_labels))) * directions[:count]


def _choose_medoids(z: np.ndarray, count: int) -> np.ndarray:
    """Return the materials (count, K) of z (M, K) that together are nearest to all others.

    They are chosen greedily, one by one.
    """
    distance = np.linalg.norm(z[:, None] - z[None], axis=-1)
    nearest, chosen = np.full(len(z), np.inf), []
    for _ in range(min(count, len(z))):
        gain = np.minimum(nearest, distance).sum(1)
        chosen.append(int(gain.argmin()))
        nearest = np.minimum(nearest, distance[chosen[-1]])
    return z[chosen]


def _fit_lights(maps: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and spread (J, 3) over harmonics and colour axes.

    Each map's log radiance is fitted by least squares, weighed by solid angle.
    """
    height, width = 32, 64
    waves = (
        spherical_harmonics(height, width, DEGREE).astype(np.float64).reshape(-1, height * width)
    )
    weight = np.repeat(envmap.row_solid_angles(height, width), width) / (4 * np.pi)
    solve = np.linalg.solve((waves * weight) @ waves.T, waves * weight)
    logs = [
        np.log(np.maximum(envmap.resize(L, height, width), DARKEST)).reshape(-1, 3) @ AXES.T
        for L in maps
    ]
    result = np.stack([solve @ log for log in logs])  # (N, J, 3)
    degree, order = _degrees_and_orders()
    mean = np.where((order == 0)[:, None], result.mean(0), 0.0)
    squared = ((result - mean) ** 2).mean(0)
    return mean, np.sqrt(
        np.stack([squared[degree == degree[j]].mean(0) for j in range(len(degree))])
    )


def _degrees_and_orders() -> np.ndarray:
    """Return degree and order of each harmonic, (2, J), in the order of `spherical_harmonics`."""
    each = [
        (degree, m)
        for m in range(DEGREE + 1)
        for degree in range(m, DEGREE + 1)
        for _ in range(1 if m == 0 else 2)
    ]
    return np.array(each).T


def save(path: Path, priors: Priors, report: Mapping[str, Any], seen: Seen | None = None) -> None:
    """Write priors.

    report  the materials and maps they were fitted to, as metadata of the file
    seen    the same as hashes; None: the file does not say
    """
    metadata = {"format": FORMAT, "fitted": json.dumps(report)}
    weights.save(
        path, vars(priors), metadata if seen is None else metadata | {KEY: encode_seen(seen)}
    )


def load(path: str | Path) -> Priors:
    """Return the Priors of a file. Raises InputError."""
    remedy = "fit them: python -m learn train-baselines"
    with tensor_file.open_tensor_file(path, "priors in a .safetensors file", remedy) as stored:
        names = Priors.__dataclass_fields__
        if stored.metadata.get("format") != FORMAT or set(stored.shapes) != set(names):
            raise InputError(
                path, "priors", stored.metadata.get("format", "something else"), remedy
            )
        K, T = (next(iter(stored.shapes[name]), 0) for name in ("directions", "medoids"))
        harmonics = ((DEGREE + 1) ** 2, 3)
        shapes = {
            "mean": (108,),
            "directions": (min(K, 108), 108),
            "medoids": (min(T, MOST_MEDOIDS), min(K, 108)),
        }
        shapes |= {"light_mean": harmonics, "light_spread": harmonics}
        stored.require(shapes, "these priors")
        return Priors(**{name: stored.tensor(name).double() for name in names})
