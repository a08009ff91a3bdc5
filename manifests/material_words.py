"""Suggestions for an unknown material: an everyday word, part of a name, or a typing error."""

import difflib
from collections.abc import Collection

from manifests.errors import closest

NEAR = 0.75  # of difflib: one wrong letter in a word of five has 0.8
# no material has such a name; these look similar on a sphere (judged by eye), most similar first
ALIKE = {
    "leather": ("natural-209", "special-walnut-224", "black-soft-plastic"),
    "copper": ("alum-bronze", "brass"),
    "bronze": ("alum-bronze", "brass"),
    "gold": ("gold-metallic-paint", "two-layer-gold", "brass"),
    "silver": ("two-layer-silver", "chrome-steel", "silver-metallic-paint"),
    "mirror": ("chrome", "chrome-steel"),
    "iron": ("hematite", "black-oxidized-steel"),
    "porcelain": ("alumina-oxide", "white-acrylic"),
    "ceramic": ("alumina-oxide", "white-acrylic"),
    "stone": ("white-marble", "black-obsidian", "pink-jasper"),
    "wood": ("cherry-235", "colonial-maple-223", "fruitwood-241"),
    "oak": ("pickled-oak-260", "natural-209"),
    "walnut": ("special-walnut-224", "fruitwood-241"),
    "velvet": ("dark-specular-fabric", "pink-felt"),
    "silk": ("satin_white", "vch_silk_blue"),
    "cotton": ("white-fabric", "white-fabric2"),
    "linen": ("white-fabric", "beige-fabric"),
    "wool": ("acrylic_felt_white", "pink-felt"),
    "vinyl": ("pvc", "vch_golden_yellow"),
}


def suggestion(name: object, known: Collection[str]) -> str:
    """Return what to try instead of an unknown name, as text.

    The text states the everyday word that is meant, if it is known; otherwise it lists materials
    that look like that word, names that contain the word, or the closest names.

    known  every name that would be understood
    """
    word = str(name).strip().lower()
    # a name has no spaces: of several words, one may be everyday
    near = [
        match
        for part in dict.fromkeys([word, *word.split()])
        for match in difflib.get_close_matches(part, ALIKE, n=1, cutoff=NEAR)
    ]
    if near and near[0] in known and word not in known:
        return f"did you mean {near[0]}?"
    named = [k for k in known if word in k.lower().replace("_", "-").split("-")]
    looks = [k for k in (ALIKE[near[0]] if near else ()) if k in known]
    if looks and word not in known:
        more = [k for k in named if k not in looks][:2]
        return (
            f"these look like {near[0]}: {', '.join(looks + more)}; `python -m learn edit` also"
            " takes a picture of it"
        )
    return f"did you mean {', '.join(sorted(named)[:5])}?" if named else closest(name, known)
