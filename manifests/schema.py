"""The contract on disk as types: jobs, records, views and data sets.

msgspec reads and writes them (manifests.reading): unknown keys and wrong types are refused with the
key's path, and the JSON Schema in manifests/json-schema is generated from these types. Angles are
in degrees here, as in every file, and the key says so. Paths are relative to the data set's folder
and stay inside it.
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
Estimator = Literal["path-tracing", "denoised", "ratio", "closed-form", "shadow-rays"]
Role = Literal["pretrain", "finetune", "train", "test"]

Count = Annotated[int, Meta(ge=1, le=1_000_000)]
Pixels = Annotated[int, Meta(ge=4, le=8192)]
Viewpoint = Annotated[int, Meta(ge=0, le=23)]
Texels = Annotated[int, Meta(ge=0, le=127)]
Samples = Annotated[int, Meta(ge=1, le=1_048_576)]
Seed = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Name = Annotated[str, Meta(min_length=1, max_length=1000)]
# ids become names of files; the length rules out a newline, which "$" admits at the end
Id = Annotated[str, Meta(pattern="^[0-9a-f]{24}$", max_length=24)]
Hash = Annotated[str, Meta(pattern="^[0-9a-f]{64}$", max_length=64)]  # sha256
# of label and mixture (manifests.materials)
MaterialHash = Annotated[str, Meta(pattern="^[0-9a-f]{16}$", max_length=16)]
Segments = Annotated[int, Meta(ge=1, le=255)]
FieldOfView = Annotated[float, Meta(ge=1, le=120)]
Elevation = Annotated[float, Meta(ge=-89, le=89)]
Roll = Annotated[float, Meta(ge=-180, le=180)]
Share = Annotated[float, Meta(ge=0, le=1)]
Amount = Annotated[float, Meta(ge=0)]
LARGEST_ERROR = 255**2  # display L2 of black against white
DisplayError = Annotated[float, Meta(gt=0, le=LARGEST_ERROR)]


class Camera(Struct, frozen=True, forbid_unknown_fields=True):
    """The camera. The object lies in the unit sphere.

    size           (height, width) in pixels
    fov_deg        field of view across the longer side, None: orthographic
    elevation_deg  above the horizon
    half_extent    the frame's longer side spans 2 × half_extent at the object's centre. In
                   perspective the frame holds the whole unit sphere where half_extent is at least
                   1 / cos(fov_deg / 2): 1.02 suffices up to 22°, and 60° take 1.155
    pixel          "square": the mean over the pixel's square, as in a camera; "centre": the one
                   point that geometry files hold, which gives jagged edges, but lets both renderers
                   look at the same points of the surface
    roll_deg       by which the picture's contents turn counter-clockwise: the camera itself is
                   turned clockwise about its optical axis
    """

    size: tuple[Pixels, Pixels] = (256, 256)
    fov_deg: FieldOfView | None = None
    elevation_deg: Elevation = 20.0
    half_extent: Annotated[float, Meta(gt=0, le=100)] = 1.02
    pixel: Pixel = "square"
    roll_deg: Roll = 0.0


class CameraRanges(Struct, frozen=True, forbid_unknown_fields=True):
    """Ranges from which each view of each shape draws its own camera (manifests.ids.camera_of).

    Values are drawn uniformly in degrees. A range that is left out is not drawn: the job's camera
    gives the value.

    elevation_deg      [lowest, highest] above the horizon
    roll_deg           [lowest, highest]
    fov_deg            [lowest, highest] field of view of the views in perspective. half_extent then
                       is the job's camera's divided by cos(fov / 2), so that perspective crops no
                       more of the unit sphere than the orthographic camera does
    perspective_share  share of views in perspective, where fov_deg is given; the others are
                       orthographic
    """

    elevation_deg: tuple[Elevation, Elevation] | None = None
    roll_deg: tuple[Roll, Roll] | None = None
    fov_deg: tuple[FieldOfView, FieldOfView] | None = None
    perspective_share: Share = 1.0


class Draw(Struct, frozen=True, forbid_unknown_fields=True):
    """`{"random": 5}`: that many different numbers, drawn for each shape, material and light."""

    random: Count


class Job(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What to render. Every shape meets every material under every light, in every view.

    name, about        for people; they do not affect pictures
    shapes             "chair:17" a family and its number, "chair:0-39" a range, "sphere",
                       "meshes/stool.obj" or a folder of mesh files (relative to the job's file, or
                       to --assets)
    materials          names, or sets of them: "merl", "merl/train", "merl/test", "merl/paper-train"
    lights             names of bundled maps, or .hdr and .exr files; one named twice is drawn
                       twice, with different rotations
    views              numbers 0–23 (azimuth 15° each; manifests/viewpoints.json), or {"random": 5}
    rotations          texels 0–127 by which the light is turned, as the camera sees it, or
                       {"random": 1}
    repeats            number of pictures of each shot, which differ in the seed alone: two show the
                       noise
    segment_materials  None: one material for the whole shape; a number: that many draws of one
                       material per segment, for each shape and light
    split, roles       the rule that says what is for training and what for testing
                       (manifests/splits.json), and the roles to render, none: all
    mixed              render shots whose shape is for training and whose material is for testing,
                       or the reverse
    camera_ranges      ranges from which each view of each shape draws its own camera; None: all
                       views have `camera`
    error              display L2 over the object's mask, of noise and bias together, that each
                       picture may have. The factory chooses estimator and samples of each shot;
                       `samples` is then ignored; None: all shots have `samples`
    pictures           False: geometry alone, of every shape in every view once. The data set
                       includes the materials and lights, for relighting; rotations, tiers, samples
                       and other settings of pictures are ignored
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
    camera_ranges: CameraRanges | None = None
    error: DisplayError | None = None


class Statistics(Struct, frozen=True, forbid_unknown_fields=True):
    """Figures of a picture.

    coverage   share of the frame that the object covers
    mean, max  of linear radiance over the mask
    """

    coverage: Share
    mean: Amount
    max: Amount


class Accuracy(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How exact a picture is, of a job that limits its error. Errors are display L2 over the mask.

    requested       the job's `error`, which is part of the id
    estimator       factory.render.estimators: one file each
    predicted       by the estimator's model from the first few samples
    estimated       of the finished picture, from two halves of independent seeds
    standard_error  of `estimated`
    seconds         that the picture took, without geometry and files
    traced          tier whose light paths were traced, where it is not the record's: `direct`,
                    because the object cannot shade itself as seen from this side
    """

    requested: DisplayError
    estimator: Estimator
    predicted: Amount
    estimated: Amount
    standard_error: Amount
    seconds: Amount
    traced: Tier | None = None


