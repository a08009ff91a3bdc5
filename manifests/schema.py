"""The contract on disk as types: what a job asks for, what a record says, what a dataset is.

Written and read by msgspec (manifests.reading): unknown keys and wrong types are refused with the
key's path, and the JSON Schema in manifests/json-schema comes from these types. Angles are degrees
here, as in every file, and the key says so. Paths are relative to the dataset's folder and stay
inside it.
"""

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

VERSION = 1

Tier = Literal["direct", "shadow", "full"]
LightResolution = Literal["64x128", "full"]
Pixel = Literal["square", "centre"]
Side = Literal["train", "test"]
# mixed: shape and materials stand on different sides; neither for training nor for testing
Split = Literal["train", "test", "mixed"]
Counts = Literal["hash", "paper", "multi-material", "general"]
Role = Literal["pretrain", "finetune", "train", "test"]

Count = Annotated[int, Meta(ge=1, le=1_000_000)]
Pixels = Annotated[int, Meta(ge=4, le=8192)]
Viewpoint = Annotated[int, Meta(ge=0, le=23)]
Texels = Annotated[int, Meta(ge=0, le=127)]
Samples = Annotated[int, Meta(ge=1, le=1_048_576)]
Seed = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Name = Annotated[str, Meta(min_length=1, max_length=1000)]
# ids become names of files; "$" alone admits a newline behind
Id = Annotated[str, Meta(pattern="^[0-9a-f]{24}$", max_length=24)]
Hash = Annotated[str, Meta(pattern="^[0-9a-f]{64}$", max_length=64)]  # sha256
# of label and mixture (manifests.materials)
MaterialHash = Annotated[str, Meta(pattern="^[0-9a-f]{16}$", max_length=16)]
Segments = Annotated[int, Meta(ge=1, le=255)]
Share = Annotated[float, Meta(ge=0, le=1)]
Amount = Annotated[float, Meta(ge=0)]


class Camera(Struct, frozen=True, forbid_unknown_fields=True):
    """size (height, width) in pixels; fov_deg across the longer side, None: orthographic; elevation
    above the horizon.

    The object lies in the unit sphere; the frame's longer side spans 2 × half_extent at the
    object's centre. pixel: "square", the mean over the pixel's square, as a camera has it;
    "centre", the one point that geometry files hold: jagged edges, but both renderers then look at
    the same points of the surface.
    """

    size: tuple[Pixels, Pixels] = (256, 256)
    fov_deg: Annotated[float, Meta(ge=1, le=120)] | None = None
    elevation_deg: Annotated[float, Meta(ge=-89, le=89)] = 20.0
    half_extent: Annotated[float, Meta(gt=0, le=100)] = 1.02
    pixel: Pixel = "square"


class Draw(Struct, frozen=True, forbid_unknown_fields=True):
    """`{"random": 5}`: that many different ones, drawn anew for each shape, material and light."""

    random: Count


