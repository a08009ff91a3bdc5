"""edit.json, which keeps an edit of the page, and the command that repeats the edit.

label  (108,) natural logarithms of κ and γ control values, docs/materials.md
"""

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from learn.app.choices import (
    OWN_LIGHT,
    Chosen,
    Edit,
    Painted,
    light_names,
    light_of,
    light_of_file,
    named_material,
)
from learn.data import photographs
from learn.editing import DETAIL, MOST_STOPS, material_expression, material_file, targets
from learn.networks import built_in_weights
from manifests import files, reading
from manifests.errors import InputError
from shaders.dsbrdf import SIZE

LARGEST_RECIPE = 1 << 20  # bytes of an edit.json
LONGEST_TEXT = 300  # letters of a material's or a light's name


def mask_options(names: list[str]) -> list[str]:
    """Return the options by which the command line takes the files of masks named so."""
    options = {"mask.png": "--mask", "regions.png": "--regions"}
    return [word for name in names if name in options for word in (options[name], name)]


def command_line(
    edit: Edit,
    photograph: str,
    masks: list[str],
    refined: bool,
    fit_mask: bool,
    weights: Path,
    shape: str | None = None,
) -> str:
    """Return the command that repeats an edit, in a folder with the photograph and the files.

    photograph  the file's name, or example:NAME
    masks       names of the files of the mask that are needed
    fit_mask    whether the mask's edge was fitted, if it was black and white
    weights     the file of the network that decomposed
    shape       the object's, one of learn.primitives.PRIMITIVES; None: predicted
    """
    words = ["brdfactory"]
    left_out = ["--no-fit-mask"] * (not fit_mask) + ["--no-refine"] * (not refined)
    named = [] if shape is None else ["--shape", shape]
    kept = (*mask_options(masks), *named, *left_out)
    plain = all(
        painted.second is None and (painted.first is None or painted.first.named)
        for painted in edit.regions
    )
    plain = plain and edit.light.unchanged
    if plain and not edit.hide_background:
        texts = ["keep" if p.first is None else p.first.text for p in edit.regions]
        shading = ["--detail", f"{edit.detail:g}"] * (edit.detail != DETAIL)
        stops = edit.brightness_stops
        brightness = ["--brightness", f"{stops:g}"] * (stops != 0)
        words += ["edit", photograph, *kept, *shading, *brightness]
        words += ["--material", "+".join(texts), "--out", "edited"]
    else:
        words += ["app", photograph, *kept, "--repeat", "edit.json", "--out", "edited"]
    return shlex.join([*words, *built_in_weights.options_for(weights)])


Numbers = Annotated[list[float], msgspec.Meta(min_length=SIZE, max_length=SIZE)]
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Stops = Annotated[float, msgspec.Meta(ge=-MOST_STOPS, le=MOST_STOPS)]


class MaterialEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A chosen material.

    label  where its name alone does not bring it back
    read   whether such a label was read from a picture
    """

    text: Annotated[str, msgspec.Meta(max_length=LONGEST_TEXT)]
    label: Numbers | None = None
    read: bool = True


class RegionEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A region's materials; first and second as of Painted."""

    first: MaterialEntry | None = None
    second: MaterialEntry | None = None
    share: Share = 0.5


class Recipe(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What edit.json holds. map: a file of a light that is none of the program's."""

    regions: Annotated[
        list[RegionEntry], msgspec.Meta(min_length=1, max_length=photographs.MOST_REGIONS)
    ]
    light: Annotated[str, msgspec.Meta(max_length=LONGEST_TEXT)] = OWN_LIGHT
    rotation_deg: float = 0.0
    map: Annotated[str, msgspec.Meta(max_length=LONGEST_TEXT)] | None = None
    hide_background: bool = False
    brightness_stops: Stops = 0.0
    detail: Share = DETAIL


def write(path: Path, edit: Edit) -> None:
    """Write edit.json, and light.exr beside it where the light is none of the program's."""

    def entry(chosen: Chosen | None) -> MaterialEntry | None:
        if chosen is None:
            return None
        if chosen.named:
            return MaterialEntry(chosen.text)
        return MaterialEntry(chosen.text, [float(x) for x in chosen.label], chosen.read)

    own_map = edit.light.map is not None and edit.light.name not in light_names()
    if own_map:
        photographs.write_exr(path.with_name("light.exr"), np.asarray(edit.light.map))
    recipe = Recipe(
        [RegionEntry(entry(p.first), entry(p.second), p.share) for p in edit.regions],
        edit.light.name,
        edit.light.rotation_deg,
        "light.exr" if own_map else None,
        edit.hide_background,
        edit.brightness_stops,
        edit.detail,
    )
    files.write_json(path, msgspec.to_builtins(recipe))


def read(path: Path) -> Edit:
    """Return the Edit of an edit.json. Raises InputError."""
    recipe = reading.read(path, Recipe, LARGEST_RECIPE)

    def chosen(entry: MaterialEntry | None) -> Chosen | None:
        if entry is None:
            return None
        if entry.label is not None:
            label = np.asarray(entry.label, np.float32)
            label = material_file.require_label(label, path)
            return Chosen(entry.text, label, named=False, read=entry.read)
        is_measured = targets.measured_name(entry.text) is not None
        if material_expression.is_expression(entry.text) and not is_measured:
            label = np.asarray(material_expression.fit_expression(entry.text).label, np.float32)
            return Chosen(entry.text, label.reshape(SIZE))
        return named_material(entry.text)

    light = light_of(recipe.light if recipe.map is None else OWN_LIGHT, recipe.rotation_deg)
    if recipe.map is not None:
        if not recipe.map:
            remedy = "name it, or leave map out"
            raise InputError(path, "a map's file in the same folder", "an empty name", remedy)
        if Path(recipe.map).name != recipe.map:
            raise InputError(path, "a map's file in the same folder", recipe.map, "move it there")
        light = replace(light, name=recipe.light, map=light_of_file(path.with_name(recipe.map)).map)
    return Edit(
        tuple(Painted(chosen(r.first), chosen(r.second), r.share) for r in recipe.regions),
        light,
        recipe.hide_background,
        recipe.brightness_stops,
        recipe.detail,
    )
