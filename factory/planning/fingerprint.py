"""The render settings as one short hash, which is part of every shot's id.

A changed setting therefore means new pictures; old and new ones are never mixed.
"""

import hashlib
import json
from collections.abc import Iterable
from functools import cache
from importlib.metadata import PackageNotFoundError, version


@cache
def render_fingerprint(by_error: bool = False) -> str:
    """Return the hash of the render settings, the light-transport tiers and Blender's version.

    Of a setting, path and value count, not the reason; of the version, the first two numbers.

    by_error  True: of jobs that limit the error, with the rules by which an estimator is chosen
    """
    from factory.render import settings
    from factory.render.estimators import rules

    def values(group: Iterable[settings.Setting]) -> list[list[object]]:
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
    parts: list[object] = [*map(values, groups), tiers, blender]
    if by_error:
        parts += [values(settings.PORTION), values(settings.DENOISED), rules.identity()]
    text = json.dumps(parts, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
