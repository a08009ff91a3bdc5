"""The grids of `learn transfer`: which pictures share one, its files, and its rows."""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from learn.editing import desired_light, drawing, targets
from learn.editing.compositor import Compositor
from learn.editing.decomposition import Decomposition
from learn.editing.edit import EditOptions
from learn.editing.edit_files import save_png
from learn.editing.photograph import Photograph
from learn.figures import montage
from learn.figures.montage import Tile
from manifests.errors import InputError
from manifests.progress import tqdm
from shaders import tone


def result_names(
    groups: Sequence[Sequence[Path]], lights: Sequence[str]
) -> tuple[list[str], list[str]]:
    """Return the names of the grids and of the edits of groups of pictures.

    lights  names of the desired lights; none: the edits keep the light of their objects' pictures
    """
    grids = [f"grid-{i:02d}.png" for i in range(1, len(groups) + 1)]
    if len(groups) == 1:
        grids = ["grid.png"]
    if not lights:
        return grids, [pair_name(*pair) for group in groups for pair in pairs_of(group)]
    names = [
        relit_name(shape, material, light)
        for group in groups
        for shape in group
        for material in group
        for light in lights
    ]
    return [f"{Path(name).stem}-under-{light}.png" for name in grids for light in lights], names


def light_names(lights: Sequence[str]) -> list[str]:
    """Return how files are named after desired lights. Raises InputError for duplicates."""
    names = []
    for text in lights:
        path, member = desired_light.split_collection(text)
        stem = member or (text if text.startswith(desired_light.COMPUTED) else Path(path).stem)
        names.append(re.sub(r"[^A-Za-z0-9._-]+", "-", stem)[:80] or "light")
    if len(set(names)) < len(names):
        raise InputError(
            "--light", "lights of different names", ", ".join(names), "rename or drop one"
        )
    return names


def relit_name(shape: Path, material: Path, light: str) -> str:
    """Return the file name of one picture's object in another's material under a desired light."""
    return f"{shape.stem}-in-{material.stem}-under-{light}.png"


def edit_rows(
    out: Path,
    pictures: Mapping[Path, Photograph],
    decompositions: Mapping[Path, Decomposition],
    edit_options: EditOptions,
    progress: tqdm,
) -> list[list[Tile]]:
    """Write the edits of one grid, each in its object's own picture; return the grid's rows."""
    rows = [header_row(decompositions)]
    for shape, photo in pictures.items():
        tiles = {}
        for material, picture in edits_of(shape, decompositions, edit_options):
            save_edit(out / pair_name(shape, material), picture, photo)
            tiles[material] = object_tile(picture, decompositions[shape])
            progress.update()
        rows.append(edit_row(shape, decompositions, tiles))
    return rows


def relit_rows(
    out: Path,
    decompositions: Mapping[Path, Decomposition],
    light_name: str,
    light: np.ndarray,
    edit_options: EditOptions,
    progress: tqdm,
) -> list[list[Tile]]:
    """Write the pictures of one grid under a desired light; return the grid's rows.

    Each object has the exposure at which a white diffuse object of its shape is just not clipped,
    as a light meter in its place would say, so that dark and bright materials keep their
    brightness.

    light  (64, 128, 3) radiance, light frame
    """
    white = targets.resolve_labels("lambert(#ffffff)", lambda path: np.zeros((1, 108), np.float32))
    assert white is not None
    header = header_row(decompositions)
    header[0] = (light_name, montage.light_picture(light))
    rows: list[list[Tile]] = [header]
    for shape, decomposed in decompositions.items():
        compositor = Compositor(decomposed, edit_options.tolerance)
        photo = decomposed.photograph
        exposure = tone.auto_exposure(compositor.relight(white, light), photo.mask)
        before = object_tile(photo.radiance, decomposed)
        row: list[Tile] = [(shape.stem, before)]
        for material, other in decompositions.items():
            chosen = decomposed.label if material is shape else other.label[:1]
            shown = tone.display(compositor.relight(chosen, light, list(chosen)), exposure)
            alpha = 255.0 * photo.coverage[..., None]
            save_png(
                out / relit_name(shape, material, light_name),
                np.concatenate([shown, alpha], -1),
            )
            ground = montage.GROUND + (shown - montage.GROUND) * photo.coverage[..., None]
            row.append(("", drawing.crop_to_object(ground, decomposed)))
            progress.update()
        rows.append(row)
    return rows


