"""Sources of measured materials: the contents of a path, and the credits of each name.

A path is an npz of Neural-BRDF weights (MERL's hundred or EPFL's fifty-one, recognised by their
names) or a folder of MERL `.binary` files.
"""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from factory.materials import families, merl_binary, nbrdf
from manifests.errors import InputError, closest
from manifests.inputs import require_file
from shaders.samples import Measured

MERL_CREDIT = (
    "MERL BRDF database (Matusik, Pfister, Brand, McMillan, SIGGRAPH 2003), through the neural fits"
    " of Sztrajman, Rainer, Ritschel, Weyrich (Neural BRDF Representation and Importance Sampling,"
    " CGF 2021)"
)
RGL_CREDIT = (
    "EPFL RGL material database (Dupuy, Jakob, SIGGRAPH Asia 2018), through the neural fits of"
    " Sztrajman et al. (CGF 2021)"
)
MERL_LICENCE = "measurements CC-BY-SA-4.0 (MERL), neural fits MIT; numbers fitted here CC-BY-SA-4.0"
NAME = re.compile(r"\w[\w. +()-]{0,99}")
RGL_LICENCE = "neural fits MIT; numbers fitted here MIT"


@dataclass(frozen=True)
class Source:
    """A measured material, a callable (cos_h, cos_d) → f (…, 3), with facts for the catalogue."""

    name: str
    measured: Measured
    family: str
    source: str
    licence: str
    split: families.Split


def load(path: str | Path, only: Collection[str] = ()) -> dict[str, Source]:
    """Return {name: Source} of an npz or a folder; only: names to keep, all if empty.

    Raises  InputError for any other path, and for a name that is not there
    """
    path = Path(path)
    make: dict[str, partial[Source]]
    if not path.is_dir():
        require_file(path, "an npz of Neural-BRDF weights or a folder of MERL .binary files")
    if path.is_dir() or path.suffix == merl_binary.SUFFIX:
        make = {n: partial(_of_file, n, file) for n, file in merl_binary.files(path).items()}
    else:
        make = {
            stored.removesuffix("_rgb"): partial(_of_network, stored, network)
            for stored, network in nbrdf.load(path).items()
        }
    for name in make:  # a file is named after it
        if not NAME.fullmatch(name):
            raise InputError(
                path,
                "names of letters, digits, '.', '_', ' ' and '-'",
                repr(name[:60]),
                "rename it there",
            )
    for name in only:
        if name not in make:
            raise InputError(
                path, f"a material named {name!r}", "none of that name", closest(name, make)
            )
    return {name: make[name]() for name in sorted(make) if not only or name in only}


def credit(sources: Mapping[str, Source]) -> str:
    """Return the credit of a catalogue of these sources."""
    return RGL_CREDIT if any(s.source.startswith("EPFL") for s in sources.values()) else MERL_CREDIT


def _of_file(name: str, path: Path) -> Source:
    return Source(
        name,
        merl_binary.read(path),
        families.family(name),
        "MERL .binary",
        MERL_LICENCE,
        families.split(name),
    )


def _of_network(stored: str, network: nbrdf.NeuralBRDF) -> Source:
    name = stored.removesuffix("_rgb")
    if stored.endswith("_rgb"):  # EPFL's names end so in Neural-BRDF's archive
        split = families.rgl_split(name)
        return Source(
            name,
            network,
            families.rgl_family(name),
            "EPFL RGL through Neural-BRDF",
            RGL_LICENCE,
            split,
        )
    return Source(
        name,
        network,
        families.family(name),
        "MERL through Neural-BRDF",
        MERL_LICENCE,
        families.split(name),
    )
