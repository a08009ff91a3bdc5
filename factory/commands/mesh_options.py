"""Options for reading mesh files."""

from __future__ import annotations

import argparse
from typing import Any


def add_reading(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    group = parser.add_argument_group("options for reading mesh files")
    group.add_argument(
        "--up",
        metavar="AXIS",
        help=(
            "the axis that points up in the file, such as y or -z (default: y for OBJ and GLB, z"
            " for others)"
        ),
    )
    group.add_argument(
        "--front",
        metavar="AXIS",
        help=(
            "the axis that points to the object's front in the file (default: z for OBJ and GLB, x"
            " for others)"
        ),
    )
    group.add_argument(
        "--crease",
        type=float,
        metavar="DEG",
        help=(
            "angle between neighbouring faces below which their common edge is shaded smooth"
            " (default: 45)"
        ),
    )
    group.add_argument(
        "--segments",
        choices=("one", "materials"),
        help=(
            "one: the whole mesh is one segment (default); materials: each material of an OBJ file"
            " is a segment"
        ),
    )
    group.add_argument(
        "--max-triangles",
        type=int,
        metavar="N",
        help="refuse meshes with more triangles (default: 2,000,000)",
    )


def reading_options(options: argparse.Namespace) -> dict[str, Any]:
    """Return those arguments of factory.shapes.mesh_import.open_mesh that the user gave."""
    named = {
        "up": options.up,
        "front": options.front,
        "crease_deg": options.crease,
        "segments": options.segments,
        "maximum_triangles": options.max_triangles,
    }
    return {key: value for key, value in named.items() if value is not None}
