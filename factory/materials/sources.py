"""Where measured materials come from: what a path holds, and what to write beside each name.

An npz of Neural-BRDF weights (MERL's hundred or EPFL's fifty-one, told apart by their names) or a
folder of MERL `.binary` files.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from factory.materials import families, merl_binary, nbrdf
from manifests.errors import InputError, closest
from manifests.inputs import require_file

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
    """measured: callable (cos_h, cos_d) → f (…, 3); the rest as a catalogue entry has it."""

    name: str
    measured: Any
    family: str
    source: str
    licence: str
    split: str


def load(path, only=()):
    """{name: Source} of an npz or a folder; only: names to keep, all if empty.

    Raises  InputError for what is neither, and for a name that is not there
    """
    path = Path(path)
    if not path.is_dir():
        require_file(path, "an npz of Neural-BRDF weights or a folder of MERL .binary files")
    if path.is_dir() or path.suffix == merl_binary.SUFFIX:
        names, make = merl_binary.files(path), _of_file
    else:
        names, make = (
            {
                name.removesuffix("_rgb"): (name, network)
                for name, network in nbrdf.load(path).items()
            },
            _of_network,
        )
    for name in names:  # a file is named after it
        if not NAME.fullmatch(name):
            raise InputError(
                path,
                "names of letters, digits, '.', '_', ' ' and '-'",
                repr(name[:60]),
                "rename it there",
            )
    for name in only:
        if name not in names:
            raise InputError(
                path, f"a material named {name!r}", "none of that name", closest(name, names)
            )
    return {name: make(name, names[name]) for name in sorted(names) if not only or name in only}


def credit(sources):
    """Whom a catalogue of these sources thanks."""
    return RGL_CREDIT if any(s.source.startswith("EPFL") for s in sources.values()) else MERL_CREDIT


def _of_file(name, path):
    return Source(
        name,
        merl_binary.read(path),
        families.family(name),
        "MERL .binary",
        MERL_LICENCE,
        families.split(name),
    )


def _of_network(name, found):
    stored, network = found
    if stored.endswith("_rgb"):  # EPFL's names end so in Neural-BRDF's archive
        side = families.rgl_split(name)
        return Source(
            name,
            network,
            families.rgl_family(name),
            "EPFL RGL through Neural-BRDF",
            RGL_LICENCE,
            side,
        )
    return Source(
        name,
        network,
        families.family(name),
        "MERL through Neural-BRDF",
        MERL_LICENCE,
        families.split(name),
    )
