"""Workers at work: chunks of shots handed out, answers gathered, the dead replaced. Nothing here
knows what a shot looks like.

A bad shot is tried once more in a fresh worker, and then given up. A worker that dies takes the
first shot it had not finished with it as suspect; the rest of its chunk goes to another. A worker
is judged by what it made: how its process ends is nobody's concern.
"""

import contextlib
import os
import selectors
import subprocess
import sys
import time
from collections import deque
from itertools import islice

import msgspec

from factory.execution.worker import STUDIO, Chunk, Reply, WorkerConfig
from manifests.errors import InputError

# shots handed out at once: long enough that nobody waits, short enough that all end together
CHUNK = 32
BARREN = 8  # deaths with no picture in between after which the machine is to blame, not the shots
# seconds of silence before a worker counts as hung, or 50 times the longest shot so far
PATIENCE = 600.0


def _line(message):
    """A message as a line of JSON. Raises InputError where a name of a file or folder in it is no
    text.
    """
    try:
        return msgspec.json.encode(message) + b"\n"
    except UnicodeEncodeError as error:
        remedy = "rename it, or give another --out"
        raise InputError(
            ascii(error.object), "a name of a file or a folder in UTF-8", "other bytes", remedy
        ) from None


class _Worker:
    """A process and what it still owes."""

    def __init__(self, config, descriptors, log):
        self.config, self.log = config, log
        first = _line(config)  # before there is a process that would have to be ended
        self.made, self.failed, self.owed, self.heard = 0, 0, deque(), time.monotonic()
        with open(log, "wb") as complaints:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "factory.execution.worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=complaints,
                pass_fds=descriptors,
                env={**os.environ, "PYTHONUNBUFFERED": "1"},
            )
        self._rest = b""
        self._send(first)

    def hand(self, shots):
        """Give it shots to make."""
        self.owed.extend(shots)
        self.heard = time.monotonic()
        self._send(_line(Chunk(list(shots))))

    def _send(self, line):
        try:
            self.process.stdin.write(line)
            self.process.stdin.flush()
        except BrokenPipeError:
            pass  # it has died: its output ends, and that is where the dead are noticed

    def replies(self):
        """Replies that have come, or None if it has died."""
        data = os.read(self.process.stdout.fileno(), 1 << 20)
        if not data:
            return None
        self.heard = time.monotonic()
        *whole, self._rest = (self._rest + data).split(b"\n")
        return [msgspec.json.decode(line, type=Reply) for line in whole]

    def end(self, patience=10.0):
        """Let it finish and go; kill it if it will not."""
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()
        try:
            self.process.wait(patience)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()
        self.log.unlink(missing_ok=True)

    def last_words(self):
        """How it ended, with the last line it complained."""
        status = self.process.wait()
        how = f"ended by signal {-status}" if status < 0 else f"ended with status {status}"
        with open(self.log, "rb") as log:
            words = log.read()[-2000:].decode(errors="replace").strip().splitlines()
        return f"the worker {how}" + (f": {words[-1][:200]}" if words else "")


class Pool:
    """`count` workers over a stream of shots.

    setup        called with a worker's number: its Setup
    descriptors  the run's locks, handed on
    folder       where workers' complaints are kept while they live
    """

    def __init__(self, count, config, descriptors, folder):
        self._setup, self._descriptors, self._folder = config, tuple(descriptors), folder
        self._folder.mkdir(parents=True, exist_ok=True)
        self._count, self._workers = count, {}
        self._selector = selectors.DefaultSelector()
        self._again = deque()  # shots whose chunk was cut short
        self._suspects = deque()  # shots for a second try in a fresh worker
        self._tried, self._longest, self._barren = set(), 0.0, 0

    def run(self, shots):
        """Make all shots; yields (shot, Reply) for each that is made or given up.

        Raises  InputError or OSError for what no shot would survive: a full disk, a missing file
        """
        shots = iter(shots)
        try:
            while self._give_out(shots):
                yield from self._gather()
        finally:
            for number in list(self._workers):
                self._drop(number)

    def _give_out(self, shots):
        """Hand chunks to the idle; False when nothing is owed and nothing is left."""
        for number in range(self._count):
            worker = self._workers.get(number)
            if worker is not None and worker.owed:
                continue
            chunk = self._chunk(shots, worker)
            if chunk and worker is not None and chunk[0].id in self._tried and worker.made:
                self._drop(number)
                worker = None
            if chunk:
                worker = worker or self._start(number)
                worker.hand(chunk)
        return any(worker.owed for worker in self._workers.values())

    def _chunk(self, shots, worker):
        if self._suspects:
            return [self._suspects.popleft()]
        chunk = [self._again.popleft() for _ in range(min(CHUNK, len(self._again)))]
        return chunk or list(islice(shots, CHUNK))

    def _start(self, number):
        worker = _Worker(
            self._setup(number),
            self._descriptors,
            self._folder / f"{self._setup(number).worker}.log",
        )
        self._workers[number] = worker
        self._selector.register(worker.process.stdout, selectors.EVENT_READ, number)
        return worker

    def _drop(self, number):
        worker = self._workers.pop(number)
        self._selector.unregister(worker.process.stdout)
        if worker.owed:
            worker.process.kill()
        worker.end()

    def _gather(self):
        """Wait for answers; yields what they settle."""
        for key, _ in self._selector.select(timeout=5.0):
            number = key.data
            worker = self._workers[number]
            replies = worker.replies()
            if replies is None:
                yield from self._buried(number, worker.last_words())
                continue
            for reply in replies:
                if reply.fatal:
                    raise InputError(*reply.problem) if reply.problem else OSError(reply.reason)
                yield from self._settled(number, worker, reply)
        for number, worker in list(self._workers.items()):
            if worker.owed and time.monotonic() - worker.heard > max(PATIENCE, 50 * self._longest):
                worker.process.kill()
                yield from self._buried(
                    number, f"the worker said nothing for {time.monotonic() - worker.heard:.0f} s"
                )

    def _settled(self, number, worker, reply):
        shot = worker.owed.popleft()
        if reply.made:
            worker.made, self._barren = worker.made + 1, 0
            self._longest = max(self._longest, reply.seconds)
            yield shot, reply
            return
        rest = list(worker.owed)
        worker.owed.clear()
        self._again.extendleft(reversed(rest))
        # a fresh worker that has failed before and made nothing: the fault is in the shots
        if worker.failed and not worker.made:
            self._tried.add(shot.id)
        worker.failed += 1
        yield from self._judged(shot, reply.reason)
        if shot.id in (s.id for s in self._suspects):
            self._drop(number)

    def _buried(self, number, reason):
        """A worker has died: another takes its place when there is work."""
        owed = list(self._workers[number].owed)
        self._workers[number].owed.clear()
        self._drop(number)
        self._again.extendleft(reversed(owed[1:]))
        self._barren += 1
        if self._barren > BARREN:
            raise OSError(f"{self._barren} workers in a row made nothing; {reason}")
        if owed:
            yield from self._judged(owed[0], reason)

    def _judged(self, shot, reason):
        """A second try for a shot, or its end."""
        if shot.id not in self._tried:
            self._tried.add(shot.id)
            self._suspects.append(shot)
            return
        yield shot, Reply(bad=shot.id, reason=reason)


def config_for_worker(folder, worker, device, threads, assignment, studio=STUDIO):
    """The Setup of a worker of this process."""
    return WorkerConfig(
        folder=str(folder),
        worker=worker,
        device=device,
        threads=threads,
        studio=studio,
        assignment=assignment,
    )
