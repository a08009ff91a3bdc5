"""Pictures of the ladder's rungs by what they show, and pairs of them: an input and its truth."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from learn.data.records import Records
    from learn.evaluation.ladder_design import Rung, Scene
    from manifests.schema import Record

RUNGS = ("direct", "8-bit")  # of learn.evaluation.ladder_design


class Key(NamedTuple):
    """What a picture shows; light is the name of a map and its rotation in texels."""

    shape: str
    viewpoint: int
    light: tuple[str, int]
    material: str


def pictures_of(records: Records) -> dict[str, dict[Key, Record]]:
    """Return {rung: {what it shows: record}} of those of RUNGS that the data set has pictures of.

    Of several pictures of the same, the one with the most samples counts. Raises InputError where
    there is none.
    """
    import msgspec

    from learn.evaluation import ladder_design
    from manifests.errors import InputError

    cameras = ladder_design.cameras(ladder_design.preset("development"))
    result: dict[str, dict[Key, Record]] = {}
    for record in sorted(records.records, key=lambda record: (record.samples, record.id)):
        if len(set(record.materials)) > 1:
            continue
        for rung in rungs():
            camera = msgspec.structs.replace(cameras[rung.cameras], size=record.camera.size)
            if (camera, rung.tier, rung.light_resolution) == (
                record.camera,
                record.tier,
                record.light_resolution,
            ):
                light = (record.light, record.rotation_texels)
                key = Key(record.shape, record.viewpoint, light, record.materials[0])
                result.setdefault(rung.name, {})[key] = record
    if not result:
        raise InputError(
            records.folder, f"pictures of the rungs {' and '.join(RUNGS)}", "none", remedy()
        )
    return {name: result[name] for name in RUNGS if name in result}


def rungs() -> list[Rung]:
    """Return the Rungs of RUNGS."""
    from learn.evaluation import ladder_design

    return [rung for rung in ladder_design.RUNGS if rung.name in RUNGS]


def remedy() -> str:
    """Return how a data set of the ladder is made, for messages."""
    from learn.evaluation import ladder_design

    return f"render them: {ladder_design.REMEDY}"


def scene_of(pictures: Mapping[str, Mapping[Key, Record]], source: Key, truth: Key) -> Scene:
    """Return the ladder's Scene of an input picture and another picture of the same object."""
    from learn.evaluation.ladder_design import Scene, group_of

    first = next(iter(pictures.values()))[source]
    return Scene(
        source.shape,
        source.light[0],
        *group_of(source.shape, first.category),
        {rung: of[source] for rung, of in pictures.items()},
        {rung: of[truth] for rung, of in pictures.items()},
    )


def edits_of(
    pictures: Mapping[str, Mapping[Key, Record]],
    count: int,
    seed: int,
    sources: Collection[str] | None = None,
) -> list[Scene]:
    """Return up to `count` edits that every rung has: a picture, and its truth in another material.

    Shapes take turns; which lights and materials come first is drawn. A larger count adds to the
    same edits.

    pictures  as of `pictures_of`
    sources   materials of which one is the picture's; None: any
    Raises    InputError where no view was rendered in two materials under one light, of which
              `sources` has one
    """
    import numpy as np

    from manifests.errors import InputError

    views: dict[tuple[Any, ...], list[Key]] = defaultdict(list)
    for key in sorted(set.intersection(*(set(each) for each in pictures.values()))):
        views[key[:3]].append(key)
    both = [
        keys
        for keys in views.values()
        if len(keys) > 1 and (sources is None or any(key.material in sources for key in keys))
    ]
    if not both:
        rule = f"pictures of a view in two materials on the rungs {' and '.join(pictures)}"
        if sources is not None:
            rule += f", one of them one of {', '.join(sorted(sources)) or 'none'}"
        raise InputError("--data", rule, "none", remedy())
    rng, by_shape = np.random.default_rng(seed), defaultdict(list)
    for index in rng.permutation(len(both)):
        drawn = [both[index][k] for k in rng.permutation(len(both[index]))]
        source = next(key for key in drawn if sources is None or key.material in sources)
        truth = next(key for key in drawn if key != source)
        by_shape[source.shape].append(scene_of(pictures, source, truth))
    turns = [(turn, each) for of in by_shape.values() for turn, each in enumerate(of)]
    return [each for _, each in sorted(turns, key=lambda pair: pair[0])][:count]
