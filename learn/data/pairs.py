"""Edits whose truth is known: two pictures of one data set that differ in the material alone.

scene  shared by two such pictures: geometry (shape, view, camera), light and its rotation,
       light-transport tier, light resolution
edit   a method sees picture a and is given the label of picture b, which is the truth
"""

import hashlib
from collections import defaultdict
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from learn.data.batch import ExampleBatch, collate
from learn.data.records import Records
from manifests.errors import InputError
from manifests.schema import Record


@dataclass(frozen=True)
class EditPair:
    """An edit: two records of one scene.

    per_segment  whether the scene's pictures have a material for each segment
    """

    source: Record
    truth: Record
    per_segment: bool

    @property
    def id(self) -> str:
        """The id of the pair, determined by both pictures' ids."""
        return f"{self.source.id}-{self.truth.id}"


def scene_key(record: Record) -> Hashable:
    """Return what the pictures of an edit share, as a key."""
    r = record
    return (
        r.geometry_hash,
        r.light_hash,
        r.rotation_texels,
        r.tier,
        r.light_resolution,
        r.camera,
        len(r.materials),
    )


def edits_between(records: Iterable[Record]) -> dict[str, list[EditPair]]:
    """Return {source record id: [EditPair]} of all ordered pairs.

    Of pictures that differ in seed and samples alone, the one of fewest samples and then of least
    id is used. Pictures of more samples serve comparisons, and do not alter the choice of edits.
    """
    scenes: dict[Hashable, dict[tuple[str, ...], Record]] = defaultdict(dict)
    for record in sorted(records, key=lambda r: (r.samples, r.id)):
        scenes[scene_key(record)].setdefault(record.materials, record)
    edits = {}
    for group in scenes.values():
        per_segment = any(len(set(materials)) > 1 for materials in group)
        for source in group.values():
            edits[source.id] = [
                EditPair(source, truth, per_segment)
                for truth in group.values()
                if truth is not source
            ]
    return {id_: pairs for id_, pairs in edits.items() if pairs}


def find_repeats(records: Iterable[Record]) -> dict[tuple, list[Record]]:
    """Return {(scene, materials): records that differ in their seed alone}.

    Two or more of them show the noise. Of several numbers of samples the largest that was rendered
    twice is used; if none was, the smallest.
    """
    groups: dict[tuple, dict[int, list[Record]]] = defaultdict(lambda: defaultdict(list))
    for record in sorted(records, key=lambda r: r.id):
        groups[scene_key(record), record.materials][record.samples].append(record)
    return {key: by_samples[_finest(by_samples)] for key, by_samples in groups.items()}


def _finest(by_samples: Mapping[int, Sequence[Record]]) -> int:
    twice = [samples for samples, records in by_samples.items() if len(records) > 1]
    return max(twice) if twice else min(by_samples)


def choose_edits(records: Iterable[Record], count: int, seed: int) -> list[EditPair]:
    """Return the first `count` edits, picture after picture.

    A larger count begins with the same edits. Raises as `edits_by_picture`.
    """
    return [edit for edits in edits_by_picture(records, seed) for edit in edits][:count]


def edits_by_picture(records: Iterable[Record], seed: int) -> list[list[EditPair]]:
    """Return the edits of each source picture, in an order that the seed determines.

    Shapes take turns, each time with another picture. Raises InputError where no two pictures make
    an edit.
    """
    edits = edits_between(records)
    if not edits:
        remedy = (
            "render each shape, view and light in two materials or more: python -m factory"
            " render JOB"
        )
        raise InputError(
            "--data", "pictures that differ in nothing but the material", "none", remedy
        )
    by_shape = defaultdict(list)
    for id_, of_picture in edits.items():
        by_shape[of_picture[0].source.shape].append(id_)
    for ids in by_shape.values():
        ids.sort(key=lambda id_: _shuffle(seed, id_))
    shapes = sorted(by_shape, key=lambda name: _shuffle(seed, name))
    rounds = range(max(map(len, by_shape.values())))
    return [
        edits[by_shape[shape][k]] for k in rounds for shape in shapes if k < len(by_shape[shape])
    ]


def _shuffle(seed: int, name: str) -> bytes:
    return hashlib.sha256(f"{seed} {name}".encode()).digest()


def make_source_batch(records: Records, edit: EditPair) -> ExampleBatch:
    """Return the batch of one that methods see of an edit's source, as of `make_batch`."""
    return make_batch(records, edit.source, edit.per_segment)


def make_batch(records: Records, record: Record, per_segment: bool = False) -> ExampleBatch:
    """Return the batch of one that methods see of a record.

    per_segment  whether it has one region per segment, as where a scene has several materials;
                 otherwise one in all
    Raises       InputError for a perspective camera: networks and edits assume a distant viewer
    """
    sample = records.load(record)
    if sample.view is not None:
        raise InputError(
            records.folder,
            "an orthographic camera",
            f"{record.camera.fov_deg:g}°",
            "render without fov_deg",
        )
    mask = sample.mask.numpy()
    segments = sample.segments if per_segment else sample.mask.long()
    label = sample.label[: None if per_segment else 1].numpy()
    image = sample.image.numpy() * mask[..., None]
    name = f"{record.shape} view {record.viewpoint} {'+'.join(dict.fromkeys(record.materials))}"
    return collate(
        [(image, mask, sample.n, segments, label, sample.light, label, name)], sample.elevation
    )


def target_label(records: Records, edit: EditPair) -> torch.Tensor:
    """Return the label (S, 108) of an edit's target, one row per region of `make_source_batch`."""
    names = edit.truth.materials if edit.per_segment else edit.truth.materials[:1]
    return torch.from_numpy(np.stack([records.label(name) for name in names]))
