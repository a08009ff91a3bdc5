"""What a user chose on the page: materials, blends and light.

label  (108,) natural logarithms of κ and γ control values, docs/materials.md
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from learn.editing import DETAIL, desired_light, material_expression, targets
from manifests import measured_lights
from manifests.errors import InputError, closest
from shaders import envmap
from shaders.dsbrdf import SIZE

OWN_LIGHT = "the photograph's own"


@dataclass(frozen=True)
class Chosen:
    """A material that a user chose; text: as the command line takes it, or what it was read from.

    named  whether `text` alone brings it back: it is a catalogue's name or an expression
    read   whether it was read from a picture
    """

    text: str
    label: np.ndarray
    named: bool = True
    read: bool = False

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Chosen) and np.array_equal(self.label, other.label)

    def __hash__(self) -> int:
        return hash(self.label.tobytes())


@dataclass(frozen=True)
class Painted:
    """The material of one region.

    first   None: the region stays as it is
    second  with which `first` is blended, or None
    share   of the second, 0 to 1; radiance is linear in the BRDF, so that the blend is exact
    """

    first: Chosen | None = None
    second: Chosen | None = None
    share: float = 0.5

    def parts(self, own: np.ndarray) -> list[tuple[float, np.ndarray]]:
        """Return (weight, label) of each part; own: the label where nothing is chosen."""
        first = own if self.first is None else self.first.label
        if self.second is None or self.share == 0:
            return [(1.0, first)]
        if self.share == 1:
            return [(1.0, self.second.label)]
        return [(1 - self.share, first), (self.share, self.second.label)]

    @property
    def unchanged(self) -> bool:
        """Whether the region stays as it is."""
        return self.first is None and (self.second is None or self.share == 0)

    @property
    def caption(self) -> str:
        """The material in words."""
        first = "as it is" if self.first is None else self.first.text
        if self.second is None:
            return first
        return f"{1 - self.share:.0%} {first}, {self.share:.0%} {self.second.text}"


@dataclass(frozen=True)
class LightChoice:
    """The light of an edit.

    name          OWN_LIGHT, or a name for people
    rotation_deg  about the vertical, rounded to the map's columns of 2.8°
    map           (64, 128, 3) of a light that replaces the photograph's, unit mean, light frame;
                  None for the photograph's own
    """

    name: str = OWN_LIGHT
    rotation_deg: float = 0.0
    map: np.ndarray | None = None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, LightChoice) and (
            (self.name, self.rotation_deg) == (other.name, other.rotation_deg)
            and (self.map is None) == (other.map is None)
            and (self.map is None or np.array_equal(self.map, np.asarray(other.map)))
        )

    def __hash__(self) -> int:
        return hash((self.name, self.rotation_deg))

    @property
    def columns(self) -> int:
        """By how many columns of a map it is turned."""
        return round(self.rotation_deg / 360 * desired_light.WIDTH) % desired_light.WIDTH

    @property
    def unchanged(self) -> bool:
        """Whether it is the photograph's own light as it is."""
        return self.map is None and self.columns == 0

    def of(self, own: np.ndarray) -> np.ndarray:
        """Return the map (64, 128, 3); own: the photograph's own light."""
        return envmap.roll(own if self.map is None else self.map, self.columns)


@dataclass(frozen=True)
class Edit:
    """All that a user chose.

    regions           of each region, in order
    hide_background   whether the result is the object alone, cut out
    brightness_stops  by which all that is rendered is made brighter, MOST_STOPS at most: how bright
                      an edit is, the program can only guess
    detail            share of the photograph's residual shading that is kept under its own light
    """

    regions: tuple[Painted, ...]
    light: LightChoice = LightChoice()
    hide_background: bool = False
    brightness_stops: float = 0.0
    detail: float = DETAIL

    @property
    def gain(self) -> np.float32:
        """The factor of the radiance of all that is rendered."""
        return np.float32(2.0**self.brightness_stops)

    @property
    def unchanged(self) -> bool:
        """Whether nothing is rendered, since all regions and the light stay as they are."""
        return all(painted.unchanged for painted in self.regions) and self.light.unchanged

    def with_region(self, number: int, painted: Painted) -> "Edit":
        """Return the edit with another material of region `number`, 0 the first."""
        regions = list(self.regions)
        regions[number] = painted
        return replace(self, regions=tuple(regions))

    @property
    def caption(self) -> str:
        """Materials, light, brightness and shading in words, on one line."""
        several = len(self.regions) > 1
        each = [
            (f"part {k}: " if several else "") + painted.caption
            for k, painted in enumerate(self.regions, 1)
        ]
        turned = f", turned by {self.light.rotation_deg:g}°" if self.light.columns else ""
        lit = "" if self.light.unchanged else f"; light: {self.light.name}{turned}"
        stops = self.brightness_stops
        brightness = f"; brightness {stops:+g}".replace("-", "−") if stops else ""
        own = f"; own shading {self.detail:.0%}" if self.detail != DETAIL else ""
        return "; ".join(each) + lit + brightness + own


def named_material(name: str) -> Chosen:
    """Return a material by its name, described or measured. Raises InputError if it has none."""
    return Chosen(name, targets.label_of(name))


@dataclass(frozen=True)
class Principled:
    """What describes a principled material; color: #rrggbb, others 0 to 1."""

    color: str
    roughness: float
    metallic: float
    specular: float = 0.5
    sheen: float = 0.0
    coat: float = 0.0

    @property
    def expression(self) -> str:
        """The material as the command line takes it; the last three are left out where usual."""
        numbers = {
            "roughness": self.roughness,
            "metallic": self.metallic,
            "specular": self.specular,
            "sheen": self.sheen,
            "coat": self.coat,
        }
        usual = {"specular": 0.5, "sheen": 0.0, "coat": 0.0}
        written = [
            f"{key}={value:.3g}" for key, value in numbers.items() if value != usual.get(key)
        ]
        return f"principled(base_color={self.color}, {', '.join(written)})"


def principled_material(described: Principled) -> Chosen:
    """Return a principled material. Raises InputError."""
    text = described.expression
    label = material_expression.fit_expression(text).label
    return Chosen(text, np.asarray(label, np.float32).reshape(SIZE))


def light_names() -> dict[str, str]:
    """Return {name for people: key} of the measured maps that come with the program."""
    result = {}
    for key in measured_lights.credits():
        source, _, name = key.partition("_")
        shown = name.replace("_", " ").replace("-", " ")
        result[shown if shown not in result else f"{shown} ({source})"] = key
    return dict(sorted(result.items()))


def light_of(name: str, rotation_deg: float = 0.0) -> LightChoice:
    """Return the light of a name that `light_names` has, or OWN_LIGHT. Raises InputError."""
    if not -360 <= rotation_deg <= 360:
        rule = "a rotation from -360 to 360 degrees"
        raise InputError("light", rule, f"{rotation_deg:g}", "turn it less")
    if name == OWN_LIGHT:
        return LightChoice(rotation_deg=rotation_deg)
    names = light_names()
    if name not in names:
        raise InputError("light", "a light of the list", name, closest(name, names))
    return LightChoice(name, rotation_deg, measured_lights.load(names[name]))


def light_of_file(path: Path) -> LightChoice:
    """Return the light of a map's file, .exr. Raises InputError."""

    def refuse(other: Path) -> np.ndarray:
        raise InputError(
            other, "a light map FILE.exr, twice as wide as high", "another file", "convert it"
        )

    return LightChoice(path.name, 0.0, desired_light.resolve_light(str(path), refuse))
