"""A data set with one thing wrong in it, through each command that reads data sets.

What is wrong: a value, key or line of its JSON; a file's bytes, values, size or place; something
else where a file should be. Where `verify` calls the folder clean, everything in it must load;
after `verify --repair` it must be clean.
"""

import contextlib
import hashlib
import io
import json
import shutil
from pathlib import Path

import numpy as np

from . import Case, Result, Room, commands, files, mutation, seeds

MEMORY_MB = 1024
WITHIN = ("out", "data-preview", "cwd/data-preview", "data/.lock")
TRAINING = (*WITHIN, "data/packed", "views/packed")

READERS = {  # command line: what it may write
    "factory status {data}": WITHIN,
    "factory status {data} --json": WITHIN,
    "factory verify {data}": WITHIN,
    "factory verify {data} --quick": WITHIN,
    "factory verify {data} {views}": ("data/.lock", "views/.lock"),
    "factory verify {data} --repair": ("data",),
    "factory preview {data} --count 2 --size 16 --out {out}": WITHIN,
    "factory preview {data} --count 2 --size 16 --material brass --tier direct": WITHIN,
    "factory export {data} --to tars --out {out} --each 5": WITHIN,
    "factory export {data} --to records --out {out}.parquet": ("out.parquet",),
    "factory render {seeds}/job.json --out {data}": ("data",),
    "learn agree {data} --limit 2 --out {out}": WITHIN,
    "learn predict {data} --weights {seeds}/weights.safetensors --out {out}": WITHIN,
    "learn edit {data} --material red-fabric " + commands.QUICK_EDIT: WITHIN,
    "learn train {seeds}/run.json --data {data} --steps 1 --workers 0 --out {out}": TRAINING,
    "learn train {seeds}/run.json --data {data} --steps 1 --workers 0 --skip-bad --out {out}": (
        TRAINING
    ),
    "learn train {seeds}/pictures.json --data {views} --pictures {data}"
    " --steps 1 --workers 0 --out {out}": TRAINING,
    "learn.experiments exposure --data {data} --out {out}": WITHIN,
}
RARE = ("learn edit", "factory render", "learn agree")


def prepare(folder: Path) -> None:
    """The shared seeds."""
    seeds.shared(folder)


def case(index: int, rng: np.random.Generator, room: Room) -> Case:
    """A data set of pictures or of geometry alone, damaged, and a command that reads it."""
    data = room.folder / "data"
    kind = mutation.pick(rng, ("data", "data", "data", "views"))
    shutil.copytree(seeds.of(room) / kind, data)
    template = list(READERS)[index % len(READERS)]
    if template.startswith(RARE) and rng.random() < 0.7:
        template = mutation.pick(rng, list(READERS)[:6])
    label = damaged(data, rng)
    words = commands.line(template, room, data=data)
    return Case(
        label=f"{kind}: {label}",
        command=words,
        check=lambda result: wrong(template, data, room, result),
        writes=READERS[template],
        before=replacing(template),
    )


def replacing(template: str):
    """What stands in for slow parts of a command."""
    if template.startswith("factory render"):
        return seeds.fake_studio
    return commands.draw_small if template.startswith("learn edit") else None


# ------------------------------------------------------------------------------------------------
# damage


def damaged(data: Path, rng: np.random.Generator) -> str:
    """Do one thing to a data set; returns what."""
    hows = (
        _json,
        _json,
        _json,
        _line,
        _line,
        _line,
        _line,
        _lines,
        _content,
        _content,
        _consistent,
        _consistent,
    )
    how = mutation.pick(rng, (*hows, _instead, _stray, _packed, _failures))
    return how(data, rng)


def _json(data, rng):
    path = data / mutation.pick(rng, ("dataset.json", "dataset.json", "materials.json"))
    text, label = mutation.some_json(path.read_bytes(), rng)
    path.write_bytes(text)
    return f"{path.name}: {label}"


def lines_of(data: Path) -> Path:
    """The file of records, or of views."""
    return next(iter([*(data / "records").glob("*.jsonl"), *(data / "views").glob("*.jsonl")]))


def _line(data, rng):
    path = lines_of(data)
    lines = path.read_bytes().splitlines()
    k = int(rng.integers(len(lines)))
    record, label = mutation.some_value(json.loads(lines[k]), rng)
    lines[k] = json.dumps(record).encode()
    path.write_bytes(b"\n".join(lines) + b"\n")
    return f"record {k + 1}: {label}"


def _lines(data, rng):
    path = lines_of(data)
    text, label = (mutation.some_text if rng.random() < 0.7 else mutation.some_bytes)(
        path.read_bytes(), rng
    )
    path.write_bytes(text)
    return f"{path.name}: {label}"


def some_file(data: Path, rng: np.random.Generator) -> Path:
    """A picture, a geometry file, or a light's map."""
    kind = mutation.pick(rng, ("images", "geometry", "geometry", "lights"))
    result = sorted(path for path in (data / kind).rglob("*") if path.is_file())
    return (
        mutation.pick(rng, result)
        if result
        else mutation.pick(rng, sorted((data / "geometry").rglob("*.exr")))
    )


def _content(data, rng):
    """A file damaged; its hash in the records stays."""
    path = some_file(data, rng)
    content, label = files.mutated(path.read_bytes(), path.suffix, rng)
    path.write_bytes(content)
    return f"{path.parent.parent.name if path.suffix == '.exr' else 'lights'}: {label}"


