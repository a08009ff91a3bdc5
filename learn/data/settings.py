"""Training runs read from files: presets of manifests/runs, a user's run file, metadata of weights.

The types are those of manifests.training_runs, which are passed on here.
"""

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from manifests import RUNS
from manifests.arrays import LIGHT_SHAPE
from manifests.errors import InputError, closest
from manifests.reading import decode, read_bytes
from manifests.renamed_keys import with_current_names
from manifests.training_runs import VERSION, Data, Losses, Run, Schedule, Stage

__all__ = ["Data", "Losses", "Run", "Schedule", "Stage", "decode_run", "read_run"]

T = TypeVar("T")
LIGHT = LIGHT_SHAPE[:2]  # rows and columns of a light map
# of a batch: their truth and pictures take 3 GiB, what networks keep of them ten times as much
MOST_PIXELS = 1 << 26

# The parts that each term of Losses trains. The network "encoder-decoder" has no parts and three
# terms.
TRAINED_PARTS = {
    "normals": ("normals",),
    "material": ("material",),
    "albedo": ("material",),
    "light_log": ("light",),
    "light_rendered": ("light",),
    "image": ("normals", "material", "light"),
    "target": ("normals", "light"),
    "image_features": ("normals", "material", "light"),
    "target_features": ("normals", "light"),
}
WITH_PRETRAINED_ENCODER = ("compact-pretrained", "two-encoders", "joint-encoders", "joint-wide")
ENCODER_DECODER_TERMS = ("material", "target", "target_features")


def read_run(
    name: str | Path,
    steps: int | None = None,
    seed: int | None = None,
    materials: str | None = None,
    start: Path | None = None,
) -> Run:
    """Return the Run of a file, or of the preset of that name.

    steps, seed, materials, start  replace what the run says; None leaves it
    Raises  InputError: missing, malformed, values out of range, nothing to train, a batch that no
            memory can hold
    """
    path = Path(name)
    where = path if path.suffix == ".json" else RUNS / f"{path.name}.json"
    if where is not path and not where.exists():
        presets = [preset.stem for preset in RUNS.glob("*.json")]
        raise InputError(
            f"run '{name}'", "a .json file or a preset", "neither", closest(name, presets)
        )
    run = decode_run(read_bytes(where), where)
    if steps is not None:
        run = msgspec.structs.replace(
            run, schedule=msgspec.structs.replace(run.schedule, steps=steps)
        )
    if seed is not None:
        run = msgspec.structs.replace(run, seed=seed)
    if start is not None:
        run = msgspec.structs.replace(run, start=str(start))
    run = msgspec.structs.replace(run, data=with_materials(run.data, materials))
    require_trainable(run, where)
    return run


def with_materials(data: Data, choice: str | None) -> Data:
    """Return a run's Data with the materials of an option --materials; None leaves the run's."""
    return data if choice is None else msgspec.structs.replace(data, materials=choice)


def decode_run(data: bytes, where: str | Path) -> Run:
    """Return the Run that JSON bytes hold, in the current version.

    Keys by their names of versions 1 and 2 are read unless the run says that it is of version 3. A
    run of version 1 takes the built-in materials, for it could not choose.

    data    of a run file, or of the metadata of weights and checkpoints
    where   what names their origin in an InputError
    Raises  InputError: malformed, unknown keys, wrong types, a key under both of its names
    """
    run = decode(_in_current_names(data, where), Run, where)
    if run.version == VERSION:
        return run
    settings = run.data
    if run.version == 1 and "materials" not in msgspec.json.decode(data).get("data", {}):
        settings = msgspec.structs.replace(settings, materials="built-in")
    return msgspec.structs.replace(run, version=VERSION, data=settings)


