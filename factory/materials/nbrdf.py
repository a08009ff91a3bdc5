"""Measured materials as small networks: Neural-BRDF's fits.

They are fits of MERL (100) and of EPFL RGL's isotropic materials (51). A network takes
(h_x, 0, h_z, d_x, d_y, d_z), Rusinkiewicz's half and difference vectors with φ_h = 0, through
6-21-21-3 with relu, to f = exp(out) − 1: an absolute BRDF per channel, no cosine. Two of its flaws
are corrected here: values below 0 are clamped to 0, and it is averaged over φ_d, which makes it
symmetric in light and view and a function of (θ_h, θ_d) alone, as a DSBRDF is.

Source: Sztrajman, Rainer, Ritschel, Weyrich, "Neural BRDF Representation and Importance Sampling",
CGF 2021 (MIT).
"""

from pathlib import Path

import numpy as np

from manifests.archives import open_zip, read_array
from manifests.errors import InputError
from manifests.inputs import require_file
from manifests.wording import number_of

LAYERS = ((6, 21), (21, 21), (21, 3))
PARAMETERS = sum(a * b + b for a, b in LAYERS)  # 675
MAX_BYTES = 64 << 20
MAX_MATERIALS = 10_000


class NeuralBRDF:
    """One material, callable with cos_h, cos_d; it returns f (…, 3) in 1/sr."""

    def __init__(self, weights: np.ndarray, n_phi: int = 16) -> None:
        self.layers, self.n_phi, at = [], n_phi, 0
        for a, b in LAYERS:
            self.layers.append(
                (
                    weights[at : at + a * b].reshape(a, b).astype(float),
                    weights[at + a * b : at + a * b + b].astype(float),
                )
            )
            at += a * b + b

    def __call__(self, cos_h: np.ndarray, cos_d: np.ndarray) -> np.ndarray:
        """Return the mean of the clamped network over φ_d.

        The mean runs over those directions where light and view are above the horizon.
        """
        cos_h, cos_d = np.broadcast_arrays(np.asarray(cos_h, float), np.asarray(cos_d, float))
        sin_h, sin_d = np.sqrt(np.clip(1 - cos_h**2, 0, 1)), np.sqrt(np.clip(1 - cos_d**2, 0, 1))
        total, count = np.zeros((*cos_h.shape, 3)), np.zeros(cos_h.shape)
        for k in range(self.n_phi):  # a whole turn: φ_d and φ_d + π swap light and view
            phi = 2 * np.pi * k / self.n_phi
            across = sin_h * sin_d * np.cos(phi)
            above = (cos_h * cos_d + across > 1e-4) & (cos_h * cos_d - across > 1e-4)
            # φ_d = ±90°: always above, so that no point is without a value
            above |= k % (self.n_phi // 2) == self.n_phi // 4
            f = self._network(sin_h, cos_h, sin_d * np.cos(phi), sin_d * np.sin(phi), cos_d)
            total += np.clip(f, 0, None) * above[..., None]
            count += above
        return total / count[..., None]

    def _network(self, h_x, h_z, d_x, d_y, d_z):
        (w1, b1), (w2, b2), (w3, b3) = self.layers
        x = np.stack([h_x, h_z, d_x, d_y, d_z], -1) @ w1[[0, 2, 3, 4, 5]] + b1  # h_y = 0
        x = np.maximum(x, 0) @ w2 + b2
        # a broken file must not overflow
        return np.expm1(np.minimum(np.maximum(x, 0) @ w3 + b3, 50.0))


def load(path: Path) -> dict[str, NeuralBRDF]:
    """Return {name: NeuralBRDF} of an npz with `names` (N,) and `weights` (N, 675).

    Raises  InputError, one line, for any other file
    """
    expected, remedy = "an npz with `names` and `weights`", "give NBRDF weights"
    require_file(path, expected, remedy, MAX_BYTES)
    with open_zip(path, expected, remedy) as archive:
        for name in ("names", "weights"):
            if f"{name}.npy" not in archive.namelist():
                raise InputError(path, expected, f"no `{name}`", remedy)
        names, weights = (read_array(archive, name, MAX_BYTES) for name in ("names", "weights"))
    if weights.dtype.kind not in "fiu" or names.dtype.kind not in "US" or names.ndim != 1:
        raise InputError(
            path,
            "names as text and weights as numbers",
            f"{names.dtype} of {names.shape} and {weights.dtype}",
            remedy,
        )
    if (
        weights.ndim != 2
        or weights.shape[1] != PARAMETERS
        or len(names) != len(weights)
        or len(names) > MAX_MATERIALS
    ):
        raise InputError(
            path,
            f"weights (N, {PARAMETERS}) beside N names",
            f"weights {weights.shape}, {number_of(len(names), 'name')}",
            "give NBRDF weights",
        )
    if not np.isfinite(weights).all():
        raise InputError(path, "finite weights", "a weight that is none", "copy the file again")
    return {str(name): NeuralBRDF(w) for name, w in zip(names, weights, strict=True)}