class Job(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What to render, as a person writes it. Every shape meets every material under every light, in
    every view.

    name, about        for people; they alter nothing
    shapes             "chair:17" a family and its number, "chair:0-39" a range, "sphere",
    "meshes/stool.obj" or a folder of mesh files
                       (relative to the job's file, or to --assets)
    materials          names, or sets of them: "merl", "merl/train", "merl/test", "merl/paper-train"
    lights             names of bundled maps, or .hdr and .exr files; one named twice is drawn
    twice, with rotations of its own
    views              numbers 0–23 (azimuth 15° each; manifests/viewpoints.json), or {"random": 5}
    rotations          texels 0–127 the light is turned by, as the camera sees it, or {"random": 1}
    repeats            pictures of each shot that differ in nothing but the seed: two show the noise
    segment_materials  None: one material over the whole shape; a number: so many draws of a
    material for each segment, a shape and light
    split, roles       which rule says what is for training and what for testing
    (manifests/splits.json), and which roles to keep
    mixed              keep shots whose shape is for training and whose material is for testing, or
    the reverse
    pictures           False: geometry alone, of every shape in every view once; materials and
    lights come along with the dataset, for
                       whoever relights it; rotations, tiers, samples and what else is about
                       pictures says nothing then
    """

    version: Literal[1] = 1
    name: Name = "job"
    about: str = ""
    shapes: Annotated[tuple[Name, ...], Meta(min_length=1)]
    materials: Annotated[tuple[Name, ...], Meta(min_length=1)]
    lights: Annotated[tuple[Name, ...], Meta(min_length=1)]
    views: Annotated[tuple[Viewpoint, ...], Meta(min_length=1)] | Draw = (0,)
    rotations: Annotated[tuple[Texels, ...], Meta(min_length=1)] | Draw = (0,)
    tiers: Annotated[tuple[Tier, ...], Meta(min_length=1)] = ("full",)
    light_resolutions: Annotated[tuple[LightResolution, ...], Meta(min_length=1)] = ("64x128",)
    samples: Samples = 64
    repeats: Annotated[int, Meta(ge=1, le=1000)] = 1
    camera: Camera = Camera()
    seed: Seed = 0
    segment_materials: Count | None = None
    split: Counts = "hash"
    roles: tuple[Role, ...] = ()
    mixed: bool = True
    pictures: bool = True


class Statistics(Struct, frozen=True, forbid_unknown_fields=True):
    """coverage: share of the frame that the object covers; mean and max of linear radiance over the
    mask.
    """

    coverage: Share
    mean: Amount
    max: Amount


class Record(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, gc=False):
    """One picture and all that determines it.

    id               hash of all that determines the pixels
    materials        one name a segment, in the order of segment ids 1, 2, …; labels stand in the
    dataset's materials.json
    rotation_texels  the light as the camera sees it is the stored 64×128 map rolled by this many
    columns
    image            linear Rec.709 radiance under the unit-mean light, half EXR; geometry: normals
    (camera frame), depth, segments
    split            train or test where shape and materials agree, else mixed
    """

    id: Id
    shape: str
    shape_hash: str
    category: str
    viewpoint: Viewpoint
    azimuth_deg: float
    camera: Camera
    materials: Annotated[tuple[str, ...], Meta(min_length=1, max_length=255)]
    light: str
    light_hash: str
    rotation_texels: Texels
    tier: Tier
    light_resolution: LightResolution
    samples: Samples
    seed: Seed
    image: str
    image_hash: str
    geometry: str
    geometry_hash: str
    split: Split
    statistics: Statistics
    seconds: Amount

    @property
    def coverage(self) -> float:
        """Share of the frame that the object covers."""
        return self.statistics.coverage

    @property
    def segments(self) -> int:
        """How many the shape has."""
        return len(self.materials)


class View(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, gc=False):
    """One shape seen from one viewpoint, without a picture: what there is to relight.

    id        of the geometry file
    segments  how many the shape has; from here not all of them need be seen
    side      the shape's
    coverage  share of the frame that the object covers
    """

    id: Id
    shape: str
    shape_hash: str
    category: str
    viewpoint: Viewpoint
    azimuth_deg: float
    camera: Camera
    segments: Segments
    geometry: str
    geometry_hash: str
    side: Side
    coverage: Share
    seconds: Amount


class ShapeEntry(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A shape of a dataset.

    side      of the split, where its hash stands
    segments  how many regions take materials
    report    what was mended in its mesh
    """

    hash: Hash
    category: str
    side: Side
    role: Role
    segments: Segments
    licence: str
    report: str = ""


class LightEntry(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A light of a dataset: its stored 64×128 map (manifests.arrays: LIGHT).

    side  by its hash; None in datasets from before lights had sides: manifests.splits.light_side
    gives it then
    """

    hash: Hash
    file: str
    file_hash: Hash
    scale: Annotated[float, Meta(gt=0)]
    licence: str
    source: str = ""
    side: Side | None = None


class MaterialEntry(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A material of a dataset; its label stands in materials.json. hash: of label and closures
    together.
    """

    hash: MaterialHash
    side: Side
    licence: str
    source: str = ""


class Order(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A job that was begun in this folder, whole, and how many shots it means."""

    job: Job
    shots: Annotated[int, Meta(ge=0)]
    begun: str


class Dataset(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """dataset.json: what the folder is, what was asked for, with which settings and assets it was
    made.

    settings  by render version: every Cycles setting that alters pixels, as it was in force
    """

    version: int = VERSION
    orders: tuple[Order, ...] = ()
    settings: dict[str, dict[str, Any]] = {}
    versions: dict[str, str] = {}
    shapes: dict[str, ShapeEntry] = {}
    materials: dict[str, MaterialEntry] = {}
    lights: dict[str, LightEntry] = {}


class Failure(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A shot that did not come out, twice: why, and what it was."""

    id: Id
    shape: str
    materials: tuple[str, ...]
    light: str
    viewpoint: Viewpoint
    tier: Tier
    reason: str
    when: str
