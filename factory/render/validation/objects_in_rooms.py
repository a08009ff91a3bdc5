"""Objects that stand in furnished rooms and under open skies, each in several materials.

python -m factory.render.validation.objects_in_rooms --scenes 36 --out DIR
python -m factory.render.validation.objects_in_rooms --scenes 36 --meshes FOLDER --out DIR
python -m factory.render.validation.objects_in_rooms --surroundings varied --seed 43 --out DIR

The pictures of a data set show an object alone, under light from far away. Here it stands on a
table in a room of factory.lights.interiors, so that light comes from near, walls and furniture are
behind it, and the table shades and colours it. `python -m learn.experiments room-photographs` takes
photographs of these pictures and compares their edits with the truth.

Surroundings are "plain", as factory.lights.interiors draws them, or "varied": with the surfaces of
factory.lights.surroundings, on the table too, which may be polished, and with other things on it.

Each scene is a folder NUMBER of DIR, which is complete once it has scene.json: the same command
continues, and adds coverage.png to scenes of before 2026-11-29, which lack it. Scenes of another
seed, or of other shapes, surroundings, samples or another size, are refused.

  MATERIAL.exr  radiance (SIZE, SIZE, 3) float32 of the frame with the object in that material;
                light at the object's place has unit mean (luminance over the sphere)
  mask.png      255 on the object
  coverage.png  255 times the share of each pixel that the object covers, from COVERING samples
  scene.json    shape and its hash, category, place ("room" or "sky"), seed of the place,
                surroundings, materials, samples of each pixel, size in pixels, and the camera:
                azimuth and elevation in degrees, distance in metres

Shapes take turns: the program's families for development, families that no training has, and files
of FOLDER (factory.render.validation.room_plans). The camera looks at the object from where nothing
stands between them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from factory.lights import interiors
from factory.render import body, materials, panorama, render_result, scene
from factory.render.settings import Setting, apply, assign
from factory.render.validation import command_line
from factory.render.validation.room_plans import (
    SURROUNDINGS,
    Plan,
    draw_plan,
    shape_name,
    with_table,
)
from factory.render.validation.scenes import meshes_of
from factory.shapes.catalogue import load as load_shape
from factory.shapes.mesh import Mesh
from manifests import exr
from manifests.errors import InputError
from manifests.files import write_image, write_json
from manifests.materials import load_catalogue
from manifests.notices import notice
from manifests.option_types import positive
from manifests.progress import tqdm
from shaders import envmap, nodes
from shaders.tone import LUMINANCE

SIZE = 192  # pixels of a frame's side
SAMPLES = 48
COVERING = 256  # samples of each pixel by which coverage is measured
FIELD_OF_VIEW = math.radians(40.0)
FILLED = 2 / 3  # of the frame's side, by the sphere about the object
PLACES = 20  # that are tried for a scene
REMEDY = "give the options with which the folder was begun, or another folder"

# resolution and samples are the caller's
FRAME = tuple(
    s for s in panorama.PANORAMA if "resolution" not in s.path and s.path != "cycles.samples"
)


def rendered(plan: Plan, folder: Path, size: int = SIZE, samples: int = SAMPLES) -> bool:
    """Write a scene into a folder; return False, and write nothing, where no view is free."""
    mesh = load_shape(plan.shape)
    place = with_table(plan, mesh)
    stage, _ = panorama.build(place, FRAME)
    for path in ("render.resolution_x", "render.resolution_y"):
        assign(stage, path, size)
    assign(stage, "cycles.samples", samples)
    thing, surface = _placed(stage, mesh, plan.radius)
    distance = plan.radius / math.sin(math.atan(FILLED * math.tan(FIELD_OF_VIEW / 2)))
    camera = _camera(stage)
    azimuth = next((a for a in plan.azimuths if _is_free(stage, thing, plan, a, distance)), None)
    if azimuth is None:
        return False
    camera.matrix_world = _looking(_direction(azimuth, plan.elevation) * distance)
    stage.view_layers[0].use_pass_object_index = True
    catalogue, frames = load_catalogue(), {}
    for number, name in enumerate(plan.materials):
        materials.show(surface, materials.build(nodes.graph(catalogue[name].mixture)))
        apply(stage, (Setting("cycles.seed", number, "noise of its own"),))
        passes = render_result.render_passes(stage)
        frames[name] = passes["Combined"][..., :3]
    coverage = _coverage(stage, thing)
    light = panorama.render(place, plan.place % 1000)  # which empties Blender's scene
    mean = float(envmap.mean_radiance(light) @ LUMINANCE)
    folder.mkdir(parents=True, exist_ok=True)
    for name, frame in frames.items():
        L = (frame / mean).astype(np.float32)
        exr.write(folder / f"{name}.exr", {c: L[..., k] for k, c in enumerate("RGB")})
    mask = passes["IndexOB"][..., 0] > 0.5
    write_image(folder / "mask.png", 255 * mask.astype(np.uint8), "PNG")
    write_image(folder / "coverage.png", coverage, "PNG")
    about = {
        "shape": shape_name(plan),
        "shape_hash": mesh.hash,
        "category": mesh.category,
        "place": "room" if _has_ceiling(place) else "sky",
        "seed": plan.place,
        "surroundings": plan.surroundings,
        "materials": plan.materials,
        "samples": samples,
        "size": size,
        "azimuth_deg": math.degrees(azimuth),
        "elevation_deg": math.degrees(plan.elevation),
        "distance": distance,
    }
    write_json(folder / "scene.json", about)
    return True


def add_coverage(plans: Sequence[Plan], folder: Path) -> None:
    """Write coverage.png into the folder of a finished scene, from the camera of its pictures.

    plans  of all attempts
    """
    about = json.loads((folder / "scene.json").read_text("utf-8"))
    plan = next(each for each in plans if each.place == about["seed"])
    mesh = load_shape(plan.shape)
    stage, _ = panorama.build(with_table(plan, mesh), FRAME)
    size = len(next(iter(exr.read(folder / f"{plan.materials[0]}.exr").values())))
    for path in ("render.resolution_x", "render.resolution_y"):
        assign(stage, path, size)
    thing, _ = _placed(stage, mesh, plan.radius)
    towards = _direction(math.radians(about["azimuth_deg"]), math.radians(about["elevation_deg"]))
    _camera(stage).matrix_world = _looking(towards * about["distance"])
    write_image(folder / "coverage.png", _coverage(stage, thing), "PNG")


def _coverage(stage: bpy.types.Scene, thing: bpy.types.Object) -> np.ndarray:
    """Return 255 times the share (N, N) of each pixel that shows an object, rounded, uint8.

    All other objects are holdouts: they hide the object but are transparent themselves, so that
    opacity is the object's coverage.
    """
    apply(
        stage,
        (
            Setting("render.film_transparent", True, "only the object has opacity"),
            Setting("cycles.samples", COVERING, "coverage in steps of 8 bits"),
            Setting("cycles.use_denoising", False, "measured, not looked at"),
            Setting("cycles.max_bounces", 0, "its light does not matter"),
        ),
    )
    for other in stage.objects:
        other.is_holdout = other is not thing
    opacity = render_result.render_passes(stage)["Combined"][..., 3]
    return np.rint(255 * np.clip(opacity, 0, 1)).astype(np.uint8)


def require_scene_of(plans: Sequence[Plan], size: int, samples: int, folder: Path) -> None:
    """Raise InputError where a folder's scene is that of no plan; plans: of all attempts."""
    path = folder / "scene.json"
    about = json.loads(path.read_text("utf-8"))
    plan = plans[0]
    # scenes of before 2026-11-29 lack the last three
    expected = {
        "shape": (about.get("shape"), shape_name(plan)),
        "materials": (tuple(about.get("materials", ())), plan.materials),
        "surroundings": (about.get("surroundings", SURROUNDINGS[0]), plan.surroundings),
        "samples": (about.get("samples", samples), samples),
        "size": (about.get("size", size), size),
    }
    for name, (written, requested) in expected.items():
        if written != requested:
            raise InputError(path, f"{name} {requested}", f"{written}", REMEDY)
    if about.get("seed") not in {each.place for each in plans}:
        raise InputError(path, "a place of this seed", f"{about.get('seed')}", REMEDY)


