"""The facts of a job's shapes, in the job's order, while work on the first ones has begun.

What the memory does not hold is read by processes of their own, which run as
`python -m factory.planning.reading`. Such a process reads sources, one line of JSON each, from
its standard input, and writes an answer for each. It ends when its input ends. A few sources are
read in the calling process for the first seconds, so that a small job is complete before anything
is rendered.
"""

import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress

import msgspec

from factory.planning.facts import Facts, Memory, facts_of
from factory.planning.shape_names import Source
from manifests import subprocesses
from manifests.errors import InputError

FEW = 8  # sources: more are read by other processes from the start
HERE = 2.0  # seconds of reading in this process before others are started
MOST_PROCESSES = 8  # each holds one mesh, which may take a gigabyte


class _Answer(msgspec.Struct, kw_only=True, omit_defaults=True):
    """Facts, or the parts of an InputError or an OSError, or the text of another error."""

    facts: Facts | None = None
    problem: tuple[str, str, str, str] | None = None
    system: tuple[int | None, str, str | None] | None = None
    error: str = ""


class Reading:
    """The facts of sources, each read once, in their order.

    processes  that read, 0: this process reads all of them
    memory     of earlier runs; what is read is noted in it

    Errors (InputError for a bad mesh) are raised where the facts of their source would come, so
    that the order of the job decides which of two bad meshes is named.
    """

    def __init__(self, sources: Sequence[Source], processes: int = 0, memory: Memory | None = None):
        self._sources, self._processes = sources, min(processes, MOST_PROCESSES)
        self._memory = memory or Memory(None)
        self._keys = [self._memory.key(source) for source in sources]
        self._known = [self._memory.recall(key) for key in self._keys]
        self._next = 0
        self._begun: float | None = None
        self._readers: _Readers | None = None
        self._pending: dict[int, Future[Facts]] = {}

    @property
    def unread(self) -> int:
        """Number of sources that `ready` and `each` have not yielded yet."""
        return len(self._sources) - self._next

    def ready(self) -> Iterator[tuple[Source, Facts]]:
        """Yield the next sources with their facts, as far as they are known by now.

        With few sources, the first call reads for up to HERE seconds. Raises InputError; OSError.
        """
        while self.unread and (facts := self._facts(wait=False)) is not None:
            self._next += 1
            yield self._sources[self._next - 1], facts

    def each(self) -> Iterator[tuple[Source, Facts]]:
        """Yield all sources with their facts, and wait for each. Raises as `ready`."""
        while self.unread:
            facts = self._facts(wait=True)
            assert facts is not None  # it was waited for
            self._next += 1
            yield self._sources[self._next - 1], facts

    def _facts(self, wait: bool) -> Facts | None:
        """Return the facts of the next source, None if they are not known yet."""
        number = self._next
        if (known := self._known[number]) is not None:
            return known
        if self._readers is None:
            self._begun = self._begun or time.monotonic()
            if not self._processes or (
                self._known[number:].count(None) <= FEW and time.monotonic() - self._begun < HERE
            ):
                facts = facts_of(self._sources[number])
                self._memory.note(self._keys[number], self._sources[number], facts)
                return facts
            self._start()
        future = self._pending[number]
        if not wait and not future.done():
            return None
        return self._pending.pop(number).result()

    def _start(self) -> None:
        unknown = [k for k in range(self._next, len(self._sources)) if self._known[k] is None]
        self._readers = _Readers(min(self._processes, len(unknown)))
        for number in unknown:
            self._pending[number] = self._readers.submit(self._read, number)

    def _read(self, number: int) -> Facts:
        """Have a process read a source, and note its facts; called in a thread."""
        assert self._readers is not None
        facts = self._readers.facts(self._sources[number])
        self._memory.note(self._keys[number], self._sources[number], facts)
        return facts

    def close(self) -> None:
        """End the processes and close the memory; what is being read is given up."""
        if self._readers is not None:
            self._readers.close()
        self._memory.close()


class _Readers:
    """Processes that read meshes, each with a thread of this process that waits for it."""

    def __init__(self, count: int):
        self._threads = ThreadPoolExecutor(count, thread_name_prefix="reading")
        self._own = threading.local()
        self._all: deque[subprocess.Popen[bytes]] = deque()
        self._lock, self._closed = threading.Lock(), False
        self.submit = self._threads.submit

    def facts(self, source: Source) -> Facts:
        """Return what this thread's process says of a source.

        A process that dies is replaced once. Raises InputError; OSError; RuntimeError.
        """
        try:
            line = msgspec.json.encode(source) + b"\n"
        except UnicodeEncodeError:  # a file's name that is no text cannot be sent
            return facts_of(source)
        for _ in range(2):
            process = self._process()
            assert process.stdin and process.stdout  # pipes, as requested
            with suppress(BrokenPipeError):
                process.stdin.write(line)
                process.stdin.flush()
            if (answer := process.stdout.readline()).endswith(b"\n"):
                return _facts_in(answer, source)
            status = process.wait()
            self._own.process = None
        raise InputError(
            source.place,
            "a mesh that can be read",
            f"that its reader ended by signal {-status}"
            if status < 0
            else f"that its reader ended with status {status}",
            "it may need more memory than there is: reduce the mesh",
        )

    def _process(self) -> subprocess.Popen[bytes]:
        process: subprocess.Popen[bytes] | None = getattr(self._own, "process", None)
        if process is None:
            with self._lock:
                if self._closed:
                    raise RuntimeError("the reading has been given up")
                process = subprocess.Popen(
                    subprocesses.command_of("factory.planning.reading"),
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    env=subprocesses.environment(),
                )
                self._all.append(process)
            self._own.process = process
        return process

    def close(self) -> None:
        """Kill the processes, and wait for the threads."""
        with self._lock:
            self._closed = True
        for process in self._all:
            process.kill()
        self._threads.shutdown(cancel_futures=True)
        for process in self._all:
            process.wait()
            assert process.stdin and process.stdout
            with suppress(BrokenPipeError):
                process.stdin.close()
            process.stdout.close()


def _facts_in(line: bytes, source: Source) -> Facts:
    """Return the facts of an answer. Raises the error that it tells of."""
    answer = msgspec.json.decode(line, type=_Answer)
    if answer.facts is not None:
        return answer.facts
    if answer.problem is not None:
        raise InputError(*answer.problem)
    if answer.system is not None:
        raise OSError(*answer.system)
    raise RuntimeError(f"{source.place}: {answer.error}")


def main() -> None:
    """Answer for each source until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    answers = os.fdopen(os.dup(1), "wb", buffering=0)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    sources = msgspec.json.Decoder(Source)
    for line in sys.stdin.buffer:
        try:
            answer = _Answer(facts=facts_of(sources.decode(line)))
        except InputError as problem:
            answer = _Answer(
                problem=(problem.where, problem.expected, problem.found, problem.remedy)
            )
        except OSError as error:
            answer = _Answer(system=(error.errno, error.strerror or str(error), error.filename))
        except Exception as error:
            answer = _Answer(error=f"{type(error).__name__}: {error}")
        try:
            answers.write(msgspec.json.encode(answer) + b"\n")
        except BrokenPipeError:
            return


if __name__ == "__main__":
    main()