def _in_current_names(data: bytes, where: str | Path) -> bytes:
    """Return the JSON of a run with today's keys; what is no JSON object stays as it is."""
    try:
        values = msgspec.json.decode(data)
        if not isinstance(values, dict) or values.get("version") == VERSION:
            return data
        renamed = with_current_names(values, where)
        return data if renamed == values else json.dumps(renamed).encode()
    except InputError:
        raise
    except (ValueError, RecursionError):  # no JSON, or beyond measure: `decode` says what is wrong
        return data


def convert(values: Any, type_: type[T], where: str | Path, strict: bool = True) -> T:
    """Return plain values as a `type_`.

    strict  whether numbers must be numbers; otherwise texts of them are read too
    Raises  InputError
    """
    try:
        return msgspec.convert(values, type_, strict=strict)
    except msgspec.ValidationError as error:
        reason, _, path = str(error).partition(" - at `$.")
        path = path.rstrip("`")
        result = values
        for key in re.findall(r"\w+", path):
            result = result[int(key)] if isinstance(result, list | tuple) else result[key]
        place = f"{where}: {path}" if path else where
        shown = str(result)[:60] if path else "none"
        raise InputError(
            place, reason.removeprefix("Expected "), shown, "give another value"
        ) from None


def require_trainable(run: Run, where: str | Path) -> None:
    """Raise InputError for a run whose values are out of range, or that trains nothing."""
    convert(msgspec.to_builtins(run), Run, where)
    for i, stage in enumerate(run.stages):
        _require_trained_parts(
            run.network, stage.parts, stage.losses, f"{where}: stages[{i}].losses"
        )
    _require_trained_parts(run.network, run.parts, run.losses, f"{where}: losses")
    _require_data(run.data, f"{where}: data")
    if run.network in WITH_PRETRAINED_ENCODER and run.size % 32:
        raise InputError(
            f"{where}: size",
            "a multiple of 32, for this network's encoder halves pictures five times",
            str(run.size),
            "take 64, 96 or 128, or the network compact-wrapped",
        )
    pixels = run.schedule.batch * run.size**2
    if pixels > MOST_PIXELS:
        rule = f"batches of at most {MOST_PIXELS >> 20} Mi pixels"
        result = f"{run.schedule.batch} pictures of {run.size}²"
        raise InputError(
            f"{where}: schedule.batch",
            rule,
            result,
            "make batches of fewer pictures, or smaller pictures",
        )


def _require_trained_parts(network: str, parts: Sequence[str], losses: Losses, where: str) -> None:
    """Raise InputError for losses that train none of the parts, or a map that does not divide."""
    if network == "encoder-decoder":
        terms, what = list(ENCODER_DECODER_TERMS), "this network"
    else:
        terms = [name for name, trained in TRAINED_PARTS.items() if set(trained) & set(parts)]
        what = " and ".join(dict.fromkeys(parts))
    if not any(getattr(losses, name) for name in terms):
        raise InputError(
            where,
            f"a weight above 0 of a term that trains {what}",
            "none",
            f"one of {', '.join(terms)}",
        )
    if any(whole % part for whole, part in zip(LIGHT, losses.layer_light, strict=True)):
        rule = f"rows and columns that divide {LIGHT[0]} and {LIGHT[1]}"
        result = " and ".join(map(str, losses.layer_light))
        raise InputError(f"{where}.layer_light", rule, result, "take 32 and 64, or 16 and 32")


def _require_data(data: Data, where: str) -> None:
    """Raise InputError for shares of more than 1 together, or held-out lights that are used."""
    shares = [data.label_mixtures, data.scaled_lobes, data.principled]
    if sum(shares) > 1 + 1e-9:
        raise InputError(
            where,
            "label_mixtures, scaled_lobes and principled of at most 1 together",
            f"{sum(shares):g}",
            "lower one of them; the rest are training materials",
        )
    held_out = (*data.validation_lights, *data.test_lights)
    if data.all_materials_and_lights and held_out:
        raise InputError(
            where,
            "no held-out lights in a run of all materials and lights",
            ", ".join(held_out),
            "leave out validation_lights and test_lights, or all_materials_and_lights",
        )
