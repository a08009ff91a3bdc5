"""Records grouped by what the layer sees: one scene is rendered by the layer once, and compared
with every picture of it.

scene      geometry, materials, light, rotation and camera: all that the layer's picture depends on
condition  a scene in one light-transport tier, at one light resolution, with one number of samples
seeds      a condition's pictures; they differ in nothing but the seed, hence in nothing but noise
"""

from dataclasses import dataclass

from manifests.schema import Record


@dataclass(frozen=True)
class Condition:
    """tier, light_resolution, samples; records: one a seed, in order of seed."""

    tier: str
    light_resolution: str
    samples: int
    records: tuple[Record, ...]

    @property
    def direct(self):
        """True if Cycles was asked for what the layer computes: no shadow, no interreflection, the
        64×128 map.
        """
        return self.tier == "direct" and self.light_resolution == "64x128"


def scenes(records):
    """The records as scenes: a list of lists of Conditions, in order of the records."""
    result = {}
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

    def seeds(group):
        return tuple(sorted(group, key=lambda record: record.seed))

    return [
        [Condition(*condition, seeds(group)) for condition, group in scene.items()]
        for scene in result.values()
    ]