def _has_ceiling(place: interiors.Scene) -> bool:
    return any(
        box.low[2] > 0 and all(box.low[k] < 0 < box.high[k] for k in (0, 1)) for box in place.boxes
    )


def _placed(
    stage: bpy.types.Scene, mesh: Mesh, radius: float
) -> tuple[bpy.types.Object, bpy.types.Material]:
    """Put a mesh at the origin, so large; return the object and the material of its segments."""
    built, surface = body.build(mesh), materials.new("surface")
    for _ in range(mesh.segments):
        built.materials.append(surface)
    thing = scene.put(stage, built)
    thing.scale, thing.pass_index = (radius,) * 3, 1
    return thing, surface


def _camera(stage: bpy.types.Scene) -> bpy.types.Object:
    data = bpy.data.cameras.new("camera")
    data.angle = FIELD_OF_VIEW
    assign(data, "clip_start", 0.01)
    camera = bpy.data.objects.new("camera", data)
    stage.collection.objects.link(camera)
    stage.camera = camera
    return camera


def _direction(azimuth: float, elevation: float) -> Vector:
    flat = math.cos(elevation)
    return Vector((flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)))


def _looking(place: Vector) -> Any:
    """Return the matrix of a camera at `place` that looks at the origin, upright."""
    matrix = place.to_track_quat("Z", "Y").to_matrix().to_4x4()
    matrix.translation = place
    return matrix


