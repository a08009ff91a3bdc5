"""A worker: one process, one Blender, many shots. Started by factory.execution.pool as `python -m
factory.execution.worker`.

It reads messages, a JSON line each, from its standard input, and answers on what was its standard
output; Blender's own prints go nowhere, its complaints to standard error. It ends when its input or
its reader ends, after the shot in hand (it holds the run's lock, so nobody else begins meanwhile),
and by os._exit: some Blenders crash while they clean up.

in   Setup, then any number of Chunk
out  Reply: `made` or `bad` a shot (a bad one ends the chunk), or `fatal`: what no other shot would
survive
"""

import importlib
import os
import signal
import sys

import msgspec

from factory.execution.pipeline import Assignment, BadShot, Pipeline
from factory.planning.plan import Shot
from manifests.errors import InputError
from manifests.materials import load_catalogue
from manifests.store import Lines, Store

STUDIO = "factory.render.studio:Studio"


class WorkerConfig(msgspec.Struct, frozen=True, kw_only=True):
    """Where to write, under which name, and with what; studio: module:class of the studio, called
    with (device, threads).
    """

    folder: str
    worker: str
    device: str
    threads: int | None
    studio: str
    assignment: Assignment


class Chunk(msgspec.Struct, frozen=True):
    """Shots to make, in this order."""

    shots: list[Shot]


class Reply(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """made, bad: a shot's id; settings and versions come with the first picture.

    bytes: what the picture, or the geometry alone, takes on disk; spent: seconds by kind; notes:
    what the user should know.
    """

    made: str = ""
    bad: str = ""
    fatal: bool = False
    problem: tuple[str, str, str, str] | None = None
    reason: str = ""
    seconds: float = 0.0
    bytes: int = 0
    spent: dict[str, float] | None = None
    notes: list[str] = []
    settings: dict | None = None
    versions: dict[str, str] | None = None


def main():
    """Serve until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, who decides
    answers = os.fdopen(os.dup(1), "wb", buffering=0)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)

    def answer(**reply):
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
    except Exception as error:  # whatever else it is, the parent says it in one line
        answer(fatal=True, reason=f"worker {type(error).__name__}: {error}".replace("\n", " "))
    sys.stderr.flush()
    os._exit(0)


def _serve(config, answer):
    store = Store(config.folder)
    pictures = config.assignment.job.pictures
    lines = Lines(store.folder / ("records" if pictures else "views") / f"{config.worker}.jsonl")
    mixtures = (
        {name: m.mixture for name, m in load_catalogue(store.folder / "materials.json").items()}
        if pictures
        else {}
    )
    studio = _studio(config)
    pipeline = Pipeline(studio, config.assignment, store, config.worker, lines.append, mixtures)
    first = True
    chunks = msgspec.json.Decoder(Chunk)
    for message in sys.stdin.buffer:
        for shot in chunks.decode(message).shots:
            try:
                record = pipeline.make(shot)
            except OSError:
                raise
            except (BadShot, InputError, RuntimeError, ValueError) as error:
                answer(bad=shot.id, reason=str(error).replace("\n", " "))
                break
            extra = (
                {"settings": msgspec.to_builtins(studio.settings), "versions": studio.versions}
                if first
                else {}
            )
            first = False
            size = (store.folder / (record.image if pictures else record.geometry)).stat().st_size
            answer(
                made=shot.id,
                seconds=record.seconds,
                bytes=size,
                spent=pipeline.spent,
                notes=pipeline.notes,
                **extra,
            )


def _studio(config):
    module, name = config.studio.split(":")
    return getattr(importlib.import_module(module), name)(config.device, config.threads)


if __name__ == "__main__":
    main()
