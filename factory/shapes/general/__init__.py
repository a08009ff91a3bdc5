"""General shapes: nineteen families of forms that are neither furniture nor cars, any number of
seeds, and eight families of ordinary things for testing alone.

The nineteen exist so that a network learns normals of forms rather than of four kinds of objects;
four of them are held out for testing (manifests/splits.json, rule "general"). The eight are held
out whatever the rule.
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
# Families that no training may ever have: whatever rule splits a job, they are for testing
# (manifests/splits.json, "test_only").
TEST_ONLY = {
    "shoe": ("clothing", 201),
    "umbrella": ("clothing", 202),
    "plant": ("growth", 203),
    "seashell": ("growth", 204),
    "key": ("ironmongery", 205),
    "screw": ("ironmongery", 206),
    "basket": ("rods", 207),
    "cycle": ("rods", 208),
}
