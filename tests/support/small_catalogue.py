"""A catalogue of two materials for tests: matte white, and a rough metal; their labels are plain
Lambert and one lobe.
"""

import numpy as np

from manifests.materials import (
    Catalogue,
    Distance,
    Entry,
    Errors,
    MixtureData,
    material_hash,
    write,
)


def entry(name, kind, alpha, rgb, split="train"):
    """One material whose mixture is a single closure; the label's numbers are a lobe of the same
    colour, not a fit.
    """
    label = np.full((3, 3, 2, 6), -9.0)
    label[:, :, 1] = 0.0
    label[:, 0, 0] = np.log(np.log1p(np.asarray(rgb) / np.pi))[:, None]
    label[:, 0, 1] = -12.0 if kind == "diffuse" else 2.0
    mixture = MixtureData(
        (kind,), (0.0,), ((float(np.log(alpha)),),), ((0.0,),), (((*map(float, rgb),),),)
    )
    nothing = Distance(l1=(0.0,) * 6)
    label = tuple(label.ravel().tolist())
    return Entry(
        name=name,
        family="test",
        source="tests",
        licence="Apache-2.0",
        split=split,
        hash=material_hash(label, mixture),
        errors=Errors(nothing, nothing, nothing),
        label=label,
        mixture=mixture,
    )


def write_catalogue(path):
    """Write the catalogue; its set is called by the file's stem."""
    materials = (
        entry("matte", "diffuse", 1.0, (0.8, 0.7, 0.6)),
        entry("metal", "ggx", 0.1, (0.9, 0.6, 0.3), split="test"),
        entry("grey", "diffuse", 1.0, (0.2, 0.2, 0.2)),
    )
    write(Catalogue(title="for tests", credit="none", materials=materials), path)
    return path
