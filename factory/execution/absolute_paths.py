"""Makes paths of meshes and lights absolute, because the workers of a Ray cluster run in the folder
where the cluster was started.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from msgspec import structs

from factory.lights.files import is_light_path

if TYPE_CHECKING:
    from factory.execution.parts import Part
    from factory.execution.run import RunOptions
    from factory.planning.job_shapes import Shape
    from factory.planning.plan import Plan


def make_paths_absolute(
    plan: Plan, parts: Iterable[Part | None], run_options: RunOptions
) -> tuple[Plan, Iterator[Part | None], RunOptions]:
    """Return a plan, its parts and options that name meshes and lights by absolute paths."""
    lights = {
        key: replace(light, source=_absolute_path(light.source))
        if is_light_path(light.source)
        else light
        for key, light in plan.assets.lights.items()
    }
    library = None if run_options.library is None else _absolute_path(run_options.library)
    absolute_parts = (
        None if part is None else part._replace(shapes=_shapes_at_absolute_paths(part.shapes))
        for part in parts
    )
    assets = replace(plan.assets, lights=lights)
    return replace(plan, assets=assets), absolute_parts, replace(run_options, library=library)


def _shapes_at_absolute_paths(shapes: Iterable[Shape]) -> list[Shape]:
    """Return shapes whose files are named by absolute paths."""
    return [
        structs.replace(s, source=structs.replace(s.source, place=_absolute_path(s.source.place)))
        if s.source.is_file
        else s
        for s in shapes
    ]


def _absolute_path(path: str) -> str:
    """Return the absolute path; what follows after its '#' or '?' stays."""
    return os.path.join(os.getcwd(), path)
