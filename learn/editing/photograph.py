"""Reads a picture to be edited, with its object's mask and regions.

radiance  (H, W, 3) linear, as the file has it
coverage  (H, W) in [0, 1]: how much of a pixel the object covers
regions   (H, W) uint8 1 … S, 0 in the background
balance   (3,) factors by which colours are multiplied before the network sees them; the edited
          object is divided by them
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from learn.data import framing, photographs, picture_arrays
from learn.data.records import Records, require_upright
from learn.editing import mask_preparation, region_masks
from learn.editing.record_choice import choose_record
from learn.editing.white_balance import find_balance
from manifests.errors import InputError
from manifests.schema import Record
from shaders import tone
from shaders.frames import ELEVATION

CLEAR = 0.02  # coverage below which a pixel counts as background


@dataclass(frozen=True)
class Photograph:
    """A picture to be edited; the module describes the arrays.

    name             what messages and files call it
    exposure         factor that balanced radiance is multiplied by for the network; None: estimated
    cut_out          whether its background is transparent
    alpha            (H, W) in [0, 1]: the file's own opacity if a mask was given besides; else None
    linear           whether the file holds radiance (an EXR, a record) instead of display values
    given            (H, W) the regions as given, if the mask's edge was then fitted to the
                     picture (learn.editing.mask_edges); else None
    records, record  the data set and the record that it comes from; else None
    """

    name: str
    radiance: np.ndarray
    coverage: np.ndarray
    regions: np.ndarray
    balance: np.ndarray
    exposure: float | None
    cut_out: bool = False
    linear: bool = False
    alpha: np.ndarray | None = None
    given: np.ndarray | None = None
    records: Records | None = None
    record: Record | None = None

    @property
    def mask(self) -> np.ndarray:
        """Pixels (H, W) bool that the object covers by at least half."""
        return self.regions > 0

    @property
    def given_regions(self) -> np.ndarray:
        """Regions (H, W) as they were given, before the mask's edge was fitted."""
        return self.regions if self.given is None else self.given

    @property
    def opacity(self) -> np.ndarray | None:
        """Opacity (H, W) in [0, 1] of an edited picture; None if it is opaque."""
        return self.coverage if self.cut_out else self.alpha

    @property
    def count(self) -> int:
        """Number of the object's regions."""
        return int(self.regions.max())

    @property
    def clipped(self) -> np.ndarray | None:
        """Channels (H, W, 3) bool that are white in the file; None if the file holds radiance."""
        return None if self.linear else photographs.find_saturated(self.radiance)

    @property
    def elevation(self) -> float:
        """The camera's elevation in radians: a record's own; for a photograph the usual one."""
        if self.record is None:
            return float(ELEVATION)
        return float(np.radians(self.record.camera.elevation_deg))

    @property
    def balanced(self) -> np.ndarray:
        """Radiance (H, W, 3) as the network sees it, except for exposure."""
        return self.radiance * self.balance


def resolve_example(
    path: str | Path, masks: Sequence[Path], regions: Path | None
) -> tuple[Path, Path | None]:
    """Return the path and the regions of a picture, also if it is "example:espresso-cup".

    This example is a photograph that comes with scikit-image, by Rachel Michetti (Pikolo Espresso
    Bar), CC0; its regions, 1 cup and 2 saucer, come with this package.
    Raises  InputError for another example
    """
    kind, _, name = str(path).partition(":")
    if kind != "example":
        return Path(path), regions
    if name != "espresso-cup":
        raise InputError(path, "an example", "none of that name", "there is example:espresso-cup")
    import skimage.data

    cup = Path(__file__).parent / "examples" / "espresso-cup.regions.png"
    return Path(skimage.data.__file__).parent / "coffee.png", None if masks else regions or cup