def _consistent(data, rng):
    """A file with other values, and its hash rewritten wherever it stands: what only a look inside
    can find.
    """
    path = some_file(data, rng)
    before = hashlib.sha256(path.read_bytes()).hexdigest()
    content, label = files.MUTATIONS[path.suffix](path.read_bytes(), rng)
    path.write_bytes(content)
    after = hashlib.sha256(content).hexdigest()
    for each in (data / "dataset.json", lines_of(data)):
        each.write_text(each.read_text().replace(before, after))
    return f"{path.suffix} with its hash rewritten: {label}"


def _instead(data, rng):
    """Something else where a file or a folder should be."""
    places = (some_file(data, rng), lines_of(data), data / "dataset.json", data / "materials.json")
    places += (
        data / "geometry",
        data / "lights",
        lines_of(data).parent,
        data / ".lock",
        data / "partial",
    )
    path = mutation.pick(rng, places)
    return f"{path.relative_to(data)} {mutation.put_instead(path, rng)}"


def _stray(data, rng):
    """A file that no program of ours writes."""
    names = (
        "images/zz/stray.exr",
        "records/worker-99.jsonl",
        "partial/x.part",
        "geometry/.x",
        "é\n.json",
    )
    name = mutation.pick(rng, (*names, "failures-x.jsonl"))
    path = data / name
    path.parent.mkdir(parents=True, exist_ok=True)
    if rng.random() < 0.5:
        return f"{name!r} {mutation.put_instead(path, rng)}"
    path.write_bytes(
        mutation.pick(
            rng, (b"", b"x", b"\n", b"{}\n", b"\xff\xfe\n", b"null\n", lines_of(data).read_bytes())
        )
    )
    return f"{name!r} added"


def _packed(data, rng):
    """The cache that training keeps beside the records, damaged."""
    folder = data / "packed"
    folder.mkdir()
    name = mutation.pick(
        rng,
        ("views.json", "skipped.json", "sums.json", "pictures.json", "normals.npy", "segments.npy"),
    )
    if name.endswith(".json"):
        hashes = [
            json.loads(line)["geometry_hash"] for line in lines_of(data).read_bytes().splitlines()
        ]
        value = mutation.pick(
            rng,
            (
                sorted(set(hashes)),
                {h: "bad" for h in hashes},
                [],
                {},
                None,
                1,
                "x",
                [[1]],
                {"a": {}},
            ),
        )
        (folder / name).write_text(json.dumps(value))
        return f"packed/{name}: {str(value)[:30]}"
    _fresh_cache(data, rng)
    path = folder / name
    if rng.random() < 0.3:
        return f"packed/{name} {mutation.put_instead(path, rng)}"
    array, label = mutation.some_array(np.load(path), rng)
    path.write_bytes(
        mutation.npy(array)
        if rng.random() < 0.7
        else mutation.some_bytes(path.read_bytes(), rng)[0]
    )
    return f"packed/{name}: {label}"


def _fresh_cache(data, rng):
    """The cache as training writes it: made from what lies in the folder."""
    from learn.data.geometry import Geometry

    Geometry(data, progress=False)


def _failures(data, rng):
    """failures.jsonl with odd lines."""
    failure = {
        "id": "0" * 24,
        "shape": "cube",
        "materials": ["brass"],
        "light": "light",
        "viewpoint": 0,
        "tier": "direct",
    }
    failure |= {"reason": "no", "when": "2026-01-01T00:00:00+00:00"}
    value, label = mutation.some_value(failure, rng)
    text = json.dumps(value) + mutation.pick(rng, ("\n", "", "\n\n", "\nnull\n", "\n{\n"))
    (data / "failures.jsonl").write_bytes(text.encode("utf-8", "replace"))
    return f"failures.jsonl: {label}"


# ------------------------------------------------------------------------------------------------
# properties


def wrong(template: str, data: Path, room: Room, result: Result) -> str | None:
    """What is not as it should be after a command that ended well."""
    if template.startswith("factory verify {data}") and result.status == 0:
        if "--repair" in template:
            return not_mended(data, room)
        return None if "--quick" in template else unloadable(data)
    return files.unreadable(room.folder / "out", result)


def not_mended(data: Path, room: Room) -> str | None:
    """What --repair and a second run of the same job leave wrong, if the folder's job can be run at
    all.
    """
    kind = "data" if (data / "records").is_dir() else "views"
    seeds.fake_studio()
    if (
        status_of(
            ["factory", "render", str(seeds.of(room) / f"job-of-{kind}.json"), "--out", str(data)]
        )
        != 0
    ):
        return None
    return (
        None
        if status_of(["factory", "verify", str(data)]) == 0
        else "not clean after --repair and another run of the job"
    )


def unloadable(data: Path) -> str | None:
    """What of a folder that is called clean cannot be learned from."""
    from learn.data.records import Records
    from manifests.errors import InputError

    try:
        records = Records(data)
        for sample in (records.load(record) for record in records.records):
            if not all(
                t.isfinite().all() for t in (sample.image, sample.n, sample.label, sample.light)
            ):
                return f"clean, yet record {sample.record.id} is not finite"
        for view in records.store.views():
            records.geometry(view)
    except InputError as problem:
        return f"clean, yet: {problem}"
    return None


def status_of(command: list[str]) -> int:
    """The exit status of a command run here, its output dropped."""
    from . import driver

    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return driver.run_command(*command)
