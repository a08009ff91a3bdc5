"""Fuzzing: damaged, extreme and hostile input for every format that is read, through the commands
that read it.

    python -m tests.fuzz --minutes 10                   every module, in turn
    python -m tests.fuzz meshes --cases 500 --seed 3    one module
    python -m tests.fuzz meshes --seed 3 --case 17      one case again: each fault is printed as
    such a line

A *generator* is any module of this package (found by itself, no list to add it to) that defines

    case(index: int, rng: numpy.random.Generator, room: Room) -> Case

Case `index` of a module depends on `index` and `rng` alone, so that any one can be made again
without the ones before it. `index` counts 0, 1, 2, … without end: use it to walk through a list of
tamperings first (`index % len(LIST)`), and `rng` for what is left to chance. `case` writes the
input files under `room.folder` and says what to run on them. A module may also have

    prepare(seeds: Path) -> None     called once a session, in its own process: valid files that
    cases start from
    MEMORY_MB: int                   bound on memory for all its cases, where the general one does
    not do

The driver makes and runs each case in a forked process of its own (torch, numpy, factory and learn
are imported already, with one thread), measures time and memory of `command` or `run` alone, and
looks for faults. The general rules, for every case:

- a traceback, or an exception that is not among `refusals`
- an exit status that is not among `statuses`; a signal
- more than 60 s, or more memory than the bound, which is 1 GiB above the warm process
- status 1 without a line that says why; a warning of a library on stderr
- a file in `room.folder` that is new, changed or gone, outside of `writes`
- a draft left behind anywhere (`*.part`, or anything in a data set's `partial/`)

`check` adds what is right in this case: its text is the fault.

Rules for those who write generators: relative imports (`from . import Case, Room`, `from . import
mutation`); no global state that one case leaves to the next; small inputs (a case should take well
under a second); copy what lies in `room.seeds`, never change it; a label that tells what was done
("faces: index 3 set to -1"), since it is what a reader of a fault sees first.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from manifests.errors import InputError

STATUSES = (0, 1, 2, 3, 130)


@dataclass(frozen=True)
class Room:
    """Where a case lives.

    folder  its own empty folder, deleted afterwards unless the case was a fault; the command runs
    in `folder/cwd`
    seeds   what the module's `prepare` wrote, shared by all cases: read-only
    """

    folder: Path
    seeds: Path


@dataclass
class Result:
    """What a case did, for `check`.

    status   exit status of a command; None for `run`
    stdout   what it printed
    stderr   what it printed there
    value    what `run` returned
    error    the refusal that `run` raised, one of `refusals`, or None
    seconds  wall time
    memory   bytes above those at the start, at most
    """

    status: int | None = None
    stdout: str = ""
    stderr: str = ""
    value: Any = None
    error: BaseException | None = None
    seconds: float = 0.0
    memory: int = 0


@dataclass(frozen=True, kw_only=True)
class Case:
    """One thing to try: a `command` line, or a function `run` of no arguments.

    label     what was done to what, in one line
    command   ["factory", "plan", "job.json"]: the program and its arguments, as after `python -m`
    run       what to call instead: its result is `Result.value`
    check     a function of the Result: None if it is right, else what is wrong in one line. It is
    called where the
              general rules found no fault, in the same process, with the files still there
    writes    names in `room.folder` that may be written, made or deleted; "out" is the usual --out
    statuses  exit statuses that are right here; of those a program may have at all
    refusals  exceptions by which `run` may refuse its input (ValueError and TypeError for the
    layer's functions) memory_mb bound for this case alone; None: the module's or the general one
    before    called first in the case's process, where something must be replaced, as Blender by a
    fake studio
    fresh     as `python -m …` in a new interpreter: slower (seconds), sees exit-time and signal
    behaviour
    """

    label: str
    command: list[str] | None = None
    run: Callable[[], Any] | None = None
    check: Callable[[Result], str | None] | None = None
    writes: tuple[str, ...] = ("out",)
    statuses: tuple[int, ...] = STATUSES
    refusals: tuple[type[BaseException], ...] = (InputError,)
    memory_mb: int | None = None
    before: Callable[[], None] | None = None
    fresh: bool = False
    environment: dict[str, str] = field(default_factory=dict)

    def __post_init__(self):
        if (self.command is None) == (self.run is None):
            raise ValueError(f"{self.label}: a case has either a command or a function to run")


@dataclass(frozen=True)
class Outcome:
    """What the driver says of one case: `fault` is None where all is right, else its kind and
    reason.
    """

    module: str
    index: int
    label: str
    fault: str | None
    status: int | None
    seconds: float
    memory: int