def open_photograph(
    path: str | Path,
    masks: Sequence[Path] = (),
    regions: Path | None = None,
    balance: str | Sequence[float] = "none",
    exposure: float | None = None,
    record: str | None = None,
    remedy: str = photographs.MASK_REMEDY,
    targets: Sequence[str] = (),
    fit_mask: bool | None = False,
) -> Photograph:
    """Return the Photograph at `path`: a picture, or a record of a dataset's folder.

    masks    files; each of several is a region of its own
    regions  a label image's file, or None
    balance  "none", "grey", or three factors
    record   id of a data set's record, or its beginning; None: choose_record says which
    remedy   what the error for a picture without a mask suggests
    targets  names of the target materials, which the chosen record should not show already
    fit_mask whether to fit the mask's edge to the picture; None: only if it is black and white
    Raises   InputError
    """
    path, regions = resolve_example(path, masks, regions)
    if path.is_dir():
        _refuse_options_of_photographs(
            path,
            "a photograph: a dataset's records have masks and regions, and light of known colour",
            masks,
            regions,
            balance,
            fit_mask,
        )
        return open_record(path, exposure, record, targets)
    if record is not None:
        raise InputError(
            f"--record {record}", "a dataset's folder", f"the picture {path}", "leave --record out"
        )
    if len(masks) <= 1:
        radiance, coverage, alpha = photographs.read_with_coverage(
            path, masks[0] if masks else None, regions, remedy
        )
        labels: np.ndarray = (coverage >= 0.5).astype(np.uint8)
    else:
        radiance, _, alpha = photographs.read_with_coverage(path, masks[0])
        coverage, labels = region_masks.read_region_masks(masks, radiance.shape[:2])
    if regions is not None:
        whole = photographs.read_labels(regions, radiance.shape[:2])
        labels = whole * (coverage >= 0.5)
        region_masks.require_pixels(labels, whole.max(), regions)
        coverage = region_masks.remove_unlabelled(coverage, labels)
    cut_out = not masks and regions is None
    is_transparency = not masks and bool((alpha < 0.5).any())
    linear = photographs.holds_radiance(path)
    contents = _Contents(path, radiance, coverage, labels, alpha, cut_out, is_transparency, linear)
    return _assemble(contents, balance, exposure, fit_mask)


def from_arrays(
    picture: np.ndarray | Path,
    mask: np.ndarray | Path | None = None,
    regions: np.ndarray | Path | None = None,
    balance: str | Sequence[float] = "none",
    exposure: float | None = None,
    name: str = "photograph",
    fit_mask: bool | None = False,
) -> Photograph:
    """Return the Photograph of arrays or files.

    picture  (H, W, 3) uint8 display values in sRGB, or floats: linear radiance. (H, W, 4) has its
             transparency as the fourth channel, 0 … 255 or 0 … 1
    mask     (H, W) bool, uint8 with 255 on the object, or floats in [0, 1]; None: the transparency
    regions  (H, W) whole numbers, one for each region, 0 in the background; None: one region
    name     for messages
    fit_mask as `open_photograph` takes it
    Raises   InputError
    """
    if isinstance(picture, Path):
        radiance, alpha = photographs.read_pixels(picture)
        name, linear = picture.name, photographs.holds_radiance(picture)
    else:
        radiance, alpha, linear = picture_arrays.read_picture(picture, name)
    size, whole = radiance.shape[:2], None
    if isinstance(regions, Path):
        whole = photographs.read_labels(regions, size)
    elif regions is not None:
        whole = picture_arrays.read_regions(regions, size, name)
    given = photographs.read_mask(mask, size) if isinstance(mask, Path) else mask
    coverage = picture_arrays.read_coverage(given, whole, alpha, name)
    labels: np.ndarray = (coverage >= 0.5).astype(np.uint8)
    if whole is not None:
        labels = whole * (coverage >= 0.5)
        region_masks.require_pixels(labels, whole.max(), f"{name}: regions")
        coverage = region_masks.remove_unlabelled(coverage, labels)
    cut_out = mask is None and regions is None
    is_transparency = mask is None and bool((alpha < 0.5).any())
    contents = _Contents(
        Path(name), radiance, coverage, labels, alpha, cut_out, is_transparency, linear
    )
    return _assemble(contents, balance, exposure, fit_mask)


