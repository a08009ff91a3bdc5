"""What a prediction's mistakes look like, measured where the truth is known: how far each property is likely to be from what was said.

For each property a linear model with normal residuals: y = A y' + b + Σ_k z_k s_k, z standard normal, y' predicted and y true. It tells
where the truth is to be expected (a network's mistakes are not all around 0) and which changes are likely (z small) or not.

material  y: coordinates of the label along the principal directions of the training labels, under every exchange of colour channels
          and apart from them y: log albedo in three colour axes, which predictions know far better than the labels that make it:
          normal labels alone would spread it three to five times as wide as it was measured
light     y: harmonics up to DEGREE of log(blurred light + FLOOR), in three colour axes; blurred by e^{SHARP (cos − 1)}, so that a lamp
          counts by its light and not by the log of its few texels. Brightness apart from the two of colour, which are alike and have
          no b. Maps and their mirror images count; brightness of degree 0 is left out, for maps are scaled to unit mean
normals   y: the two coordinates in the stereographic disk; A = 1, b = 0; the residual is a sum of independent grids, enlarged bilinearly:
          z_g times s_g, one number a grid, found from the residual's correlation between pixels at several distances

J harmonics, K directions of labels, N pictures, X texels
"""

import functools
import itertools
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from scipy.optimize import nnls

from learn.refinement.coordinates import spherical_harmonics
from learn.training import checkpoint
from learn.training.losses import log_albedo
from manifests.problems import Problem
from shaders import envmap

FILE = Path(__file__).parents[1] / "weights" / "likely.safetensors"  # of the weights that come with this package
FORMAT = "brdfactory likely mistakes 1"
DEGREE = 8
SHARP = 20.0  # of the blur, about 13° wide: as fine as harmonics of this degree
FLOOR = 0.02  # of the mean light
HEIGHT, WIDTH = 32, 64  # at which light is blurred
KEPT = 0.99  # of the training labels' variance
RIDGE = 1e-2  # of the predictors' mean variance: as if each were measured with so much noise
LEAST = 1e-6  # of the largest variance of a residual: directions below it are left out
GRIDS = (4, 8, 16, 32, 64)
DISTANCES = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24)  # pixels of SIDE
SIDE = 64  # pixels of the pictures whose normals are compared
AXES = np.array([[1, 1, 1], [1, -1, 0], [1, 1, -2]]) / np.sqrt([[3], [2], [6]])  # brightness, red against green, yellow against blue


@dataclass(frozen=True)
class Likely:
    """float32 tensors of the models above; spreads have a direction s_k a row.

    label_mean (108,), label_directions (K, 108), label_step (K, K), label_shift (K,), label_spread (K', K)
    albedo_step (3, 3), albedo_shift (3,), albedo_spread (3, 3)
    bright_step (J−1, J−1), bright_shift (J−1,), bright_spread (J', J−1); tint_step (J, J), tint_spread (J'', J)
    normals_spread (5,) of GRIDS
    """

    label_mean: torch.Tensor
    label_directions: torch.Tensor
    label_step: torch.Tensor
    label_shift: torch.Tensor
    label_spread: torch.Tensor
    albedo_step: torch.Tensor
    albedo_shift: torch.Tensor
    albedo_spread: torch.Tensor
    bright_step: torch.Tensor
    bright_shift: torch.Tensor
    bright_spread: torch.Tensor
    tint_step: torch.Tensor
    tint_spread: torch.Tensor
    normals_spread: torch.Tensor


def waves(height, width):
    """(J, height, width) float32 real harmonics of unit mean square, in the order of learn.refinement.coordinates.spherical_harmonics."""
    degree, _ = degrees()
    return spherical_harmonics(height, width, DEGREE) * (1 + degree[:, None, None]).astype(np.float32)


def degrees():
    """(J,) degree and order of each harmonic; order below 0 where it goes by the sine."""
    each = [(l, s * m) for m in range(DEGREE + 1) for l in range(m, DEGREE + 1) for s in ((1,) if m == 0 else (1, -1))]  # noqa: E741
    return np.array(each).T


def light_coordinates(lights):
    """(N, 3, J) of lights (N, H, W, 3): what the light's model speaks of."""
    small = np.stack([envmap.resize(L, HEIGHT, WIDTH) for L in lights]).reshape(len(lights), -1, 3).astype(np.float64)
    logs = np.log(_blur() @ small + FLOOR) @ AXES.T
    return np.einsum("jx,nxa->naj", _projection(), logs)


@functools.cache
def _blur():
    """(X, X): each row the weights of a blurred texel."""
    w = envmap.directions(HEIGHT, WIDTH)[0].reshape(-1, 3)
    weights = np.exp(SHARP * (w @ w.T - 1)) * np.repeat(envmap.row_solid_angles(HEIGHT, WIDTH), WIDTH)
    return weights / weights.sum(1, keepdims=True)


@functools.cache
def _projection():
    """(J, X): harmonics of unit mean square, weighed by solid angle."""
    shapes = waves(HEIGHT, WIDTH).reshape(-1, HEIGHT * WIDTH).astype(np.float64)
    return shapes * np.repeat(envmap.row_solid_angles(HEIGHT, WIDTH), WIDTH) / (4 * np.pi)


