"""Materials: labels, the mixtures that render them, their fit errors, sources, licences and splits.

label    (3, 3, 2, 6) natural logarithms: channel, lobe (ascending mean log γ), (κ, γ), spline
         control values; 108 numbers
mixture  shaders.mixture.Mixture, which Cycles renders
errors   at view angles that no fit used (0.5, 15, 30, 45, 60, 75°): relative L1 of f · cos, and the
         display L2 of a sphere under three light maps (mean squared difference of values in [0,
         255], exposure from the 99th percentile)

A catalogue is one JSON file with one line per material. `materials.json` holds the hundred of MERL,
`materials-rgl.json` the isotropic ones of EPFL.
"""

import functools
import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta, Struct

from manifests import reading
from manifests.errors import InputError
from manifests.files import write_bytes
from manifests.material_words import suggestion
from shaders import dsbrdf
from shaders.mixture import Mixture

VERSION = 1
HASH_DIGITS = 16
LARGEST_LABEL = 14.0  # log γ of the sharpest lobe that the layer is tested with is 11.5
FOLDER = Path(__file__).parent
# MERL's database is too dark: docs/materials.md has what this factor follows from
CALIBRATIONS = {"MERL through Neural-BRDF": 2.7}
BUILT_IN = (FOLDER / "materials.json", FOLDER / "materials-rgl.json")


# of f · cos; beyond, sums over materials are no numbers
RelativeError = Annotated[float, Meta(ge=0, le=1e12)]
DisplayError = Annotated[float, Meta(ge=0, le=255.0**2)]  # mean square of differences in [0, 255]


class Distance(Struct, frozen=True, forbid_unknown_fields=True):
    """How far two descriptions of a material differ.

    l1          relative L1 at 0.5, 15, 30, 45, 60, 75°
    display_l2  one value per light map
    """

    l1: Annotated[tuple[RelativeError, ...], Meta(min_length=6, max_length=6)]
    display_l2: tuple[DisplayError, ...] = ()

    @property
    def mean(self) -> float:
        """Mean L1 of the six views."""
        return float(np.mean(self.l1))

    @property
    def worst(self) -> float:
        """L1 of the worst view."""
        return max(self.l1)


class Errors(Struct, frozen=True, forbid_unknown_fields=True):
    """The differences of mixture (nodes), label and measurement; the reference is named second."""

    nodes_vs_label: Distance
    nodes_vs_source: Distance
    label_vs_source: Distance


class Neighbour(Struct, frozen=True, forbid_unknown_fields=True):
    """The training material that is closest to a test material.

    distance  relative L1 of their labels' f · cos, mean of the six views
    """

    name: str
    distance: float


class MixtureData(Struct, frozen=True, forbid_unknown_fields=True):
    """shaders.mixture.Mixture as plain lists."""

    kinds: tuple[str, ...]
    stops: tuple[float, ...]
    log_alpha: tuple[tuple[float, ...], ...]
    tilt: tuple[tuple[float, ...], ...]
    weights: tuple[tuple[tuple[float, float, float], ...], ...]


