"""What runs on a node of a Ray cluster: an actor that holds one worker process and feeds it.

Messages are the worker's own (factory.execution.worker), as JSON. The actor adds nothing to them
but what it alone can see: how its process died, and whether the shot that was in hand then had been
recorded already.
"""

import contextlib
import os
import subprocess
import tempfile
from pathlib import Path

import msgspec

from factory.execution.worker import PARENT, Chunk, Reply, WorkerConfig
from manifests import subprocesses


class RayWorker:
    """The actor. Its process is started by the first chunk, and again after it has died.

    config  a WorkerConfig as JSON
    """

    def __init__(self, config: bytes):
        self._first = config
        self._config = msgspec.json.decode(config, type=WorkerConfig)
        self._process: subprocess.Popen | None = None
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 (as long as the actor lives)

    def ready(self) -> bool:
        """Return True, once Ray has given this actor its CPUs."""
        return True

    def make(self, chunk: bytes, is_retry: bool = False) -> list[bytes]:
        """Make the shots of a Chunk, given as JSON; return a Reply, as JSON, for each.

        A shot that fails ends the chunk, and so does the death of the process: the last reply is
        then about the shot that was in hand, and the others have none.

        is_retry  start a new process first
        """
        shots = msgspec.json.decode(chunk, type=Chunk).shots
        if is_retry:
            self._end()
        process = self._running()
        assert process.stdin and process.stdout  # pipes, as requested
        with contextlib.suppress(BrokenPipeError):  # noticed where its output ends
            process.stdin.write(chunk + b"\n")
            process.stdin.flush()
        replies: list[bytes] = []
        for shot in shots:
            line = process.stdout.readline()
            if not line.endswith(b"\n"):
                replies.append(msgspec.json.encode(self._after_death(shot.id)))
                break
            replies.append(line)
            reply = msgspec.json.decode(line, type=Reply)
            if reply.bad or reply.fatal:
                break
        return replies

    def _running(self) -> subprocess.Popen:
        """Return the process, a new one if there is none."""
        if self._process is None:
            self._errors.seek(0)
            self._errors.truncate()
            self._process = subprocess.Popen(
                subprocesses.command_of("factory.execution.worker"),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                env={
                    **subprocesses.environment(),
                    "PYTHONUNBUFFERED": "1",
                    PARENT: str(os.getpid()),
                },
            )
            assert self._process.stdin
            with contextlib.suppress(BrokenPipeError):
                self._process.stdin.write(self._first + b"\n")
        return self._process

    def _after_death(self, shot: str) -> Reply:
        """Return the Reply about the shot in hand when the process died."""
        assert self._process is not None
        status = self._process.wait()
        assert self._process.stdin and self._process.stdout
        with contextlib.suppress(BrokenPipeError):  # what it did not read
            self._process.stdin.close()
        self._process.stdout.close()
        self._process, how = None, f"by signal {-status}" if status < 0 else f"status {status}"
        self._errors.seek(0)
        words = self._errors.read()[-2000:].decode(errors="replace").strip().splitlines()
        path = lines_path(self._config)
        if path.exists() and shot in ids_of(path.read_bytes()):
            return Reply(made=shot)
        end = f": {words[-1][:200]}" if words else ""
        return Reply(bad=shot, reason=f"the worker ended: {how}{end}")

    def _end(self) -> None:
        """Let the process end after what it has in hand."""
        if self._process is not None:
            assert self._process.stdin and self._process.stdout
            with contextlib.suppress(BrokenPipeError):
                self._process.stdin.close()
            self._process.wait()
            self._process.stdout.close()
            self._process = None


def lines_path(config: WorkerConfig) -> Path:
    """Return the file to which a worker of that configuration appends its records or views."""
    kind = "records" if config.assignment.job.pictures else "views"
    return Path(config.folder) / kind / f"{config.worker}.jsonl"


class _Id(msgspec.Struct):
    id: str


def ids_of(data: bytes) -> set[str]:
    """Return the ids of the whole lines of a file of records or views."""
    decoder = msgspec.json.Decoder(_Id)
    return {decoder.decode(line).id for line in data.split(b"\n")[:-1]}
