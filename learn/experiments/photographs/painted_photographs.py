"""Measure edits of photographs of objects in colours and prints that no catalogue has.

The photographs of `photographed-edits` are taken four times: of the object as it was rendered, in
one strong colour, with a print, and in one colour with a label (`painting`, beside this file). Each
is decomposed without refinement, with it, and with refinements that lack one or both settings for
colours and prints: all pixels count alike whatever their colour, or the light may take on any
colour as well. It is edited as `edit` does it and compared with Cycles' picture of the unpainted
object in the target's material, so any colour or print left in an edit is an error.

rows.jsonl keeps a line per photograph, paint and method: the same command continues, and a larger
--photographs adds to it.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from learn.editing import DETAIL
from learn.experiments import runner
from learn.experiments.photographs import photographed_edits
from learn.experiments.photographs.photographed_edits import Case

if TYPE_CHECKING:
    import numpy as np
    import torch

    from learn.data.records import Records, Sample
    from learn.refinement import RefinementSettings

ON_RAY = True
PREDICTED, BEFORE = "not refined", "refined as before 2026-11-28"
LIGHT_HELD, IN_USE = "refined, light's colours held", "refined, in use"
METHODS = (PREDICTED, BEFORE, LIGHT_HELD, IN_USE)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data, the weights and the number of photographs, each of which is in all paints."""
    photographed_edits.add_arguments(parser, photographs=96)


def settings_of(method: str) -> RefinementSettings | None:
    """Return how one of METHODS refines."""
    from learn.refinement import PHOTOGRAPHS

    light_held = replace(PHOTOGRAPHS, unexplained_share_at_half_weight=None)
    before = replace(light_held, b_colour=0.0)
    return {BEFORE: before, LIGHT_HELD: light_held, IN_USE: PHOTOGRAPHS}.get(method)


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows", "weights", "seen"}; rows as of `row_of`.

    Raises InputError for a data set without pictures of one scene in two materials.
    """
    from learn.experiments.photographs import painting

    opened = photographed_edits.opened(arguments, {m: _as_json(m) for m in METHODS})
    todo = [
        ({"photograph": case.source.id, "paint": paint, "method": method}, (case, paint, method))
        for case in opened.cases
        for paint in painting.KINDS
        for method in METHODS
    ]
    rows = runner.resume(
        arguments.out / "rows.jsonl",
        todo,
        lambda of: row_of(
            opened.records, opened.network, opened.size, *of, detail=arguments.detail
        ),
        "photograph",
    )
    return {"rows": rows, "weights": arguments.weights.name, "seen": opened.seen}


def _as_json(method: str) -> dict[str, Any] | None:
    settings = settings_of(method)
    return None if settings is None else asdict(settings)


def row_of(
    records: Records,
    network: torch.nn.Module,
    size: int,
    case: Case,
    paint: str,
    method: str,
    detail: float = DETAIL,
) -> dict[str, Any]:
    """Return the row of `photographed_edits.row_of` for a painted object and one method."""
    from learn.experiments.photographs import painting

    def in_paint(sample: Sample) -> np.ndarray:
        return painting.painted(paint, sample, case.source.id)

    return photographed_edits.row_of(
        records, network, size, case, settings_of(method), in_paint, detail
    )


def tables(report: runner.Report) -> str:
    """Return the error of edits by paint and method, and how refinement changes it."""
    from learn.experiments.photographs import painted_tables

    return painted_tables.page(report)
