"""dataset.json and materials.json, checked against each other and against the rules of the split.

label  an entry of materials.json; its hash is recomputed from its numbers
side   of a shape by its role, of a light by its hash, of a material by its label's split
       (manifests.splits)
"""

import re
from collections.abc import Iterator
from functools import cache
from pathlib import PurePath

from manifests import splits
from manifests.errors import InputError
from manifests.materials import BUILT_IN, Entry, material, material_hash, read_catalogue
from manifests.schema import Dataset, Draw, Job
from manifests.store_paths import light_path
from manifests.verification.faults import Fault

# of shapes that go by number: "chair:17" is a chair
FAMILIES = frozenset((*splits.rules()["general"]["shapes"], *splits.rules()["test_only"]))
RANGE = re.compile(r"^\w+:([0-9]{1,100})-([0-9]{1,100})$")
SETS = {"merl": BUILT_IN[0], "rgl": BUILT_IN[1]}


def entry_faults(dataset: Dataset, labels: dict[str, Entry] | None) -> Iterator[Fault]:
    """Yield the faults of dataset.json and materials.json.

    labels  None if materials.json cannot be read
    """
    if not dataset.orders:
        yield Fault("dataset.json: expected an order, the job that was rendered, found none")
    for name in dataset.materials if labels is not None else ():
        yield from _material_faults(name, dataset, labels)
    for name in labels or ():
        if name not in dataset.materials:
            text = f"materials.json: expected a material that dataset.json names, found '{name}'"
            yield Fault(text, entry=("labels", name))
    for name, entry in dataset.lights.items():
        fault = _fault_of("lights", name)
        if entry.side not in (None, side := splits.light_side(entry.hash)):
            yield fault(f"side {side} by its hash", entry.side)
        if entry.file != (path := light_path(name, entry.hash)):
            yield fault(f"its map at {path}", entry.file)
        if dataset.orders and not any(
            _names_light(term, name) for order in dataset.orders for term in order.job.lights
        ):
            yield fault("a light that an order names", "one that none does")
    for name in dataset.shapes:
        yield from _shape_faults(name, dataset)
    for number, order in enumerate(dataset.orders, 1):
        if (most := most_shots(order.job, dataset)) is not None and order.shots > most:
            yield Fault(
                f"dataset.json: order {number}: expected at most {most} shots of its job, found"
                f" {order.shots}"
            )


def _fault_of(kind, name):
    """Return a function (expected, found) that makes the Fault of an entry of dataset.json."""

    def fault(expected, found):
        return Fault(
            f"dataset.json: {kind[:-1]} '{name}': expected {expected}, found {found}",
            entry=(kind, name),
        )

    return fault


def _material_faults(name, dataset, labels):
    entry, label = dataset.materials[name], labels.get(name)
    if label is None:
        yield Fault(
            f"materials.json: expected a label of '{name}', which dataset.json names, found none"
        )
        return
    own = material_hash(label.label, label.mixture)
    if own != label.hash:
        text = (
            f"materials.json: '{name}': expected hash {own}, of its label and mixture, found"
            f" {label.hash}"
        )
        yield Fault(text, entry=("labels", name))
    elif own != entry.hash:
        text = (
            f"materials.json: '{name}': expected hash {entry.hash}, as in dataset.json, found {own}"
        )
        yield Fault(text, entry=("labels", name))
    else:
        try:
            material(label, "materials.json")
        except InputError as problem:
            yield Fault(str(problem), entry=("labels", name))
    fault = _fault_of("materials", name)
    side = built_in_splits().get((name, own), label.split)
    if entry.side != side:
        yield fault(f"side {side}", entry.side)
    if label.split != side:
        yield Fault(
            f"materials.json: '{name}': expected split {side}, found {label.split}",
            entry=("labels", name),
        )
    for key in ("licence", "source"):
        if (there := getattr(label, key)) != getattr(entry, key):
            yield fault(f"{key} '{there}', as in materials.json", f"'{getattr(entry, key)}'")
    if dataset.orders and not any(
        _may_name_material(term, name) for order in dataset.orders for term in order.job.materials
    ):
        yield fault("a material that an order names", "one that none does")


