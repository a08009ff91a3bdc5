"""Edits whose truth is known: two pictures of one dataset that differ in nothing but the material.

scene  what two such pictures share: geometry (shape, view, camera), light and its turn,
light-transport tier, light resolution
edit   picture a is shown to a method, the label of picture b is asked for, picture b is the truth
"""

import hashlib
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import torch

from learn.data.batch import joined
from manifests.errors import InputError
from manifests.schema import Record


@dataclass(frozen=True)
class EditPair:
    """source, truth: Records of one scene. several: whether the scene's pictures have a material
    for each segment.
    """

    source: Record
    truth: Record
    several: bool

    @property
    def id(self):
        """Of the pair: determined by both pictures' ids."""
        return f"{self.source.id}-{self.truth.id}"


def scene(record):
    """What pictures of an edit share, as a key."""
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


def edits_between(records):
    """{source record id: [Edit]} of all ordered pairs.

    Of pictures that differ in seed and samples alone one of the fewest samples is taken, of these
    the one of least id: a picture of more samples is there to be compared with, and alters no
    choice of edits.
    """
    scenes = defaultdict(dict)
    for record in sorted(records, key=lambda r: (r.samples, r.id)):
        scenes[scene(record)].setdefault(record.materials, record)
    edits = {}
    for group in scenes.values():
        several = any(len(set(materials)) > 1 for materials in group)
        for source in group.values():
            edits[source.id] = [
                EditPair(source, truth, several) for truth in group.values() if truth is not source
            ]
    return {id_: pairs for id_, pairs in edits.items() if pairs}


def repeats(records):
    """{(scene, materials): records that differ in their seed alone}: two or more of them show the
    noise.

    Of several numbers of samples the largest is taken that was rendered twice, where none was the
    smallest.
    """
    groups = defaultdict(lambda: defaultdict(list))
    for record in sorted(records, key=lambda r: r.id):
        groups[scene(record), record.materials][record.samples].append(record)
    return {key: by_samples[_finest(by_samples)] for key, by_samples in groups.items()}


def _finest(by_samples):
    twice = [samples for samples, records in by_samples.items() if len(records) > 1]
    return max(twice) if twice else min(by_samples)


def chosen(records, count, seed):
    """The first `count` edits, picture after picture. A larger count begins with the same edits.
    Raises as `by_picture`.
    """
    return [edit for edits in by_picture(records, seed) for edit in edits][:count]


def by_picture(records, seed):
    """[all Edits of one source picture] in an order that a seed determines: shape after shape in
    turn, each time another picture.

    Raises InputError where no two pictures make an edit.
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
        ids.sort(key=lambda id_: _shuffled(seed, id_))
    shapes = sorted(by_shape, key=lambda name: _shuffled(seed, name))
    rounds = range(max(map(len, by_shape.values())))
    return [
        edits[by_shape[shape][k]] for k in rounds for shape in shapes if k < len(by_shape[shape])
    ]


def _shuffled(seed, name):
    return hashlib.sha256(f"{seed} {name}".encode()).digest()


def shown(records, edit):
    """The Batch of one that methods see of an edit's source: one region, or one a segment where the
    scene has several materials.

    records  learn.data.records.Records. Raises InputError for a perspective camera: networks and
    edits are of a distant viewer
    """
    sample = records.load(edit.source)
    if sample.view is not None:
        raise InputError(
            records.folder,
            "an orthographic camera",
            f"{edit.source.camera.fov_deg:g}°",
            "render without fov_deg",
        )
    mask = sample.mask.numpy()
    segments = sample.segments if edit.several else sample.mask.long()
    label = sample.label[: None if edit.several else 1].numpy()
    image = sample.image.numpy() * mask[..., None]
    name = (
        f"{edit.source.shape} view {edit.source.viewpoint}"
        f" {'+'.join(dict.fromkeys(edit.source.materials))}"
    )
    return joined(
        [(image, mask, sample.n, segments, label, sample.light, label, name)], sample.elevation
    )


def target_label(records, edit):
    """The label (S, 108) tensor that an edit asks for, a row a region of `shown`."""
    names = edit.truth.materials if edit.several else edit.truth.materials[:1]
    return torch.from_numpy(np.stack([records.label(name) for name in names]))
