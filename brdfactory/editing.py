"""Editing a photograph from Python: decompose it once, then paint its object in any material."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TypedDict, Unpack

import numpy as np
import torch

from brdfactory import arguments, rendering
from brdfactory.materials import Material, material
from brdfactory.pictures import Picture
from learn.commands.options import EDITING_WEIGHTS, weights_file
from learn.data import devices, photographs
from learn.data.devices import to_numpy
from learn.editing import DETAIL, MOST_STOPS, drawing, photograph
from learn.editing import decomposition as decomposing
from learn.editing.compositor import Compositor
from learn.editing.photograph import Photograph
from learn.layer import predictions
from learn.metrics.pictures import display_l2
from learn.networks import weights as checkpoint
from learn.networks.prediction import Coded
from learn.primitives import PRIMITIVES
from manifests import notices
from manifests.errors import InputError
from manifests.wording import number_of
from shaders import tone

MaterialSource = str | Path | np.ndarray | Material
PictureSource = str | Path | np.ndarray

STOPS = f"a number of stops from -{MOST_STOPS:g} to {MOST_STOPS:g}"


@dataclass(frozen=True)
class EditedPicture(Picture):
    """A photograph with its object in another material, its decomposition and that material."""

    decomposition: "Decomposition | None" = None
    material: Material | None = None


class Decomposition:
    """The normals, light and material of a photographed object, made by `decompose`.

    `paint` gives the object other materials, and `relight` shows it under another light; neither
    decomposes the photograph again.

    photograph  learn.editing.photograph.Photograph that was decomposed
    computed    learn.editing.decomposition.Decomposition of it
    detail      share of the photograph's residual shading that edits keep
    """

    def __init__(self, photograph: Photograph, computed: decomposing.Decomposition, detail: float):
        self.photograph, self.computed = photograph, computed
        self._compositor = Compositor(computed, predictions.SHOWN.tolerance, detail)

    @property
    def normals(self) -> np.ndarray:
        """Unit normals (h, w, 3), camera frame, at the network's size; 0 outside the object."""
        n = to_numpy(self.computed.parts.n[0].movedim(0, -1))
        return n * self.computed.framed.mask[..., None]

    @property
    def light(self) -> np.ndarray:
        """The light (64, 128, 3), linear, of unit mean luminance, light frame."""
        return to_numpy(self.computed.parts.light[0].movedim(0, -1))

    @property
    def materials(self) -> list[Material]:
        """The material of each region."""
        each = [
            material(label, f"region {number}")
            for number, label in enumerate(self.computed.label, 1)
        ]
        return [replace(m, read=(m.label,)) for m in each]

    @property
    def material(self) -> Material:
        """The material of an object of one region. Raises InputError for more regions."""
        if len(self.computed.label) > 1:
            result = f"{len(self.computed.label)} regions"
            raise InputError("material", "an object of one region", result, "use materials")
        return self.materials[0]

    @cached_property
    def rendering(self) -> Picture:
        """The photograph with its object rendered from the estimated parts."""
        return self._picture(self._compositor.render_again())

    @property
    def error(self) -> float:
        """Display L2 between the photograph and `rendering`, over the object."""
        return display_l2(self.rendering.linear, self.photograph.radiance, self.photograph.mask)

    def paint(self, *materials: MaterialSource | None, brightness: float = 0.0) -> EditedPicture:
        """Return the photograph with its object in another material.

        materials   one for all regions, or one for each; None leaves a region as it is. Each is a
                    name, a description, a label or a Material, which may be a blend
        brightness  stops by which the new materials are made brighter, -3 to 3
        Raises      InputError
        """
        from learn.commands.editing_options import check_brightness

        brightness = arguments.require_number("brightness", brightness, STOPS, "0 changes nothing")
        check_brightness(brightness, "brightness")
        count = len(self.computed.label)
        if len(materials) not in (1, count):
            rule = "one material" + (f", or {count}: one for each region" if count > 1 else "")
            raise InputError("paint", rule, f"{len(materials)}", "None leaves a region as it is")
        chosen = [None if m is None else material(m) for m in materials]
        read = _labels_read_from_pictures(chosen)
        linear: np.ndarray | float = 0.0
        for weight, labels in _weighted_labels(chosen):
            linear = linear + weight * self._compositor.edit(labels, read, brightness)
        shown = self._picture(np.asarray(linear, np.float32))
        single = chosen[0] if len(chosen) == 1 else None
        return EditedPicture(shown.linear, shown.exposure, shown.opacity, self, single)

    def relight(self, light: str | Path | np.ndarray, *materials: MaterialSource | None) -> Picture:
        """Return the object alone, on a transparent background, under another light.

        light      a name or file that `brdfactory.light` takes, or an array that it returns
        materials  as `paint` takes them; without any, the object keeps its own
        Raises     InputError
        """
        if isinstance(light, str | Path):
            L = rendering.light(light)
        else:
            rule = "a light's name or file, or an array (64, 128, 3)"
            L = arguments.require_floats("relight: light", light, rule, "use bf.light")
        if L.shape != (64, 128, 3):
            raise InputError(
                "relight: light", "an array (64, 128, 3)", f"{L.shape}", "use bf.light"
            )
        if not (np.isfinite(L) & (L >= 0)).all():
            rule, result = "radiance that is finite and not negative", "other values"
            raise InputError("relight: light", rule, result, "use bf.light")
        own = self.computed.label
        requested = list(materials) or [None]
        requested = requested * len(own) if len(requested) == 1 else requested
        if len(requested) != len(own):
            raise InputError(
                "relight", number_of(len(own), "material"), f"{len(requested)}", "one a region"
            )
        chosen = [None if m is None else material(m) for m in requested]
        read = _labels_read_from_pictures(chosen)
        linear: np.ndarray | float = 0.0
        for weight, labels in _weighted_labels(chosen):
            label = np.stack(
                [mine if new is None else new for mine, new in zip(own, labels, strict=True)]
            )
            linear = linear + weight * self._compositor.relight(label, L, read)
        radiance = np.asarray(linear, np.float32)
        exposure = tone.auto_exposure(radiance, self.photograph.mask)
        return Picture(radiance, exposure, self.photograph.coverage)

    def _picture(self, linear: np.ndarray) -> Picture:
        return Picture(linear, drawing.display_exposure(self.photograph), self.photograph.opacity)


