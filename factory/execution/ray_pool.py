"""A pool of workers on a Ray cluster, used instead of factory.execution.pool.

The unit of work is a shape's shots: they go to one worker, so that its geometry is rendered once. A
worker gets a unit in slices of about SLICE_SECONDS, which is how often progress is reported. When
no unit is left, an idle worker takes half of the largest one that another works on.

A worker or a node that is lost (Ray says so) may still be at work, behind a broken network. Each
worker holds a lock on its file of records (manifests.line_files.Lines), which ends with its
process. What was given to a lost worker is therefore given out again only once the pool itself
holds that lock, and without the shots that the file then names: nothing is lost, and nothing is
made twice.
The pool keeps the lock, so that a process that comes to life late cannot begin. This needs a folder
that all nodes share at one path, on a file system whose locks hold between machines (NFS 4, Lustre
with flock, local disks).

A shot that fails is tried once more in a new process, and then given up. A shot that was in hand
when its worker was lost is tried MOST_LOSSES times in all, because the loss is rarely its fault.
"""

import contextlib
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec

from factory.execution.assignment import ShapeSource
from factory.execution.ray_worker import RayWorker, ids_of, lines_path
from factory.execution.worker import Chunk, Reply, WorkerConfig
from factory.planning.plan import Shot
from manifests import ray_cluster
from manifests.errors import InputError
from manifests.line_files import Lines
from manifests.ray_cluster import MOST_LOSSES, MOST_LOST_IN_A_ROW, SCALE_SECONDS

SLICE_SECONDS = 2.0  # of work that a worker is given at once
MOST_SLICE = 64  # shots that it is given at once
MOST_UNIT = 4096  # shots of a shape that one worker holds; the rest is a further unit
PATIENCE = 900.0  # seconds to wait for the lock of a lost worker
STOP_PATIENCE = 20.0  # seconds that workers have to end in when the run is stopped


@dataclass
class _Worker:
    """An actor, the shots that it was given, and those that it is still to get.

    pending  shots of the slice in its hands, None before it is ready
    unit     shots of its unit that it was not given yet
    """

    actor: Any
    config: WorkerConfig
    reference: Any
    pending: list[Shot] | None = None
    unit: deque[Shot] = field(default_factory=deque)


@dataclass
class _Lost:
    """A worker that is gone, and the shots that it had in hand."""

    config: WorkerConfig
    pending: list[Shot]
    since: float


