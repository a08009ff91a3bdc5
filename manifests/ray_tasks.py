"""Independent pieces of work on a Ray cluster, whose results one process writes.

The process that asks is the only one that writes results, and it hears of a piece through the
worker that has it in hand, once. What a lost worker had in hand is given to another one; what the
lost one may still do, behind a broken network, is never read. Nothing is therefore lost, and
nothing is written twice. (Renderers write files themselves, and need factory.execution.ray_pool.)

Messages are JSON. A worker is an actor of Ray that runs the pieces in its own process.
"""

from __future__ import annotations

import contextlib
import importlib
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from manifests import ray_cluster
from manifests.errors import InputError
from manifests.object_store import is_url
from manifests.ray_cluster import MOST_LOSSES, MOST_LOST_IN_A_ROW, SCALE_SECONDS

Work = Callable[[bytes], bytes]  # a piece of work as JSON → its result as JSON


class _Answer(msgspec.Struct, omit_defaults=True):
    """A result; or the parts of an InputError, or the text of another error."""

    result: msgspec.Raw = msgspec.Raw(b"null")
    problem: tuple[str, str, str, str] | None = None
    error: str = ""


class Worker:
    """The actor.

    maker     "module:function" of this program, which is called with the settings and returns a
              Work. It is called once, in the actor, so that what is loaded serves all pieces
    settings  JSON
    """

    def __init__(self, maker: str, settings: bytes):
        self._maker, self._settings = maker, settings
        self._work: Work | None = None

    def ready(self) -> bytes:
        """Load what the work needs; return an answer without a result."""
        return _answer_of(self._load)

    def do(self, piece: bytes) -> bytes:
        """Return the answer to a piece of work."""
        assert self._work is not None  # no piece comes before the answer to `ready`
        work = self._work
        return _answer_of(lambda: work(piece))

    def _load(self) -> bytes:
        module, _, name = self._maker.partition(":")
        self._work = getattr(importlib.import_module(module), name)(self._settings)
        return b"null"


def _answer_of(work: Callable[[], bytes]) -> bytes:
    """Return what `work` returns or raises, as the JSON of an _Answer."""
    import traceback

    try:
        answer = _Answer(result=msgspec.Raw(work()))
    except InputError as problem:
        parts = (str(problem.where), problem.expected, problem.found, problem.remedy)
        answer = _Answer(problem=parts)
    except Exception:
        answer = _Answer(error=traceback.format_exc())
    return msgspec.json.encode(answer)


def unpack_answer(answer: bytes) -> bytes:
    """Return the result of an answer. Raises InputError or RuntimeError as the worker did."""
    decoded = msgspec.json.decode(answer, type=_Answer)
    if decoded.problem is not None:
        raise InputError(*decoded.problem)
    if decoded.error:
        raise RuntimeError(f"on a worker of the Ray cluster:\n{decoded.error}")
    return bytes(decoded.result)


@dataclass
class _Hand:
    """An actor, and the number of the piece in its hands: None before it is ready."""

    actor: Any
    reference: Any
    piece: int | None = None


