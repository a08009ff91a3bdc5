"""The family of each measured material, and its split.

Most of MERL's hundred carry their family in the name; the rest is listed. The paper holds out 20 of
80 materials and names none: the twenty here are our choice, drawn from every family.
manifests.splits says which 60 of the other 80 the `paper` preset keeps.
"""

import hashlib
from typing import Literal, TypeAlias

Split: TypeAlias = Literal["train", "test"]
HELD_OUT = frozenset(
    [
        *(
            "chrome-steel",
            "aluminium",
            "ss440",
            "brass",
            "green-metallic-paint2",
            "silver-metallic-paint",
            "gold-metallic-paint",
        ),
        *(
            "color-changing-paint1",
            "color-changing-paint2",
            "purple-paint",
            "white-paint",
            "specular-green-phenolic",
        ),
        *(
            "specular-yellow-phenolic",
            "gray-plastic",
            "pink-plastic",
            "red-fabric",
            "white-fabric",
            "pink-fabric",
            "green-latex",
        ),
        "pickled-oak-260",
    ]
)
NAMED = {
    "metal": (
        "alum-bronze aluminium black-oxidized-steel brass chrome chrome-steel grease-covered-steel"
        " hematite nickel ss440 steel tungsten-carbide two-layer-gold two-layer-silver"
    ),
    "wood": (
        "cherry-235 colonial-maple-223 fruitwood-241 ipswich-pine-221 natural-209 pickled-oak-260"
        " special-walnut-224"
    ),
    "stone and ceramic": (
        "alumina-oxide aventurnine black-obsidian pink-jasper silicon-nitrade white-marble"
    ),
    "plastic": "black-soft-plastic delrin nylon polyethylene pvc teflon white-diffuse-bball",
    "rubber": "green-latex polyurethane-foam",
    "fabric": "pink-felt",
    "paint": "color-changing-paint1 color-changing-paint2 color-changing-paint3 pearl-paint",
}
BY_WORD = (  # the first word found in the name decides
    ("metallic-paint", "metallic paint"),
    ("gold-paint", "metallic paint"),
    ("silver-paint", "metallic paint"),
    ("paint", "paint"),
    ("phenolic", "phenolic"),
    ("acrylic", "plastic"),
    ("plastic", "plastic"),
    ("rubber", "rubber"),
    ("fabric", "fabric"),
)
RGL_FAMILIES = {  # by the name's first part, as EPFL's database groups them
    "acrylic": "fabric",
    "aurora": "paint",
    "cardboard": "paper",
    "cc": "colour-changing paint",
    "cg": "paint",
    "chm": "paint",
    "cm": "paint",
    "colodur": "plastic",
    "ilm": "paint",
    "irid": "metallic paint",
    "laika": "paint",
    "leaf": "leaf",
    "paper": "paper",
    "satin": "fabric",
    "spectralon": "reference",
    "vch": "vinyl wrap",
}


def family(name: str) -> str:
    """Return the family of a MERL material; "other" for a name that says nothing."""
    for kind, names in NAMED.items():
        if name in names.split():
            return kind
    return next((kind for word, kind in BY_WORD if word in name), "other")


def rgl_family(name: str) -> str:
    """Return the family of an EPFL material."""
    return RGL_FAMILIES.get(name.split("_")[0], "other")


def split(name: str) -> Split:
    """Return the split of a MERL material, train or test."""
    return "test" if name in HELD_OUT else "train"


def rgl_split(name: str) -> Split:
    """Return the split of an EPFL material, train or test.

    The test split has about a fifth, by a hash of the name's first part, so that one maker's
    colours stay together. This is our choice: the paper has MERL alone.
    """
    group = hashlib.sha256(name.split("_")[0].encode()).hexdigest()
    return "test" if int(group[:8], 16) / 2**32 < 0.2 else "train"