def group_pictures(paths: Sequence[Path], per_grid: int) -> list[list[Path]]:
    """Return lists of at most `per_grid` pictures, in order, none with a single picture.

    Of an odd number of pictures in pairs, the last three share a list.
    """
    groups = [list(paths[i : i + per_grid]) for i in range(0, len(paths), per_grid)]
    if len(groups) > 1 and len(groups[-1]) == 1:
        if len(groups[-2]) > 2:
            groups[-1].insert(0, groups[-2].pop())
        else:
            alone = groups.pop()
            groups[-1] += alone
    return groups


def pairs_of(group: Sequence[Path]) -> list[tuple[Path, Path]]:
    """Return the pairs (object, material) of a grid, row by row."""
    return [(shape, material) for shape in group for material in group if shape is not material]


def pair_name(shape: Path, material: Path) -> str:
    """Return the file name of one picture's object in another's material."""
    return f"{shape.stem}-in-{material.stem}.png"


def edits_of(
    shape: Path, decompositions: Mapping[Path, Decomposition], edit_options: EditOptions
) -> Iterator[tuple[Path, np.ndarray]]:
    """Yield (path of the material, edited picture (H, W, 3), linear) of one picture's object."""
    compositor = Compositor(decompositions[shape], edit_options.tolerance, edit_options.detail)
    for material, other in decompositions.items():
        if material is not shape:
            yield material, compositor.edit([other.label[0]], [other.label[0]])


def save_edit(path: Path, picture: np.ndarray, photo: Photograph) -> None:
    """Write a PNG of an edited photograph (H, W, 3), linear, as transparent as the photograph."""
    shown = tone.display(picture, drawing.display_exposure(photo))
    save_png(path, drawing.with_alpha(shown, photo))


def object_tile(picture: np.ndarray, decomposed: Decomposition) -> np.ndarray:
    """Return the object's square of a linear picture, as a contact sheet shows it."""
    shown = tone.display(picture, drawing.display_exposure(decomposed.photograph))
    return drawing.crop_to_object(drawing.on_ground(shown, decomposed.photograph), decomposed)


def header_row(decompositions: Mapping[Path, Decomposition]) -> list[Tile]:
    """Return a grid's first row: a material sphere above each column."""
    corner: Tile = ("", np.full((8, 8, 3), montage.GROUND / 2))
    return [
        corner,
        *(
            (path.stem, drawing.material_sphere(each.label[0], each))
            for path, each in decompositions.items()
        ),
    ]


def edit_row(
    shape: Path, decompositions: Mapping[Path, Decomposition], tiles: Mapping[Path, np.ndarray]
) -> list[Tile]:
    """Return a grid's row of one object; tiles: {path of the material: tile of the edit}."""
    before = object_tile(decompositions[shape].photograph.radiance, decompositions[shape])
    return [
        (shape.stem, before),
        *(("", tiles.get(material, before)) for material in decompositions),
    ]


def metadata_of(decompositions: Mapping[Path, Decomposition], name: str) -> list[dict]:
    """Return what transfer.json says of the pictures of the grid `name`."""
    report = []
    for path, each in decompositions.items():
        refined = each.refined
        energies = None if refined is None else [refined.before["total"], refined.after["total"]]
        report.append(
            {
                "name": path.stem,
                "grid": name,
                "exposure": each.framed.exposure,
                "mask_fitted": each.photograph.given is not None,
                "energy": energies,
            }
        )
    return report
