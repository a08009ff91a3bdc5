"""The settings in force as one short hash: part of every shot's id, so that a changed setting means
new pictures, never mixed ones.
"""

import hashlib
import json
from functools import cache
from importlib.metadata import PackageNotFoundError, version


@cache
def render_fingerprint():
    """Hash of every render setting's value (not its reason), the light-transport tiers and
    Blender's version up to the minor one.
    """
    from factory.render import settings

    def values(group):
        return [[s.path, s.value] for s in group]

    groups = (settings.ALWAYS, *settings.PIXELS.values(), settings.GEOMETRY)
    tiers = {
        name: {k: v for k, v in tier.items() if k != "reason"}
        for name, tier in settings.TIERS.items()
    }
    try:
        blender = ".".join(version("bpy").split(".")[:2])
    except PackageNotFoundError:  # planning alone needs no Blender
        blender = "none"
    text = json.dumps([*map(values, groups), tiers, blender], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
