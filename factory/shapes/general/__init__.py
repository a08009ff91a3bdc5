"""General shapes: nineteen families of forms that are neither furniture nor cars, any number of
seeds.

They exist so that a network learns normals of forms rather than of four kinds of objects. Whole
families are held out for testing (manifests/splits.json, rule "general").
"""

FAMILIES = {  # name: (module of this package, key of its random numbers)
    "vessel": ("vessels", 101),
    "dish": ("vessels", 102),
    "compound": ("solids", 103),
    "carving": ("solids", 104),
    "metaball": ("solids", 105),
    "stone": ("solids", 106),
    "knot": ("solids", 107),
    "wire": ("solids", 108),
    "letter": ("extrusions", 109),
    "extrusion": ("extrusions", 110),
    "cushion": ("soft", 111),
    "cloth": ("soft", 112),
    "bag": ("soft", 113),
    "lamp": ("household", 114),
    "table": ("household", 115),
    "tool": ("household", 116),
    "toy": ("household", 117),
    "block": ("boxes", 118),
    "cabinet": ("boxes", 119),
}