@cache
def built_in_splits() -> dict[tuple[str, str], str]:
    """Return {(name, hash): split} of the materials that come with the program."""
    return {
        (entry.name, entry.hash): entry.split
        for path in BUILT_IN
        if path.exists()
        for entry in read_catalogue(path).materials
    }


@cache
def _built_in_names(path):
    return {entry.name for entry in read_catalogue(path).materials} if path.exists() else set()


def _may_name_material(term, name):
    """Return whether a job's term may mean a material.

    The contents of the user's own sets are not known here.
    """
    first, slash, rest = term.partition("/")
    if first in SETS:
        return name in _built_in_names(SETS[first]) and rest in (
            "",
            "train",
            "test",
            "paper-train",
            name,
        )
    if slash:
        return rest in ("train", "test", "paper-train", name)
    return term == name or term not in _built_in_names(SETS["merl"]) | _built_in_names(SETS["rgl"])


def _names_light(term, name):
    """Return whether a job's term means a light: its name, or a file of that name."""
    return term == name or PurePath(term.replace("\\", "/")).stem == name


def _shape_faults(name, dataset):
    entry, fault = dataset.shapes[name], _fault_of("shapes", name)
    if entry.side != splits.SIDES[entry.role]:
        yield fault(f"side {splits.SIDES[entry.role]} of its role {entry.role}", entry.side)
    files = any(is_mesh_file(term) for order in dataset.orders for term in order.job.shapes)
    number = splits.NUMBERED.match(name)
    if number and number[1] in FAMILIES and not files and entry.category != number[1]:
        yield fault(f"category {number[1]}", entry.category)
        return
    rules = {order.job.split for order in dataset.orders}
    by_rule = [splits.role_of(name, entry.category, entry.hash, rule) for rule in rules]
    roles = {role for role in by_rule if role is not None}
    if not roles or None in by_rule:
        return
    # a duplicate that was left out may have changed the role: duplicates get the first role in this
    # order that one of them has
    if files:
        first = max(splits.PRECEDENCE.index(role) for role in roles)
        roles = set(splits.PRECEDENCE[: first + 1])
    if entry.role not in roles:
        yield fault(f"role {' or '.join(sorted(roles))}", entry.role)


def is_mesh_file(term: str) -> bool:
    """Return whether a job's term for shapes is a path and not a name such as "chair:0-39"."""
    return any(mark in term for mark in "/\\.")


def most_shots(job: Job, dataset: Dataset) -> int | None:
    """Return the largest number of shots that a job can mean.

    None if it names the user's own files or sets, whose sizes are not known here.
    """
    if any(is_mesh_file(term) for term in job.shapes):
        return None
    shapes = sum(_count(term) for term in job.shapes)
    views = job.views.random if isinstance(job.views, Draw) else len(job.views)
    if not job.pictures:
        return shapes * views
    choices = job.segment_materials
    if choices is None:
        choices = _most_materials(job, dataset)
        if choices is None:
            return None
    rotations = job.rotations.random if isinstance(job.rotations, Draw) else len(job.rotations)
    return (
        shapes
        * choices
        * len(job.lights)
        * views
        * rotations
        * len(job.tiers)
        * len(job.light_resolutions)
        * job.repeats
    )


def _count(term):
    """Return how many shapes a term such as "chair:0-39" means."""
    span = RANGE.match(term)
    return max(int(span[2]) - int(span[1]) + 1, 0) if span else 1


def _most_materials(job, dataset):
    """Return how many materials a job's terms mean at most, None if that is not known."""
    sizes = [_set_size(term, dataset) for term in job.materials]
    if None in sizes:
        return None
    own = dataset.materials.keys() - _built_in_names(SETS["merl"]) - _built_in_names(SETS["rgl"])
    # a user's set may have the name of one of its materials
    others = own - {*job.materials} if own & {*job.materials} else ()
    return sum(sizes) + len(others)


def _set_size(term, dataset):
    """Return how many materials a term means at most, None if that is not known."""
    first, _, rest = term.partition("/")
    if first in SETS:
        return (
            len(_built_in_names(SETS[first])) if rest in ("", "train", "test", "paper-train") else 1
        )
    return 1 if term in dataset.materials else None
