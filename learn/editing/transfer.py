"""`learn transfer`: every picture's object and light in every picture's material.

As in the paper's Figures 10 and 15, row i of a grid is the object and light of picture i, column j
the material of picture j; on the diagonal is the picture itself.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch

from learn.data.devices import to_numpy
from learn.editing import decomposition, desired_light, drawing, photograph, region_masks, targets
from learn.editing.compositor import Compositor
from learn.editing.decomposition import Decomposition
from learn.editing.edit import EditOptions
from learn.editing.edit_files import save
from learn.editing.photograph import Photograph
from learn.figures import montage
from learn.figures.montage import Tile
from learn.networks import weights as checkpoint
from manifests import earlier_results, files, outputs
from manifests.errors import InputError
from manifests.inputs import require_file
from manifests.notices import notice
from manifests.progress import tqdm
from shaders import envmap, tone

REMEDY = (
    "put NAME.mask.png beside it, white where the object is, or name a folder of masks:"
    " --mask-dir DIR"
)
LARGEST_LIST = 1 << 20  # bytes: ten thousand long paths
MOST_PER_GRID = 10  # pictures: more become several grids
PICTURES = re.compile(r".+-in-.+\.png|grid(-\d+)?(-under-.+)?\.png", re.DOTALL)


def listed(paths: Iterable[Path], list_file: Path | None = None) -> list[Path]:
    """Return the requested pictures: paths, and the lines of a file of paths, relative to it.

    Raises  InputError for fewer than two pictures, or two of one name
    """
    results = [Path(path) for path in paths]
    if list_file is not None:
        rule = "a text file with one path per line"
        require_file(list_file, rule, maximum_bytes=LARGEST_LIST)
        try:
            lines = Path(list_file).read_text(encoding="utf-8").splitlines()
        except UnicodeDecodeError:
            raise InputError(list_file, rule, "other bytes", "write the paths as UTF-8") from None
        results += [
            Path(list_file).parent / line.strip()
            for line in lines
            if line.strip() and not line.startswith("#")
        ]
    results = [path for path in results if not path.name.endswith(".mask.png")]
    if len(results) < 2:
        raise InputError(
            "pictures",
            "two or more",
            str(len(results)),
            "name them, or give --list FILE with one path per line",
        )
    names = [path.stem for path in results]
    if len(set(names)) < len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise InputError(
            "pictures",
            "names that differ",
            f"{', '.join(twice[:3])} twice",
            "rename one: results are named after them",
        )
    return results


def run(
    paths: Sequence[Path],
    mask_folder: Path | None,
    out: Path,
    edit_options: EditOptions,
    per_grid: int = 6,
    overwrite: bool = False,
    lights: Sequence[str] = (),
    rotation_deg: float = 0.0,
) -> None:
    """Write the edit of every pair of pictures, the grids, and transfer.json.

    The files are SHAPE-in-MATERIAL.png for every pair, and grid.png, or grid-01.png … for many
    pictures. With desired lights (texts of learn.editing.desired_light), they are
    SHAPE-in-MATERIAL-under-LIGHT.png for every object, material and light, and
    grid-under-LIGHT.png; the objects stand alone, on a transparent ground. Raises InputError.
    """
    out = Path(out)
    if not 2 <= per_grid <= MOST_PER_GRID:
        raise InputError(
            "--per-grid",
            f"2 to {MOST_PER_GRID} pictures a grid",
            str(per_grid),
            "more become several grids",
        )
    groups = grouped(paths, per_grid)
    grids = (
        ["grid.png"]
        if len(groups) == 1
        else [f"grid-{i:02d}.png" for i in range(1, len(groups) + 1)]
    )
    if lights:
        labels = light_names(lights)
        grids = [f"{Path(name).stem}-under-{label}.png" for name in grids for label in labels]
        names = [
            relit_name(shape, material, label)
            for group in groups
            for shape in group
            for material in group
            for label in labels
        ]
    else:
        names = [pair_name(*pair) for group in groups for pair in pairs_of(group)]
    inputs: list[str | Path] = [*paths, *(text.partition("#")[0] for text in lights)]
    outputs.reserve_outputs(out, [*grids, *names, "transfer.json"], overwrite, inputs)
    network, metadata = checkpoint.load_parts(edit_options.weights, edit_options.device)
    # Unusable pictures are refused before the first is worked on; they are read again when their
    # turn comes, since all of them together would fill the memory.
    for path in (path for group in groups[1:] for path in group):
        opened(path, mask_folder, edit_options)

    def of_picture(path: Path) -> np.ndarray:
        photo = opened(path, mask_folder, edit_options)
        return light_in(
            decomposition.decompose(photo, network, metadata["size"], edit_options.settings)
        )

    maps = [desired_light.resolve_light(text, of_picture, rotation_deg) for text in lights]
    out.mkdir(parents=True, exist_ok=True)
    report = []
    count = sum(len(group) * (1 + len(group) * len(maps)) for group in groups)
    if not maps:
        count = sum(len(group) ** 2 for group in groups)
    with files.transaction(), tqdm(total=count, unit="picture") as progress:
        for number, group in enumerate(groups):
            name = grids[number * max(len(maps), 1)]
            pictures = {path: opened(path, mask_folder, edit_options) for path in group}
            decompositions = compute(pictures, network, metadata["size"], edit_options, progress)
            report += metadata_of(decompositions, name)
            if maps:
                of_group = grids[number * len(maps) : (number + 1) * len(maps)]
                for label, light, grid in zip(labels, maps, of_group, strict=True):
                    rows = relit_rows(out, decompositions, label, light, edit_options, progress)
                    save(out / grid, montage.contact_sheet(rows, drawing.TILE))
                continue
            tiles_by_row = [head(decompositions)]
            for shape in group:
                tiles = {}
                for material, picture in edits_of(shape, decompositions, edit_options):
                    save_edit(out / pair_name(shape, material), picture, pictures[shape])
                    tiles[material] = tile(picture, decompositions[shape])
                    progress.update()
                tiles_by_row.append(row(shape, decompositions, tiles))
            save(out / name, montage.contact_sheet(tiles_by_row, drawing.TILE))
        about = {"lights": list(lights), "light_rotation_deg": rotation_deg} if lights else {}
        written = earlier_results.written()
        files.write_json(
            out / "transfer.json",
            {"pictures": report} | about | edit_options.as_metadata() | {"files": written},
        )
        if overwrite and (
            line := earlier_results.remove(out / "transfer.json", written, PICTURES, inputs)
        ):
            notice(line)


def light_names(lights: Sequence[str]) -> list[str]:
    """Return what desired lights are called in names of files. Raises InputError for duplicates."""
    names = []
    for text in lights:
        path, _, member = text.partition("#")
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


def light_in(decomposed: Decomposition) -> np.ndarray:
    """Return the light (64, 128, 3) of a decomposed picture, at unit mean."""
    L = to_numpy(decomposed.parts.light[0].movedim(0, -1))
    return envmap.unit_mean(np.ascontiguousarray(L))[0].astype(np.float32)


def relit_rows(
    out: Path,
    decompositions: Mapping[Path, Decomposition],
    label: str,
    light: np.ndarray,
    edit_options: EditOptions,
    progress: tqdm,
) -> list[list[Tile]]:
    """Write the pictures of one grid under a desired light; return the grid's rows.

    Each object is exposed as a light meter at its place would say: a white diffuse object of its
    shape is just not clipped, so that dark and bright materials keep their brightness.
    """
    white = targets.resolve_labels("lambert(#ffffff)", lambda path: np.zeros((1, 108), np.float32))
    assert white is not None
    above = head(decompositions)
    above[0] = (label, montage.light_picture(light))
    rows: list[list[Tile]] = [above]
    for shape, decomposed in decompositions.items():
        compositor = Compositor(decomposed, edit_options.tolerance)
        photo = decomposed.photograph
        exposure = tone.auto_exposure(compositor.relit(white, light), photo.mask)
        before = tile(photo.radiance, decomposed)
        row: list[Tile] = [(shape.stem, before)]
        for material, other in decompositions.items():
            chosen = decomposed.label if material is shape else other.label[:1]
            shown = tone.display(compositor.relit(chosen, light, list(chosen)), exposure)
            alpha = 255.0 * photo.coverage[..., None]
            save(
                out / relit_name(shape, material, label),
                np.concatenate([shown, alpha], -1),
            )
            ground = montage.GROUND + (shown - montage.GROUND) * photo.coverage[..., None]
            row.append(("", drawing.crop_to_object(ground, decomposed)))
            progress.update()
        rows.append(row)
    return rows


def opened(path: Path, mask_folder: Path | None, edit_options: EditOptions) -> Photograph:
    """Return the Photograph at a path, with its mask."""
    return photograph.open_photograph(
        path,
        masks(path, mask_folder),
        None,
        edit_options.balance,
        edit_options.exposure,
        remedy=REMEDY,
    )


def masks(path: Path, folder: Path | None) -> list[Path]:
    """Return the mask file of a picture, in a list; an empty one where its transparency serves."""
    beside = region_masks.find_mask_beside(path, folder)
    if folder is not None and beside is None:
        raise InputError(
            Path(folder) / f"{Path(path).stem}.png",
            f"the mask of {path}",
            "no such file",
            "name masks as the pictures",
        )
    return [] if beside is None else [beside]


def grouped(paths: Sequence[Path], per_grid: int) -> list[list[Path]]:
    """Return lists of at most `per_grid` pictures, in order, none with a single picture."""
    groups = [list(paths[i : i + per_grid]) for i in range(0, len(paths), per_grid)]
    if len(groups) > 1 and len(groups[-1]) == 1:
        groups[-1].insert(0, groups[-2].pop())
    return groups


def pairs_of(group: Sequence[Path]) -> list[tuple[Path, Path]]:
    """Return the pairs (object, material) of a grid, row by row."""
    return [(shape, material) for shape in group for material in group if shape is not material]


def pair_name(shape: Path, material: Path) -> str:
    """Return the file name of one picture's object in another's material."""
    return f"{shape.stem}-in-{material.stem}.png"


def compute(
    pictures: Mapping[Path, Photograph],
    network: torch.nn.Module,
    size: int,
    edit_options: EditOptions,
    progress: tqdm,
) -> dict[Path, Decomposition]:
    """Return {path: Decomposition} of the pictures of one grid."""
    decompositions = {}
    for path, photo in pictures.items():
        progress.set_description(f"decomposing {path.stem}"[:30])
        decompositions[path] = decomposition.decompose(photo, network, size, edit_options.settings)
        progress.update()
    return decompositions


def edits_of(
    shape: Path, decompositions: Mapping[Path, Decomposition], edit_options: EditOptions
) -> Iterator[tuple[Path, np.ndarray]]:
    """Yield (path of the material, edited picture (H, W, 3), linear) of one picture's object."""
    compositor = Compositor(decompositions[shape], edit_options.tolerance, edit_options.detail)
    for material, other in decompositions.items():
        if material is not shape:
            yield material, compositor.edited([other.label[0]], [other.label[0]])


