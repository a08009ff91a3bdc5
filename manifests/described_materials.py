"""Everyday materials by name, none of which was measured: each stands for a description.

Colours of metals, porcelain, terracotta and brick are those of the table "Physically Based" by
Anton Palmqvist, in the package materialxmaterials (Apache-2.0). The other colours, and how rough
each surface is, were chosen by eye. A material is one colour throughout: wood without grain,
leather without pores.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Described:
    """A material that is described.

    family  as the catalogue has families
    values  what differs from a usual PrincipledMaterial (shaders.principled); a colour is #rrggbb
            in sRGB
    """

    family: str
    values: str

    @property
    def text(self) -> str:
        """The expression that stands for it (learn.editing.material_expression)."""
        return f"principled({self.values})"


DESCRIBED: Mapping[str, Described] = {
    "gold": Described("metal", "base_color=#ffe496, metallic=1, roughness=.25"),
    "silver": Described("metal", "base_color=#fefdfc, metallic=1, roughness=.25"),
    "copper": Described("metal", "base_color=#f7cfbf, metallic=1, roughness=.25"),
    "bronze": Described("metal", "base_color=#cda977, metallic=1, roughness=.35"),
    "polished-brass": Described("metal", "base_color=#f5e4ae, metallic=1, roughness=.2"),
    "polished-chrome": Described("metal", "base_color=#d3d8da, metallic=1, roughness=.12"),
    "iron": Described("metal", "base_color=#c0bebb, metallic=1, roughness=.45"),
    "titanium": Described("metal", "base_color=#b1aaa2, metallic=1, roughness=.35"),
    "leather": Described("leather", "base_color=#7a4a2b, roughness=.45, specular=.5"),
    "black-leather": Described("leather", "base_color=#242220, roughness=.45, specular=.5"),
    "oak": Described("wood", "base_color=#b98f5f, roughness=.55, specular=.4"),
    "walnut": Described("wood", "base_color=#5d412c, roughness=.5, specular=.4"),
    "cotton": Described("fabric", "base_color=#e4e0d6, roughness=1, specular=.1, sheen=.3"),
    "linen": Described("fabric", "base_color=#d2c4a5, roughness=1, specular=.1, sheen=.3"),
    "denim": Described("fabric", "base_color=#3b4f72, roughness=1, specular=.1, sheen=.3"),
    "red-velvet": Described("fabric", "base_color=#7d1020, roughness=1, specular=.05, sheen=1"),
    "porcelain": Described("stone and ceramic", "base_color=#e0e0dd, roughness=.15"),
    "terracotta": Described("stone and ceramic", "base_color=#c47f5d, roughness=.8, specular=.3"),
    "concrete": Described("stone and ceramic", "base_color=#a09e99, roughness=.9, specular=.3"),
    "brick": Described("stone and ceramic", "base_color=#8c5746, roughness=.9, specular=.3"),
}