class Options(TypedDict, total=False):
    """The keyword arguments of `decompose`, all of which `edit` passes on."""

    regions: PictureSource | None
    fit_mask: bool | None
    shape: str | None
    refine: bool
    refinement_method: str | None
    detail: float
    exposure: float | None
    white_balance: str | Sequence[float]
    weights: str | Path
    device: str | torch.device


def decompose(
    photo: PictureSource,
    mask: PictureSource | None = None,
    *,
    regions: PictureSource | None = None,
    fit_mask: bool | None = None,
    shape: str | None = None,
    refine: bool = True,
    refinement_method: str | None = None,
    detail: float = DETAIL,
    exposure: float | None = None,
    white_balance: str | Sequence[float] = "none",
    weights: str | Path = EDITING_WEIGHTS,
    device: str | torch.device = "cpu",
) -> Decomposition:
    """Return the decomposition of a photograph into normals, light and material.

    photo          a file; "example:espresso-cup"; or an array (H, W, 3 or 4): uint8 display values,
                   or floats of linear radiance. More than 25 megapixels are made smaller, except
                   radiance
    mask           a file that is white on the object, or an array (H, W): bool, uint8, or floats in
                   [0, 1]; of the photograph's size or of the edit's. None: the photograph's
                   transparency
    regions        a file or an array (H, W) with one value for each region, 0 outside; None: one
    fit_mask       whether to move the mask's edge, by a few pixels at most, to where the object
                   ends according to the photograph's colours; None: only if the mask is black
                   and white
    shape          "box", "cylinder", "ball" or "flat", if the object is one: its normals are then
                   not guessed, but follow from its outline; None: guessed by the network
    refine         whether to adjust the prediction until its rendering looks like the photograph
    refinement_method  how refinement renders: "auto" (also None) sums over the light map's texels;
                   "quadrature" integrates, which is more accurate for narrow highlights and slower
    detail         share that edits keep of the photograph's shading beyond `rendering`, 0 to 1
    exposure       factor by which the photograph's radiance is multiplied for the network; larger
                   values make edits darker; None: estimated
    white_balance  "none", "grey", or three factors
    weights        a file, or the name of weights that come with the program
    device         where the network and the layer run: "auto", "cpu", "cuda", or a torch.device
    Raises         InputError
    """
    from learn.commands.editing_options import (
        check,
        check_exposure,
        parse_balance,
        refinement_of_photographs,
    )

    refine = arguments.require_flag("refine", refine)
    settings = refinement_of_photographs(refine, refinement_method, "refinement_method")
    rule = "a number from 0 to 1"
    detail = arguments.require_number("detail", detail, rule, f"leave it out: it is {DETAIL:g}")
    check("detail", 0 <= detail <= 1, rule, detail)
    if exposure is not None:
        rule = "a number above 0, or None"
        exposure = arguments.require_number("exposure", exposure, rule, "None estimates it")
    check_exposure(exposure)
    if fit_mask is not None:
        fit_mask = arguments.require_flag("fit_mask", fit_mask)
    if shape is not None and (not isinstance(shape, str) or shape not in PRIMITIVES):
        remedy = "leave it out, and the network guesses the shape"
        result = shape if isinstance(shape, str) else arguments.shown(shape)
        raise InputError("shape", f"{', '.join(PRIMITIVES)}, or None", result, remedy)
    chosen = _device(device)
    opened = _open_photograph(
        photo, mask, regions, parse_balance(white_balance), exposure, fit_mask
    )
    rule, remedy = "a file, or a name of weights", "leave it out for those of photographs"
    file = weights_file(arguments.require_path("weights", weights, rule, remedy))
    modified = file.stat().st_mtime_ns if os.path.exists(file) else 0
    network, size = _network(str(file), modified, str(chosen))
    decomposed = decomposing.decompose(opened, network, size, settings, shape=shape)
    return Decomposition(opened, decomposed, detail)


