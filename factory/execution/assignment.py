"""What a worker needs besides its shots: where it reads assets from, and which hashes they have."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from factory.planning.shape_names import Source, load_mesh
from manifests.schema import Job

if TYPE_CHECKING:
    from factory.lights.light import Light
    from factory.shapes.mesh import Mesh


class ShapeSource(msgspec.Struct, frozen=True, kw_only=True):
    """Where a shape is read from, and the hash that it must have."""

    source: Source
    hash: str
    category: str


class LightSource(msgspec.Struct, frozen=True, kw_only=True):
    """Where a light is read from, and the hash that it must have."""

    source: str
    hash: str


class Assignment(msgspec.Struct, frozen=True, kw_only=True):
    """What a worker needs to know besides its shots.

    lights   by the names that shots use
    library  a folder of light maps, or None
    """

    job: Job
    lights: dict[str, LightSource]
    library: str | None = None


class BadShot(RuntimeError):
    """A shot whose pixels, normals or light are not what they should be."""


def load_shape(source: ShapeSource) -> Mesh:
    """Return the Mesh of an assignment's shape. Raises BadShot if the file has changed."""
    mesh = load_mesh(source.source)
    _require_unchanged(source.source.place, "mesh", source.hash, mesh.hash)
    return mesh


def load_light(source: LightSource, library: str | None) -> Light:
    """Return the Light of an assignment's light. Raises BadShot if the file has changed."""
    from factory.lights import load

    light = load(source.source, library)
    _require_unchanged(source.source, "map", source.hash, light.hash)
    return light


def _require_unchanged(place: str, what: str, expected: str, digest: str) -> None:
    """Raise BadShot if the hash of an asset is not the one that it had when the plan was made."""
    if digest != expected:
        raise BadShot(
            f"{place}: expected the {what} with hash {expected[:12]}, found {digest[:12]} (the file"
            " has changed since the plan was made)"
        )