class Record(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, gc=False):
    """One picture and everything that determines it.

    id               hash of everything that determines the pixels
    materials        one name per segment, in the order of segment ids 1, 2, …; labels are in the
                     data set's materials.json
    rotation_texels  the light as the camera sees it is the stored 64×128 map rolled by this many
                     columns
    image            linear Rec.709 radiance under the unit-mean light, half EXR
    geometry         normals (camera frame), depth, segments
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
    accuracy: Accuracy | None = None

    @property
    def coverage(self) -> float:
        """Share of the frame that the object covers."""
        return self.statistics.coverage

    @property
    def segments(self) -> int:
        """Number of segments of the shape."""
        return len(self.materials)


class View(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, gc=False):
    """One shape seen from one viewpoint, without a picture, for relighting.

    id        of the geometry file
    segments  number of segments of the shape; not all of them need be visible
    side      of the shape
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
    """A shape of a data set.

    side      of the split
    segments  number of regions that take a material each
    report    what was repaired in its mesh
    """

    hash: Hash
    category: str
    side: Side
    role: Role
    segments: Segments
    licence: str
    report: str = ""


class LightEntry(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A light of a data set: its stored 64×128 map (manifests.arrays: LIGHT).

    side  by its hash; None in data sets from before lights had sides, where
          manifests.splits.light_side gives it
    """

    hash: Hash
    file: str
    file_hash: Hash
    scale: Annotated[float, Meta(gt=0)]
    licence: str
    source: str = ""
    side: Side | None = None


class MaterialEntry(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A material of a data set, whose label is in materials.json.

    hash  of label and mixture together
    """

    hash: MaterialHash
    side: Side
    licence: str
    source: str = ""


class Order(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A job that was begun in this folder.

    shots  number of shots of the whole job
    begun  date and time in UTC
    """

    job: Job
    shots: Annotated[int, Meta(ge=0)]
    begun: str


class Dataset(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """dataset.json: the jobs that were rendered, with their settings and assets.

    orders    the jobs
    settings  {render version: every Cycles setting that alters pixels, with its value and reason}
    """

    version: int = VERSION
    orders: tuple[Order, ...] = ()
    settings: dict[str, dict[str, Any]] = {}
    versions: dict[str, str] = {}
    shapes: dict[str, ShapeEntry] = {}
    materials: dict[str, MaterialEntry] = {}
    lights: dict[str, LightEntry] = {}


class Failure(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A shot that failed twice, and the reason."""

    id: Id
    shape: str
    materials: tuple[str, ...]
    light: str
    viewpoint: Viewpoint
    tier: Tier
    reason: str
    when: str