def fitted(samples, training_labels):
    """Likely of samples {"light", "label", "disk": true, the same with "predicted_" before: predicted, "inside"}.

    light (N, H, W, 3), label (N, 108), disk (N, 2, SIDE, SIDE), inside (N, SIDE, SIDE) bool; training_labels [(108,)]
    """
    mean, directions = principal(np.stack(training_labels).astype(np.float64))
    true, said = (_labels(samples[name], mean, directions) for name in ("label", "predicted_label"))
    label_step, label_shift, label_spread = model(said, true)
    albedo = model(*(_albedos(samples[name]) for name in ("predicted_label", "label")))
    true, said = (light_coordinates(samples[name]) for name in ("light", "predicted_light"))
    bright = [mirrored(y[:, 0])[:, 1:] for y in (said, true)]
    tint = [np.concatenate([sign * mirrored(y[:, a]) for a in (1, 2) for sign in (1, -1)]) for y in (said, true)]
    bright_step, bright_shift, bright_spread = model(*bright)
    tint_step, _, tint_spread = model(*tint)
    spread = _grids(samples["disk"] - samples["predicted_disk"], samples["inside"])
    labels = (mean, directions, label_step, label_shift, label_spread, *albedo)
    found = (*labels, bright_step, bright_shift, bright_spread, tint_step, tint_spread, spread)
    return Likely(*(torch.from_numpy(np.ascontiguousarray(x)).float() for x in found))


def principal(labels):
    """mean (108,), directions (K, 108): σ_k u_k, the largest first, of labels (M, 108) under every exchange of channels."""
    every = np.concatenate([_exchanged(labels, order) for order in itertools.permutations(range(3))])
    mean = every.mean(0)
    _, spread, directions = np.linalg.svd(every - mean, full_matrices=False)
    count = int(np.searchsorted(np.cumsum(spread**2) / (spread**2).sum(), KEPT)) + 1
    return mean, (spread[:count, None] / np.sqrt(len(every))) * directions[:count]


def _exchanged(labels, order):
    return labels.reshape(-1, 3, 36)[:, list(order)].reshape(-1, 108)


def _labels(labels, mean, directions):
    """(6 N, K) coordinates of labels (N, 108) under every exchange of channels."""
    every = [_exchanged(labels.astype(np.float64), order) for order in itertools.permutations(range(3))]
    return (np.concatenate(every) - mean) @ np.linalg.pinv(directions)


def _albedos(labels):
    """(6 N, 3) log albedo in AXES of labels (N, 108) under every exchange of channels."""
    every = np.concatenate([_exchanged(labels, order) for order in itertools.permutations(range(3))])
    return albedo_axes(torch.from_numpy(every).double()).numpy()


def albedo_axes(label):
    """(…, 3) log albedo, lit and seen along the normal, of labels (…, 108) in AXES."""
    return log_albedo(label) @ torch.from_numpy(AXES.T).to(label)


def mirrored(y):
    """Coordinates (N, J) of maps, followed by those of their mirror images, left and right exchanged."""
    _, order = degrees()
    parity = (-1.0) ** np.abs(order)  # of cos m(π − φ) and −sin m(π − φ)
    return np.concatenate([y, y * np.where(order >= 0, parity, -parity)])


def model(said, true):
    """A, b and the spread of true ≈ A said + b: ridge regression."""
    centre = said.mean(0), true.mean(0)
    x, y = said - centre[0], true - centre[1]
    square = x.T @ x / len(x)
    ridge = RIDGE * np.trace(square) / len(square) * np.eye(len(square))
    step = np.linalg.solve(square + ridge, x.T @ y / len(x)).T
    left = y - x @ step.T
    variance, directions = np.linalg.eigh(left.T @ left / len(left))
    kept = variance > LEAST * variance.max()
    spread = (directions[:, kept] * np.sqrt(variance[kept])).T[::-1]
    return step, centre[1] - step @ centre[0], spread


def _grids(residual, inside):
    """(len(GRIDS),) spread of each grid: whose sum has the residual's correlation along rows.

    residual (N, 2, SIDE, SIDE), inside (N, SIDE, SIDE). What single pixels have of their own takes part in the fit and is left out.
    """
    mine = [_correlation(np.asarray(residual, np.float32), inside[:, None], d) for d in DISTANCES]
    rng = torch.Generator().manual_seed(0)
    rows = []
    for g in GRIDS:
        grid = F.interpolate(torch.randn(256, 1, g, g, generator=rng), (2 * SIDE, 2 * SIDE), mode="bilinear").numpy()
        rows.append([_correlation(grid, np.ones_like(grid, bool), 2 * d) for d in DISTANCES])
    rows.append([1.0] + [0.0] * (len(DISTANCES) - 1))
    variance, _ = nnls(np.array(rows).T, np.array(mine))
    return np.sqrt(variance[:-1])


def _correlation(values, inside, distance):
    """Mean product of values (N, C, h, w) `distance` columns apart, where both are inside (N, 1 or C, h, w)."""
    end = values.shape[-1] - distance
    both = np.broadcast_to(inside[..., distance:] & inside[..., :end], values[..., :end].shape)
    return float((values[..., distance:] * values[..., :end])[both].mean())


def save(path, likely, told):
    """told: what they were measured on, for whoever reads the file."""
    checkpoint.save(path, vars(likely), {"format": FORMAT, "measured": json.dumps(told)})


@functools.cache
def load(path):
    """Likely of a file. Raises Problem."""
    tensors, metadata = checkpoint.load(path)
    if metadata.get("format") != FORMAT or set(tensors) != set(Likely.__dataclass_fields__):
        raise Problem(path, "likely mistakes", metadata.get("format", "something else"), "measure them: python -m learn likely")
    return Likely(**tensors)
