"""The edits of an experiment: pictures of the ladder's rungs, and scenes that are drawn of them."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from learn.data.records import Records
    from learn.evaluation.ladder_design import Scene
    from learn.experiments.relighting import Key
    from manifests.schema import Record


class DrawnEdits(NamedTuple):
    """The edits that an experiment measures.

    pictures  as of `relighting.pictures_of`
    seen      sentences about what the weights saw of the scenes in training
    """

    records: Records
    pictures: Mapping[str, Mapping[Key, Record]]
    scenes: list[Scene]
    seen: list[str]


def opened(arguments: argparse.Namespace, **settings: Any) -> DrawnEdits:
    """Return the edits of the arguments data, weights, scenes and seed; torch gets one thread.

    What rows.jsonl depends on is pinned in arguments.out, so that no run continues another's rows.

    settings  further ones of the experiment that are pinned
    Raises    InputError for a data set without pictures of the rungs, and for an earlier run of
              other settings
    """
    import torch

    from learn.data.records import Records
    from learn.evaluation import ladder, overlap
    from learn.experiments import relighting
    from manifests import files
    from manifests.store import file_hash

    torch.set_num_threads(1)
    records = Records(arguments.data)
    pictures = relighting.pictures_of(records)
    scenes = relighting.edits_of(pictures, arguments.scenes, arguments.seed)
    is_one = isinstance(arguments.weights, Path)
    weights = [arguments.weights] if is_one else arguments.weights
    seen = overlap.sentences(weights, ladder.tested(records, scenes), arguments.data, True)
    hashes = [file_hash(path) for path in weights]
    about = {
        "data": file_hash(arguments.data / "materials.json"),
        "weights": hashes[0] if is_one else hashes,
        "seed": arguments.seed,
    }
    files.pin_settings(arguments.out / "settings.json", about | settings)
    return DrawnEdits(records, pictures, scenes, seen)