def _is_free(
    stage: bpy.types.Scene, thing: bpy.types.Object, plan: Plan, azimuth: float, distance: float
) -> bool:
    """Return whether no wall, lamp or piece of furniture is before the object."""
    towards = _direction(azimuth, plan.elevation)
    eye = towards * distance
    graph = bpy.context.evaluated_depsgraph_get()
    side = towards.cross(Vector((0, 0, 1))).normalized()
    above = side.cross(towards)
    seen = 0
    for across, up in ((0, 0), (0.8, 0), (-0.8, 0), (0, 0.8), (0.5, 0.5), (-0.5, 0.5)):
        aim = (side * across + above * up) * plan.radius
        hit, place, _, _, what, _ = stage.ray_cast(graph, eye, (aim - eye).normalized())
        if hit and what.original is thing:
            seen += 1
        elif hit and (place - eye).length < distance - plan.radius:
            return False
    return seen > 0


def main() -> None:
    """Render the scenes that are missing; say which have no free view in any place."""
    parser = command_line.parser(
        __doc__, "scenes", 36, seed=41, size=SIZE, reference=None, meshes=True
    )
    parser.add_argument("--surroundings", choices=SURROUNDINGS, default=SURROUNDINGS[0])
    parser.add_argument(
        "--samples", type=positive, default=SAMPLES, metavar="N", help="of each pixel"
    )
    parser.add_argument(
        "--only-meshes", action="store_true", help="show the meshes alone, each as often"
    )
    options = command_line.parse(parser, what="of the scenes' folders")
    meshes = meshes_of(options.meshes)
    if options.only_meshes and not meshes:
        parser.error("--only-meshes: expected meshes, found none; give --meshes FOLDER")
    folders = [options.out / f"{number:04d}" for number in range(options.scenes)]
    attempts = [
        [
            draw_plan(number, k, options.seed, meshes, options.surroundings, options.only_meshes)
            for k in range(PLACES)
        ]
        for number in range(options.scenes)
    ]
    done = [(folder / "scene.json").exists() for folder in folders]
    for folder, plans, is_done in zip(folders, attempts, done, strict=True):
        if is_done:
            try:
                require_scene_of(plans, options.size, options.samples, folder)
            except InputError as problem:
                parser.error(str(problem))
    for folder, plans, is_done in zip(tqdm(folders, unit="scene"), attempts, done, strict=True):
        if is_done:
            if not (folder / "coverage.png").exists():
                add_coverage(plans, folder)
            continue
        for plan in plans:
            if rendered(plan, folder, options.size, options.samples):
                break
        else:
            notice(f"{folder}: left out, because no place of {PLACES} has a free view")


if __name__ == "__main__":
    main()
