"""The shapes of a job, with the roles that a rule gives them.

What a job's shapes are can be known before all of them are read; where each shape's role follows
from it alone, shapes can be taken one by one.
"""

from collections.abc import Collection, Iterable

import msgspec

from factory.planning.duplicates import duplicate_message
from factory.planning.facts import Facts
from factory.planning.shape_names import Source
from manifests import splits
from manifests.errors import InputError
from manifests.schema import Job, Role, Side


class Shape(msgspec.Struct, frozen=True, kw_only=True):
    """A shape of a job; segments: number of regions that get a material each."""

    name: str
    source: Source
    category: str
    hash: str
    segments: int
    side: Side
    role: Role
    licence: str
    report: str


def shapes_of(job: Job, read: Iterable[tuple[Source, Facts]]) -> list[Shape]:
    """Return the shapes with a role of the job, each name once."""
    result: dict[str, tuple[Source, Facts]] = {}
    for source, facts in read:
        first, known = result.setdefault(facts.name, (source, facts))
        _require_same(facts, source, first, known.hash)
    roles = splits.shape_roles(
        [(name, facts.category, facts.hash) for name, (_, facts) in result.items()], job.split
    )
    return [
        _shape(source, facts, roles[name])
        for name, (source, facts) in result.items()
        if roles[name] in _requested_roles(job)
    ]


def _shape(source: Source, facts: Facts, role: Role) -> Shape:
    return Shape(
        name=facts.name,
        source=source,
        category=facts.category,
        hash=facts.hash,
        segments=facts.segments,
        side=splits.SIDES[role],
        role=role,
        licence=source.licence,
        report=facts.report,
    )


def _requested_roles(job: Job) -> Collection[Role]:
    """Return the roles that a job keeps."""
    return job.roles or splits.SIDES


def _require_same(facts: Facts, source: Source, first: Source, hash_: str) -> None:
    """Raise InputError if a shape's hash is not that of the first shape of its name."""
    if facts.hash != hash_:
        raise InputError(
            f"shape '{facts.name}'",
            "one mesh under a name",
            f"{first.place} and {source.place}",
            "rename one of the files",
        )


def no_shapes_error(job: Job) -> InputError:
    """Return the error of a job none of whose shapes has a role of the job."""
    return InputError(
        "job: shapes",
        f"some with a role among {', '.join(job.roles)}",
        "none",
        "widen shapes or roles",
    )


def roles_are_independent(job: Job, unread: Iterable[Source]) -> bool:
    """Return whether each shape's role follows from the shape, whatever the others are.

    It does not where a rule has ranges and there are mesh files: these stand by the rank of their
    hashes, and a file may be a duplicate of a numbered shape.
    """
    return not splits.rules()[job.split]["shapes"] or not any(source.is_file for source in unread)


class Arrivals:
    """The shapes of a job whose roles follow from each alone, taken one by one in any order."""

    def __init__(self, job: Job):
        self._job = job
        self._by_name: dict[str, tuple[Source, str]] = {}
        self._by_hash: dict[str, tuple[str, Role]] = {}

    def take(self, source: Source, facts: Facts) -> Shape | None:
        """Return a source's shape, None if its role is none of the job's; duplicates come, too.

        Raises  InputError: two meshes of one name, a duplicate with another role
        """
        first, hash_ = self._by_name.setdefault(facts.name, (source, facts.hash))
        _require_same(facts, source, first, hash_)
        role = splits.shape_roles([(facts.name, facts.category, facts.hash)], self._job.split)
        shape = _shape(source, facts, role[facts.name])
        _require_same_role(shape, *self._by_hash.setdefault(facts.hash, (shape.name, shape.role)))
        return shape if shape.role in _requested_roles(self._job) else None

    @property
    def is_empty(self) -> bool:
        """Whether no shape that was taken has a role of the job."""
        return not any(role in _requested_roles(self._job) for _, role in self._by_hash.values())


def duplicate_note(shape: Shape, first: str, role: Role) -> str | None:
    """Return the line that says that a shape is left out, None for the same mesh and name.

    first, role  name and role of the shape that is kept
    Raises       InputError for another role
    """
    _require_same_role(shape, first, role)
    return None if shape.name == first else duplicate_message("shape", shape.name, first)


def _require_same_role(shape: Shape, first: str, role: Role) -> None:
    """Raise InputError for a duplicate whose role is not that of the first shape of its mesh."""
    if shape.role != role:
        raise InputError(
            f"shape '{shape.name}'",
            f"role {role}, as '{first}', which is the same mesh",
            shape.role,
            "leave one of them out of the job",
        )
