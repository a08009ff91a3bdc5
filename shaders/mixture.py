"""A mixture of Cycles closures whose widths, tilts and RGB weights depend on the viewing angle.

It is the material that the factory renders.

Facing   1 − cos_o, 0 seen head-on and 1 at the horizon: the output of Cycles' Layer Weight node
stops    (V,) ascending facings, at most 32 (a colour ramp holds no more); V = 1: nothing depends on
         the view
K        closures, summed:
         f(c) = Σ_k weight_k(facing, c) · closure_k(alpha_k(facing), tilt_k(facing))

Between the stops log α, tilt and weights are interpolated as Cycles does it: a colour ramp becomes
a table of 256 values, linear between them (kernel/svm/ramp.h, RAMP_TABLE_SIZE); facings that are
multiples of 1/255 are therefore kept exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from shaders import closures

MAX_STOPS = 32
TABLE_SIZE = 256
KINDS = tuple(closures.CLOSURES)


@dataclass(frozen=True)
class Mixture:
    """Closures and their parameters at each view stop.

    kinds    (K,) names of closures
    stops    (V,); log_alpha, tilt (V, K)
    weights  (V, K, 3) ≥ 0, linear Rec.709
    """

    kinds: tuple[str, ...]
    stops: np.ndarray
    log_alpha: np.ndarray
    tilt: np.ndarray
    weights: np.ndarray

    def __post_init__(self) -> None:
        for name in ("stops", "log_alpha", "tilt", "weights"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=np.float64))
        object.__setattr__(self, "kinds", tuple(self.kinds))
        check(self)

    @property
    def key(self) -> tuple:
        """What it is made of, by which tables hold what was computed of it."""
        arrays = (self.stops, self.log_alpha, self.tilt, self.weights)
        return self.kinds, *(array.tobytes() for array in arrays)

    @classmethod
    def constant(cls, kind: str, alpha: float, rgb: ArrayLike, tilt: float = 0.0) -> Mixture:
        """Return a mixture of one closure that does not depend on the view."""
        return cls(
            (kind,),
            np.array([0.0]),
            np.array([[np.log(alpha)]]),
            np.array([[tilt]]),
            np.asarray(rgb, dtype=float).reshape(1, 1, 3),
        )

    @classmethod
    def lambert(cls, albedo: ArrayLike) -> Mixture:
        """Return a matte surface; albedo: three numbers in [0, 1]."""
        return cls.constant("diffuse", 1.0, albedo)

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Mixture:
        """Return the mixture of the plain lists of `to_json`."""
        return cls(
            tuple(data["kinds"]), data["stops"], data["log_alpha"], data["tilt"], data["weights"]
        )

    def to_json(self, digits: int = 6) -> dict[str, Any]:
        """Return plain lists, rounded to `digits` significant digits."""

        def rounded(values):
            return (
                [rounded(v) for v in values]
                if isinstance(values, list)
                else float(f"{values:.{digits}g}")
            )

        arrays = {
            name: rounded(getattr(self, name).tolist())
            for name in ("stops", "log_alpha", "tilt", "weights")
        }
        return {"kinds": list(self.kinds), **arrays}

    def at(self, cos_o: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return log α (…, K), tilt (…, K) and weights (…, K, 3) at the view cosines (…)."""
        facing = 1 - np.asarray(cos_o, dtype=np.float64)
        return tuple(
            ramp(self.stops, values, facing) for values in (self.log_alpha, self.tilt, self.weights)
        )

    def evaluate(
        self,
        cos_i: np.ndarray,
        cos_o: np.ndarray | float,
        cos_h: np.ndarray,
        cos_d: np.ndarray,
    ) -> np.ndarray:
        """Return the BRDF (…, 3) in 1/sr, without cosine; the cosines broadcast, cos_i > 0."""
        cos_i, view_cos, cos_h, cos_d = np.broadcast_arrays(cos_i, cos_o, cos_h, cos_d)
        log_alpha, tilt, weights = self.at(view_cos)
        f = np.zeros((*cos_i.shape, 3))
        for k, kind in enumerate(self.kinds):
            value = closures.evaluate(
                kind, np.exp(log_alpha[..., k]), tilt[..., k], cos_i, view_cos, cos_h, cos_d
            )
            f += weights[..., k, :] * value[..., None]
        return f


def ramp(stops: np.ndarray, values: np.ndarray, facing: np.ndarray) -> np.ndarray:
    """Return the values of a colour ramp's table at the facings.

    stops (V,), values (V, …), facing (…) clamped to [0, 1]. The result has the facing's shape and
    values' further axes.
    """
    if len(stops) == 1:
        return np.broadcast_to(values[0], (*np.shape(facing), *np.shape(values)[1:]))
    return table_look_up(ramp_table(stops, values), facing)


def ramp_table(stops: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the ramp (256, …) at facings j/255, constant outside its stops."""
    x = np.clip(np.arange(TABLE_SIZE) / (TABLE_SIZE - 1), stops[0], stops[-1])
    low = np.clip(np.searchsorted(stops, x, side="right") - 1, 0, len(stops) - 2)
    t = ((x - stops[low]) / (stops[low + 1] - stops[low])).reshape(-1, *[1] * (np.ndim(values) - 1))
    return values[low] * (1 - t) + values[low + 1] * t


def table_look_up(table: np.ndarray, facing: np.ndarray) -> np.ndarray:
    """Return linear interpolations in a table of equal steps over [0, 1]."""
    position = np.clip(facing, 0.0, 1.0) * (len(table) - 1)
    low = np.clip(
        position.astype(int) if np.ndim(position) else np.asarray(int(position)), 0, len(table) - 2
    )
    t = np.asarray(position - low).reshape(*np.shape(position), *[1] * (table.ndim - 1))
    return table[low] * (1 - t) + table[low + 1] * t


def check(mixture: Mixture) -> None:
    """Raise ValueError unless Cycles can render a mixture of such shapes, kinds and ranges."""
    v, k = len(mixture.stops), len(mixture.kinds)
    shapes = {"stops": (v,), "log_alpha": (v, k), "tilt": (v, k), "weights": (v, k, 3)}
    for name, shape in shapes.items():
        array = getattr(mixture, name)
        if array.shape != shape:
            raise ValueError(
                f"mixture.{name}: expected shape {shape}, found {array.shape} (one row per stop,"
                " one column per closure)"
            )
        if not np.isfinite(array).all():
            raise ValueError(
                f"mixture.{name}: expected finite numbers, found {array[~np.isfinite(array)][0]}"
                " (fit the material again)"
            )
    unknown = [kind for kind in mixture.kinds if kind not in KINDS]
    if unknown or not k:
        raise ValueError(
            f"mixture.kinds: expected names among {', '.join(KINDS)}, found {unknown or 'none'}"
            " (name stock closures)"
        )
    if (
        not 1 <= v <= MAX_STOPS
        or (np.diff(mixture.stops) <= 0).any()
        or mixture.stops[0] < 0
        or mixture.stops[-1] > 1
    ):
        raise ValueError(
            f"mixture.stops: expected 1 to {MAX_STOPS} ascending facings in [0, 1], found {v} (a"
            " colour ramp holds no more)"
        )
    if (mixture.weights < 0).any():
        raise ValueError(
            f"mixture.weights: expected values ≥ 0, found {mixture.weights.min():g} (Cycles has no"
            " negative closures)"
        )