class Tasks:
    """Pieces of work for the cluster that Ray is connected to (manifests.ray_cluster).

    maker, settings  of each Worker
    threads          CPUs of each Worker
    note             called with lines for the user
    """

    def __init__(
        self, maker: str, settings: bytes, threads: int = 1, note: Callable[[str], Any] = print
    ):
        self._maker, self._settings, self._threads, self._note = maker, settings, threads, note
        self._hands: list[_Hand] = []
        self._idle: list[Any] = []  # actors without a piece
        self._left: deque[int] = deque()
        self._losses: Counter[int] = Counter()
        self._lost_in_a_row = 0
        self._looked = -SCALE_SECONDS

    def results(self, pieces: Sequence[bytes]) -> Generator[tuple[int, bytes], None, None]:
        """Yield (number of a piece, its result) as they are finished, each once.

        Raises  InputError or RuntimeError if a piece fails; OSError if workers are lost again and
                again. What was yielded before is the caller's
        """
        self._left = deque(range(len(pieces)))
        try:
            while self._left or any(hand.piece is not None for hand in self._hands):
                self._scale()
                self._give_out(pieces)
                yield from self._gather()
        finally:
            self._stop()

    def _scale(self) -> None:
        """Start workers until there is one for each `threads` CPUs, or for each piece left."""
        if time.monotonic() - self._looked < SCALE_SECONDS and (self._hands or self._idle):
            return
        self._looked = time.monotonic()
        there = len(self._hands) + len(self._idle)
        in_hand = sum(hand.piece is not None for hand in self._hands)
        target = min(ray_cluster.workers(self._threads), len(self._left) + in_hand)
        for _ in range(target - there):
            actor = self._start_worker()
            self._hands.append(_Hand(actor, actor.ready.remote()))

    def _start_worker(self) -> Any:
        """Return a new actor."""
        import ray

        remote: Any = ray.remote(num_cpus=self._threads, max_restarts=0)(Worker)
        return remote.remote(self._maker, self._settings)

    def _give_out(self, pieces: Sequence[bytes]) -> None:
        """Give each idle worker a piece."""
        while self._idle and self._left:
            actor, piece = self._idle.pop(), self._left.popleft()
            self._hands.append(_Hand(actor, actor.do.remote(pieces[piece]), piece))

    def _gather(self) -> Generator[tuple[int, bytes], None, None]:
        """Wait for a worker; yield what is finished."""
        for hand in self._finished_workers():
            self._hands.remove(hand)
            answer = self._answer(hand)
            if isinstance(answer, Exception):
                self._lose(hand, answer)
                continue
            result = unpack_answer(answer)
            self._idle.append(hand.actor)
            if hand.piece is not None:
                self._lost_in_a_row = 0
                yield hand.piece, result

    def _finished_workers(self) -> list[_Hand]:
        """Return workers that have answered or were lost; none after a short wait."""
        import ray

        of = {hand.reference: hand for hand in self._hands}
        done, _ = ray.wait(list(of), num_returns=1, timeout=0.5) if of else ([], [])
        return [of[reference] for reference in done]

    def _answer(self, hand: _Hand) -> bytes | Exception:
        """Return a worker's answer, or by which error Ray says that it or its node is gone."""
        import ray
        from ray.exceptions import RayError

        try:
            answer: bytes = ray.get(hand.reference)
        except RayError as error:
            return error
        return answer

    def _lose(self, hand: _Hand, error: Exception) -> None:
        """Let others have the piece of a worker that is gone."""
        self._end(hand.actor)
        self._lost_in_a_row += 1
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
        if self._lost_in_a_row > MOST_LOST_IN_A_ROW:
            raise OSError(f"{self._lost_in_a_row} workers in a row were lost; {reason}")
        self._looked = time.monotonic() - SCALE_SECONDS + 1.0
        if hand.piece is None:
            self._note(f"a worker was lost before it began ({reason})")
            return
        self._losses[hand.piece] += 1
        if self._losses[hand.piece] >= MOST_LOSSES:
            raise OSError(f"a piece of work lost its worker {MOST_LOSSES} times; {reason}")
        self._note(f"a worker was lost ({reason}); its work goes elsewhere")
        self._left.appendleft(hand.piece)

    def _end(self, actor: Any) -> None:
        """End an actor, which may be gone or out of reach."""
        import ray

        with contextlib.suppress(Exception):
            ray.kill(actor)

    def _stop(self) -> None:
        """End all actors."""
        for actor in [*self._idle, *(hand.actor for hand in self._hands)]:
            self._end(actor)
        self._idle, self._hands = [], []


def results(
    address: str, maker: str, settings: Any, pieces: Sequence[Any]
) -> Generator[tuple[int, bytes], None, None]:
    """Yield what Tasks.results does, of a cluster, with workers of one thread.

    address   as of ray_cluster.connected
    settings  and pieces: what JSON can hold, or a msgspec.Struct, a dataclass or a Path
    """
    encoded = msgspec.json.Encoder(enc_hook=_absolute).encode
    tasks = Tasks(maker, encoded(settings), note=lambda line: print(line, file=sys.stderr))
    with (
        ray_cluster.connected(address),
        contextlib.closing(tasks.results([encoded(piece) for piece in pieces])) as yielded,
    ):
        yield from yielded


def _absolute(value: object) -> str:
    """Return a path as text: workers have other working folders."""
    if isinstance(value, Path):
        return str(value if is_url(value) else value.absolute())
    raise NotImplementedError(f"JSON of {type(value)}")
