"""Which shapes, materials and lights are for training and which for testing: decided by what they
are, never by the order they come in.

role   pretrain, finetune, train or test; side: train or test (every role but test is for training)
rule   "hash": a fifth of all shapes, by their hash (of lights always). "paper", "multi-material",
"general": counts by number (manifests/splits.json)
duplicates  one mesh or fit under two names, found by hash: both take one side, and that is test if
either was for testing
"""

import hashlib
import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from manifests.reading import read

NUMBERED = re.compile(r"^(\w+):(\d+)$")  # "chair:17"
SIDES = {"pretrain": "train", "finetune": "train", "train": "train", "test": "test"}
# what duplicates take, the first that one of them has
PRECEDENCE = ("test", "pretrain", "finetune", "train")


@cache
def rules() -> dict[str, Any]:
    """manifests/splits.json."""
    return read(Path(__file__).parent / "splits.json", dict)


def shape_roles(shapes: Sequence[tuple[str, str, str]], rule: str) -> dict[str, str]:
    """The role of each shape.

    shapes   [(name, category, hash)], each name once
    rule     "hash", "paper", "multi-material" or "general"
    Returns  {name: role}
    """
    ranges = rules()[rule]["shapes"]
    rank = _ranks(shapes)
    roles = {}
    for name, category, hash_ in shapes:
        place = rank[category, hash_] if (number := _number(name, category)) is None else number
        roles[name] = _by_number(place, ranges.get(category, {})) or _by_hash(hash_)
    return _keep_duplicates_together(roles, {name: hash_ for name, _, hash_ in shapes})


def numbered_role(name: str, rule: str) -> str | None:
    """The role of "chair:17" by its number alone, or None where the rule has no range that holds it
    (then its hash decides).
    """
    number = NUMBERED.match(name)
    return (
        _by_number(int(number[2]), rules()[rule]["shapes"].get(number[1], {})) if number else None
    )


def role_of(name: str, category: str, hash_: str, rule: str) -> str | None:
    """The role of a shape by itself, or None where it depends on the other meshes of its category,
    by the rank among their hashes.
    """
    ranges = rules()[rule]["shapes"].get(category)
    if not ranges:
        return _by_hash(hash_)
    number = _number(name, category)
    return None if number is None else _by_number(number, ranges) or _by_hash(hash_)


def material_sides(materials: Sequence[tuple[str, str, str]]) -> dict[str, str]:
    """The side of each material: [(name, its catalogue's split, hash)] to {name: side}; duplicates
    together.
    """
    return _keep_duplicates_together(
        {name: split for name, split, _ in materials}, {name: hash_ for name, _, hash_ in materials}
    )


def paper_training(names: Iterable[str]) -> set[str]:
    """The paper's 60 of the materials for training: those whose names' hashes are least, so that
    nobody's taste chooses.
    """
    order = sorted(names, key=lambda name: hashlib.sha256(f"paper {name}".encode()).digest())
    return set(order[: rules()["paper"]["train_materials"]])


def light_side(hash_: str) -> str:
    """The side of a light, by the hash of its map: of pictures it says nothing, to who samples
    lights for training everything.
    """
    return _by_hash(hash_)


def split_of(shape_side: str, material_sides_: Iterable[str]) -> str:
    """A record's split: the side that shape and all materials share, or mixed."""
    return shape_side if all(side == shape_side for side in material_sides_) else "mixed"


def _ranks(shapes):
    """(category, hash) → rank of the hash among the category's mesh files: duplicates share one."""
    hashes = defaultdict(set)
    for name, category, hash_ in shapes:
        if _number(name, category) is None:
            hashes[category].add(hash_)
    return {
        (category, hash_): rank
        for category, result in hashes.items()
        for rank, hash_ in enumerate(sorted(result))
    }


def _number(name, category):
    """17 of "chair:17" if it is a chair, else None."""
    number = NUMBERED.match(name)
    return int(number[2]) if number and number[1] == category else None


def _by_number(number, ranges):
    return next(
        (
            role
            for role, (first, end) in ranges.items()
            if first <= number and (end is None or number < end)
        ),
        None,
    )


def _by_hash(hash_):
    share = int(hash_[:8], 16) / 2**32
    return "test" if share < rules()["test_share"] else "train"


def _keep_duplicates_together(roles, hashes):
    groups = defaultdict(list)
    for name, hash_ in hashes.items():
        groups[hash_].append(name)
    return {
        name: min((roles[twin] for twin in duplicates), key=PRECEDENCE.index)
        for duplicates in groups.values()
        for name in duplicates
    }
