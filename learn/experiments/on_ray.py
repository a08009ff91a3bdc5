"""The rows of an experiment, measured on a Ray cluster.

A worker runs the experiment itself, from its options, up to that call of runner.resume whose rows
are asked for; from there on it measures the rows that it is given. Calls before that one find all
their rows in the folder, which the nodes share. An experiment therefore needs no code of its own:
it says ON_RAY = True if its rows depend neither on each other nor on a clock, and if what comes
before runner.resume may be done by every worker.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec

from manifests import ray_tasks
from manifests.errors import InputError
from manifests.line_files import encode

Identity = dict[str, Any]  # what identifies a row


@dataclass(frozen=True)
class _Asking:
    """The experiment that this process measures on a cluster."""

    address: str
    experiment: str
    arguments: argparse.Namespace


class _Reached(Exception):
    """The call of runner.resume was reached for which a worker is there."""

    def __init__(self, cases: Sequence[tuple[Identity, Any]], measure: Callable[[Any], dict]):
        super().__init__()
        self.cases, self.measure = cases, measure


_asking: _Asking | None = None
_wanted: Path | None = None  # in a worker: the file of the rows that it is there for


@contextmanager
def asked_of_cluster(
    address: str | None, experiment: object, arguments: argparse.Namespace
) -> Iterator[None]:
    """Have rows measured on the cluster at `address` within this block; None: in this process."""
    global _asking
    before = _asking
    if address is not None:
        assert isinstance(experiment, ModuleType)
        _asking = _Asking(address, experiment.__name__, arguments)
    try:
        yield
    finally:
        _asking = before


def is_asking() -> bool:
    """Return whether rows are to be measured on a cluster."""
    return _asking is not None


def measure_on_cluster(
    path: Path, pieces: Sequence[Sequence[Identity]]
) -> Generator[tuple[Identity, dict[str, Any]], None, None]:
    """Yield (identity, the rest of its row) as the cluster measures them.

    path    of the file of rows
    pieces  identities that one worker measures together
    """
    if not pieces:
        return
    assert _asking is not None
    settings = {
        "experiment": _asking.experiment,
        "path": path,
        "arguments": _pack(vars(_asking.arguments) | {"ray": None}),
    }
    values = [[list(each.values()) for each in piece] for piece in pieces]
    with contextlib.closing(
        ray_tasks.results(_asking.address, f"{__name__}:on_worker", settings, values)
    ) as answers:
        for number, answer in answers:
            yield from zip(pieces[number], msgspec.json.decode(answer), strict=True)


def on_worker(settings: bytes) -> ray_tasks.Work:
    """Return what a worker of a Ray cluster does: identities as JSON → the rest of their rows."""
    import torch

    global _wanted
    torch.set_num_threads(1)
    given = msgspec.json.decode(settings)
    experiment = importlib.import_module(given["experiment"])
    before, _wanted = _wanted, Path(given["path"])
    try:
        experiment.measure(argparse.Namespace(**_unpack(given["arguments"])))
    except _Reached as reached:
        cases = {tuple(identity.values()): case for identity, case in reached.cases}
        measure = reached.measure
    else:
        raise RuntimeError(f"{given['experiment']} does not come to {given['path']}")
    finally:
        _wanted = before

    def work(piece: bytes) -> bytes:
        return encode([measure(cases[tuple(each)]) for each in msgspec.json.decode(piece)])

    return work


def end_where_rows_are_requested(
    path: Path,
    cases: Sequence[tuple[Identity, Any]],
    measure: Callable[[Any], dict[str, Any]],
    missing: int,
) -> None:
    """Do nothing, except in a worker: end the experiment where its rows are requested.

    missing  number of rows that the file does not have
    Raises   InputError if an earlier file, which is complete, does not look so from here
    """
    if _wanted is None:
        return
    if path.absolute() == _wanted:
        raise _Reached(cases, measure)
    if missing:
        remedy = "give a folder that all nodes share at one path"
        raise InputError(path, "all rows, on every node of the cluster", "some", remedy)


def _pack(value: Any) -> Any:
    """Return options as what JSON can hold; functions are left out, paths are marked."""
    if isinstance(value, dict):
        return {key: _pack(each) for key, each in value.items() if not callable(each)}
    if isinstance(value, list | tuple):
        return [_pack(each) for each in value]
    return {"path": value} if isinstance(value, Path) else value


def _unpack(value: Any) -> Any:
    """Return options from what `_pack` made of them."""
    if isinstance(value, dict):
        if set(value) == {"path"}:
            return Path(value["path"])
        return {key: _unpack(each) for key, each in value.items()}
    return [_unpack(each) for each in value] if isinstance(value, list) else value
