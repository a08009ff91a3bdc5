"""The materials: labels, the mixtures that render them, how well they agree, where they come from
and who may learn from them.

label    (3, 3, 2, 6) natural logarithms: channel, lobe (ascending mean log γ), (κ, γ), spline
control values; 108 numbers
mixture  shaders.mixture.Mixture: what Cycles renders
errors   on view angles that no fit saw (0.5, 15, 30, 45, 60, 75°): relative L1 of f · cos, and the
display L2 of a sphere under
         three light maps (mean squared difference of values in [0, 255], exposure from the 99th
         percentile)

A catalogue is one JSON file, a material a line. `materials.json` holds MERL's hundred,
`materials-rgl.json` EPFL's isotropic ones.
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
BUILT_IN = (FOLDER / "materials.json", FOLDER / "materials-rgl.json")


# of f · cos; beyond, sums over materials are no numbers
RelativeError = Annotated[float, Meta(ge=0, le=1e12)]
DisplayError = Annotated[float, Meta(ge=0, le=255.0**2)]  # mean square of differences in [0, 255]


class Distance(Struct, frozen=True, forbid_unknown_fields=True):
    """l1: at 0.5, 15, 30, 45, 60, 75° (fractions of the reference); display_l2: a value a light
    map.
    """

    l1: Annotated[tuple[RelativeError, ...], Meta(min_length=6, max_length=6)]
    display_l2: tuple[DisplayError, ...] = ()

    @property
    def mean(self) -> float:
        """L1 over the six views."""
        return float(np.mean(self.l1))

    @property
    def worst(self) -> float:
        """L1 at the worst view."""
        return max(self.l1)


class Errors(Struct, frozen=True, forbid_unknown_fields=True):
    """What stands apart by how much: the reference is named last."""

    nodes_vs_label: Distance
    nodes_vs_source: Distance
    label_vs_source: Distance


class Neighbour(Struct, frozen=True, forbid_unknown_fields=True):
    """The training material nearest to a test one; distance: relative L1 of their labels' f · cos,
    mean of the six views.
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

    family       metal, metallic paint, paint, plastic, phenolic, rubber, fabric, wood, …
    split        train or test; which 60 of the training ones the `paper` preset keeps is said by
    manifests.splits
    hash         of label and mixture: twins share it
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
    """A file of materials; light_maps name those under which display_l2 was measured."""

    version: int = VERSION
    title: str
    credit: str
    light_maps: tuple[str, ...] = ()
    materials: tuple[Entry, ...]


@dataclass(frozen=True)
class Material:
    """An entry ready for use: label (3, 3, 2, 6) float64 logarithms, mixture a Mixture; the rest as
    in Entry.
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
        """κ and γ control values (3, 3, 2, 6): exp(label), what shaders.dsbrdf evaluates."""
        return np.exp(self.label)


def material_hash(label: tuple[float, ...], mixture: MixtureData) -> str:
    """Hash of a material: of its label (108 numbers) and the mixture (MixtureData) that renders it,
    as an Entry holds them.
    """
    return hashlib.sha256(msgspec.json.encode([label, mixture])).hexdigest()[:HASH_DIGITS]


def require_own_hash(entry: Entry, where: object) -> None:
    """Raises InputError if an entry's hash is not that of its label and mixture: one of the three
    was altered; `where` names the file.
    """
    if entry.hash != (own := material_hash(entry.label, entry.mixture)):
        remedy = "copy the file again, or fit the material again"
        raise InputError(
            f"{where}: '{entry.name}'", f"hash {own}, of its label and mixture", entry.hash, remedy
        )


def material(entry: Entry, where: object) -> Material:
    """The entry ready for use. Raises InputError if its numbers do not fit together, or its hash
    not to them; `where` names the file.
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
    """The catalogue file at `path`, checked against its type. Raises InputError, one line."""
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
    """The bytes of a catalogue's file: one line for each material, keys in the order of the
    type.
    """
    head = msgspec.to_builtins(catalogue)
    entries = head.pop("materials")
    lines = ",\n".join(json.dumps(entry, separators=(",", ":")) for entry in entries)
    text = json.dumps(head, indent=1)[:-2] + ',\n "materials": [\n' + lines + "\n]}\n"
    return text.encode("utf-8")


def write(catalogue: Catalogue, path: str | os.PathLike) -> None:
    """Writes the file, whole or not at all."""
    write_bytes(path, encode(catalogue))


@functools.cache
def _loaded(path: Path, _stamp: int) -> dict[str, Material]:
    return {entry.name: material(entry, path.name) for entry in read_catalogue(path).materials}


def load_catalogue(*paths: str | os.PathLike) -> dict[str, Material]:
    """{name: Material} of the files given, or of the built-in ones; a later file's material takes
    the place of an earlier one's name.
    """
    materials = {}
    for path in map(Path, paths or [p for p in BUILT_IN if p.exists()]):
        materials.update(_loaded(path, path.stat().st_mtime_ns))
    return materials


def find(name: str, materials: Mapping[str, Material] | None = None) -> Material:
    """The material of that name. Raises InputError that lists the closest names, or what an
    everyday word may mean.
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
