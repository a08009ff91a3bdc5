"""Runs fuzzing cases, each in a forked process of its own, and says which of them are faults.

The parent imports torch, numpy, factory and learn once, with one thread, and never calls them. A
child makes its case (`case(index, rng, room)`), runs it with its output in files, applies the
general rules and the case's `check`, and writes its verdict to `verdict.json`. The parent watches
time and memory from outside, so that a child that hangs or fills memory is seen and ended; a child
that dies without a verdict is a fault, too.

    WORK/MODULE-INDEX/room/       what the case sees; the command runs in room/cwd
    WORK/MODULE-INDEX/home, tmp   its HOME and TMPDIR, which must be empty afterwards
    WORK/MODULE-INDEX/stdout, stderr, verdict.json
"""

import contextlib
import gc
import hashlib
import importlib
import json
import os
import re
import resource
import selectors
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
import traceback
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import ModuleType

import numpy as np

from . import Case, Outcome, Result, Room

ROOT = Path(__file__).resolve().parents[2]
PAGE = resource.getpagesize()
FRESH_MB = 600  # what an interpreter that imports torch, scipy and matplotlib takes by itself
POLL = 0.02  # seconds between looks at a child's memory: at 3 GB/s that is 60 MB past the bound
# a data set's locks stay: they are held, not deleted (manifests/lock.py)
LOCKS = re.compile(r"\.lock[\w-]*")
TERMINAL = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")  # progress bars move the cursor
PROGRESS = re.compile(r"\d+%\||\[\d+:\d+<|\d+(\.\d+)?(it|\w+)/s\]|: \d+\w+ \[\d+:\d+")
WARNING = re.compile(r"\b\w*Warning: ")


@dataclass(frozen=True)
class Limits:
    """Seconds and MiB beyond which a case is a fault. Memory counts above that of the warm
    process; `making` is for the generator, before the case begins.
    """

    seconds: float = 60.0
    memory_mb: int = 1024
    making: float = 60.0


# ----------------------------------------------------------------------------------------------
# what there is to run


def generator_names() -> list[str]:
    """Names of the generators of this package: the modules that define `case`. None is imported."""
    sources = {
        path.stem: path.read_text(encoding="utf-8")
        for path in sorted(Path(__file__).parent.glob("*.py"))
    }
    return [name for name, text in sources.items() if "\ndef case(" in text]


def generators(names: list[str] | None = None) -> dict[str, ModuleType]:
    """{name: module} of all generators, or of those named. Raises ValueError for an unknown
    name.
    """
    known = generator_names()
    result = {
        name: importlib.import_module(f".{name}", __package__)
        for name in known
        if not names or name in names
    }
    if unknown := set(names or ()) - set(result):
        raise ValueError(f"unknown generators: {', '.join(sorted(unknown))}")
    return result


def warm_up() -> None:
    """Import what the commands import, so that a forked child needs milliseconds. Blender is left
    out.
    """
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    os.environ.setdefault("MPLBACKEND", "agg")
    # a case's HOME is empty
    cache = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    os.environ.setdefault("BRDFACTORY_CACHE", str(Path(cache) / "brdfactory"))
    # else it is made in TMPDIR
    os.environ.setdefault("TORCHINDUCTOR_CACHE_DIR", str(Path(cache) / "torchinductor"))
    import PIL.Image
    import torch
    import tqdm

    torch.set_num_threads(1)
    tqdm.tqdm.monitor_interval = 0  # its thread would not live in the children
    PIL.Image.init()
    for name in ("matplotlib.figure", "torch._dynamo"):  # figures; what optimisers import
        importlib.import_module(name)
    for package in ("manifests", "shaders", "factory", "learn"):
        # not pkgutil.walk_packages, which imports every package, the one inside Blender among them
        for path in sorted((ROOT / package).rglob("*.py")):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
            last = name.split(".")[-1]
            needs_blender = name.startswith(("factory.render", "factory.blender_extension"))
            if needs_blender or last == "__main__" or "triton" in last:
                continue
            with contextlib.suppress(ImportError):  # an extra that is not installed
                importlib.import_module(name)
    gc.collect()
    gc.freeze()  # the collector of a child would touch, and so copy, every page of these objects


