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

    maps  {name: L (height, width, 3)}

    What maps are compared by is computed once for each map, and not again for each pair.
    """

    def __init__(self, maps: Maps) -> None:
        self.maps = list(maps.items())
        self._spectra = np.array([_spectrum(L) for L in maps.values()])
        self._row_means = np.array([_amplitudes(L)[:, 0] for L in maps.values()])

    def copy_of(self, L: np.ndarray, among: np.ndarray | None = None) -> str | None:
        """Return the name of the first known map that a map (height, width, 3) is a copy of.

        among  (N,) bool, the known maps with which it is compared; None: all
        """
        if not self.maps:
            return None
        likeness = envmap.highest_correlations(self._spectra, _spectrum(L), L.shape[1])
        own = _amplitudes(L)
        largest = DUPLICATE_DIFFERENCE * own.sum()
        # the means of rows are among the amplitudes, so that where they differ by more, all do
        close = np.abs(self._row_means - own[:, 0]).sum((1, 2)) < largest
        candidates = close | (likeness > envmap.SAME_SOURCE)
        for index in np.flatnonzero(candidates if among is None else candidates & among):
            name, known = self.maps[index]
            if (
                likeness[index] > envmap.SAME_SOURCE
                or np.abs(_amplitudes(known) - own).sum() < largest
            ):
                return name
        return None


def without_duplicates(maps: Maps, held: Container[str]) -> dict[str, np.ndarray]:
    """Return each map once, under the name by which it is held out if it is.

    maps    {name: L}; held: names of maps that training must not see
    Raises  InputError if two held-out names mean one map
    """
    ordered = {name: maps[name] for name in sorted(maps, key=lambda name: name not in held)}
    known = KnownLights(ordered)
    kept = np.zeros(len(ordered), bool)
    for index, (name, L) in enumerate(ordered.items()):
        duplicate = known.copy_of(L, kept)
        if duplicate is not None and name in held:
            raise InputError(
                f"held-out light '{name}'",
                "a map of its own",
                f"'{duplicate}' again",
                "name each held-out map once",
            )
        kept[index] = duplicate is None
    return {name: L for (name, L), is_kept in zip(ordered.items(), kept, strict=True) if is_kept}


def join_maps(maps: Maps, others: Maps, where: str, remedy: str) -> dict[str, np.ndarray]:
    """Return all maps of both; of copies under one name, those of `others`.

    where, remedy  of the InputError
    Raises         InputError for two different maps of one name, since sides go by names
    """
    for name in (name for name in others if name in maps):
        if KnownLights({name: maps[name]}).copy_of(others[name]) is None:
            result = f"a second, different one under '{name}'"
            raise InputError(where, "one map under a name", result, remedy)
    return {**maps, **others}


def _spectrum(L: np.ndarray) -> np.ndarray:
    return envmap.log_spectrum(L).astype(np.complex64)


def _amplitudes(L: np.ndarray) -> np.ndarray:
    """Return the amplitudes (height, width/2 + 1, 3) float32 of a map's Fourier series along rows.

    Averaging to 64×128 by other programs, and half floats, change them by less than
    DUPLICATE_DIFFERENCE.
    """
    return np.abs(np.fft.rfft(L, axis=1)).astype(np.float32)
