"""Shots without self-shading: whether they are recognised, by rays and by Cycles.

python -m factory.render.validation.self_shading_check --shots 1000 --out DIR
python -m factory.render.validation.self_shading_check --shots 1000 --meshes FOLDER --out DIR
python -m factory.render.validation.self_shading_check --shots 1000 --perspective --out DIR

shots       families of shapes in turn, or the meshes of FOLDER as half of the shots; drawn seeds,
            sides and elevations of −10° to 60°, from a distant camera, or in perspective with
            fields of view of 10° to 75° and the whole unit sphere in the frame
rays        RAYS from each visible point, in directions drawn over its facet. A shot shades itself
            if more than one in a thousand meets the object
recognised  by factory.render.self_shading
false       recognised, though the rays say that it shades itself
difference  of those recognised: display L2 between Cycles' pictures of the tiers full and direct,
            by the same samples under the light `night`, whose lamps are small
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import bpy  # noqa: F401 (brings mathutils)
import mathutils.bvhtree
import msgspec
import numpy as np

from factory.lights import load as load_light
from factory.render import camera
from factory.render.studio import Studio
from factory.render.validation import command_line
from factory.render.validation.scenes import meshes_of
from factory.shapes.catalogue import FAMILIES, PRIMITIVES
from factory.shapes.catalogue import load as load_shape
from factory.shapes.general import FAMILIES as GENERAL
from manifests.errors import InputError
from manifests.provenance import provenance
from manifests.schema import Camera
from shaders import tone
from shaders.mixture import Mixture

RAYS = 8
MOST_POINTS = 1000  # of a shot
OFFSET = 1e-4  # above the surface, where rays begin: the tolerance of the geometric test
SHADED = 1e-3  # share of rays from which a shot counts as shading itself
SAMPLES = 64


def shot_names(options: argparse.Namespace) -> list[str]:
    """Return the shapes of all shots."""
    families = sorted({*FAMILIES, *GENERAL})
    meshes = meshes_of(options.meshes)
    names = []
    for number in range(options.shots):
        if meshes and number % 2:
            names.append(str(meshes[number // 2 % len(meshes)]))
        elif number % 8 == 0:
            names.append(sorted(PRIMITIVES)[number // 8 % len(PRIMITIVES)])
        else:
            names.append(f"{families[number % len(families)]}:{number % 100}")
    return names


def share_blocked(studio: Studio, tree: Any, rng: np.random.Generator) -> float:
    """Return the share of rays from visible points that meet the object again.

    tree  of the mesh, in the object's frame
    """
    at, lens = studio._surface(), studio._require_camera()
    points = camera.points(lens, at.mask, at.depth)
    some = rng.permutation(len(points))[:MOST_POINTS]
    turn = camera.vertices_from_camera(
        np.eye(3), studio._azimuth, lens
    )  # rows: the object's axes as seen
    blocked = total = 0
    for point, facet in zip(points[some] @ turn.T, at.facets[some] @ turn.T, strict=True):
        directions = rng.normal(size=(RAYS, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        directions *= np.sign(directions @ facet)[:, None]
        start = mathutils.Vector(point + OFFSET * facet)
        for direction in directions:
            blocked += tree.ray_cast(start, mathutils.Vector(direction))[0] is not None
            total += 1
    return blocked / max(total, 1)


def difference(studio: Studio, seed: int) -> float:
    """Return the display L2 between Cycles' pictures of the tiers full and direct."""
    mask = studio.geometry().mask
    full, direct = (studio.portion(0, SAMPLES, seed, tier).noisy for tier in ("full", "direct"))
    return float(tone.display_l2(full, direct, tone.auto_exposure(direct, mask), mask))


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return a row for each shot."""
    studio = Studio("cpu", 1)
    light = load_light("night").L64
    rows = []
    for number, name in enumerate(shot_names(options)):
        rng = np.random.default_rng(np.random.SeedSequence(options.seed, spawn_key=(number,)))
        try:
            mesh = load_shape(name)
        except InputError:
            continue
        lens = Camera(size=(options.size, options.size), elevation_deg=float(rng.uniform(-10, 60)))
        if options.perspective:
            fov = float(rng.uniform(10, 75))
            wide = lens.half_extent / float(np.cos(np.radians(fov) / 2))
            lens = msgspec.structs.replace(lens, fov_deg=fov, half_extent=wide)
        studio.set_camera(lens)
        studio.set_shape(mesh)
        studio.set_view(float(rng.uniform(0, 2 * np.pi)))
        recognised = not studio.may_shade_itself()
        tree = mathutils.bvhtree.BVHTree.FromPolygons(mesh.vertices.tolist(), mesh.faces.tolist())
        row: dict[str, Any] = {
            "shape": Path(name).name,
            "fov_deg": lens.fov_deg,
            "recognised": recognised,
            "blocked": share_blocked(studio, tree, rng),
        }
        if recognised:
            studio.set_light(light, int(rng.integers(128)))
            studio.set_materials([Mixture.lambert([0.6] * 3)] * mesh.segments)
            row["difference"] = difference(studio, number)
        rows.append(row)
        if number % 50 == 49:
            print(f"{number + 1} of {options.shots}", flush=True)
    return rows


def figures(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the counts of a measurement."""
    free = [row for row in rows if row["blocked"] <= SHADED]
    recognised = [row for row in rows if row["recognised"]]
    return {
        "shots": len(rows),
        "without_self_shading": len(free),
        "recognised": len(recognised),
        "recognised_of_those": sum(row["recognised"] for row in free),
        "false": sum(row["blocked"] > SHADED for row in recognised),
        "most_blocked": max((row["blocked"] for row in recognised), default=0.0),
        "worst_difference": max((row["difference"] for row in recognised), default=0.0),
    }


def report(result: dict[str, Any]) -> str:
    """Return the page of a measurement."""
    of = result["figures"]
    lines = [
        "# Shots without self-shading",
        "",
        f"    {result['command']}",
        "",
        f"Commit {result['commit']}, {result['date']}, {result['machine']}.",
        "",
        "| | |",
        "|---|---|",
        f"| shots | {of['shots']} |",
        f"| without self-shading, by rays | {of['without_self_shading']} |",
        f"| of these recognised | {of['recognised_of_those']} |",
        f"| recognised, though rays meet the object | {of['false']} |",
        "| largest share of rays that meet the object on one recognised"
        f" | {of['most_blocked']:.2%} |",
        "| largest display L2 between the tiers full and direct on one recognised"
        f" | {of['worst_difference']:.2g} |",
        "",
        "Recognised shapes:",
        "",
    ]
    names: dict[str, int] = {}
    for row in result["rows"]:
        if row["recognised"]:
            family = row["shape"].split(":")[0]
            names[family] = names.get(family, 0) + 1
    lines.append(", ".join(f"{name} ({count})" for name, count in sorted(names.items())) + ".")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, and write report.json and report.md."""
    parser = command_line.parser(__doc__, "shots", 1000, seed=0, size=96, meshes=True)
    parser.add_argument("--perspective", action="store_true", help="a drawn field of view")
    options = command_line.parse(parser)
    rows = measure(options)
    result = {**provenance(), "figures": figures(rows), "rows": rows}
    command_line.write_report(options.out, result, report(result))
    print(f"See {options.out / 'report.md'}")


if __name__ == "__main__":
    main()
