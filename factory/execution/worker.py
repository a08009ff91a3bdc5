"""A worker: one process with one Blender, which makes many shots.

factory.execution.pool starts it as `python -m factory.execution.worker`. It reads messages from its
standard input, one line of JSON each, and writes replies to its standard output. What Blender
prints is dropped; Blender's errors go to standard error. When the input or the reader of the
replies is gone, the worker ends after the current shot. Until then it holds the run's lock, so that
no other run begins. It ends by os._exit, because some versions of Blender crash as they clean up.

in   a WorkerConfig, then any number of Chunks
out  Replies: a shot was `made`, or is `bad` (which ends the chunk), or an error is `fatal` (every
     other shot would fail as well)
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
from collections.abc import Callable
from typing import Any

import msgspec

from factory.execution.assignment import Assignment, BadShot, ShapeSource
from factory.execution.pipeline import Pipeline, Studio
from factory.planning.plan import Shot
from manifests.allocator import return_large_blocks
from manifests.errors import InputError
from manifests.line_files import Lines
from manifests.materials import load_catalogue
from manifests.schema import Record
from manifests.store import Store

STUDIO = "factory.render.studio:Studio"
PARENT = "BRDFACTORY_PARENT"  # environment variable: id of the process without which a worker ends


class WorkerConfig(msgspec.Struct, frozen=True, kw_only=True):
    """The configuration of a worker.

    folder   the data set's folder
    worker   the worker's name, which is that of its file of records
    device   one of factory.render.device.NAMES
    threads  CPU threads, None: all
    studio   module:class of the studio, called with (device, threads)
    """

    folder: str
    worker: str
    device: str
    threads: int | None
    studio: str
    assignment: Assignment


class Chunk(msgspec.Struct, frozen=True):
    """Shots to make, in this order, and where their shapes are read from, by name."""

    shots: list[Shot]
    shapes: dict[str, ShapeSource]


class Reply(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What a worker says about one shot, or about an error that ends it.

    made                id of the shot that was made
    bad                 id of the shot that failed
    fatal               whether every other shot would fail as well, so that the worker ends
    problem             the four parts of an InputError, if it was one
    reason              the error in one line
    seconds             how long the shot took
    bytes               size on disk of the picture, or of the geometry if there is no picture
    spent               {kind of work: seconds by the clock}
    computed            {kind of work: seconds of processor time, over all threads}
    notes               lines for the user
    settings, versions  those of the studio; only with the first shot
    """

    made: str = ""
    bad: str = ""
    fatal: bool = False
    problem: tuple[str, str, str, str] | None = None
    reason: str = ""
    seconds: float = 0.0
    bytes: int = 0
    spent: dict[str, float] | None = None
    computed: dict[str, float] | None = None
    notes: list[str] = []
    settings: dict | None = None
    versions: dict[str, str] | None = None


def main() -> None:
    """Make shots until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    return_large_blocks()
    answers = os.fdopen(os.dup(1), "wb", buffering=0)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)

    def answer(**reply: Any) -> None:
        try:
            answers.write(msgspec.json.encode(Reply(**reply)) + b"\n")
        except BrokenPipeError:
            os._exit(0)

    try:
        config = msgspec.json.decode(sys.stdin.buffer.readline(), type=WorkerConfig)
        _serve(config, answer)
    except InputError as problem:
        answer(fatal=True, problem=(problem.where, problem.expected, problem.found, problem.remedy))
    except OSError as error:
        remedy = "make room or mend the disk, then run the same command: what was written stays"
        answer(
            fatal=True,
            problem=(
                error.filename or config.folder,
                "a disk that takes a file",
                error.strerror or str(error),
                remedy,
            ),
        )
    except Exception as error:  # the parent shows any other error in one line
        answer(fatal=True, reason=f"worker {type(error).__name__}: {error}".replace("\n", " "))
    sys.stderr.flush()
    os._exit(0)


def _serve(config: WorkerConfig, answer: Callable[..., None]) -> None:
    """Make the shots of every chunk, and answer for each."""
    store = Store(config.folder)
    pictures = config.assignment.job.pictures
    lines = Lines(store.folder / ("records" if pictures else "views") / f"{config.worker}.jsonl")
    studio = _studio(config)
    # materials are registered before the first shot is given out, but maybe after the start
    if (message := sys.stdin.buffer.readline()) == b"":
        return
    mixtures = (
        {name: m.mixture for name, m in load_catalogue(store.folder / "materials.json").items()}
        if pictures
        else {}
    )
    pipeline = Pipeline(studio, config.assignment, store, config.worker, lines.append, mixtures)
    first = True
    chunks = msgspec.json.Decoder(Chunk)
    while message:
        chunk = chunks.decode(message)
        pipeline.shapes = chunk.shapes
        for shot in chunk.shots:
            if os.environ.get(PARENT) not in (None, str(os.getppid())):
                return
            try:
                record = pipeline.make(shot)
            except OSError:
                raise
            except (BadShot, InputError, RuntimeError, ValueError) as error:
                lines.sync()
                answer(bad=shot.id, reason=str(error).replace("\n", " "))
                break
            extra = (
                {"settings": _settings(studio, config), "versions": studio.versions}
                if first
                else {}
            )
            first = False
            if shot is chunk.shots[-1]:  # the run may count on all that it was answered
                lines.sync()
            file = record.image if isinstance(record, Record) else record.geometry
            size = (store.folder / file).stat().st_size
            answer(
                made=shot.id,
                seconds=record.seconds,
                bytes=size,
                spent=pipeline.spent,
                computed=pipeline.computed,
                notes=pipeline.notes,
                **extra,
            )
        message = sys.stdin.buffer.readline()


def _settings(studio: Studio, config: WorkerConfig) -> dict[str, Any]:
    """Return the studio's settings, and those of the estimators where the job limits the error."""
    settings = msgspec.to_builtins(studio.settings)
    if config.assignment.job.error is None:
        return settings
    from factory.render.estimators import rules
    from factory.render.settings import DENOISED, PORTION

    estimators = {s.path: {"value": s.value, "reason": s.reason} for s in (*PORTION, *DENOISED)}
    return settings | {"estimators": estimators, "rules": rules.identity()}


def _studio(config: WorkerConfig) -> Studio:
    from factory.render.blender_threads import importing_blender

    module, name = config.studio.split(":")
    with importing_blender(config.threads):
        studio = getattr(importlib.import_module(module), name)
    return studio(config.device, config.threads)


if __name__ == "__main__":
    main()
