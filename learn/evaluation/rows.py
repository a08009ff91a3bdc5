"""The lines of an evaluation as types, against which they are checked when a later run reads them.

A figure is None where there was nothing to measure, or where it was not finite. Keys that are not
named here are kept.
"""

from typing import Annotated

from msgspec import Meta, Struct, field

Figure = Annotated[float, Meta(ge=-1e30, le=1e30)]  # far beyond any; sums of squares stay finite
Figures = dict[str, Figure | None]
Names = Annotated[tuple[str, ...], Meta(min_length=1)]


class Comparison(Struct):
    """A picture against its truth (learn.metrics.pictures.compare)."""

    l2: Figure
    l2_frame: Figure
    ssim: Figure | None
    ssim_frame: Figure | None
    psnr: Figure
    flip: Figure
    lpips: Figure | None = None
    l2_own_exposure: Figure | None = None
    l2_one_factor: Figure | None = None
    l2_three_factors: Figure | None = None
    l2_true_light: Figure | None = None
    l2_true_normals: Figure | None = None


class Refinement(Struct):
    """Energies of a refinement, its time, and whether all that came out is finite."""

    before: Figure | None
    after: Figure | None
    seconds: Figure
    finite: bool


class Parts(Struct):
    """A method's errors on a picture: of the parts that it predicts, and of their renderings."""

    normals: Figures = {}
    material: Figures = {}
    light: Figures = {}
    rendered_normals: Comparison | None = None
    rendered_material: Comparison | None = None
    rendered_light: Comparison | None = None
    rendered_all: Comparison | None = None
    rendered_all_true_light: Comparison | None = None
    refinement: Refinement | None = None


class Layer(Struct):
    """The error of the layer's edit from true parts; more of it where the truth has two seeds."""

    l2: Figure
    l2_inner: Figure | None
    node_fit: Figure | None
    seeds: int = 1
    net_inner: Figure | None = None
    net_error: Figure | None = None
    coarse: Figure | None = None
    fit_here: Figure | None = None
    rest: Figure | None = None

    def __post_init__(self) -> None:
        if self.net_inner is not None and self.net_error is None:
            raise ValueError("a net_error beside net_inner")


class Line(Struct, kw_only=True):
    """What a line says of its input picture, and the commit that measured it."""

    id: str
    shape: str
    category: str
    viewpoint: int
    materials: Names
    light: str
    rotation_texels: int
    split: str
    commit: str = "none"


class Picture(Line, kw_only=True):
    """A line of pictures.jsonl: one picture's parts by every method."""

    methods: dict[str, Parts]


class Edit(Line, kw_only=True):
    """A line of edits.jsonl: one edit by every method.

    source, truth  ids of records
    targets        materials of the truth; "wanted" in the file
    """

    source: str
    truth: str
    several: bool
    methods: dict[str, Comparison]
    targets: Names = field(name="wanted")
    layer: Layer


TYPES = {"pictures.jsonl": Picture, "edits.jsonl": Edit}