def edit(
    photo: PictureSource,
    mask: PictureSource | None = None,
    material: MaterialSource | Sequence[MaterialSource | None] | None = "brass",
    *,
    brightness: float = 0.0,
    **options: Unpack[Options],
) -> EditedPicture:
    """Return a photograph with its object in another material.

    For several materials, call `decompose` once, and then `paint` for each.

    photo, mask, options  as for `decompose`
    material              a name, a description such as "principled(roughness=.35)", a label (108,)
                          or a Material; or a list with one of these for each region, in which None
                          leaves a region as it is
    brightness            as of `paint`
    Raises                InputError: a file or a name that does not exist, a mask of another size
    """
    several = isinstance(material, list | tuple)
    drawn: Sequence[MaterialSource | None] = material if several else (material,)  # type: ignore[assignment]
    return decompose(photo, mask, **options).paint(*drawn, brightness=brightness)


def _open_photograph(
    photo: PictureSource,
    mask: PictureSource | None,
    regions: PictureSource | None,
    balance: str | Sequence[float],
    exposure: float | None,
    fit_mask: bool | None,
) -> Photograph:
    """Return the Photograph of files or of arrays."""
    picture = arguments.require_picture("photo", photo)
    covered, parted = (
        given if given is None else arguments.require_picture(name, given)
        for name, given in (("mask", mask), ("regions", regions))
    )
    if not any(isinstance(given, np.ndarray) for given in (picture, covered, parted)):
        return photograph.open_photograph(
            str(picture),
            [] if covered is None else [Path(str(covered))],
            None if parted is None else Path(str(parted)),
            balance,
            exposure,
            fit_mask=fit_mask,
        )
    source = _array_or_path(picture)
    if isinstance(source, Path):
        source = photograph.resolve_example(source, [], None)[0]
    opened = photograph.from_arrays(
        source,
        None if covered is None else _array_or_path(covered),
        None if parted is None else _array_or_path(parted),
        balance,
        exposure,
        fit_mask=fit_mask,
    )
    if isinstance(source, Path) and (
        line := photographs.describe_reduction(source, opened.radiance.shape[:2])
    ):
        notices.notice(f"{source}: {line}")
    return opened


def _array_or_path(given: str | np.ndarray) -> Path | np.ndarray:
    return given if isinstance(given, np.ndarray) else Path(given)


def _device(given: str | torch.device) -> torch.device:
    """Return the torch.device that a user named. Raises InputError if it is not available."""
    rule, remedy = "auto, cpu or cuda", "leave it out: the CPU computes"
    if not isinstance(given, str | torch.device):
        raise InputError("device", rule, arguments.shown(given), remedy)
    if str(given) in devices.CHOICES:
        return devices.choose(str(given))
    try:
        result = torch.device(given)
    except RuntimeError:
        raise InputError("device", rule, str(given), remedy) from None
    if result.type not in devices.CHOICES:  # mps, meta and others, for which there is no layer
        raise InputError("device", rule, str(given), remedy)
    if result.type == "cuda":
        devices.choose("cuda")
        if result.index is not None and result.index >= torch.cuda.device_count():
            count = number_of(torch.cuda.device_count(), "CUDA device")
            raise InputError("device", f"one of {count}", str(given), "they are counted from 0")
    return result


@lru_cache(maxsize=2)
def _network(path: str, modified: int, device: str) -> tuple[Coded, int]:
    """Return a network and the size of its pictures; the last two networks stay in memory.

    modified  time at which the file was modified, so that weights trained again are read again
    """
    network, metadata = checkpoint.load_full_network(path, device)
    return network, metadata["size"]


def _labels_read_from_pictures(chosen: Sequence[Material | None]) -> list[np.ndarray]:
    """Return those labels of the materials that were read from pictures."""
    return [label for each in chosen if each is not None for label in each.read]


def _weighted_labels(
    chosen: Sequence[Material | None],
) -> list[tuple[float, list[np.ndarray | None]]]:
    """Return [(weight, label or None of each region)]: pictures whose weighted sum is the edit.

    Regions are blended independently: each combination of their parts has the product of the parts'
    weights.
    """
    result: list[tuple[float, list[np.ndarray | None]]] = [(1.0, [])]
    for each in chosen:
        parts: Sequence[tuple[float, np.ndarray | None]] = (
            ((1.0, None),) if each is None else each.parts
        )
        result = [(w * v, [*labels, label]) for w, labels in result for v, label in parts]
    return result
