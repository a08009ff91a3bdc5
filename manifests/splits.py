"""Which shapes, materials and lights are for training and which are for testing.

The decision follows from what they are, and never from the order in which they come.

role        pretrain, finetune, train or test
side        train or test; every role but test is on the training side
rule        "hash": by hash, a fifth is for testing (lights always follow this rule); "paper",
            "multi-material" and "general": by number, as manifests/splits.json says. By every rule,
            the families that this file calls test_only are for testing
duplicates  one mesh or fit under two names, found by its hash: both get one role, and they are for
            testing if either is
"""

import hashlib
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from manifests.reading import read
from manifests.schema import Role, Side, Split

AnyRole = TypeVar("AnyRole", Role, Side)
NUMBERED = re.compile(r"^(\w+):(\d+)$")  # "chair:17"
SIDES: dict[Role, Side] = {
    "pretrain": "train",
    "finetune": "train",
    "train": "train",
    "test": "test",
}
# duplicates get the first role in this order that one of them has
PRECEDENCE: tuple[Role, ...] = ("test", "pretrain", "finetune", "train")


@cache
def rules() -> dict[str, Any]:
    """Return the content of manifests/splits.json."""
    return read(Path(__file__).parent / "splits.json", dict)


def is_test_only(name: str) -> bool:
    """Return whether a shape "shoe:17" is of a family that no training may have.

    A mesh file that a user calls a shoe is none of them.
    """
    number = NUMBERED.match(name)
    return number is not None and number[1] in rules()["test_only"]


def shape_roles(shapes: Sequence[tuple[str, str, str]], rule: str) -> dict[str, Role]:
    """Return {name: role} of shapes.

    shapes  [(name, category, hash)], each name once
    rule    "hash", "paper", "multi-material" or "general"
    """
    ranges = rules()[rule]["shapes"]
    rank = _ranks(shapes)
    roles: dict[str, Role] = {}
    for name, category, hash_ in shapes:
        if (number := _number(name, category)) is None:
            by_number = _by_number(rank[category, hash_], ranges.get(category, {}))
        else:
            by_number = _by_seed(number, category, rule)
        roles[name] = "test" if is_test_only(name) else by_number or _by_hash(hash_)
    return _keep_duplicates_together(roles, {name: hash_ for name, _, hash_ in shapes})


def numbered_role(name: str, rule: str) -> Role | None:
    """Return the role of "chair:17" by its number alone.

    None where the rule has no range that holds the number: the hash decides then.
    """
    if is_test_only(name):
        return "test"
    number = NUMBERED.match(name)
    return _by_seed(int(number[2]), number[1], rule) if number else None


def role_of(name: str, category: str, hash_: str, rule: str) -> Role | None:
    """Return the role of a shape where it follows from the shape alone.

    None where it depends on the rank of the hash among the other meshes of its category.
    """
    if is_test_only(name):
        return "test"
    ranges = rules()[rule]["shapes"].get(category)
    if not ranges:
        return _by_hash(hash_)
    number = _number(name, category)
    return None if number is None else _by_seed(number, category, rule) or _by_hash(hash_)


def material_sides(materials: Sequence[tuple[str, Side, str]]) -> dict[str, Side]:
    """Return {name: side} of materials; duplicates get one side.

    materials  [(name, split in its catalogue, hash)]
    """
    return _keep_duplicates_together(
        {name: split for name, split, _ in materials}, {name: hash_ for name, _, hash_ in materials}
    )


def paper_training(names: Iterable[str]) -> set[str]:
    """Return the names of the 60 training materials that stand for the paper's 60.

    They are those whose names have the smallest hashes, so that no taste is involved.
    """
    order = sorted(names, key=lambda name: hashlib.sha256(f"paper {name}".encode()).digest())
    return set(order[: rules()["paper"]["train_materials"]])


def light_side(hash_: str) -> Side:
    """Return the side of a light, by the hash of its map.

    It does not affect the split of pictures; training that samples lights uses it.
    """
    return _by_hash(hash_)


def split_of(shape_side: Side, material_sides_: Iterable[Side]) -> Split:
    """Return a record's split: the side that shape and all materials share, or mixed."""
    return shape_side if all(side == shape_side for side in material_sides_) else "mixed"


def _ranks(shapes: Sequence[tuple[str, str, str]]) -> dict[tuple[str, str], int]:
    """Return {(category, hash): rank of the hash among the category's mesh files}."""
    hashes = defaultdict(set)
    for name, category, hash_ in shapes:
        if _number(name, category) is None:
            hashes[category].add(hash_)
    return {
        (category, hash_): rank
        for category, result in hashes.items()
        for rank, hash_ in enumerate(sorted(result))
    }


def _number(name: str, category: str) -> int | None:
    """Return 17 for "chair:17" if the category is chair, else None."""
    number = NUMBERED.match(name)
    return int(number[2]) if number and number[1] == category else None


def _by_seed(number: int, category: str, rule: str) -> Role | None:
    """Return the role of a family's seed, which has ranges that mesh files' ranks have not."""
    parts = ("shapes", "further_seeds")
    ranges = (rules()[rule].get(part, {}).get(category, {}) for part in parts)
    return next((role for each in ranges if (role := _by_number(number, each))), None)


def _by_number(number: int, ranges: Mapping[Role, tuple[int, int | None]]) -> Role | None:
    """Return the role whose range holds a number; a range without an end is open."""
    for role, (first, end) in ranges.items():
        if first <= number and (end is None or number < end):
            return role
    return None


def _by_hash(hash_: str) -> Side:
    share = int(hash_[:8], 16) / 2**32
    return "test" if share < rules()["test_share"] else "train"


def _keep_duplicates_together(
    roles: Mapping[str, AnyRole], hashes: Mapping[str, str]
) -> dict[str, AnyRole]:
    """Return the roles (or sides) with one role for all names of a hash."""
    groups = defaultdict(list)
    for name, hash_ in hashes.items():
        groups[hash_].append(name)
    return {
        name: min((roles[each] for each in duplicates), key=PRECEDENCE.index)
        for duplicates in groups.values()
        for name in duplicates
    }
