"""Make data sets from Python: load a job, and render it into a folder."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from manifests.errors import InputError

if TYPE_CHECKING:
    from manifests.schema import Job


def load_job(job: "str | Path | Mapping[str, Any] | Job") -> "Job":
    """Return the Job of a preset's name, a JSON file or a dict of a job's keys.

    A Job is returned as it is. Raises InputError for unknown keys and values out of range.
    """
    return _job_and_folder(job)[0]


def generate(
    job: "str | Path | Mapping[str, Any] | Job",
    out: str | Path,
    *,
    workers: int = 1,
    limit: int | None = None,
    lights: str | Path | None = None,
    ray: str | None = None,
    progress: bool = True,
) -> dict[str, int]:
    """Render a job into the data set's folder `out`.

    Pictures that the folder already has are not rendered again, so calling this again continues a
    job that was stopped.

    job       as `load_job` takes it
    workers   number of processes
    limit     the largest number of pictures to make in this call; None: all
    lights    a folder of your own light maps, or None
    ray       address of a Ray cluster to render on instead of with `workers`; "auto": the cluster
              that this machine belongs to, or a new one here; None: processes of this machine
    progress  whether to show a progress bar
    Returns   numbers of pictures: {"made", "already_there", "failed"}
    Raises    InputError; OSError, for example a full disk; what was written before is intact
    """
    from factory.commands.render import Progress
    from factory.execution.run import RunOptions, carry_out, make_plan
    from factory.planning.assets import resolve_unread

    if workers < 1:
        raise InputError("generate: workers", "1 or more", f"{workers}", "2 suits two cores")
    if limit is not None and limit < 0:
        raise InputError("generate: limit", "0 or more, or None", f"{limit}", "None makes all")
    loaded, folder = _job_and_folder(job)
    library = None if lights is None else str(lights)
    plan = make_plan(loaded, resolve_unread(loaded, folder, library))
    options = RunOptions(workers=workers, limit=limit, library=library, ray=ray)
    if progress:
        with Progress(limit, "picture" if loaded.pictures else "view") as bar:
            outcome = carry_out(plan, out, options, bar)
    else:
        outcome = carry_out(plan, out, options)
    return {
        "made": outcome.made,
        "already_there": outcome.already_there,
        "failed": outcome.failed,
    }


def _job_and_folder(
    job: "str | Path | Mapping[str, Any] | Job",
) -> "tuple[Job, str | Path | None]":
    import msgspec

    from factory.planning import jobs
    from manifests.reading import decode
    from manifests.schema import Job

    if isinstance(job, Job):
        return job, None
    if isinstance(job, Mapping):
        return decode(msgspec.json.encode(dict(job), enc_hook=_as_json), Job, "job"), None
    return jobs.load(str(job))


def _as_json(value: object) -> object:
    """Return a path or a number of NumPy as JSON has it. Raises InputError for anything else."""
    import numpy as np

    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    rule, remedy = "texts, numbers, lists and dicts", "write it as in a job file"
    raise InputError("job", rule, type(value).__name__, remedy)
