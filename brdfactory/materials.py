"""Materials by name, description or label, and exact blends of them.

label  (108,) float32 natural logarithms of κ and γ control values, docs/materials.md
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from brdfactory import arguments
from learn.editing import material_file, targets
from manifests.errors import InputError
from shaders.dsbrdf import SIZE

PHOTOGRAPH = "give bf.decompose(photo, mask).materials[0] instead"


@dataclass(frozen=True)
class Material:
    """A material, or a blend of several.

    name   what messages and files call it
    parts  (weight, label (108,)) of each material in the blend; the weights sum to 1
    read   those of the labels that were read from pictures, as a decomposition's materials are

    Radiance is linear in the reflectance, so a blend's picture is the weighted sum of its parts'
    pictures, exactly.
    """

    name: str
    parts: tuple[tuple[float, np.ndarray], ...]
    read: tuple[np.ndarray, ...] = ()

    @property
    def label(self) -> np.ndarray:
        """The label (108,) of a single material. Raises InputError for a blend."""
        if len(self.parts) > 1:
            rule = "one material, which has a label"
            raise InputError(
                f"material {self.name}", rule, f"a blend of {len(self.parts)}", "use its parts"
            )
        return self.parts[0][1]


def material(text: "str | Path | np.ndarray | Material", name: str = "") -> Material:
    """Return a Material.

    text    a name of the catalogue; a description such as
            "principled(base_color=#a03020, roughness=.35)"; a material.json; a label (108,), which
            is taken to be measured, not read from a picture; or a Material, which is returned as
            it is
    name    what messages and files call it; "": the text itself
    Raises  InputError: an unknown name (the message suggests close ones), a picture
    """
    if isinstance(text, Material):
        return text
    if isinstance(text, np.ndarray):
        rule, remedy = f"a label ({SIZE},) of finite numbers", "bf.material('brass').label is one"
        label = arguments.require_floats("material", text, rule, remedy)
        if label.shape != (SIZE,) or not np.isfinite(label).all():
            raise InputError("material", rule, f"shape {label.shape}", remedy)
        label = material_file.require_label(label, "material")
        return Material(name or "label", ((1.0, label),))

    rule = f"a name, a description, a file, an array ({SIZE},) or a bf.Material"
    text = arguments.require_path("material", text, rule, "'brass' is a name")

    def refuse(path: Path) -> np.ndarray:
        rule = "a material's name, an expression, or a material.json"
        raise InputError(f"material {path}", rule, "a picture", PHOTOGRAPH)

    labels = targets.resolve_labels(text, refuse)
    if labels is None or len(labels) != 1:
        result = "keep" if labels is None else f"{len(labels)} materials"
        raise InputError(f"material {text}", "one material", result, "name one")
    shown = name or re.sub(r"\s+", " ", text)
    label = np.asarray(labels[0], np.float32)
    return Material(shown, ((1.0, label),), (label,) if targets.is_from_picture(text) else ())


def blend(
    first: str | Path | np.ndarray | Material,
    second: str | Path | np.ndarray | Material,
    share: float = 0.5,
) -> Material:
    """Return a blend of two materials.

    first, second  as `material` takes them
    share          of the second material, from 0 (only the first) to 1 (only the second)
    Raises         InputError: a share outside this range, an unknown name
    """
    rule, remedy = "a number from 0 to 1", "0.5 is half each"
    share = arguments.require_number("blend: share", share, rule, remedy)
    if not 0 <= share <= 1:
        raise InputError("blend: share", rule, f"{share:g}", remedy)
    a, b = material(first), material(second)
    weighted = [(w * (1 - share), m) for w, m in a.parts] + [(w * share, m) for w, m in b.parts]
    return Material(
        f"{a.name} and {b.name}, {share:.0%}",
        tuple((w, m) for w, m in weighted if w > 0),
        a.read + b.read,
    )
