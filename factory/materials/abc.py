"""The ABC microfacet fits of MERL's hundred, a second witness beside the neural fits.

f = k_d/π + F D G / (π cos_i cos_o);  D = A / (1 + B (1 − cos_h))^C;  F unpolarised dielectric
Fresnel at cos_d; G = min(1, 2 cos_h cos_i / cos_d, 2 cos_h cos_o / cos_d). Source: Löw, Kronander,
Ynnerman, Unger, "BRDF Models for Accurate and Efficient Rendering of Glossy Surfaces", TOG 2012;
parameters as in dj_brdf's table (CSV: name, kd_r, kd_g, kd_b, A_r, A_g, A_b, B, C, ior).
"""

import csv
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from factory.materials.sources import Source
from manifests.errors import InputError
from manifests.inputs import require_file
from shaders.errors import relative_l1
from shaders.samples import held_out_samples

MAXIMUM_BYTES = 16 << 20  # the table of MERL's hundred has some KiB
COLUMNS = ("kd_r", "kd_g", "kd_b", "A_r", "A_g", "A_b", "B", "C", "ior")


class ABC:
    """One material of the table, callable with the four cosines; it returns f (…, 3)."""

    def __init__(self, k_d: ArrayLike, A: ArrayLike, B: float, C: float, ior: float) -> None:
        self.k_d, self.A, self.B, self.C, self.ior = np.asarray(k_d), np.asarray(A), B, C, ior

    def __call__(
        self, cos_i: np.ndarray, cos_o: np.ndarray, cos_h: np.ndarray, cos_d: np.ndarray
    ) -> np.ndarray:
        g = np.sqrt(self.ior**2 - 1 + cos_d**2)
        parallel, crossed = (
            (g - cos_d) / (g + cos_d),
            (cos_d * (g + cos_d) - 1) / (cos_d * (g - cos_d) + 1),
        )
        F = 0.5 * parallel**2 * (1 + crossed**2)
        G = np.minimum(1, 2 * cos_h / cos_d * np.minimum(cos_i, cos_o))
        D = self.A / (1 + self.B * (1 - cos_h[..., None])) ** self.C
        return self.k_d / np.pi + D * (F * G / (np.pi * cos_i * cos_o))[..., None]


def load(path: Path) -> dict[str, ABC]:
    """Return {name: ABC} of the table at `path`. Raises InputError for a malformed row."""
    require_file(path, "the ABC table", "give it as a CSV file", MAXIMUM_BYTES)
    materials = {}
    with open(path, newline="", encoding="utf-8-sig") as file:
        rows, number = csv.DictReader(file), 1
        try:
            for number, row in enumerate(rows, 2):  # noqa: B007 (named in the error)
                v = [float(row[c]) for c in COLUMNS]
                if not all(math.isfinite(x) for x in v) or not row["name"]:
                    raise ValueError(f"{row['name']}: {v}")
                materials[row["name"]] = ABC(v[:3], v[3:6], *v[6:])
        except (KeyError, TypeError, ValueError, csv.Error) as error:
            result = f"'{str(error)[:80]}'"
            raise InputError(
                f"{path}: line {number}",
                f"numbers under {', '.join(COLUMNS)}",
                result,
                "give the ABC table",
            ) from None
    return materials


def relative_distances(
    sources: Mapping[str, Source], table: Mapping[str, ABC]
) -> dict[str, np.ndarray]:
    """Return the relative L1 of f · cos (6,) between measurement and table at the held-out views.

    Only names that both have are compared.
    """
    samples = held_out_samples()
    return {
        name: relative_l1(
            table[name](*samples.cosines), source.measured(samples.cos_h, samples.cos_d), samples
        )
        for name, source in sources.items()
        if name in table
    }
