"""Make data sets from Python: load a job, and render it into a folder."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from brdfactory import arguments
from manifests import outputs
from manifests.errors import InputError
from manifests.object_store import is_url

if TYPE_CHECKING:
    from manifests.schema import Job


def load_job(job: "str | Path | Mapping[str, Any] | Job") -> "Job":
    """Return the Job of a preset's name, a JSON file or a dict of a job's keys.

    Raises InputError for unknown keys, and for values of another type or out of range, as NaN is.
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

    loaded, folder = _job_and_folder(job)
    rule, remedy = "a whole number, 1 or more", "2 suits two cores"
    workers = arguments.require_whole("generate: workers", workers, rule, remedy)
    if workers < 1:
        raise InputError("generate: workers", rule, f"{workers}", remedy)
    if limit is not None:
        rule, remedy = "a whole number, 0 or more, or None", "None makes all"
        limit = arguments.require_whole("generate: limit", limit, rule, remedy)
        if limit < 0:
            raise InputError("generate: limit", rule, f"{limit}", remedy)
    library = None
    if lights is not None:
        rule, remedy = "a folder of light maps, or None", "check the path"
        library = arguments.require_path("generate: lights", lights, rule, remedy)
    if ray is not None:
        rule = "a cluster's address, auto, or None"
        ray = arguments.require_path("generate: ray", ray, rule, "None renders on this machine")
    target = arguments.require_path("generate: out", out, "a folder", "'my-data' is one")
    if not is_url(target):
        outputs.try_folder(target)
    plan = make_plan(loaded, resolve_unread(loaded, folder, library))
    options = RunOptions(workers=workers, limit=limit, library=library, ray=ray)
    if progress:
        with Progress(limit, "picture" if loaded.pictures else "view") as bar:
            outcome = carry_out(plan, target, options, bar)
    else:
        outcome = carry_out(plan, target, options)
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
        return decode(_json_of(msgspec.structs.asdict(job)), Job, "job"), None
    if isinstance(job, Mapping):
        return decode(_json_of(job), Job, "job"), None
    rule = "a preset's name, a file, a dict of a job's keys, or a bf.Job"
    return jobs.load(arguments.require_path("job", job, rule, "'demo' is a preset"))


def _json_of(job: Mapping[str, Any]) -> bytes:
    """Return a job's keys as JSON, in which there is no NaN. Raises InputError for other values."""
    for key, value in job.items():
        try:
            json.dumps({key: value}, allow_nan=False, default=_as_json)
        except (ValueError, TypeError, RecursionError) as error:
            if isinstance(error, InputError):
                raise
            rule, remedy = "numbers, texts, lists and dicts", "write it as in a job file"
            result = str(error).partition(":")[0]
            where = f"job: {key}" if isinstance(key, str) else "job"
            raise InputError(where, f"{rule}, as JSON has them", result, remedy) from None
    return json.dumps(dict(job), allow_nan=False, default=_as_json).encode()


def _as_json(value: object) -> object:
    """Return a path, a number of NumPy or a part of a Job as JSON has it.

    Raises InputError for anything else.
    """
    import msgspec
    import numpy as np

    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, msgspec.Struct):
        return msgspec.structs.asdict(value)
    if isinstance(value, set | frozenset):
        return sorted(value, key=str)
    rule, remedy = "texts, numbers, lists and dicts", "write it as in a job file"
    raise InputError("job", rule, type(value).__name__, remedy)