class Entry(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One material as it is written.

    family  metal, metallic paint, paint, plastic, phenolic, rubber, fabric, wood, …
    split   train or test; manifests.splits says which 60 training materials the `paper` preset uses
    hash    of label and mixture; duplicates share it
    """

    name: str
    family: str
    source: str
    licence: str
    split: Literal["train", "test"]
    hash: str
    errors: Errors
    nearest_train: Neighbour | None = None
    label: tuple[float, ...]
    mixture: MixtureData


class Catalogue(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A file of materials; light_maps are those under which display_l2 was measured."""

    version: int = VERSION
    title: str
    credit: str
    light_maps: tuple[str, ...] = ()
    materials: tuple[Entry, ...]


@dataclass(frozen=True)
class Material:
    """An entry ready for use.

    label    (3, 3, 2, 6) float64 logarithms
    mixture  a Mixture
    The other fields are those of Entry.
    """

    name: str
    family: str
    source: str
    licence: str
    split: str
    hash: str
    errors: Errors
    nearest_train: Neighbour | None
    label: np.ndarray
    mixture: Mixture

    @property
    def m(self) -> np.ndarray:
        """κ and γ control values (3, 3, 2, 6): exp(label), as shaders.dsbrdf takes them."""
        return np.exp(self.label)

    @property
    def calibration(self) -> float:
        """How many times as much light the surface reflects as its source has measured."""
        return CALIBRATIONS.get(self.source, 1.0)

    @property
    def calibrated_label(self) -> np.ndarray:
        """The label (3, 3, 2, 6) of the surface itself: as measured, times `calibration`."""
        factor = self.calibration
        return self.label if factor == 1 else dsbrdf.scale_label(self.label, factor)


def material_hash(label: tuple[float, ...], mixture: MixtureData) -> str:
    """Return the hash of a material's label (108 numbers) and mixture, as an Entry holds them."""
    return hashlib.sha256(msgspec.json.encode([label, mixture])).hexdigest()[:HASH_DIGITS]


def require_own_hash(entry: Entry, where: object) -> None:
    """Raise InputError if an entry's hash is not that of its label and mixture.

    where  the file, for the error
    """
    if entry.hash != (own := material_hash(entry.label, entry.mixture)):
        remedy = "copy the file again, or fit the material again"
        raise InputError(
            f"{where}: '{entry.name}'", f"hash {own}, of its label and mixture", entry.hash, remedy
        )


def material(entry: Entry, where: object) -> Material:
    """Return the entry ready for use.

    where   the file, for the error
    Raises  InputError if its numbers or its hash do not fit together
    """
    label = np.asarray(entry.label)
    if label.size != dsbrdf.SIZE or not np.isfinite(label).all():
        raise InputError(
            f"{where}: {entry.name}",
            f"a label of {dsbrdf.SIZE} finite numbers",
            f"{label.size}",
            "fit the material again",
        )
    if label.max() > LARGEST_LABEL:
        remedy = "fit or copy the materials again"
        raise InputError(
            f"{where}: '{entry.name}'",
            f"natural logarithms up to {LARGEST_LABEL:g}",
            f"{label.max():g}",
            remedy,
        )
    try:
        mixture = Mixture(**{f: getattr(entry.mixture, f) for f in entry.mixture.__struct_fields__})
    except ValueError as error:
        raise InputError(
            f"{where}: {entry.name}",
            "a mixture that Cycles can render",
            str(error),
            "fit the material again",
        ) from None
    require_own_hash(entry, where)
    fields = {
        f: getattr(entry, f) for f in entry.__struct_fields__ if f not in ("label", "mixture")
    }
    return Material(**fields, label=label.reshape(dsbrdf.SHAPE), mixture=mixture)


def read_catalogue(path: str | os.PathLike) -> Catalogue:
    """Return the catalogue in a file. Raises InputError."""
    catalogue = reading.read(path, Catalogue)
    if catalogue.version != VERSION:
        raise InputError(
            path,
            f"version {VERSION}",
            str(catalogue.version),
            "fit the materials again with this program",
        )
    return catalogue


def encode(catalogue: Catalogue) -> bytes:
    """Return the bytes of a catalogue: one line per material, keys in the type's order."""
    head = msgspec.to_builtins(catalogue)
    entries = head.pop("materials")
    lines = ",\n".join(json.dumps(entry, separators=(",", ":")) for entry in entries)
    text = json.dumps(head, indent=1)[:-2] + ',\n "materials": [\n' + lines + "\n]}\n"
    return text.encode("utf-8")


def write(catalogue: Catalogue, path: str | os.PathLike) -> None:
    """Write a catalogue's file, whole or not at all."""
    write_bytes(path, encode(catalogue))


@functools.cache
def _load(path: Path, _stamp: int) -> dict[str, Material]:
    return {entry.name: material(entry, path.name) for entry in read_catalogue(path).materials}


def load_catalogue(*paths: str | os.PathLike) -> dict[str, Material]:
    """Return {name: Material} of the given files, or of the built-in ones.

    If two files have a material of one name, the later file's is returned.
    """
    materials = {}
    for path in map(Path, paths or [p for p in BUILT_IN if p.exists()]):
        stamp = path.stat().st_mtime_ns if path.exists() else 0  # a missing one is refused there
        materials.update(_load(path, stamp))
    return materials


def find(name: str, materials: Mapping[str, Material] | None = None) -> Material:
    """Return the material of that name.

    Raises  InputError that lists the closest names, or materials that look like an everyday word
    """
    materials = load_catalogue() if materials is None else materials
    if name not in materials:
        raise InputError(
            f"material {name!r}",
            "a name in the catalogue",
            "none of that name",
            suggestion(name, materials),
        )
    return materials[name]
