"""Photographs of objects that stand in rooms: which there are, and what a camera takes of them.

The scenes are those that `python -m factory.render.validation.objects_in_rooms` renders: pictures
of one object in several materials, of which each is a photograph to be edited into the others.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import msgspec

from learn.experiments.photographs import photographed_edits

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from learn.evaluation import overlap
    from learn.experiments.photographs.photographing import Photographed
    from manifests.materials import Material


class RoomScene(msgspec.Struct, forbid_unknown_fields=True):
    """A scene.json of factory.render.validation.objects_in_rooms, which describes its keys."""

    shape: str
    shape_hash: str
    category: str
    place: str
    seed: int
    materials: Annotated[tuple[str, ...], msgspec.Meta(min_length=2)]
    azimuth_deg: float
    elevation_deg: float
    distance: float
    surroundings: str = "plain"  # scenes of before 2026-11-29 lack it, samples and size
    samples: int | None = None
    size: int | None = None


class Case(NamedTuple):
    """A photograph: a scene's folder, its RoomScene, and the material that it shows.

    balances  whether the camera balances white
    shape     of learn.primitives.PRIMITIVES, if edits use the object's named shape; else None
    """

    folder: Path
    scene: RoomScene
    source: str
    balances: bool = False
    shape: str | None = None


def cases_of(
    folder: Path, count: int | None = None, after: int = 0, balances: bool = False
) -> list[Case]:
    """Return a photograph of each material of scenes of a folder.

    count     number of scenes; None: all
    after     number of scenes before them
    balances  whether the camera balances white
    Raises    InputError: there are none
    """
    from manifests.errors import InputError
    from manifests.reading import read

    scenes = sorted(path.parent for path in folder.glob("[0-9]*/scene.json"))[after:][:count]
    if not scenes:
        remedy = "render them: python -m factory.render.validation.objects_in_rooms --out DIR"
        raise InputError(folder, "folders with a scene.json", "none", remedy)
    result = []
    for path in scenes:
        scene = read(path / "scene.json", RoomScene)
        result += [Case(path, scene, name, balances) for name in scene.materials]
    return result


def named_cases(cases: Sequence[Case], file: Path, use: bool) -> list[Case]:
    """Return those of which a JSON file names the shape; use: whether edits use it.

    Raises InputError: the file is none, or names none of the shapes
    """
    from learn.experiments.photographs.named_shapes import read_shapes
    from manifests.errors import InputError

    shapes = read_shapes(file)
    named = [case for case in cases if case.scene.shape in shapes]
    if not named:
        others = ", ".join(sorted({case.scene.shape for case in cases})[:3])
        raise InputError(file, "shapes of the scenes' objects", others, "name them")
    return [case._replace(shape=shapes[case.scene.shape] if use else None) for case in named]


def list_tested(cases: Sequence[Case]) -> overlap.Tested:
    """Return the shapes and materials that photographs show, as learn.evaluation.overlap has them.

    Their places are drawn for them alone, and no weights were trained on their light.
    """
    from learn.data.seen import DIGITS, label_hash
    from manifests.materials import find

    scenes = [case.scene for case in cases]
    names = sorted({name for scene in scenes for name in scene.materials})
    return {
        "shapes": {scene.shape_hash[:DIGITS]: scene.shape for scene in scenes},
        "materials": {label_hash(_label(find(name))): name for name in names},
        "lights": {},
    }


def name_of(case: Case) -> str:
    """Return what messages call a case's photograph; its exposure is drawn by it."""
    return f"{case.folder.name} {case.source}"


def photograph_of(case: Case) -> Photographed:
    """Return what a camera takes of a case."""
    from learn.data import photographs
    from learn.experiments.photographs.photographing import exposed

    frame = frame_of(case, case.source)
    mask = photographs.read_mask(case.folder / "mask.png", frame.shape[:2]) > 0.5
    return exposed(frame, mask, name_of(case), case.balances)


def truth_of(case: Case, target: str) -> photographed_edits.Truth:
    """Return what an edit of a case's photograph into a target material should show."""
    from manifests.materials import find

    material = find(target)
    frame = frame_of(case, target)
    return photographed_edits.Truth(target, material.family, _label(material), frame)


def _label(material: Material) -> np.ndarray:
    """Return a material's label (108,) float32 as data sets hold it."""
    import numpy as np

    return material.label.reshape(-1).astype(np.float32)


def frame_of(case: Case, material: str) -> np.ndarray:
    """Return radiance (N, N, 3) float32 of a case's frame with the object in a material.

    Raises InputError where it is none of the built-in ones, whose names are no paths
    """
    import numpy as np

    from manifests import exr
    from manifests.materials import find

    channels = exr.read(case.folder / f"{find(material).name}.exr")
    return np.stack([channels[name] for name in "RGB"], -1)
