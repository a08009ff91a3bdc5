"""How edits are shown: display pictures, material spheres, and the rows of contact sheets."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch

from learn.data.devices import to_numpy
from learn.editing import reflectance_store, targets
from learn.editing.decomposition import Decomposition, require_parts
from learn.editing.photograph import Photograph
from learn.figures import montage, spheres
from learn.figures.montage import Tile
from learn.layer import predictions
from shaders import tone

if TYPE_CHECKING:
    from learn.editing.edit import Edit, EditResult

TILE, SPHERE = 224, 128  # pixels of a contact sheet's tiles, and of a material sphere


def display_exposure(opened: Photograph) -> float:
    """Return the exposure under which a photograph and its edits are shown.

    It is 1 for a photograph, whose values are a display's already; for radiance from a renderer it
    is the one that shows the object well.
    """
    scene = opened.record is not None or opened.radiance.max() > 1.001
    return tone.auto_exposure(opened.radiance, opened.mask) if scene else 1.0


def with_alpha(picture: np.ndarray, opened: Photograph) -> np.ndarray:
    """Return display values (H, W, 3), or (H, W, 4) where the photograph is partly transparent."""
    if opened.opacity is None:
        return picture
    return np.concatenate([picture, 255.0 * opened.opacity[..., None]], -1)


def on_ground(picture: np.ndarray, opened: Photograph) -> np.ndarray:
    """Return display values (H, W, 3) over a contact sheet's grey where they are transparent."""
    if opened.opacity is None:
        return picture
    return montage.GROUND + (picture - montage.GROUND) * opened.opacity[..., None]


def crop_to_object(picture: np.ndarray, decomposed: Decomposition) -> np.ndarray:
    """Return the part of a picture inside the square about the object."""
    top, left, side = decomposed.framed.box
    return picture[max(top, 0) : top + side, max(left, 0) : left + side]


def material_sphere(label: np.ndarray | torch.Tensor, decomposed: Decomposition) -> np.ndarray:
    """Return the display picture of a material (108,), seen by a Decomposition's camera."""
    light = torch.from_numpy(spheres.preview_lighting()).movedim(-1, 0)[None]
    return _sphere(to_numpy(torch.as_tensor(label)), light, decomposed, spheres.PREVIEW_EXPOSURE)


def _sphere(
    label: np.ndarray, light: torch.Tensor, decomposed: Decomposition, exposure: float
) -> np.ndarray:
    """Return the display picture of a sphere in a material (108,) under a light (1, 3, Hl, Wl)."""
    n = spheres.sphere_normals(SPHERE)
    inside, picture = (n != 0).any(-1), np.zeros_like(n)
    picture[inside] = reflectance_store.radiance_at_normals(
        label,
        n[inside],
        light.to(decomposed.parts.light.device),
        decomposed.batch.elevation,
        predictions.SHOWN.tolerance,
    )
    return tone.display(picture, exposure)


def reflectance_maps(decomposed: Decomposition) -> list[Tile]:
    """Return tiles of the first region's reflectance map: observed, predicted and refined."""
    first = to_numpy(decomposed.batch.segments[0]) == 1
    # at the network's size the region may be too small to be seen
    mask = first if first.any() else decomposed.framed.mask
    exposure = tone.auto_exposure(decomposed.framed.radiance, mask)
    n = to_numpy(decomposed.parts.n[0].movedim(0, -1))
    what = "reflectance map" if decomposed.photograph.count == 1 else "reflectance map 1"
    observed = spheres.observed_reflectance(decomposed.framed.radiance, n, mask, TILE, exposure)
    tiles: list[Tile] = [(f"{what}, observed", observed)]
    stages = [("predicted", decomposed.start)]
    if decomposed.refined:
        stages.append(("refined", decomposed.refined.prediction))
    for name, prediction in stages:
        _, label, light = require_parts(prediction)
        picture = _sphere(to_numpy(label[0, 0]), light, decomposed, exposure)
        tiles.append((f"{what}, {name}", picture))
    return tiles


def make_sheet_rows(
    result: "EditResult", exposure: float, own: Sequence[np.ndarray], maps: list[Tile]
) -> list[list[Tile]]:
    """Return the rows of a contact sheet: the parts, the reflectance maps, and each edit.

    own   the material sphere of each region
    maps  `reflectance_maps` of the decomposition
    """
    decomposed, opened = result.decomposition, result.decomposition.photograph
    parts, mask = decomposed.parts, decomposed.framed.mask
    before: Tile = ("photograph", on_ground(tone.display(opened.radiance, exposure), opened))
    names = [
        f"material {number}" if opened.count > 1 else "material"
        for number in range(1, len(parts.label[0]) + 1)
    ]
    first = [
        before,
        ("rendered again", on_ground(tone.display(result.rendering, exposure), opened)),
        ("normals", montage.normals_picture(to_numpy(parts.n[0].movedim(0, -1)), mask)),
        ("light", montage.light_picture(to_numpy(parts.light[0].movedim(0, -1)))),
        *zip(names, own, strict=True),
    ]
    of_edits = [make_sheet_row(edit, decomposed, before, exposure) for edit in result.edits]
    return [first, maps, *of_edits]


def make_sheet_row(
    edit: "Edit", decomposed: Decomposition, before: Tile, exposure: float
) -> list[Tile]:
    """Return a contact sheet's row of one edit.

    It shows the photograph, the edit, its target materials, and the truth with the difference from
    it where there is one; the edit is then under the truth's exposure.
    """
    opened = decomposed.photograph
    if edit.truth is not None:
        exposure = tone.auto_exposure(edit.truth, opened.mask)
    shown = tone.display(edit.picture, exposure)
    named = targets.split_by_region(edit.text)
    names = named if len(named) == len(edit.labels) else [edit.text] * len(edit.labels)
    materials = {
        targets.caption_of(name): material_sphere(label, decomposed)
        for name, label in zip(names, edit.labels, strict=True)
        if label is not None
    }
    row = [before, (targets.caption_of(edit.text), on_ground(shown, opened)), *materials.items()]
    if edit.truth is not None:
        right = tone.display(edit.truth, exposure)
        row += [("truth", on_ground(right, opened)), ("|difference|", abs(shown - right))]
    return row
