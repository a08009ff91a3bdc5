"""Copies of light maps: one map under two names, however it was scaled, turned or mirrored.

A copy under another name would let training see a held-out map. Two properties of a map do not
change with its rotation, and each finds copies that the other one may miss: the amplitudes of its
Fourier series along rows, and its highest correlation with the other map over all rotations.
"""

from collections.abc import Container, Mapping

import numpy as np

from manifests.errors import InputError
from shaders import envmap

Maps = Mapping[str, np.ndarray]  # {name: L (64, 128, 3)}
DUPLICATE_DIFFERENCE = 0.05  # of Fourier amplitudes, relative


class KnownLights:
    """Light maps of one size, among which copies of a further map are found.

    What maps are compared by is computed once for each: a thousand maps take seconds, and not the
    minutes that each pair by itself would.
    """

    def __init__(self) -> None:
        self.names: list[str] = []
        self._spectra = _Rows()
        self._amplitudes = _Rows()
        self._row_means = _Rows()

    def add(self, name: str, L: np.ndarray) -> None:
        """Let a map (height, width, 3) be known by a name."""
        self.names.append(name)
        self._spectra.add(envmap.log_spectrum(L).astype(np.complex64))
        amplitudes = _amplitudes(L)
        self._amplitudes.add(amplitudes)
        self._row_means.add(amplitudes[:, 0])

    def copy_of(self, L: np.ndarray) -> str | None:
        """Return the name of the first known map that a map (height, width, 3) is a copy of."""
        if not self.names:
            return None
        likeness = envmap.highest_correlations(
            self._spectra.all(), envmap.log_spectrum(L).astype(np.complex64), L.shape[1]
        )
        copies = likeness > envmap.SAME_SOURCE
        own = _amplitudes(L)
        largest = DUPLICATE_DIFFERENCE * own.sum()
        # the means of rows are among the amplitudes, so that where they differ by more, all do
        close = np.abs(self._row_means.all() - own[:, 0]).sum((1, 2)) < largest
        for index in np.flatnonzero(close & ~copies):
            copies[index] = np.abs(self._amplitudes.all()[index] - own).sum() < largest
        first = np.flatnonzero(copies)
        return self.names[first[0]] if len(first) else None


def without_duplicates(maps: Maps, held: Container[str]) -> dict[str, np.ndarray]:
    """Return each map once, under the name by which it is held out if it is.

    maps    {name: L}; held: names of maps that training must not see
    Raises  InputError if two held-out names mean one map
    """
    result: dict[str, np.ndarray] = {}
    known = KnownLights()
    for name in sorted(maps, key=lambda name: name not in held):
        duplicate = known.copy_of(maps[name])
        if duplicate is None:
            result[name] = maps[name]
            known.add(name, maps[name])
        elif name in held:
            raise InputError(
                f"held-out light '{name}'",
                "a map of its own",
                f"'{duplicate}' again",
                "name each held-out map once",
            )
    return result


class _Rows:
    """Arrays of one shape in one array, to which further ones are added without copying it."""

    def __init__(self) -> None:
        self._stored: np.ndarray | None = None
        self._count = 0

    def add(self, row: np.ndarray) -> None:
        if self._stored is None:
            self._stored = np.empty((16, *row.shape), row.dtype)
        elif self._count == len(self._stored):
            self._stored = np.concatenate([self._stored, np.empty_like(self._stored)])
        self._stored[self._count] = row
        self._count += 1

    def all(self) -> np.ndarray:
        assert self._stored is not None
        return self._stored[: self._count]


def _amplitudes(L: np.ndarray) -> np.ndarray:
    """Return the amplitudes (height, width/2 + 1, 3) float32 of a map's Fourier series along rows.

    Averaging to 64×128 by other programs, and half floats, change them by less than
    DUPLICATE_DIFFERENCE.
    """
    return np.abs(np.fft.rfft(L, axis=1)).astype(np.float32)
