"""Approximations of materials as a MaterialX document: one surfacematerial for each material.

Each element says in its `doc` what it approximates, how far it is from it, whose measurement it is
and under which licence.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import fields
from statistics import median

from factory.materials.standard_surface import Approximation
from manifests.materials import Material

VERSION = "1.38"  # of the format; later versions read it


def document(materials: Sequence[Material], approximations: Mapping[str, Approximation]) -> str:
    """Return the text of a document, in the order of the materials.

    approximations  {material's name: Approximation}
    """
    root = ElementTree.Element("materialx", version=VERSION, colorspace="lin_rec709")
    for material in materials:
        _add(root, material, approximations[material.name])
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def identifier(name: str) -> str:
    """Return a material's name in the letters that MaterialX allows."""
    return "".join(c if c.isascii() and c.isalnum() else "_" for c in name)


def _add(root: ElementTree.Element, material: Material, approximation: Approximation) -> None:
    name = identifier(material.name)
    shader = ElementTree.SubElement(
        root, "standard_surface", name=f"SR_{name}", type="surfaceshader"
    )
    shader.set("doc", description(material, approximation))
    numbers = {"base": 1.0} | {
        field.name: getattr(approximation.material, field.name)
        for field in fields(approximation.material)
    }
    for input_name, value in numbers.items():
        colour = isinstance(value, tuple)
        ElementTree.SubElement(
            shader,
            "input",
            name=input_name,
            type="color3" if colour else "float",
            value=", ".join(f"{x:g}" for x in value) if colour else f"{value:g}",
        )
    surface = ElementTree.SubElement(root, "surfacematerial", name=name, type="material")
    ElementTree.SubElement(
        surface, "input", name="surfaceshader", type="surfaceshader", nodename=f"SR_{name}"
    )


def table(materials: Sequence[Material], approximations: Mapping[str, Approximation]) -> str:
    """Return a Markdown table of every approximation's error, with a summary by family above."""
    by_family: dict[str, list[float]] = {}
    for material in materials:
        by_family.setdefault(material.family, []).append(approximations[material.name].error)
    lines = [
        "# Errors of the approximations",
        "",
        "Relative L1 of BRDF times cosine between the approximation by MaterialX's standard_surface"
        " and the fitted mixture.",
        "It is the mean of six view angles that no fit used; *worst view* is the largest of the"
        " six.",
        "",
        "| family | materials | median | largest |",
        "|---|---|---|---|",
    ]
    every = [error for errors in by_family.values() for error in errors]
    for family, errors in [*sorted(by_family.items()), ("all", every)]:
        lines.append(f"| {family} | {len(errors)} | {median(errors):.3f} | {max(errors):.3f} |")
    lines += ["", "| material | family | relative L1 | worst view |", "|---|---|---|---|"]
    for material in materials:
        result = approximations[material.name]
        lines.append(
            f"| {material.name} | {material.family} | {result.error:.3f} |"
            f" {result.views.max():.3f} |"
        )
    return "\n".join(lines) + "\n"


def description(material: Material, approximation: Approximation) -> str:
    """Return what a material's element says of it."""
    views = ", ".join(f"{view:.3f}" for view in approximation.views)
    return (
        f"Approximates {material.name} ({material.family}). Relative L1 of BRDF times cosine to the"
        f" fitted mixture: {approximation.error:.3f}; at view angles 0.5, 15, 30, 45, 60 and 75"
        f" degrees: {views}. Source: {material.source}. Licence: {material.licence}."
    )