def generator_of_numbers(module: str, seed: int, index: int) -> np.random.Generator:
    """The random numbers of one case: they depend on nothing else."""
    key = (zlib.crc32(module.encode()), index)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


# ------------------------------------------------------------------------------------------------
# in the child


def _child(place: Path, make, limits: Limits) -> None:
    """Make a case, run it and write the verdict; ends the process."""
    status = 1
    try:
        _settle(place)
        verdict = _verdict(place, make, limits)
        _write(place / "verdict.json", verdict)
        status = 0
    except BaseException:
        _write(
            place / "verdict.json", {"fault": "the fuzzer itself failed\n" + traceback.format_exc()}
        )
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)


def _settle(place: Path) -> None:
    """Own process group, output, HOME, TMPDIR and folder."""
    os.setsid()
    for name, descriptor, flags in (
        (os.devnull, 0, os.O_RDONLY),
        (place / "stdout", 1, os.O_WRONLY | os.O_CREAT | os.O_TRUNC),
        (place / "stderr", 2, os.O_WRONLY | os.O_CREAT | os.O_TRUNC),
    ):
        opened = os.open(name, flags, 0o644)
        os.dup2(opened, descriptor)
        os.close(opened)
    sys.stdin, sys.stdout = open(0, closefd=False), open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", closefd=False, errors="backslashreplace")  # noqa: SIM115
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for name in ("home", "tmp", "room/cwd"):
        (place / name).mkdir(parents=True, exist_ok=True)
    os.environ |= {"HOME": str(place / "home"), "TMPDIR": str(place / "tmp"), "COLUMNS": "200"}
    tempfile.tempdir = str(place / "tmp")
    os.chdir(place / "room" / "cwd")


def _verdict(place: Path, make, limits: Limits) -> dict:
    case: Case = make()
    os.environ.update(case.environment)
    if case.before:
        case.before()
    bound = case.memory_mb or limits.memory_mb
    shown = case.command and [
        part if isinstance(part, str) else repr(part) for part in case.command
    ]
    report = {"label": case.label, "command": shown, "bound_mb": bound}
    before = _listing(place / "room")
    gc.collect()
    baseline = _reset_peak()
    _write(place / "started.json", {**report, "baseline": baseline + (FRESH_MB << 20) * case.fresh})
    started = time.monotonic()
    result, fault = _fresh(case) if case.fresh else _called(case)
    result.seconds = time.monotonic() - started
    result.memory = _peak(case, baseline)
    _write(place / "ended.json", {"status": result.status, "seconds": result.seconds})
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(Exception):
            stream.flush()
    result.stdout, result.stderr = (_text(place / name) for name in ("stdout", "stderr"))
    fault = fault or _broken_rule(case, result, before, place, bound, limits)
    if fault is None and case.check is not None:
        wrong = case.check(result)
        fault = None if wrong is None else f"wrong result: {wrong}"
    return {
        **report,
        "fault": fault,
        "status": result.status,
        "seconds": result.seconds,
        "memory": result.memory,
    }


def _called(case: Case) -> tuple[Result, str | None]:
    """Call the command's main function, or the case's own, here."""
    result = Result()
    try:
        if case.command is None:
            result.value = case.run()
        else:
            result.status = run_command(*case.command)
    except SystemExit as end:
        result.status = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except case.refusals as error:
        if case.command is not None:
            return result, _trace(error)
        result.error = error
    except BaseException as error:
        return result, _trace(error)
    return result, None


def run_command(program: str, *arguments: str) -> int:
    """The exit status of `python -m PROGRAM ARGUMENTS`, run here."""
    module = importlib.import_module(f"{program}.__main__")
    if hasattr(module, "keep_freed"):  # what the program does before it begins
        module.keep_freed()
    sys.argv = [f"{program}/__main__.py", *arguments]
    return module.main(program, module.__doc__, module.COMMANDS, list(arguments))


