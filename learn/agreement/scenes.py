"""Records grouped by scene: the layer renders a scene once, for comparison with all its pictures.

scene      geometry, materials, light, rotation and camera: all that the layer's picture depends on
condition  a scene in one light-transport tier, at one light resolution, with one number of samples
seeds      a condition's pictures; they differ only by their seed, and so only by noise
"""

from collections.abc import Iterable
from dataclasses import dataclass

from manifests.schema import Record


@dataclass(frozen=True)
class Condition:
    """A tier, a light resolution and a number of samples; records: one per seed, in order."""

    tier: str
    light_resolution: str
    samples: int
    records: tuple[Record, ...]

    @property
    def direct(self) -> bool:
        """Whether Cycles rendered what the layer models: direct light of the 64×128 map."""
        return self.tier == "direct" and self.light_resolution == "64x128"


def scenes(records: Iterable[Record]) -> list[list[Condition]]:
    """Return the records as scenes, each a list of Conditions, in order of the records."""
    result: dict[tuple, dict[tuple[str, str, int], list[Record]]] = {}
    for record in records:
        scene = (
            record.geometry,
            record.materials,
            record.light,
            record.rotation_texels,
            record.camera,
        )
        condition = (record.tier, record.light_resolution, record.samples)
        result.setdefault(scene, {}).setdefault(condition, []).append(record)

    def seeds(group: list[Record]) -> tuple[Record, ...]:
        return tuple(sorted(group, key=lambda record: record.seed))

    return [
        [
            Condition(tier, resolution, samples, seeds(group))
            for (tier, resolution, samples), group in scene.items()
        ]
        for scene in result.values()
    ]
