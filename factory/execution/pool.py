"""A pool of worker processes: it hands out chunks of shots, gathers replies and replaces workers.

A shot that fails is tried once more in a new worker, and then given up. Where a worker dies, the
first shot that it had not finished is suspected of having killed it and is tried once more; the
rest of its chunk goes to another worker. Only a worker's replies count: how its process ends does
not matter.
"""

import contextlib
import os
import selectors
import subprocess
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path

import msgspec

from factory.execution.assignment import ShapeSource
from factory.execution.worker import Chunk, Reply, WorkerConfig
from factory.planning.plan import Shot
from manifests import subprocesses
from manifests.errors import InputError

# shots handed out at once: enough that no worker waits, few enough that all end at the same time
CHUNK = 32
# deaths without a picture in between, after which the machine is at fault and not the shots
MOST_DEATHS = 8
# seconds of silence after which a worker counts as hung; 50 times the longest shot, if that is more
PATIENCE = 600.0
SOON = 0.05  # seconds after which the pool asks again for shots that were not known yet


def _line(message: WorkerConfig | Chunk) -> bytes:
    """Return a message as a line of JSON. Raises InputError for a file name that is not UTF-8."""
    try:
        return msgspec.json.encode(message) + b"\n"
    except UnicodeEncodeError as error:
        remedy = "rename it, or give another --out"
        raise InputError(
            ascii(error.object), "a name of a file or a folder in UTF-8", "other bytes", remedy
        ) from None


class _Worker:
    """A process, and the shots that it has not finished.

    made, failed  numbers of its shots
    pending       shots that it was given and has not replied to
    heard         time.monotonic of its last sign of life
    """

    def __init__(self, config: WorkerConfig, descriptors: Sequence[int], log: Path):
        self.log = log
        first = _line(config)  # may raise, so before the process is started
        self.made, self.failed, self.heard = 0, 0, time.monotonic()
        self.pending: deque[Shot] = deque()
        with open(log, "wb") as errors:
            self.process = subprocess.Popen(
                subprocesses.command_of("factory.execution.worker"),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                pass_fds=descriptors,
                env={**subprocesses.environment(), "PYTHONUNBUFFERED": "1"},
            )
        assert self.process.stdin and self.process.stdout  # pipes, as requested
        self._input, self.output = self.process.stdin, self.process.stdout
        self._rest = b""
        self._send(first)

    def assign(self, chunk: Chunk) -> None:
        """Send shots to be made."""
        self.pending.extend(chunk.shots)
        self.heard = time.monotonic()
        self._send(_line(chunk))

    def _send(self, line: bytes) -> None:
        # a worker that has died is noticed where its output ends
        with contextlib.suppress(BrokenPipeError):
            self._input.write(line)
            self._input.flush()

    def replies(self) -> list[Reply] | None:
        """Return the replies that have arrived, or None if the worker has died."""
        data = os.read(self.output.fileno(), 1 << 20)
        if not data:
            return None
        self.heard = time.monotonic()
        *whole, self._rest = (self._rest + data).split(b"\n")
        return [msgspec.json.decode(line, type=Reply) for line in whole]

    def end(self, patience: float = 10.0) -> None:
        """Let the worker end by itself; kill it after `patience` seconds."""
        with contextlib.suppress(BrokenPipeError):
            self._input.close()
        try:
            self.process.wait(patience)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.output.close()
        self.log.unlink(missing_ok=True)

    def reason_of_death(self) -> str:
        """Return how the process ended, with the last line of its standard error."""
        status = self.process.wait()
        how = f"ended by signal {-status}" if status < 0 else f"ended with status {status}"
        with open(self.log, "rb") as log:
            words = log.read()[-2000:].decode(errors="replace").strip().splitlines()
        return f"the worker {how}" + (f": {words[-1][:200]}" if words else "")