def save_edit(path: Path, picture: np.ndarray, photo: Photograph) -> None:
    """Write a PNG of an edited photograph (H, W, 3), linear, as transparent as the photograph."""
    shown = tone.display(picture, drawing.display_exposure(photo))
    save(path, drawing.with_alpha(shown, photo))


def tile(picture: np.ndarray, decompositions: Decomposition) -> np.ndarray:
    """Return the object's square of a linear picture, as a contact sheet shows it."""
    shown = tone.display(picture, drawing.display_exposure(decompositions.photograph))
    return drawing.crop_to_object(
        drawing.on_ground(shown, decompositions.photograph), decompositions
    )


def head(decompositions: Mapping[Path, Decomposition]) -> list[Tile]:
    """Return a grid's first row: a material sphere above each column."""
    corner: Tile = ("", np.full((8, 8, 3), montage.GROUND / 2))
    return [
        corner,
        *(
            (path.stem, drawing.material_sphere(each.label[0], each))
            for path, each in decompositions.items()
        ),
    ]


def row(
    shape: Path, decompositions: Mapping[Path, Decomposition], tiles: Mapping[Path, np.ndarray]
) -> list[Tile]:
    """Return a grid's row of one object; tiles: {path of the material: tile of the edit}."""
    before = tile(decompositions[shape].photograph.radiance, decompositions[shape])
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
                "energy": energies,
            }
        )
    return report
