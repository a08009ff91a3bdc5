"""Every shape by its spec, a text.

"chair:17" is a family and a seed, "sphere" a primitive, "file:PATH" or a plain path a mesh file.
"""

from importlib import import_module
from pathlib import Path
from typing import Any

from factory.shapes.general import FAMILIES as ORDINARY
from factory.shapes.general import TEST_ONLY
from factory.shapes.mesh import Mesh
from manifests.errors import InputError, closest

FAMILIES = ("car", "chair", "sofa", "monitor")
GENERAL = (*ORDINARY, *TEST_ONLY)
PAPER_COUNTS = {"car": 130, "chair": 50, "sofa": 50, "monitor": 50}  # the paper's numbers of models
LONGEST = 100  # digits of a seed: Python reads no number of thousands
PRIMITIVES = ("sphere", "cube", "torus", "disc", "blob")


def load(spec: str | Path, **options: Any) -> Mesh:
    """Return the Mesh that a spec names.

    spec     "chair:17" | "sphere" | "sphere:4" (level) | "blob:3" (seed) | "file:PATH" | PATH
    options  for files only: up=, front=, crease_deg=, category=, name=, maximum_triangles= (see
             factory.shapes.mesh_import.open_mesh)
    Raises   InputError: an unknown name, a seed that is no number, or anything wrong with the file
    """
    spec = str(spec)
    family, colon, rest = spec.partition(":")
    if family == "file" and colon:
        return _file(rest, options)
    if family in FAMILIES:
        build = import_module(f"factory.shapes.{family}").build
        return build(_number(spec, rest if colon else "0"))
    if family in GENERAL:
        from factory.shapes.general.build import build as build_general

        return build_general(family, _number(spec, rest if colon else "0"))
    if family in PRIMITIVES:
        build = getattr(import_module("factory.shapes.primitives"), family)
        if not colon:
            return build()
        if family in ("sphere", "blob"):
            return build(_number(spec, rest, 8 if family == "sphere" else None))
        raise InputError(
            spec,
            f"'{family}' alone",
            f"'{spec}'",
            "only sphere (level) and blob (seed) take a number",
        )
    if _looks_like_a_path(spec):
        return _file(spec, options)
    raise InputError(
        spec,
        "a shape",
        "an unknown name",
        closest(family, (*FAMILIES, *GENERAL, *PRIMITIVES))
        + "; a shape is FAMILY:SEED, a primitive or a mesh file",
    )


def specs(family: str, count: int | None = None, first: int = 0) -> list[str]:
    """Return the specs of `count` seeds of a family, by default the paper's count or 50."""
    if family not in FAMILIES and family not in GENERAL:
        raise InputError(family, "a family", f"'{family}'", closest(family, (*FAMILIES, *GENERAL)))
    return [
        f"{family}:{seed}"
        for seed in range(first, first + (PAPER_COUNTS.get(family, 50) if count is None else count))
    ]


def _file(path, options):
    from factory.shapes.mesh_import import open_mesh

    return open_mesh(path, **options)


def _looks_like_a_path(spec):
    return any(mark in spec for mark in "/\\.")


def _number(spec, text, limit=None):
    if not (text.isascii() and text.isdigit() and len(text) <= LONGEST) or (
        limit is not None and int(text) > limit
    ):
        span = (
            f"a whole number ≥ 0 of at most {LONGEST} digits"
            if limit is None
            else f"a whole number from 0 to {limit}"
        )
        raise InputError(
            spec, f"{span} after the colon", f"'{text[:40]}'", f"write {spec.split(':')[0]}:3"
        )
    return int(text)