class RayPool:
    """Workers on the cluster that Ray is connected to, one for each `threads` of its CPUs.

    config   called with a worker's number, returns its WorkerConfig; no number comes twice
    shapes   {name: ShapeSource} of the shots' shapes; the caller may add to it while the pool runs
    threads  CPU threads of each worker
    note     called with lines for the user
    """

    def __init__(
        self,
        config: Callable[[int], WorkerConfig],
        shapes: Mapping[str, ShapeSource],
        threads: int,
        note: Callable[[str], Any],
    ):
        self._config, self._shapes, self._threads, self._note = config, shapes, threads, note
        self._workers: list[_Worker] = []
        self._lost: list[_Lost] = []
        self._fences: list[Lines] = []  # the files of lost workers
        self._names: list[WorkerConfig] = []
        self._units: deque[deque[Shot]] = deque()  # units that were interrupted
        self._retries: deque[Shot] = deque()  # shots for a second try, each in a new process
        self._tried: set[str] = set()
        self._losses: Counter[str] = Counter()
        self._lost_in_a_row = 0
        self._next: Shot | None = None  # the first shot of the next unit
        self._waiting, self._ended = False, False
        self._seconds = SLICE_SECONDS  # of a shot, a running mean
        self._looked = -SCALE_SECONDS

    def run(self, shots: Iterable[Shot | None]) -> Generator[tuple[Shot, Reply], None, None]:
        """Make all shots; yield (shot, Reply) for each that is made or given up.

        shots   None among them: the next one is not known yet, and is asked for again soon
        Raises  InputError or OSError where every shot would fail: a full disk, a missing file
        """
        shots = iter(shots)
        try:
            while True:
                self._scale()
                yield from self._give_out_lost_shots()
                self._give_out(shots)
                if self._is_done():
                    return
                yield from self._gather()
        finally:
            self._stop()

    def _is_done(self) -> bool:
        busy = any(worker.pending or worker.unit for worker in self._workers)
        left = busy or self._units or self._retries or self._lost or self._next is not None
        return self._ended and not left

    def _scale(self) -> None:
        """Start workers until there is one for each `threads` CPUs of the cluster."""
        import ray

        if time.monotonic() - self._looked < SCALE_SECONDS and self._workers:
            return
        self._looked = time.monotonic()
        for _ in range(ray_cluster.workers(self._threads) - len(self._workers)):
            config = self._config(len(self._names))
            try:
                first = msgspec.json.encode(config)
            except UnicodeEncodeError as error:
                remedy = "rename it, or give another --out"
                raise InputError(
                    ascii(error.object), "a name of a folder in UTF-8", "other bytes", remedy
                ) from None
            self._names.append(config)
            remote: Any = ray.remote(num_cpus=self._threads, max_restarts=0)(RayWorker)
            actor = remote.remote(first)
            self._workers.append(_Worker(actor, config, actor.ready.remote()))

    def _give_out(self, shots: Iterator[Shot | None]) -> None:
        """Give each idle worker its next slice."""
        self._waiting = False
        for worker in self._workers:
            if worker.pending is None or worker.pending:
                continue
            is_retry = bool(self._retries) and not worker.unit
            if is_retry:
                chosen = [self._retries.popleft()]
            else:
                if not worker.unit:
                    worker.unit = self._next_unit(shots) or self._half_of_another()
                count = int(min(MOST_SLICE, max(1.0, SLICE_SECONDS / max(self._seconds, 1e-3))))
                chosen = [worker.unit.popleft() for _ in range(min(count, len(worker.unit)))]
            if not chosen:
                continue
            worker.pending = chosen
            chunk = Chunk(chosen, {shot.shape: self._shapes[shot.shape] for shot in chosen})
            worker.reference = worker.actor.make.remote(msgspec.json.encode(chunk), is_retry)

    def _next_unit(self, shots: Iterator[Shot | None]) -> deque[Shot]:
        """Return an interrupted unit or a new one; empty if none is known."""
        if self._units:
            return self._units.popleft()
        unit: deque[Shot] = deque()
        while not (self._waiting or self._ended) and len(unit) < MOST_UNIT:
            shot = self._next
            self._next = None
            if shot is None:
                try:
                    shot = next(shots)
                except StopIteration:
                    self._ended = True
                    break
                if shot is None:
                    self._waiting = True
                    break
            if unit and shot.shape != unit[0].shape:
                self._next = shot
                break
            unit.append(shot)
        if not unit and self._next is not None and self._ended:
            unit.append(self._next)
            self._next = None
        return unit

    def _half_of_another(self) -> deque[Shot]:
        """Take half of the largest unit that another worker has before it."""
        if self._waiting or not self._workers:
            return deque()
        largest = max(self._workers, key=lambda worker: len(worker.unit))
        count = len(largest.unit) // 2
        return deque(reversed([largest.unit.pop() for _ in range(count)]))

    def _gather(self) -> Iterator[tuple[Shot, Reply]]:
        """Wait for workers; yield the shots that are made or given up."""
        import ray
        from ray.exceptions import RayError

        references = {
            worker.reference: worker for worker in self._workers if worker.reference is not None
        }
        if not references:
            time.sleep(0.05)
            return
        done, _ = ray.wait(list(references), num_returns=1, timeout=0.1 if self._waiting else 0.5)
        for reference in done:
            worker = references[reference]
            worker.reference = None
            try:
                answer = ray.get(reference)
            except RayError as error:
                self._lose(worker, error)
                continue
            if worker.pending is None:
                worker.pending = []
                continue
            yield from self._receive(worker, answer)

    def _receive(self, worker: _Worker, lines: list[bytes]) -> Iterator[tuple[Shot, Reply]]:
        """Handle the replies about a worker's slice."""
        pending = deque(worker.pending or ())
        worker.pending = []
        for line in lines:
            reply = msgspec.json.decode(line, type=Reply)
            if reply.fatal:
                raise InputError(*reply.problem) if reply.problem else OSError(reply.reason)
            shot = pending.popleft()
            if reply.made:
                self._lost_in_a_row = 0
                self._seconds = 0.8 * self._seconds + 0.2 * reply.seconds
                yield shot, reply
            elif shot.id in self._tried:
                yield shot, reply
            else:
                self._tried.add(shot.id)
                self._retries.append(shot)
        worker.unit.extendleft(reversed(pending))

    def _lose(self, worker: _Worker, error: Exception) -> None:
        """Remove a worker whose actor or node is gone; its unit goes to others at once."""
        import ray

        self._workers.remove(worker)
        with contextlib.suppress(Exception):  # it may be gone, or out of reach
            ray.kill(worker.actor)
        if worker.unit:
            self._units.append(worker.unit)
        pending = worker.pending or []
        self._lost.append(_Lost(worker.config, pending, time.monotonic()))
        self._lost_in_a_row += 1
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
        self._note(f"{worker.config.worker} was lost ({reason}); its work goes elsewhere")
        if self._lost_in_a_row > MOST_LOST_IN_A_ROW:
            raise OSError(f"{self._lost_in_a_row} workers in a row were lost; {reason}")
        self._looked = time.monotonic() - SCALE_SECONDS + 1.0

    def _give_out_lost_shots(self) -> Iterator[tuple[Shot, Reply]]:
        """Give the shots of lost workers out again, once their files are free.

        Those that the files name or that are given up are yielded.
        """
        for lost in list(self._lost):
            path = lines_path(lost.config)
            try:
                fence = Lines(path)
            except InputError:
                if time.monotonic() - lost.since > PATIENCE:
                    remedy = "end that process, then run the same command"
                    raise InputError(
                        path, "a lost worker that ends", "one at work", remedy
                    ) from None
                continue
            self._lost.remove(lost)
            self._fences.append(fence)
            for draft in (path.parents[1] / "partial").glob(f"{lost.config.worker}-*"):
                draft.unlink(missing_ok=True)
            there = ids_of(fence.read())
            left = deque(shot for shot in lost.pending if shot.id not in there)
            for shot in lost.pending:
                if shot.id in there:
                    self._lost_in_a_row = 0
                    yield shot, Reply(made=shot.id)
            if left:
                first = left[0]
                self._losses[first.id] += 1
                if self._losses[first.id] >= MOST_LOSSES:
                    reason = f"its worker was lost {MOST_LOSSES} times"
                    yield left.popleft(), Reply(bad=first.id, reason=reason)
                if left:
                    self._units.appendleft(left)

    def _stop(self) -> None:
        """End all actors, and wait until their processes have let go of their files."""
        import ray

        for worker in self._workers:
            with contextlib.suppress(Exception):
                ray.kill(worker.actor)
        for fence in self._fences:
            fence.close()
        end = time.monotonic() + STOP_PATIENCE
        while time.monotonic() < end:
            if all(map(_is_free, self._names)):
                break
            time.sleep(0.1)


def _is_free(config: WorkerConfig) -> bool:
    """Return whether no process holds a worker's file of records."""
    path = lines_path(config)
    if not path.exists():
        return True
    try:
        Lines(path).close()
    except InputError:
        return False
    return True