def _fresh(case: Case) -> tuple[Result, str | None]:
    """The command in an interpreter of its own."""
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    }
    done = subprocess.run(
        [sys.executable, "-m", *case.command],
        env=environment,
        stdin=subprocess.DEVNULL,
        check=False,
    )
    fault = f"ended by signal {-done.returncode}" if done.returncode < 0 else None
    return Result(status=done.returncode), fault


def _trace(error: BaseException) -> str:
    text = "".join(traceback.format_exception(error))
    print(text, file=sys.stderr)
    return f"traceback: {_signature(error)}"


def _signature(error: BaseException) -> str:
    """The exception and the innermost line of the project that it passed through."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [
        f for f in frames if Path(f.filename).is_relative_to(ROOT) and "/tests/" not in f.filename
    ]
    place = (
        f"{Path(ours[-1].filename).relative_to(ROOT)}:{ours[-1].lineno}"
        if ours
        else "outside of the project"
    )
    first = (str(error).splitlines() or [""])[0]
    return f"{type(error).__name__} at {place}: {first[:160]}"


def _broken_rule(
    case: Case, result: Result, before: dict, place: Path, bound: int, limits: Limits
) -> str | None:
    """The first of the general rules that is broken, or None."""
    if "Traceback (most recent call last)" in result.stderr:
        last = [
            line
            for line in result.stderr.splitlines()
            if re.match(r"\w[\w.]*(Error|Exception|InputError)\b", line)
        ]
        return f"traceback: {last[-1][:200] if last else 'on stderr'}"
    if case.command is not None and result.status not in case.statuses:
        return f"exit status {result.status}"
    if result.memory > bound << 20:
        return f"memory: {result.memory >> 20} MiB, bound {bound}"
    if result.seconds > limits.seconds:
        return f"time: {result.seconds:.0f} s"
    lines = (line.strip() for line in re.split(r"[\r\n]+", TERMINAL.sub("", result.stderr)))
    # a bar begins there; digits by the thousand take minutes
    said = [line for line in lines if line and not PROGRESS.search(line[:200])]
    if warned := [line for line in said if WARNING.search(line)]:
        return f"warning: {warned[0][:200]}"
    if case.command is not None and result.status == 1:
        if said and not said[-1].startswith(f"{case.command[0]}: ") and not result.stdout.strip():
            return f"status 1 with a last line that is no message: {said[-1][:200]}"
        if not said and not result.stdout.strip():
            return "status 1 without a word"
    return _litter(case, before, place)


def _litter(case: Case, before: dict, place: Path) -> str | None:
    """What the case left, changed or took away where it should not have."""
    room = place / "room"
    for path in _walk(place / "room"):
        name = path.relative_to(room).as_posix()
        if name in before:
            continue
        if path.name.endswith(".part") or path.parent.name == "partial" or _hidden(path):
            return f"draft left behind: {name}"
    after = _listing(room)
    for name in sorted(before.keys() | after.keys()):
        if name == "cwd" or any(
            name == each or name.startswith(f"{each}/") for each in case.writes
        ):
            continue
        if name not in after:
            return f"deleted: {name}"
        if name not in before:
            return f"written outside of the output: {name}"
        if before[name] != after[name]:
            return f"input changed: {name}"
    for folder in ("home", "tmp"):
        if left := sorted(os.listdir(place / folder)):
            return f"left in {'HOME' if folder == 'home' else 'TMPDIR'}: {left[0]}"
    return None


def _hidden(path: Path) -> bool:
    return path.name.startswith(".") and not LOCKS.fullmatch(path.name)


def _listing(folder: Path) -> dict[str, str]:
    """{path: what lies there}; contents of files by hash."""
    return {path.relative_to(folder).as_posix(): _content(path) for path in _walk(folder)}


def _walk(folder: Path) -> Iterator[Path]:
    """Everything below a folder, links not followed."""
    with contextlib.suppress(PermissionError), os.scandir(folder) as entries:
        for entry in sorted(entries, key=lambda e: e.name):
            yield Path(entry.path)
            if entry.is_dir(follow_symlinks=False):
                yield from _walk(Path(entry.path))


def _content(path: Path) -> str:
    status = os.lstat(path)
    if stat.S_ISLNK(status.st_mode):
        return f"link {os.readlink(path)}"
    if not stat.S_ISREG(status.st_mode):
        return f"kind {stat.S_IFMT(status.st_mode)}"
    if status.st_size > 16 << 20:  # a sparse giant: its size and time will do
        return f"file {status.st_size} {status.st_mtime_ns}"
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha1").hexdigest()


def _reset_peak() -> int:
    """Bytes of memory now, from which the peak counts on."""
    with contextlib.suppress(OSError), open("/proc/self/clear_refs", "w") as file:
        file.write("5")
    return _status("VmRSS")


def _peak(case: Case, baseline: int) -> int:
    """Bytes above the baseline; of the largest process where the case has started some."""
    others = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss << 10
    if case.fresh:
        return max(0, others - (FRESH_MB << 20))
    return max(0, _status("VmHWM") - baseline)


def _status(key: str) -> int:
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) << 10 for line in file if line.startswith(key))


def _text(path: Path) -> str:
    with open(path, "rb") as file:
        return file.read(1 << 20).decode(errors="replace")


def _write(path: Path, value: dict) -> None:
    draft = path.with_suffix(".draft")
    draft.write_text(json.dumps(value))
    os.replace(draft, path)


# ------------------------------------------------------------------------------------------------
# in the parent


class Running:
    """A child at work on one case."""

    def __init__(self, module: str, index: int, place: Path, make, limits: Limits):
        self.module, self.index, self.place, self.limits = module, index, place, limits
        place.mkdir(parents=True)
        self.begun, self.started, self.report, self.fault = time.monotonic(), None, {}, None
        self.pid = os.fork()
        if self.pid == 0:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            _child(place, make, limits)
        self.descriptor = os.pidfd_open(self.pid)

    def watch(self) -> None:
        """End the child if it has passed a limit."""
        if self.started is None and (report := _read(self.place / "started.json")):
            self.started, self.report = time.monotonic(), report
        if self.started is None:
            if time.monotonic() - self.begun > self.limits.making:
                self._end(f"the generator took more than {self.limits.making:g} s")
            return
        if time.monotonic() - self.started > self.limits.seconds + 1:
            self._end(f"time: more than {self.limits.seconds:g} s")
        bound = self.report["bound_mb"]
        if (used := _tree_memory(self.pid) - self.report["baseline"]) > bound << 20 and not (
            self.place / "ended.json"
        ).exists():
            self._end(f"memory: more than {used >> 20} MiB, bound {bound}")

    def _end(self, fault: str) -> None:
        if self.fault is None:
            self.fault = fault
            self._stop()

    def _stop(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGKILL)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, signal.SIGKILL)

    def outcome(self) -> Outcome:
        """The verdict; call it when the child has ended."""
        _, status = os.waitpid(self.pid, 0)
        os.close(self.descriptor)
        self._stop()  # what it may have started
        verdict = _read(self.place / "verdict.json")
        if verdict is None or self.fault:
            report = _read(self.place / "started.json") or {"label": "(before the case was made)"}
            how = (
                f"ended by signal {os.WTERMSIG(status)}"
                if os.WIFSIGNALED(status)
                else "ended without a verdict"
            )
            verdict = {**report, "fault": self.fault or how}
        seconds = verdict.get("seconds") or time.monotonic() - (self.started or self.begun)
        label, fault = verdict.get("label", "?"), verdict["fault"]
        return Outcome(
            self.module,
            self.index,
            label,
            fault,
            verdict.get("status"),
            seconds,
            verdict.get("memory", 0),
        )


def _read(path: Path) -> dict | None:
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        return None


def _tree_memory(pid: int) -> int:
    """Resident bytes of a process and its descendants."""
    total = 0
    try:
        total += int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE
        for task in os.listdir(f"/proc/{pid}/task"):
            for child in Path(f"/proc/{pid}/task/{task}/children").read_text().split():
                total += _tree_memory(int(child))
    except (OSError, IndexError):  # it has ended meanwhile
        pass
    return total


class Driver:
    """Cases of some generators, several at a time.

    kept      folder in which the files of faults are kept
    keep_all  keep those of every case
    """

    def __init__(
        self, result: dict[str, ModuleType], seed: int, kept: Path, limits: Limits, jobs: int = 2
    ):
        self.found, self.seed, self.kept, self.jobs = result, seed, kept, jobs
        self.limits = {
            name: replace(limits, memory_mb=max(limits.memory_mb, getattr(module, "MEMORY_MB", 0)))
            for name, module in result.items()
        }
        self.work = kept / f"work-{os.getpid()}"
        self.selector = selectors.DefaultSelector()
        self.keep_all = False

    def __enter__(self):
        self.work.mkdir(parents=True)
        return self

    def __exit__(self, *_):
        for key in list(self.selector.get_map().values()):
            key.data._stop()
            os.waitpid(key.data.pid, 0)
        self.selector.close()
        _remove(self.work)

    def prepare(self) -> None:
        """Let each generator write its seeds. Raises RuntimeError with the reason if one cannot."""
        for name, module in self.found.items():
            seeds = self.work / "seeds" / name
            seeds.mkdir(parents=True)
            if not hasattr(module, "prepare"):
                continue
            place = self.work / "prepare" / name

            def make(module=module, seeds=seeds):
                return Case(label="prepare", run=lambda: module.prepare(seeds), writes=("cwd",))

            running = Running(name, -1, place, make, Limits(300.0, 8192))
            while os.waitid(os.P_PID, running.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
                time.sleep(0.005)
            outcome = running.outcome()
            if outcome.fault:
                raise RuntimeError(
                    f"{name} could not prepare: {outcome.fault}\n{_text(place / 'stderr')[-2000:]}"
                )
        self.seeds = _listing(self.work / "seeds")

    def changed_seeds(self) -> list[str]:
        """Names of seeds that some case has changed: later cases then depend on earlier ones, which
        is a fault of its generator.
        """
        after = _listing(self.work / "seeds")
        return sorted(
            name
            for name in self.seeds.keys() | after.keys()
            if self.seeds.get(name) != after.get(name)
        )

    def run(self, order: Iterator[tuple[str, int]]) -> Iterator[Outcome]:
        """The outcome of each (module, index), as they end."""
        order, over = iter(order), False
        while True:
            while not over and len(self.selector.get_map()) < self.jobs:
                following = next(order, None)
                if following is None:
                    over = True
                else:
                    self._start(*following)
            if not self.selector.get_map():
                return
            for key, _ in self.selector.select(timeout=POLL):
                self.selector.unregister(key.fileobj)
                outcome = key.data.outcome()
                self._put_away(key.data, outcome)
                yield outcome
            for key in list(self.selector.get_map().values()):
                key.data.watch()

    def _start(self, name: str, index: int) -> None:
        module, place = self.found[name], self.work / f"{name}-{index}"
        room = Room(place / "room", self.work / "seeds" / name)

        def make():
            return module.case(index, generator_of_numbers(name, self.seed, index), room)

        running = Running(name, index, place, make, self.limits[name])
        self.selector.register(running.descriptor, selectors.EVENT_READ, running)

    def _put_away(self, running: Running, outcome: Outcome) -> None:
        if outcome.fault is None and not self.keep_all:
            _remove(running.place)
            return
        target = self.kept / f"{outcome.module}-{self.seed}-{outcome.index}"
        _remove(target)
        verdict = {
            **(
                _read(running.place / "verdict.json") or _read(running.place / "started.json") or {}
            ),
            **asdict(outcome),
        }
        (running.place / "fault.json").write_text(json.dumps(verdict, indent=1))
        os.replace(running.place, target)


def _remove(folder: Path) -> None:
    """Delete a folder whatever a case did to its permissions."""

    def allow(function, path, _):
        with contextlib.suppress(OSError):
            os.chmod(os.path.dirname(path), 0o700)
            os.chmod(path, 0o700)
            function(path)

    if os.path.lexists(folder):
        shutil.rmtree(folder, onerror=allow)