class Pool:
    """`count` workers that make a stream of shots.

    config       called with a worker's number, returns its WorkerConfig
    descriptors  the run's locks, which workers hold too
    folder       where the standard error of running workers is written
    shapes       {name: ShapeSource} of the shots' shapes; the caller may add to it while the pool
                 runs
    """

    def __init__(
        self,
        count: int,
        config: Callable[[int], WorkerConfig],
        descriptors: Iterable[int],
        folder: Path,
        shapes: Mapping[str, ShapeSource],
    ):
        self._shapes, self._waiting = shapes, False
        self._config, self._descriptors, self._folder = config, tuple(descriptors), folder
        self._folder.mkdir(parents=True, exist_ok=True)
        self._count = count
        self._workers: dict[int, _Worker] = {}
        self._selector = selectors.DefaultSelector()
        self._interrupted: deque[Shot] = deque()  # shots whose chunk was cut short
        self._suspects: deque[Shot] = deque()  # shots for a second try in a new worker
        self._tried: set[str] = set()  # ids of shots that have failed once
        # seconds of the longest shot; deaths since the last picture
        self._longest, self._deaths = 0.0, 0

    def run(self, shots: Iterable[Shot | None]) -> Generator[tuple[Shot, Reply], None, None]:
        """Make all shots; yield (shot, Reply) for each that is made or given up.

        shots   None among them: the next one is not known yet, and is asked for again soon
        Raises  InputError or OSError where every shot would fail: a full disk, a missing file
        """
        shots = iter(shots)
        try:
            while self._give_out(shots):
                yield from self._gather()
        finally:
            for number in list(self._workers):
                self._drop(number)

    def _give_out(self, shots: Iterator[Shot | None]) -> bool:
        """Send chunks to idle workers; return whether any shot is pending or expected."""
        self._waiting = False
        for number in range(self._count):
            worker = self._workers.get(number)
            if worker is not None and worker.pending:
                continue
            chunk = self._chunk(shots)
            if self._waiting and worker is None and not chunk:
                self._start(number)  # it takes seconds, so that the shots may be known by then
            if chunk and worker is not None and chunk[0].id in self._tried and worker.made:
                self._drop(number)
                worker = None
            if chunk:
                worker = worker or self._start(number)
                worker.assign(
                    Chunk(chunk, {shot.shape: self._shapes[shot.shape] for shot in chunk})
                )
        return self._waiting or any(worker.pending for worker in self._workers.values())

    def _chunk(self, shots: Iterator[Shot | None]) -> list[Shot]:
        """Return the next shots to be made: a suspect alone, else interrupted or new ones."""
        if self._suspects:
            return [self._suspects.popleft()]
        if self._interrupted:
            return [self._interrupted.popleft() for _ in range(min(CHUNK, len(self._interrupted)))]
        chunk: list[Shot] = []
        for shot in islice(shots, 0 if self._waiting else CHUNK):
            if shot is None:
                self._waiting = True
                break
            chunk.append(shot)
        return chunk

    def _start(self, number: int) -> _Worker:
        config = self._config(number)
        worker = _Worker(config, self._descriptors, self._folder / f"{config.worker}.log")
        self._workers[number] = worker
        self._selector.register(worker.output, selectors.EVENT_READ, number)
        return worker

    def _drop(self, number: int) -> None:
        """End a worker and remove its drafts; one with pending shots is killed."""
        worker = self._workers.pop(number)
        self._selector.unregister(worker.output)
        if worker.pending:
            worker.process.kill()
        worker.end()
        # what it was writing when it was killed; on a slow disk there nearly always is something
        for draft in self._folder.glob(f"{worker.log.stem}-*"):
            draft.unlink(missing_ok=True)

    def _gather(self) -> Iterator[tuple[Shot, Reply]]:
        """Wait for replies; yield the shots that are made or given up."""
        for key, _ in self._selector.select(timeout=SOON if self._waiting else 5.0):
            number = key.data
            worker = self._workers[number]
            replies = worker.replies()
            if replies is None:
                yield from self._replace_worker(number, worker.reason_of_death())
                continue
            for reply in replies:
                if reply.fatal:
                    raise InputError(*reply.problem) if reply.problem else OSError(reply.reason)
                yield from self._receive(number, worker, reply)
        for number, worker in list(self._workers.items()):
            silence = time.monotonic() - worker.heard
            if worker.pending and silence > max(PATIENCE, 50 * self._longest):
                worker.process.kill()
                yield from self._replace_worker(
                    number, f"the worker sent nothing for {silence:.0f} s"
                )

    def _receive(self, number: int, worker: _Worker, reply: Reply) -> Iterator[tuple[Shot, Reply]]:
        """Handle a reply about a worker's first pending shot."""
        shot = worker.pending.popleft()
        if reply.made:
            worker.made, self._deaths = worker.made + 1, 0
            self._longest = max(self._longest, reply.seconds)
            yield shot, reply
            return
        rest = list(worker.pending)
        worker.pending.clear()
        self._interrupted.extendleft(reversed(rest))
        # a new worker that has failed before and made nothing: the fault is in the shots
        if worker.failed and not worker.made:
            self._tried.add(shot.id)
        worker.failed += 1
        yield from self._suspect_or_give_up(shot, reply.reason)
        if shot.id in (s.id for s in self._suspects):
            self._drop(number)

    def _replace_worker(self, number: int, reason: str) -> Iterator[tuple[Shot, Reply]]:
        """Remove a worker that has died; another is started when there is work."""
        pending = list(self._workers[number].pending)
        self._workers[number].pending.clear()
        self._drop(number)
        self._interrupted.extendleft(reversed(pending[1:]))
        self._deaths += 1
        if self._deaths > MOST_DEATHS:
            raise OSError(f"{self._deaths} workers in a row made nothing; {reason}")
        if pending:
            yield from self._suspect_or_give_up(pending[0], reason)

    def _suspect_or_give_up(self, shot: Shot, reason: str) -> Iterator[tuple[Shot, Reply]]:
        """Queue a shot for a second try, or yield it as given up after that."""
        if shot.id not in self._tried:
            self._tried.add(shot.id)
            self._suspects.append(shot)
            return
        yield shot, Reply(bad=shot.id, reason=reason)
