"""Duplicates: the same mesh, fit or map under a second name.

A duplicate is left out, because its pictures would be those of the first.
"""

from collections.abc import Iterable
from typing import Protocol, TypeVar

from manifests.errors import InputError


class Named(Protocol):
    """Something with a name and a hash of its content."""

    @property
    def name(self) -> str: ...

    @property
    def hash(self) -> str: ...


Asset = TypeVar("Asset", bound=Named)


def duplicate_message(kind: str, name: str, first: str) -> str:
    """Return the line that says that an asset is left out, since it is the first one again."""
    return f"{kind} '{name}' is '{first}' again, left out"


def without_duplicates(assets: Iterable[Asset], kind: str, notes: list[str]) -> list[Asset]:
    """Return each asset once by its hash, and add a line to the notes for each that is left out.

    kind    what the assets are called in messages
    Raises  InputError for two assets of one name
    """
    by_hash: dict[str, Asset] = {}
    names: set[str] = set()
    for asset in assets:
        if asset.hash in by_hash:
            if asset.name != by_hash[asset.hash].name:
                notes.append(duplicate_message(kind, asset.name, by_hash[asset.hash].name))
            continue
        if asset.name in names:
            raise InputError(
                f"{kind} '{asset.name}'",
                "one thing under a name",
                "two that differ",
                "rename one of the files",
            )
        by_hash[asset.hash] = asset
        names.add(asset.name)
    return list(by_hash.values())