class _Contents(NamedTuple):
    """What was read of a photograph and its masks.

    path             of the picture, or its name
    radiance         (H, W, 3) linear
    coverage         (H, W) in [0, 1]
    labels           (H, W) 0 … S: the regions
    alpha            (H, W) the picture's own transparency, 1 where it has none
    cut_out          whether no mask and no regions were given
    is_transparency  whether the coverage is the picture's own transparency
    linear           whether the file or the array holds radiance
    """

    path: Path
    radiance: np.ndarray
    coverage: np.ndarray
    labels: np.ndarray
    alpha: np.ndarray
    cut_out: bool
    is_transparency: bool
    linear: bool


def _assemble(
    contents: _Contents,
    balance: str | Sequence[float],
    exposure: float | None,
    fit_mask: bool | None,
) -> Photograph:
    """Return the Photograph of what was read, with its mask prepared and its balance resolved.

    The picture's own transparency is neither softened nor fitted.
    """
    coverage, labels, radiance = contents.coverage, contents.labels, contents.radiance
    if fit_mask and contents.is_transparency:
        rule, remedy = "a mask that is not the photograph's own transparency", "leave it out"
        raise InputError("--fit-mask", rule, "no other mask", remedy)
    is_hard = mask_preparation.is_black_and_white(coverage)
    fitted = None
    if fit_mask or (fit_mask is None and is_hard and not contents.is_transparency):
        everywhere = np.ones(labels.shape, bool)
        shown = tone.auto_exposure(radiance, everywhere) if contents.linear else 1.0
        seen = radiance * np.float32(shown)
        fitted = mask_preparation.fit_regions(seen, coverage, labels, contents.alpha < 1)
    if fitted is not None:
        coverage, labels = fitted
    elif not contents.is_transparency:
        coverage = mask_preparation.soften(coverage)
    clear = (coverage < CLEAR) & (contents.alpha > 0.5) & (not contents.cut_out)
    factors = find_balance(balance, radiance, clear if clear.any() else coverage >= 0.5)
    framing.resolve_exposure(radiance * factors, labels > 0, exposure, contents.path)
    own = contents.alpha if not contents.cut_out and (contents.alpha < 1).any() else None
    return Photograph(
        contents.path.stem,
        radiance,
        coverage,
        labels,
        factors,
        exposure,
        cut_out=contents.cut_out,
        linear=contents.linear,
        alpha=own,
        given=None if fitted is None else contents.labels,
    )


def _refuse_options_of_photographs(path, rule, masks, regions, balance, fit_mask):
    """Raise InputError if an option is given that the dataset `path` leaves no place for."""
    given = {
        "--fit-mask": bool(fit_mask),
        "--mask": bool(masks),
        "--regions": regions is not None,
        "--white-balance": balance != "none",
    }
    for option in (name for name, there in given.items() if there):
        raise InputError(option, rule, f"the dataset {path}", f"leave {option} out")


def open_record(
    folder: Path,
    exposure: float | None = None,
    requested: str | None = None,
    targets: Sequence[str] = (),
) -> Photograph:
    """Return a record's picture; its light has unit mean luminance, so its exposure is 1.

    requested, targets  as choose_record takes them
    Raises              InputError: no such record, or one by a perspective or rolled camera
    """
    records = Records(folder)
    record = choose_record(records, requested, targets)
    sample = records.load(record)
    if sample.view is not None:
        raise InputError(
            folder,
            "an orthographic camera",
            f"{record.camera.fov_deg:g}°",
            "render without fov_deg",
        )
    require_upright(record)
    regions = sample.segments.numpy().astype(np.uint8)
    if len(set(record.materials)) == 1:
        regions = (regions > 0).astype(np.uint8)
    coverage, ones = (regions > 0).astype(np.float32), np.ones(3, np.float32)
    picture = sample.image.numpy()
    exposure = framing.resolve_exposure(
        picture, regions > 0, 1.0 if exposure is None else exposure, f"record {record.id}"
    )
    return Photograph(
        record.id,
        picture,
        coverage,
        regions,
        ones,
        exposure,
        cut_out=True,
        linear=True,
        records=records,
        record=record,
    )
